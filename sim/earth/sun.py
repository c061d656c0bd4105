"""The sun as seen from the spacecraft: where it is, and how much of it the Earth covers.

The position is apparent (with the annual aberration, 20.5 arcsec), because that is what a sensor sees and
what casts the shadow; the aberration by the spacecraft's own motion (5 arcsec) is left out.

The Earth is a sphere of the WGS 84 equatorial radius, 6378.137 km, without atmosphere. A real shadow edge
differs by the flattening (up to 21 km lower near a pole) and by the air (some tens of km higher): together
a few seconds of an eclipse in low orbit.
"""

from __future__ import annotations

import erfa
import numpy as np

from fluxtwin.sim.base.types import FloatArray, TimeArray
from fluxtwin.sim.earth import epoch
from fluxtwin.sim.earth.constants import AU_KM, EARTH_RADIUS_KM, SUN_RADIUS_KM
from fluxtwin.sim.earth.frames import on_grid

_GRID_DAYS = 0.25  # spline error below 1e-3 km, tested against the full series
_AU_PER_DAY_IN_C = AU_KM / (299792.458 * 86400.0)
_J2000 = 2451545.0


def sun_N_km(time: TimeArray | np.datetime64) -> FloatArray:
    """Apparent geocentric position of the sun in GCRS [km], shape (N, 3).

    Source: ERFA epv00 (a fit to VSOP2000 and DE405, 11 km at most over 1900-2100) and ab for the aberration; TDB is
    taken as TT (0.002 s). For long records the series is splined on a six-hour grid.
    """
    tt1, tt2 = epoch.jd_tt(time)
    return on_grid((tt1 - _J2000) + tt2, _apparent_sun_N_km, _GRID_DAYS)


def sun_direction_N(time: TimeArray | np.datetime64, r_N_km: FloatArray | None = None) -> FloatArray:
    """Unit vectors to the sun in GCRS, shape (N, 3).

    r_N_km: where the observer is, shape (N, 3) or (3,); the Earth's centre if absent (in low orbit the
    parallax is at most 10 arcsec).
    """
    towards = sun_N_km(time)
    if r_N_km is not None:
        towards = towards - np.asarray(r_N_km, dtype=np.float64)
    return np.asarray(towards / np.linalg.norm(towards, axis=1)[:, None])


def illumination(r_N_km: FloatArray, sun_N_km: FloatArray) -> FloatArray:
    """Fraction of the sun's disc that the Earth leaves free, 0 (umbra) to 1 (full sunlight), shape (N,).

    r_N_km, sun_N_km: geocentric positions of the spacecraft and the sun, shape (N, 3), same axes. The cones
    of umbra and penumbra follow from the overlap of the two discs on the sky, taken as flat discs (right to
    0.001 in low orbit) without limb darkening (Montenbruck & Gill, Satellite Orbits, 2000, section 3.4.2).
    NaN where a position is NaN.
    """
    r = np.atleast_2d(np.asarray(r_N_km, dtype=np.float64))
    to_sun = np.atleast_2d(np.asarray(sun_N_km, dtype=np.float64)) - r
    distance = np.linalg.norm(r, axis=1)
    sun_radius = np.arcsin(SUN_RADIUS_KM / np.linalg.norm(to_sun, axis=1))
    earth_radius = np.arcsin(EARTH_RADIUS_KM / np.maximum(distance, EARTH_RADIUS_KM))
    separation = np.arctan2(np.linalg.norm(np.cross(to_sun, r), axis=1), -np.einsum("ij,ij->i", to_sun, r))
    free = np.where(separation >= earth_radius + sun_radius, 1.0, 0.0)
    crossing = separation > np.abs(earth_radius - sun_radius)
    partial = crossing & (separation < earth_radius + sun_radius)
    a, b, c = sun_radius[partial], earth_radius[partial], separation[partial]
    free[partial] = 1.0 - _overlap(a, b, c) / (np.pi * a**2)
    # An annulus around the Earth is seen only from beyond 1.4 million km.
    ring = separation <= sun_radius - earth_radius
    free[ring] = 1.0 - (earth_radius[ring] / sun_radius[ring]) ** 2
    free[np.isnan(separation)] = np.nan
    return np.clip(free, 0.0, 1.0)


def _overlap(a: FloatArray, b: FloatArray, c: FloatArray) -> FloatArray:
    """Area common to two flat discs of radii a, b whose centres are c apart, where their edges cross."""
    x = (c**2 + a**2 - b**2) / (2.0 * c)
    y = np.sqrt(np.maximum(a**2 - x**2, 0.0))
    in_a = a**2 * np.arccos(np.clip(x / a, -1.0, 1.0))
    in_b = b**2 * np.arccos(np.clip((c - x) / b, -1.0, 1.0))
    return np.asarray(in_a + in_b - c * y)


def _apparent_sun_N_km(days_tt: FloatArray) -> FloatArray:
    heliocentric, barycentric = erfa.epv00(_J2000, days_tt)
    to_sun = -heliocentric["p"]
    distance = np.linalg.norm(to_sun, axis=1)
    velocity_c = barycentric["v"] * _AU_PER_DAY_IN_C
    contraction = np.sqrt(1.0 - np.einsum("ij,ij->i", velocity_c, velocity_c))
    apparent = erfa.ab(to_sun / distance[:, None], velocity_c, distance, contraction)
    return np.asarray(AU_KM * distance[:, None] * apparent)
