"""The stray field of the battery's current."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.effects.base import SignalEffect, vector_parameters
from fluxtwin.sim.effects.drivers import battery_current_A, varies
from fluxtwin.sim.effects.signal import Setting, Signal


@dataclass(frozen=True)
class BatteryCurrent(SignalEffect):
    """Field in proportion to the battery's current.

    Field in proportion to the battery's current, positive when charging.

    Without the column `battery_current_A` the current is +1 A in sunlight and -1 A in shadow.
    """

    name: ClassVar[str] = "battery_current"
    stage: ClassVar[str] = "spacecraft"
    frame: ClassVar[str | None] = "body"
    follows: ClassVar[str | None] = "current"
    settled_by: ClassVar[str] = (
        "steps of the load, or the taper at the end of charge, with the current in the telemetry"
    )
    about: ClassVar[str] = (
        "field in proportion to the battery's current (+ when charging), + along the axis "
        "(CryoSat-2: Olsen et al. 2020, doi 10.1186/s40623-020-01171-9)"
    )

    parameters = vector_parameters("s", "nT/A", 20.0)

    def condition_on(self, setting: Setting) -> str | None:
        return "sunlit" if setting.column("battery_current_A") is None else self.follows

    def untestable(self, setting: Setting) -> str | None:
        if varies(battery_current_A(setting)):
            return None
        return "the battery neither charges and discharges in turn, nor changes its current: its field is a bias"

    def apply(self, signal: Signal, theta: FloatArray) -> Signal:
        return signal.with_stray(battery_current_A(signal.setting)[:, None] * theta)
