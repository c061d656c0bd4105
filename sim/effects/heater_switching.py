"""The stray field of a heater on a thermostat."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from fluxtwin.sim.base.errors import BadInput
from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.earth import epoch
from fluxtwin.sim.effects.base import SignalEffect, known_column, vector_parameters
from fluxtwin.sim.effects.drivers import varies
from fluxtwin.sim.effects.signal import Setting, Signal


@dataclass(frozen=True)
class HeaterSwitching(SignalEffect):
    """Constant field while the heater is on.

    Constant field while the heater is on: by `switches_utc` or `sequence` if given, else the column `heater_on`.
    """

    name: ClassVar[str] = "heater_switching"
    stage: ClassVar[str] = "spacecraft"
    frame: ClassVar[str | None] = "body"
    follows: ClassVar[str | None] = "flag:heater_on"
    settled_by: ClassVar[str] = "the state of the heater in the telemetry, or an orbit with the thermostat off"
    about: ClassVar[str] = (
        "constant field while a thermostat's heater is on, + along the axis (Ampere's law for its loop)"
    )
    sequence: tuple[int, ...] | None = None
    """Heater off (0) or on (1), one entry a row: what a search in the residual has found."""
    switches_utc: tuple[str, ...] | None = None
    """The same for any rows: moments at which the heater goes on, off, on, ... in order; off before the first."""

    parameters = vector_parameters("f", "nT", 100.0)

    def on(self, setting: Setting) -> FloatArray | None:
        """(N,) 1 while the heater is on; None when nothing tells."""
        if self.switches_utc is not None:
            moments = np.array([epoch.parse_time(moment, where=self.name) for moment in self.switches_utc])
            if (np.diff(moments.astype("int64")) <= 0).any():
                raise BadInput("switches_utc is out of order", where=self.name, wanted="moments in time order")
            return np.asarray(np.searchsorted(moments, setting.time, side="right") % 2, dtype=np.float64)
        if self.sequence is None:
            return known_column(setting, "heater_on")
        if len(self.sequence) != setting.time.size:
            raise BadInput(
                f"{len(self.sequence)} entries for {setting.time.size} rows",
                where=f"{self.name} sequence",
                wanted="one entry a row",
            )
        return np.array(self.sequence, dtype=np.float64)

    def condition_on(self, setting: Setting) -> str | None:
        return None if setting.column("heater_on") is None else self.follows

    def untestable(self, setting: Setting) -> str | None:
        on = self.on(setting)
        if on is None:
            return "the telemetry has no heater_on; only a two-state sequence found in the residual can stand in"
        return None if varies(on) else "the heater never switches"

    def pinned(self, setting: Setting, reading_B_nT: FloatArray) -> HeaterSwitching:
        if self.sequence is None:
            return self
        state = np.concatenate([[0.0], np.asarray(self.on(setting)), [0.0]])
        rows = np.flatnonzero(np.diff(state))
        usual_s = float(np.median(np.diff(setting.seconds)))
        moments = np.append(setting.time, epoch.add_seconds(setting.time[-1], usual_s))[rows]
        return replace(self, sequence=None, switches_utc=tuple(epoch.iso(moment, "ms") for moment in moments))

    @property
    def bound(self) -> str | None:
        if self.sequence is None and self.switches_utc is None:
            return None
        return "the thermostat's moments are those of this record: only the field is carried over"

    def apply(self, signal: Signal, theta: FloatArray) -> Signal:
        on = self.on(signal.setting)
        return signal if on is None else signal.with_stray(on[:, None] * theta)
