"""The stray field of a heater on a thermostat."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from fluxtwin.sim.effects.base import Parameter, SignalEffect, known_column, vector_parameters
from fluxtwin.sim.effects.drivers import varies
from fluxtwin.sim.errors import BadInput
from fluxtwin.sim.signal import Setting, Signal
from fluxtwin.sim.types import FloatArray


@dataclass(frozen=True)
class HeaterSwitching(SignalEffect):
    """Constant field while the heater is on: by `sequence` if given, else by the column `heater_on`."""

    name: ClassVar[str] = "heater_switching"
    stage: ClassVar[str] = "spacecraft"
    about: ClassVar[str] = (
        "constant field while a thermostat's heater is on, + along the axis (Ampere's law for its loop)"
    )
    sequence: tuple[int, ...] | None = None
    """Heater off (0) or on (1), one entry a row: what a search in the residual has found."""

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        return vector_parameters("f", "nT", 100.0)

    def on(self, setting: Setting) -> FloatArray | None:
        """(N,) 1 while the heater is on; None when nothing tells."""
        if self.sequence is None:
            return known_column(setting, "heater_on")
        if len(self.sequence) != setting.time.size:
            raise BadInput(
                f"{len(self.sequence)} entries for {setting.time.size} rows",
                where=f"{self.name} sequence",
                wanted="one entry a row",
            )
        return np.array(self.sequence, dtype=np.float64)

    def untestable(self, setting: Setting) -> str | None:
        on = self.on(setting)
        if on is None:
            return "the telemetry has no heater_on; only a two-state sequence found in the residual can stand in"
        return None if varies(on) else "the heater never switches"

    def apply(self, signal: Signal, theta: FloatArray) -> Signal:
        on = self.on(signal.setting)
        return signal if on is None else signal.with_stray(on[:, None] * theta)
