"""Orbit and attitude as functions of time: along a scenario, or along a record.

Both give the same three things at any small offset from the stamps, so an effect that samples late needs not
know which it is.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.spatial.transform import Rotation

from fluxtwin.sim import epoch
from fluxtwin.sim.constants import GM_EARTH_KM3_S2
from fluxtwin.sim.types import FloatArray, TimeArray

_WINDOW = 9  # stamps in the local fit of the body rate: attitude noise is averaged, a slow spin still followed


@dataclass(frozen=True)
class RecordedMotion:
    """Motion along recorded positions, velocities and attitudes; N rows, all known.

    Positions move by velocity and the pull of the Earth; the body turns at the gyro's rate if there is one, else
    at the rate of a straight line through the rotations of nearby rows. Meant for offsets of a few sample
    spacings at most.
    """

    time: TimeArray
    r_N_km: FloatArray
    v_N_km_s: FloatArray
    R_BN: Rotation
    gyro_B_rad_s: FloatArray | None = None
    """(N, 3) measured body rate; rows may be NaN."""

    def at(self, offset_s: float) -> tuple[FloatArray, FloatArray, Rotation]:
        """Position, velocity (N, 3) and R_BN `offset_s` after each stamp."""
        if offset_s == 0.0:
            return self.r_N_km, self.v_N_km_s, self.R_BN
        pull = -GM_EARTH_KM3_S2 * self.r_N_km / np.linalg.norm(self.r_N_km, axis=1)[:, None] ** 3
        r = self.r_N_km + offset_s * self.v_N_km_s + 0.5 * offset_s**2 * pull
        v = self.v_N_km_s + offset_s * pull
        return r, v, Rotation.from_rotvec(-offset_s * self.rate_B_rad_s) * self.R_BN

    @cached_property
    def rate_B_rad_s(self) -> FloatArray:
        """(N, 3) body rate relative to N, components in B."""
        seconds = epoch.seconds_since(self.time, self.time[0])
        rate = _fitted_rate(seconds, self.R_BN)
        if self.gyro_B_rad_s is not None:
            measured = np.isfinite(self.gyro_B_rad_s).all(axis=1)
            rate[measured] = self.gyro_B_rad_s[measured]
        return rate


def _fitted_rate(seconds: FloatArray, R_BN: Rotation) -> FloatArray:
    """Slope of the rotation vector from each row to its neighbours, by least squares over a short window."""
    rows = seconds.size
    if rows < 2:
        return np.zeros((rows, 3))
    spacing = float(np.median(np.diff(seconds)))
    half = min(_WINDOW // 2, rows - 1)
    moment, weight = np.zeros((rows, 3)), np.zeros(rows)
    index = np.arange(rows)
    for lag in [*range(-half, 0), *range(1, half + 1)]:
        other = index + lag
        inside = (other >= 0) & (other < rows)
        here, there = index[inside], other[inside]
        step = seconds[there] - seconds[here]
        turn = -np.atleast_2d((R_BN[there] * R_BN[here].inv()).as_rotvec())
        # Neighbours across a gap, or so far round that the short way is ambiguous, say nothing.
        good = (np.abs(step) <= (abs(lag) + 0.5) * spacing) & (np.linalg.norm(turn, axis=1) < 2.0)
        moment[here[good]] += step[good, None] * turn[good]
        weight[here[good]] += step[good] ** 2
    return np.asarray(moment / np.where(weight > 0, weight, 1.0)[:, None])
