"""Infrared horizon scanner: roll and pitch from the Earth's disc."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fluxtwin.sim.attitude.gauss_markov import gauss_markov
from fluxtwin.sim.base.errors import BadInput
from fluxtwin.sim.base.types import FloatArray, TimeArray


def roll_pitch(nadir_B: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Roll and pitch [rad], each (N,), of the 3-1-2 set from the nadir direction in body axes (N, 3).

    Nadir is z of O, so nadir_B = (-sin p cos r, sin r, cos p cos r), whatever the yaw.
    """
    nadir = np.atleast_2d(np.asarray(nadir_B, dtype=np.float64))
    return np.arctan2(nadir[:, 1], np.hypot(nadir[:, 0], nadir[:, 2])), np.arctan2(-nadir[:, 0], nadir[:, 2])


def nadir_from(roll_rad: FloatArray, pitch_rad: FloatArray) -> FloatArray:
    """Nadir direction in body axes (N, 3) from roll and pitch; inverse of `roll_pitch`."""
    nadir: FloatArray = np.stack(
        [-np.sin(pitch_rad) * np.cos(roll_rad), np.sin(roll_rad), np.cos(pitch_rad) * np.cos(roll_rad)],
        axis=-1,
    )
    return nadir


@dataclass(frozen=True)
class HorizonScanner:
    """Roll and pitch, each with bias, correlated error, white noise and rounding, added in that order."""

    noise_rad: float = 0.0
    """White noise of a single reading, 1 sigma per angle."""
    lsb_rad: float = 0.0
    bias_rad: tuple[float, float] = (0.0, 0.0)
    """Constant error of roll and of pitch."""
    wander_rad: float = 0.0
    """Standard deviation of the correlated error per angle (Gauss-Markov)."""
    wander_tau_s: float = 0.0
    field_of_view_rad: float = float(np.pi)
    """Largest angle between body z and nadir at which the scanner still finds the Earth."""

    def __post_init__(self) -> None:
        if min(self.noise_rad, self.lsb_rad, self.wander_rad, self.wander_tau_s) < 0:
            raise BadInput(f"{self}", where="horizon scanner", wanted="noise, LSB, wander and tau >= 0")

    def measure(
        self, time: TimeArray, nadir_B: FloatArray, rng: np.random.Generator
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Measured roll (N,), pitch (N,) [rad] and the nadir direction that they make, (N, 3).

        nadir_B (N, 3) true unit vectors in body axes. NaN where nadir is outside the field of view.
        """
        nadir = np.atleast_2d(np.asarray(nadir_B, dtype=np.float64))
        angles = np.stack(roll_pitch(nadir), axis=1)
        wander = gauss_markov(time, self.wander_rad, self.wander_tau_s, rng, columns=2)
        angles = angles + self.bias_rad + wander + self.noise_rad * rng.standard_normal(angles.shape)
        if self.lsb_rad > 0:
            angles = self.lsb_rad * np.rint(angles / self.lsb_rad)
        off_axis = np.arctan2(np.hypot(nadir[:, 0], nadir[:, 1]), nadir[:, 2])
        angles[off_axis > self.field_of_view_rad] = np.nan
        return angles[:, 0], angles[:, 1], nadir_from(angles[:, 0], angles[:, 1])
