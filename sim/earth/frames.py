"""The frames, defined once, and the rotations between them.

| letter | frame |
|---|---|
| N | GCRS: inertial, Earth-centred |
| E | Earth-fixed (ITRS), with UT1 = UTC and no polar motion: under 0.42 km at the equator |
| O | orbital, as in Lerner & Shuster: z nadir, y negative orbit normal, x = y cross z (along the motion) |
| B | body |
| S | magnetometer |
| NEC | local geocentric north, east, centre (down) |

`R_BN` is a scipy `Rotation` that turns N components into B components, `v_B = R_BN.apply(v_N)`; inner letters
cancel: `R_BN = R_BO * R_ON`. Its `.as_matrix()` is the attitude matrix A of the papers.

The trap: a *textbook* attitude quaternion of the body relative to N (Wertz; Markley & Crassidis), scalar
last, read by scipy's `Rotation.from_quat`, is `R_NB` (body to inertial), because scipy's quaternion is
active. Columns and arrays called `q_NB` hold the textbook quaternion; `R_BN = rotation_from_q(q_NB)`.

Yaw, roll and pitch are the 3-1-2 set from O to B: first yaw about z, then roll about x, then pitch about y.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import Any

import erfa
import numpy as np
from scipy.spatial.transform import Rotation

from fluxtwin.sim.base.errors import BadInput
from fluxtwin.sim.base.types import FloatArray, TimeArray
from fluxtwin.sim.earth import epoch
from fluxtwin.sim.earth.constants import EARTH_FLATTENING, EARTH_RADIUS_KM

_GRID_DAYS = 0.125  # spline of the slow part on this grid: below 1e-11 rad, tested against the full series
_J2000 = 2451545.0  # TT
_MARGIN = 3  # nodes beyond each end, so that the end condition of the spline does not reach the data
_REMEMBERED_ROWS = 50_000  # sixteen such series and their rotations are 30 MB


def rotation_EN(time: TimeArray | np.datetime64) -> Rotation:
    """GCRS to ITRS at each stamp. Batch of N.

    IAU 2006/2000A (ERFA xys06a, era00), UT1 = UTC, no polar motion. For more than a few hundred stamps the
    slow part (all but the Earth's rotation) is splined on a three-hour grid.
    """
    stamps = epoch.as_times(time)
    return _of_stamps(stamps.tobytes()) if stamps.size <= _REMEMBERED_ROWS else _rotation_EN(stamps)


@lru_cache(maxsize=16)
def _of_stamps(stamps: bytes) -> Rotation:
    """A Monte Carlo and a diagnosis ask for the same stamps again and again; a Rotation cannot be changed."""
    return _rotation_EN(np.frombuffer(stamps, dtype="datetime64[ns]"))


def _rotation_EN(stamps: TimeArray) -> Rotation:
    """The slow part as quaternions: matrices would have to be made, and taken apart again, in every row."""
    half = -0.5 * erfa.era00(*epoch.jd_ut1(stamps))
    spin = np.stack([np.zeros_like(half), np.zeros_like(half), np.sin(half), np.cos(half)], axis=1)
    slow = on_grid(_days_tt(stamps), _intermediate_pole, _GRID_DAYS)
    return product(Rotation.from_quat(spin), Rotation.from_quat(slow))


def rotation_TN(time: TimeArray | np.datetime64) -> Rotation:
    """GCRS to true equator and equinox of date at each stamp. Batch of N.

    IAU 2006/2000A (ERFA pnm06a), splined on a three-hour grid for more than a few hundred stamps.
    """
    return Rotation.from_matrix(on_grid(_days_tt(time), _equator_of_date, _GRID_DAYS).reshape(-1, 3, 3))


def rotation_from_N(name: str, time: TimeArray) -> Rotation:
    """GCRS to other inertial or Earth-fixed axes that foreign files use, by name, at each stamp. Batch of N.

    J2000: mean equator and equinox of J2000.0, 0.023 arcsec from GCRS (ERFA bp06, frame bias). mean_of_date and
    true_of_date: mean or true equator and equinox at the stamp (ERFA pmat06, pnm06a). ITRS: as `rotation_EN`.
    """
    if name == "GCRS":
        return Rotation.identity(len(time))
    if name == "J2000":
        bias = erfa.bp06(_J2000, 0.0)[0]
        return Rotation.from_matrix(np.tile(bias, (len(time), 1, 1)))  # older scipy refuses what is read-only
    if name == "mean_of_date":
        return Rotation.from_matrix(erfa.pmat06(*epoch.jd_tt(time)))
    return {"true_of_date": rotation_TN, "ITRS": rotation_EN}[name](time)


def rotation_ON(r_N_km: FloatArray, v_N_km_s: FloatArray) -> Rotation:
    """N to the papers' orbital frame from position and velocity, shapes (N, 3). Batch of N.

    Raises BadInput where position and velocity are parallel or zero.
    """
    r = np.atleast_2d(np.asarray(r_N_km, dtype=np.float64))
    v = np.atleast_2d(np.asarray(v_N_km_s, dtype=np.float64))
    normal = np.cross(r, v)
    size = np.linalg.norm(normal, axis=1)
    if not (size > 0).all():
        row = int(np.flatnonzero(~(size > 0))[0])
        raise BadInput(f"position and velocity are parallel or zero in row {row}", where="orbital frame")
    z = -r / np.linalg.norm(r, axis=1)[:, None]
    y = -normal / size[:, None]
    x = np.cross(y, z)
    return Rotation.from_matrix(np.stack([x, y, z], axis=1))


def rotation_from_q(q_NB: FloatArray) -> Rotation:
    """R_BN from textbook quaternions of the body relative to N, scalar last, shape (N, 4).

    Raises BadInput for a zero quaternion (there is no such attitude); names the first row.
    """
    q = np.atleast_2d(np.asarray(q_NB, dtype=np.float64))
    size = np.linalg.norm(q, axis=1)
    if not (size > 1e-8).all():
        row = int(np.flatnonzero(~(size > 1e-8))[0])
        raise BadInput(
            f"the quaternion in row {row} is zero or not a number",
            where="q_x q_y q_z q_w",
            wanted="unit quaternions; leave the row blank where the attitude is not known",
        )
    return Rotation.from_quat(q).inv()


def q_from_rotation(R_BN: Rotation) -> FloatArray:
    """Textbook quaternions q_NB, scalar last, scalar >= 0, shape (N, 4). Inverse of `rotation_from_q`."""
    return np.asarray(np.atleast_2d(R_BN.inv().as_quat(canonical=True)))


def product(first: Rotation, second: Rotation) -> Rotation:
    """first * second, each of (N,) or one, to the bit as scipy gives it, and at a tenth of what its loop takes."""
    p, q = first.as_quat(), second.as_quat()
    (a, b, c, d), (e, f, g, h) = np.ascontiguousarray(p.T), np.ascontiguousarray(q.T)
    both = np.empty(np.broadcast_shapes(p.shape, q.shape))
    both[..., 0] = d * e + h * a + (b * g - c * f)
    both[..., 1] = d * f + h * b + (c * e - a * g)
    both[..., 2] = d * g + h * c + (a * f - b * e)
    both[..., 3] = d * h - a * e - b * f - c * g
    return Rotation.from_quat(both)


def rotation_BO(yaw_rad: FloatArray, roll_rad: FloatArray, pitch_rad: FloatArray) -> Rotation:
    """O to B from the 3-1-2 angles, each of shape (N,). To first order the matrix of journal equation 13:
    [[1, y, -p], [-y, 1, r], [p, -r, 1]]."""
    angles = np.stack(np.broadcast_arrays(yaw_rad, roll_rad, pitch_rad), axis=-1)
    return Rotation.from_euler("ZXY", np.atleast_2d(angles)).inv()


def yaw_roll_pitch(R_BO: Rotation) -> tuple[FloatArray, FloatArray, FloatArray]:
    """The 3-1-2 angles (yaw, roll, pitch) in rad, each (N,). Inverse of `rotation_BO`."""
    angles = np.atleast_2d(R_BO.inv().as_euler("ZXY"))
    return angles[:, 0], angles[:, 1], angles[:, 2]


def roll_pitch(nadir_B: FloatArray) -> FloatArray:
    """(N, 2) roll and pitch of the 3-1-2 set [rad] from nadir (N, 3) in body axes, of any length; whatever the yaw."""
    x, y, z = np.asarray(nadir_B).T
    return np.stack([np.arctan2(y, np.hypot(x, z)), np.arctan2(-x, z)], axis=1)


def nadir_of(roll_pitch_rad: FloatArray) -> FloatArray:
    """(N, 3) unit vectors. Inverse of `roll_pitch`."""
    roll, pitch = roll_pitch_rad.T
    return np.stack([-np.sin(pitch) * np.cos(roll), np.sin(roll), np.cos(pitch) * np.cos(roll)], axis=1)


def angle_between(a: FloatArray, b: FloatArray) -> FloatArray:
    """(N,) angles between vectors (N, 3) of any length [rad], exact for small ones too."""
    return np.asarray(np.arctan2(np.linalg.norm(np.cross(a, b), axis=1), np.einsum("ij,ij->i", a, b)))


def rotation_NEC_E(r_E_km: FloatArray) -> Rotation:
    """E to local geocentric north, east, centre at each position, shape (N, 3).

    At a pole, east is where the Greenwich meridian's y axis points.
    """
    latitude, longitude, _ = geocentric(r_E_km)
    sl, cl = np.sin(latitude), np.cos(latitude)
    so, co = np.sin(longitude), np.cos(longitude)
    zero = np.zeros_like(so)
    north = np.stack([-sl * co, -sl * so, cl], axis=1)
    east = np.stack([-so, co, zero], axis=1)
    centre = np.stack([-cl * co, -cl * so, -sl], axis=1)
    return Rotation.from_matrix(np.stack([north, east, centre], axis=1))


def geocentric(r_E_km: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Geocentric latitude [rad], east longitude [rad], radius [km] of positions (N, 3)."""
    r = np.atleast_2d(np.asarray(r_E_km, dtype=np.float64))
    horizontal = np.hypot(r[:, 0], r[:, 1])
    return (
        np.arctan2(r[:, 2], horizontal),
        np.arctan2(r[:, 1], r[:, 0]),
        np.hypot(horizontal, r[:, 2]),
    )


def from_geocentric(latitude_rad: FloatArray, longitude_rad: FloatArray, radius_km: FloatArray) -> FloatArray:
    """Earth-fixed positions (N, 3) in km from geocentric latitude, longitude and radius."""
    cl = np.cos(latitude_rad)
    unit = np.stack([cl * np.cos(longitude_rad), cl * np.sin(longitude_rad), np.sin(latitude_rad)], axis=-1)
    return np.asarray(np.asarray(radius_km, dtype=np.float64)[..., None] * unit)


def from_geodetic(latitude_rad: FloatArray, longitude_rad: FloatArray, altitude_km: FloatArray) -> FloatArray:
    """Earth-fixed positions (N, 3) in km from WGS 84 geodetic coordinates (ERFA gd2gce)."""
    lon, lat, height = np.broadcast_arrays(longitude_rad, latitude_rad, altitude_km)
    xyz = erfa.gd2gce(EARTH_RADIUS_KM * 1e3, EARTH_FLATTENING, lon, lat, np.asarray(height) * 1e3)
    return np.atleast_2d(np.asarray(xyz)) * 1e-3


def geodetic(r_E_km: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """WGS 84 latitude [rad], east longitude [rad], altitude [km] of positions (N, 3) (ERFA gc2gde)."""
    r = np.atleast_2d(np.asarray(r_E_km, dtype=np.float64)) * 1e3
    longitude, latitude, height = erfa.gc2gde(EARTH_RADIUS_KM * 1e3, EARTH_FLATTENING, r)
    return latitude, longitude, height * 1e-3


def rotation_NEC_geodetic(latitude_rad: FloatArray, longitude_rad: FloatArray) -> Rotation:
    """E to local *geodetic* north, east, down at WGS 84 latitude and longitude, each (N,)."""
    lat, lon = np.broadcast_arrays(np.atleast_1d(latitude_rad), np.atleast_1d(longitude_rad))
    return rotation_NEC_E(from_geocentric(lat, lon, np.ones_like(lat)))


def on_grid(days: FloatArray, function: Callable[[FloatArray], FloatArray], step_days: float) -> FloatArray:
    """`function(days)`, shape (N, K), by a cubic spline on a grid of `step_days`.

    days: (N,) in any order. function: (M,) -> (M, K), smooth over a few steps. Where the grid would not
    save work (few rows, or rows far apart) the function itself is called.
    """
    first, last = int(np.floor(days.min() / step_days)), int(np.ceil(days.max() / step_days))
    nodes = last - first + 1 + 2 * _MARGIN
    if days.size <= 2 * nodes:
        return function(days)
    return np.asarray(_spline(function, first - _MARGIN, nodes, step_days)(days))


@lru_cache(maxsize=8)
def _spline(function: Callable[[FloatArray], FloatArray], first: int, nodes: int, step_days: float) -> Any:
    """Through `nodes` whole multiples of the step from the `first` on, which records that start a little later share."""
    from scipy.interpolate import CubicSpline  # here: it takes a fifth of a second to load

    grid: FloatArray = step_days * np.arange(first, first + nodes, dtype=np.float64)
    return CubicSpline(grid, function(grid))


def _days_tt(time: TimeArray | np.datetime64) -> FloatArray:
    tt1, tt2 = epoch.jd_tt(time)
    return np.asarray((tt1 - _J2000) + tt2)


def _intermediate_pole(days_tt: FloatArray) -> FloatArray:
    """(M, 4) quaternions, scalar last, of GCRS to the celestial intermediate frame: close to one, so their signs agree."""
    return Rotation.from_matrix(erfa.c2ixys(*erfa.xys06a(_J2000, days_tt))).as_quat()


def _equator_of_date(days_tt: FloatArray) -> FloatArray:
    return np.asarray(erfa.pnm06a(_J2000, days_tt).reshape(-1, 9))
