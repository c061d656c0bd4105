"""More noise than was declared."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np

from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.effects.base import DistributionEffect, Parameter
from fluxtwin.sim.effects.signal import Signal


@dataclass(frozen=True)
class ExcessNoise(DistributionEffect):
    """More white noise than was declared.

    White Gaussian noise on each reading, on one axis or on all.
    """

    name: ClassVar[str] = "excess_noise"
    stage: ClassVar[str] = "sensor"
    frame: ClassVar[str | None] = "body"
    follows: ClassVar[str | None] = None
    settled_by: ClassVar[str] = "a quiet stretch with torquers and payload off"
    about: ClassVar[str] = (
        "white noise beyond the declared, adding to it in variance (magnetoresistors 10 to 100 nT rms; "
        "200 nT in ST5's simulation, Sedlak)"
    )
    axis: Literal["x", "y", "z", "all"] = "all"

    parameters = (Parameter("rms", "nT", 50.0, 0.0),)

    def draw(self, signal: Signal, theta: FloatArray, rng: np.random.Generator) -> Signal:
        noisy = np.ones(3) if self.axis == "all" else np.array([float(self.axis == axis) for axis in "xyz"])
        return signal.with_reading(signal.reading + theta[0] * noisy * rng.standard_normal((signal.rows, 3)))
