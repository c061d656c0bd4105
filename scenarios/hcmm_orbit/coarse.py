"""A first guess of the orbit from acquisition times alone, by trying the whole sky: no starting value is needed."""

from __future__ import annotations

import numpy as np

from fluxtwin.scenarios.hcmm_orbit.geometry import EPOCH, INCLINATION_DEG
from fluxtwin.scenarios.hcmm_orbit.record import Pass, read_stations
from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.earth import epoch, frames
from fluxtwin.sim.earth.constants import EARTH_RADIUS_KM
from fluxtwin.sim.earth.orbit import orbital_rates

_ANGLES_DEG = np.arange(0.0, 360.0, 4.0)
_AXES_KM = np.arange(6930.0, 7070.1, 4.0)
"""Periods of 95.8 to 98.7 min: launch reports give 96.7."""
_MOST_DEG = 12.0
"""A pass further from its horizon than this counts no more: a wrong time must not decide."""


def first_guess(passes: tuple[Pass, ...]) -> tuple[float, float, float]:
    """(a [km], RAAN [deg], argument of latitude [deg]) at EPOCH.

    A satellite that rises stands at the horizon: the angle at the Earth's centre between it and the station is
    acos(R/a), and shrinks. The score is the mean distance from that, of trial orbits on a grid of all three elements.
    """
    time = np.array([item.aos for item in passes])
    seconds = epoch.seconds_since(time, EPOCH)
    stations = read_stations()
    fixed = np.array([stations[item.station].r_E_km for item in passes])
    # The equator of date at the epoch serves for three days.
    up = (frames.rotation_TN(EPOCH) * frames.rotation_EN(time).inv()).apply(fixed)
    up = up / np.linalg.norm(up, axis=1)[:, None]
    later = _later(up)
    best = (np.inf, (0.0, 0.0, 0.0))
    for axis_km in _AXES_KM:
        score = _scores(float(axis_km), seconds, up, later)
        at = np.unravel_index(int(np.argmin(score)), score.shape)
        best = min(best, (float(score[at]), (float(axis_km), float(_ANGLES_DEG[at[0]]), float(_ANGLES_DEG[at[1]]))))
    return best[1]


def _later(up: FloatArray, minutes: float = 3.0) -> FloatArray:
    """The stations' verticals a few minutes later: the Earth turns."""
    angle = 2.0 * np.pi * minutes / 1436.07
    c, s = np.cos(angle), np.sin(angle)
    return np.stack([c * up[:, 0] - s * up[:, 1], s * up[:, 0] + c * up[:, 1], up[:, 2]], axis=1)


def _scores(axis_km: float, seconds: FloatArray, up: FloatArray, later: FloatArray) -> FloatArray:
    """(nodes, latitudes) mean distance from the horizon in deg, passes that set instead of rising counted as lost."""
    horizon = float(np.degrees(np.arccos(EARTH_RADIUS_KM / axis_km)))
    now = _from_horizon(axis_km, seconds, up)
    then = _from_horizon(axis_km, seconds + 180.0, later)
    distance = np.minimum(np.abs(now - horizon), _MOST_DEG)
    return np.asarray(np.where(then < now, distance, _MOST_DEG).mean(axis=-1))


def _from_horizon(axis_km: float, seconds: FloatArray, up: FloatArray) -> FloatArray:
    """(nodes, latitudes, P) angle at the Earth's centre between satellite and station [deg]."""
    inclination = np.radians(INCLINATION_DEG)
    rates = orbital_rates(axis_km, 0.0, float(inclination))
    node = np.radians(_ANGLES_DEG)[:, None] + rates.raan_rad_s * seconds[None, :]
    u = np.radians(_ANGLES_DEG)[:, None] + (rates.argument_of_perigee_rad_s + rates.mean_anomaly_rad_s) * seconds
    cn, sn, ci, si = np.cos(node), np.sin(node), np.cos(inclination), np.sin(inclination)
    along = up[:, 0] * cn + up[:, 1] * sn
    across = ci * (-up[:, 0] * sn + up[:, 1] * cn) + si * up[:, 2]
    cosine = along[:, None, :] * np.cos(u)[None, :, :] + across[:, None, :] * np.sin(u)[None, :, :]
    return np.asarray(np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))))
