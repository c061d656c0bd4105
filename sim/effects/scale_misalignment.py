"""An error of scale, misalignment and crosstalk that the calibration does not know."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.effects.base import Parameter, SignalEffect
from fluxtwin.sim.effects.instrument import mapped
from fluxtwin.sim.effects.signal import Signal


@dataclass(frozen=True)
class ScaleMisalignment(SignalEffect):
    """Errors of scale, skewness and mounting.

    S of equation 1, beyond the baseline's: reading (I + S + dS)^-1 (I + S) B.
    """

    name: ClassVar[str] = "scale_misalignment"
    stage: ClassVar[str] = "sensor"
    frame: ClassVar[str | None] = "body"
    follows: ClassVar[str | None] = "field_strength"
    settled_by: ClassVar[str] = "a slow tumble of 0.25 deg/s"
    equivalent_stages: ClassVar[tuple[str, ...]] = ("attitude",)
    about: ClassVar[str] = (
        "S of A B0 = (I+S) B + b + T D (Lerner & Shuster 1981, eq. 1), row by row; + on the diagonal lowers the reading"
    )

    parameters = tuple(Parameter(f"S_{row}{column}", "1", 0.01, -0.5, 0.5) for row in "xyz" for column in "xyz")

    def apply(self, signal: Signal, theta: FloatArray) -> Signal:
        nominal = np.eye(3) + signal.setting.instrument.S
        change = np.asarray(np.linalg.solve(nominal + theta.reshape(3, 3), nominal), dtype=np.float64)
        return signal.with_reading(mapped(change, signal.reading))
