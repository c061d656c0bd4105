"""What a sensor of a scenario is: a section that measures the vehicle's surroundings into columns of telemetry."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from fluxtwin.sim.base.section_types import Section
from fluxtwin.sim.base.types import FloatArray, TimeArray


@dataclass(frozen=True)
class Surroundings:
    """What the sensors of a vehicle look at, at N stamps; all of it is true."""

    time: TimeArray
    r_N_km: FloatArray
    R_BN: Rotation
    R_ON: Rotation
    rate_B_rad_s: FloatArray
    """(N, 3) relative to N."""
    sun_N: FloatArray
    """(N, 3) unit vectors."""
    illumination: FloatArray
    """(N,) share of the sun's disc in view."""

    @property
    def nadir_N(self) -> FloatArray:
        """(N, 3) unit vectors to the centre of the Earth."""
        return np.asarray(-self.r_N_km / np.linalg.norm(self.r_N_km, axis=1)[:, None])


class SensorSection(Section):
    """Base of the sensors. Each is a frozen record, checked as the section [NAME] of a scenario."""

    def measure(self, around: Surroundings, rng: np.random.Generator) -> dict[str, FloatArray]:
        """Columns of the telemetry by name, each (N,) or (N, k), NaN where it measures nothing.

        A sensor that gives the reference attitude has the column `q_NB`.
        """
        raise NotImplementedError
