"""One sun-sensor head sits otherwise than the ground believes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.effects.base import Effect, Parameter, SignalEffect
from fluxtwin.sim.effects.signal import Setting, Signal


@dataclass(frozen=True)
class SunSensorHeadMisalignment(SignalEffect):
    """A sun sensor head is not mounted as stated.

    The reference attitude is turned while that head gives it, and so is the sun that the head measures.
    """

    head: int = 0
    """Number of the head; 0 stands for whichever is in use, so: wherever the sun is seen."""

    name: ClassVar[str] = "sun_sensor_head_misalignment"
    stage: ClassVar[str] = "attitude"
    frame: ClassVar[str | None] = "body"
    follows: ClassVar[str | None] = "head"
    settled_by: ClassVar[str] = (
        "the number of the head in the telemetry, and turns of 90 deg that bring each head to the sun for half an orbit"
    )
    about: ClassVar[str] = (
        "while head k is in use the reported attitude is turned by this rotation vector, body axes: a field v is "
        "predicted as v + turn x v (mounting error as in Wertz 1978, section 7.1; tenths of a degree before alignment "
        "in flight)"
    )

    parameters = tuple(Parameter(f"turn_{axis}", "deg", 0.2, -20.0, 20.0) for axis in "xyz")

    def alternatives(self, setting: Setting) -> tuple[Effect, ...]:
        """Each head in use."""
        return tuple(SunSensorHeadMisalignment(head) for head in _heads(setting)) or (self,)

    def untestable(self, setting: Setting) -> str | None:
        if setting.column("sun_sensor_head") is None:
            return "the telemetry has no column sun_sensor_head"
        heads = _heads(setting)
        if not heads:
            return "no sun-sensor head is ever in use"
        if self.head and self.head not in heads:
            return f"head {self.head} is never in use (in use: {', '.join(map(str, heads))})"
        return None

    def apply(self, signal: Signal, theta: FloatArray) -> Signal:
        column = signal.setting.column("sun_sensor_head")
        if column is None:
            return signal
        used = column == self.head if self.head else column > 0
        return signal.attitude_reported_turned(np.where(used[:, None], np.radians(theta), 0.0), "sun_B")


def _heads(setting: Setting) -> list[int]:
    column = setting.column("sun_sensor_head")
    if column is None:
        return []
    return [int(head) for head in np.unique(column[np.isfinite(column)]) if head > 0]
