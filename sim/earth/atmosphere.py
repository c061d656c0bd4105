"""Density of the upper air from a table: exponential layers, no sun, no season.

The table: base altitude [km], density there [kg/m3], scale height [km]; US Standard Atmosphere 1976 at the ground,
CIRA-72 from 25 to 500 km, CIRA-72 with an exospheric temperature of 1000 K above. As printed in Wertz 1978, p. 820,
and Vallado, Fundamentals of Astrodynamics and Applications, 4th ed. 2013, table 8-4. Real density differs from it by a
factor of up to ten at 600 km between solar minimum and maximum.
"""

from __future__ import annotations

import numpy as np

from fluxtwin.sim.base.errors import OutOfRange
from fluxtwin.sim.base.types import FloatArray, TimeArray
from fluxtwin.sim.earth import frames

LAYERS = (
    (0.0, 1.225, 7.249),
    (25.0, 3.899e-2, 6.349),
    (30.0, 1.774e-2, 6.682),
    (40.0, 3.972e-3, 7.554),
    (50.0, 1.057e-3, 8.382),
    (60.0, 3.206e-4, 7.714),
    (70.0, 8.770e-5, 6.549),
    (80.0, 1.905e-5, 5.799),
    (90.0, 3.396e-6, 5.382),
    (100.0, 5.297e-7, 5.877),
    (110.0, 9.661e-8, 7.263),
    (120.0, 2.438e-8, 9.473),
    (130.0, 8.484e-9, 12.636),
    (140.0, 3.845e-9, 16.149),
    (150.0, 2.070e-9, 22.523),
    (180.0, 5.464e-10, 29.740),
    (200.0, 2.789e-10, 37.105),
    (250.0, 7.248e-11, 45.546),
    (300.0, 2.418e-11, 53.628),
    (350.0, 9.518e-12, 53.298),
    (400.0, 3.725e-12, 58.515),
    (450.0, 1.585e-12, 60.828),
    (500.0, 6.967e-13, 63.822),
    (600.0, 1.454e-13, 71.835),
    (700.0, 3.614e-14, 88.667),
    (800.0, 1.170e-14, 124.64),
    (900.0, 5.245e-15, 181.05),
    (1000.0, 3.019e-15, 268.00),
)


def density_kg_m3(altitude_km: FloatArray) -> FloatArray:
    """Density at altitudes above the ellipsoid, any shape. Raises OutOfRange below the ground."""
    altitude = np.asarray(altitude_km, dtype=np.float64)
    base, density, scale_height = np.array(LAYERS).T
    if (altitude < 0.0).any():
        raise OutOfRange(f"{altitude.min():g} km altitude", where="air density", wanted="0 km or more")
    layer = np.searchsorted(base, altitude, side="right") - 1
    return np.asarray(density[layer] * np.exp(-(altitude - base[layer]) / scale_height[layer]))


def density_along(time: TimeArray, r_N_km: FloatArray) -> FloatArray:
    """Density [kg/m3] at GCRS positions (N, 3), by the altitude above the WGS 84 ellipsoid."""
    *_, altitude_km = frames.geodetic(frames.rotation_EN(time).apply(r_N_km))
    return density_kg_m3(altitude_km)
