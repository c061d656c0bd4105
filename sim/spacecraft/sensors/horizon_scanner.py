"""Infrared horizon scanner: roll and pitch from the Earth's disc."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from fluxtwin.sim.attitude.gauss_markov import gauss_markov
from fluxtwin.sim.base.errors import BadInput
from fluxtwin.sim.base.section_types import NonNegative
from fluxtwin.sim.base.types import FloatArray, TimeArray
from fluxtwin.sim.earth import horizon
from fluxtwin.sim.spacecraft.sensors.base import SensorSection, Surroundings
from fluxtwin.sim.spacecraft.sensors.horizon_crossings import ConicalScanner


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


class HorizonScannerSection(SensorSection):
    """Measures roll and pitch against the Earth's horizon; noise is correlated over `tau_s`."""

    earth: Literal["disc", "ellipsoid", "infrared"] = "disc"
    """What is seen: a disc whose middle is found as it is, or the horizon of that surface, crossed by conical scans."""
    assumed: Literal["sphere", "ellipsoid"] = "sphere"
    """What the processing takes the Earth for."""
    scans: Literal["pair", "+y", "-y"] = "pair"
    """Body axes that the half-cones are centred on."""
    half_cone_deg: Annotated[float, Field(gt=0, lt=90)] = 45.0
    noise_deg: NonNegative = 0.0
    lsb_deg: NonNegative = 0.0
    tau_s: NonNegative = 0.0
    roll_bias_deg: float = 0.0
    pitch_bias_deg: float = 0.0

    def measure(self, around: Surroundings, rng: np.random.Generator) -> dict[str, FloatArray]:
        """nadir_B (N, 3) unit vectors in body axes."""
        correlated = self.tau_s > 0
        scanner = HorizonScanner(
            noise_rad=0.0 if correlated else float(np.radians(self.noise_deg)),
            lsb_rad=float(np.radians(self.lsb_deg)),
            bias_rad=(float(np.radians(self.roll_bias_deg)), float(np.radians(self.pitch_bias_deg))),
            wander_rad=float(np.radians(self.noise_deg)) if correlated else 0.0,
            wander_tau_s=self.tau_s,
        )
        *_, nadir_B = scanner.measure(around.time, self._seen_nadir_B(around), rng)
        return {"nadir_B": nadir_B}

    @property
    def conical(self) -> ConicalScanner:
        """Its scans."""
        axes = {"pair": (1, -1), "+y": (1,), "-y": (-1,)}[self.scans]
        return ConicalScanner(axes, float(np.radians(self.half_cone_deg)))

    def _seen_nadir_B(self, around: Surroundings) -> FloatArray:
        """(N, 3) nadir as the horizon shows it, before the errors of the scanner itself."""
        if self.earth == "disc":
            return around.R_BN.apply(around.nadir_N)
        seen, assumed = (horizon.surface(name, around.time) for name in (self.earth, self.assumed))
        north_N = horizon.north_N(around.time)
        return self.conical.nadir(around.r_N_km, north_N, around.R_BN, around.R_ON, seen, assumed)
