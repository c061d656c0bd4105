"""Infrared horizon scanner: roll and pitch from the Earth's disc."""

from __future__ import annotations

from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from fluxtwin.sim.attitude.gauss_markov import gauss_markov
from fluxtwin.sim.base.section_types import NonNegative
from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.earth import horizon
from fluxtwin.sim.earth.frames import nadir_of, roll_pitch
from fluxtwin.sim.spacecraft.sensors.base import SensorSection, Surroundings
from fluxtwin.sim.spacecraft.sensors.horizon_crossings import ConicalScanner


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
        """nadir_B (N, 3) unit vectors in body axes; to roll and pitch are added bias, noise and rounding, in that order."""
        correlated = self.tau_s > 0
        wander_rad = float(np.radians(self.noise_deg)) if correlated else 0.0
        white_rad = 0.0 if correlated else float(np.radians(self.noise_deg))
        angles = roll_pitch(self._seen_nadir_B(around))
        bias_rad = (float(np.radians(self.roll_bias_deg)), float(np.radians(self.pitch_bias_deg)))
        wander = gauss_markov(around.time, wander_rad, self.tau_s, rng, columns=2)
        angles = angles + bias_rad + wander + white_rad * rng.standard_normal(angles.shape)
        lsb_rad = float(np.radians(self.lsb_deg))
        if lsb_rad > 0:
            angles = lsb_rad * np.rint(angles / lsb_rad)
        return {"nadir_B": nadir_of(angles)}

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
