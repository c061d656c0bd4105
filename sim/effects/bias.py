"""A bias of the magnetometer that the calibration does not know."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.effects.base import SignalEffect, vector_parameters
from fluxtwin.sim.effects.signal import Signal


@dataclass(frozen=True)
class Bias(SignalEffect):
    """A constant error of the reading.

    b of equation 1: reading and true field differ by a constant.
    """

    name: ClassVar[str] = "bias"
    stage: ClassVar[str] = "sensor"
    frame: ClassVar[str | None] = "body"
    follows: ClassVar[str | None] = None
    settled_by: ClassVar[str] = "a slow tumble of 0.25 deg/s"
    equivalent_stages: ClassVar[tuple[str, ...]] = ("spacecraft",)
    about: ClassVar[str] = "b of A B0 = (I+S) B + b + T D (Lerner & Shuster 1981, eq. 1); + lowers the reading"

    parameters = vector_parameters("b", "nT", 100.0)

    def apply(self, signal: Signal, theta: FloatArray) -> Signal:
        matrix = np.eye(3) + signal.setting.instrument.S
        return signal.with_reading(signal.reading - np.linalg.solve(matrix, theta))
