"""What an attitude may be relative to, by name: inertial and Earth-fixed axes, local ones, and those of two directions."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from fluxtwin.sim.base.types import FloatArray, TimeArray
from fluxtwin.sim.earth import frames
from fluxtwin.sim.earth.sun import sun_direction_N

OF_POSITION = ("NEC", "NED", "orbital", "sun_nadir", "nadir_sun")
"""These need the position; `orbital` the velocity too. The others are those of `frames.rotation_from_N`."""


def rotation_XN(
    name: str, time: TimeArray, r_N_km: FloatArray | None = None, v_N_km_s: FloatArray | None = None
) -> Rotation:
    """GCRS to the axes called `name` at each stamp. Batch of N.

    orbital: z nadir, y negative orbit normal. NEC: geocentric north, east, centre. NED: geodetic north, east, down (WGS 84).
    sun_nadir: x at the sun, y along sun cross nadir; nadir_sun likewise with x at nadir. Positions and velocities: GCRS.
    """
    if name not in OF_POSITION:
        return frames.rotation_from_N(name, time)
    assert r_N_km is not None
    if name == "orbital":
        assert v_N_km_s is not None
        return frames.rotation_ON(r_N_km, v_N_km_s)
    if name in ("NEC", "NED"):
        R_EN = frames.rotation_EN(time)
        r_E_km = R_EN.apply(r_N_km)
        if name == "NEC":
            return frames.rotation_NEC_E(r_E_km) * R_EN
        return frames.rotation_NEC_geodetic(*frames.geodetic(r_E_km)[:2]) * R_EN
    pair = (sun_direction_N(time, r_N_km), -r_N_km)
    return triad(*(pair if name == "sun_nadir" else pair[::-1]))


def triad(first: FloatArray, second: FloatArray) -> Rotation:
    """Turns components into those along `first`, `first` cross `second`, and the third, vectors (N, 3) of any length.

    The first direction is followed exactly (Black 1964). Rows in which the two are parallel are not to be asked for.
    """
    return Rotation.from_matrix(triad_matrices(first, second))


def triad_matrices(first: FloatArray, second: FloatArray) -> FloatArray:
    """(N, 3, 3) as `triad`."""
    x = first / np.linalg.norm(first, axis=1, keepdims=True)
    y = np.cross(first, second)
    y = y / np.linalg.norm(y, axis=1, keepdims=True)
    return np.stack([x, y, np.cross(x, y)], axis=1)
