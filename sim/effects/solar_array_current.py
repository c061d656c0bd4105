"""The stray field of the solar array's current."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.effects.base import SignalEffect, known_column, vector_parameters
from fluxtwin.sim.effects.drivers import PanelKind, array_current_A, sun_in_body, varies
from fluxtwin.sim.effects.signal import Setting, Signal


@dataclass(frozen=True)
class SolarArrayCurrent(SignalEffect):
    """Field in proportion to the array's current.

    Without the column `array_current_A` the current is that of an array of 1 A in full sun, so the parameter
    is the field in full sun: `panel` says whether it sits on the -z face (zenith), tracks about the y axis, or
    gives a constant current in sunlight.
    """

    name: ClassVar[str] = "solar_array_current"
    stage: ClassVar[str] = "spacecraft"
    frame: ClassVar[str | None] = "body"
    follows: ClassVar[str | None] = "current"
    settled_by: ClassVar[str] = "steps of the load, or panels turned off the sun, with the current in the telemetry"
    about: ClassVar[str] = (
        "field in proportion to the solar array's current, + along the axis (RAX: Springmann & Cutler 2012, "
        "doi 10.2514/1.56726; CryoSat-2: Olsen et al. 2020)"
    )
    panel: PanelKind = "zenith"

    parameters = vector_parameters("s", "nT/A", 20.0)

    def alternatives(self, setting: Setting) -> tuple[SolarArrayCurrent, ...]:
        if known_column(setting, "array_current_A") is not None:
            return (self,)
        kinds: tuple[PanelKind, ...] = ("zenith", "tracking", "constant")
        if not sun_in_body(setting)[1].any():
            kinds = ("constant",)  # no incidence is known
        choices = tuple(SolarArrayCurrent(kind) for kind in kinds)
        return tuple(choice for choice in choices if choice.untestable(setting) is None) or (self,)

    def condition_on(self, setting: Setting) -> str | None:
        return "sunlit" if setting.column("array_current_A") is None else self.follows

    def untestable(self, setting: Setting) -> str | None:
        if known_column(setting, "array_current_A") is not None:
            if varies(array_current_A(setting, self.panel)):
                return None
            return "the solar array's current never changes: its field is a bias"
        if varies(array_current_A(setting, self.panel)):
            return None
        return "no array current was recorded, and neither sunlight nor the sun's incidence changes"

    def apply(self, signal: Signal, theta: FloatArray) -> Signal:
        return signal.with_stray(array_current_A(signal.setting, self.panel)[:, None] * theta)
