"""A bias that jumps once."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.earth import epoch
from fluxtwin.sim.effects.base import SignalEffect, vector_parameters
from fluxtwin.sim.effects.instrument import in_reading
from fluxtwin.sim.effects.signal import Setting, Signal

_GRID = 31


@dataclass(frozen=True)
class BiasStep(SignalEffect):
    """The bias jumps at a moment and stays there.

    b of equation 1 is larger from `at` on.
    """

    name: ClassVar[str] = "bias_step"
    stage: ClassVar[str] = "sensor"
    frame: ClassVar[str | None] = "body"
    follows: ClassVar[str | None] = "after_time"
    settled_by: ClassVar[str] = "data from well before and well after the jump"
    equivalent_stages: ClassVar[tuple[str, ...]] = ("spacecraft",)
    about: ClassVar[str] = (
        "b of eq. 1 jumps at a moment and stays; + lowers the reading from then on "
        "(additive jump: Willsky & Jones 1976, doi 10.1109/TAC.1976.1101146)"
    )
    at: str | None = None
    """ISO 8601 UTC; None: the middle row."""

    parameters = vector_parameters("b", "nT", 100.0)

    def alternatives(self, setting: Setting) -> tuple[BiasStep, ...]:
        """Moments spread evenly over the rows, at a row each; the given one alone where there is one."""
        rows = setting.time.size
        if self.at is not None or rows < 3:
            return (self,)
        number = np.unique(np.linspace(0, rows, _GRID + 2)[1:-1].round().astype(int))
        return tuple(replace(self, at=epoch.iso(setting.time[row], "ms")) for row in number if 0 < row < rows)

    def after(self, setting: Setting) -> FloatArray:
        """(N,) 0 before the jump, 1 from it on."""
        moment = setting.time[setting.time.size // 2] if self.at is None else epoch.parse_time(self.at, where=self.name)
        return (setting.time >= moment).astype(np.float64)

    def untestable(self, setting: Setting) -> str | None:
        after = self.after(setting)
        return None if 0.0 < after.mean() < 1.0 else "the moment lies outside the record"

    def pinned(self, setting: Setting, reading_B_nT: FloatArray) -> BiasStep:
        middle = epoch.iso(setting.time[setting.time.size // 2], "ms")
        return self if self.at is not None else replace(self, at=middle)

    @property
    def bound(self) -> str:
        moment = "once" if self.at is None else f"once, at {self.at}"
        return f"it happened {moment}: later it is a constant part of b, and whether it happens again is not known"

    def apply(self, signal: Signal, theta: FloatArray) -> Signal:
        shift = in_reading(signal.setting, theta)
        return signal.with_reading(signal.reading - self.after(signal.setting)[:, None] * shift)
