"""Fields that are on at times: a heater, and any equipment that a flag, a clock, shadow or a region switches."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from fluxtwin.sim.base.errors import BadInput
from fluxtwin.sim.base.late import varies
from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.earth import epoch
from fluxtwin.sim.effects.base import SpacecraftField, known_column, vector_parameters
from fluxtwin.sim.effects.drivers import lit
from fluxtwin.sim.effects.region import WANTED, depth_deg, region_words
from fluxtwin.sim.effects.signal import Setting

FLAG = "flag:"
_PLAIN = ("eclipse", "night", "interval", "region")


@dataclass(frozen=True)
class HeaterSwitching(SpacecraftField):
    """Constant field while a heater or load is on.

    By `switches_utc` or `sequence` if given, else the column `heater_on`.
    """

    name = "heater_switching"
    follows = "flag:heater_on"
    settled_by = "the state of the heater in the telemetry, or an orbit with the thermostat off"
    about = "switched by a thermostat, positive along the axis (Ampere's law for the loop of the heater)"
    sequence: tuple[int, ...] | None = None
    """Heater off (0) or on (1), one entry a row: what a search in the residual has found."""
    switches_utc: tuple[str, ...] | None = None
    """The same for any rows: moments at which the heater goes on, off, on, ... in order; off before the first."""

    parameters = vector_parameters("f", "nT", 100.0)

    def values(self, setting: Setting) -> FloatArray | None:
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
        on = self.values(setting)
        if on is None:
            return "the telemetry has no heater_on; only a two-state sequence in the residual can show it"
        return None if varies(on) else "the heater never switches"

    def pinned(self, setting: Setting, reading_B_nT: FloatArray) -> HeaterSwitching:
        if self.sequence is None:
            return self
        state = np.concatenate([[0.0], np.asarray(self.values(setting)), [0.0]])
        rows = np.flatnonzero(np.diff(state))
        usual_s = float(np.median(np.diff(setting.seconds)))
        moments = np.append(setting.time, epoch.add_seconds(setting.time[-1], usual_s))[rows]
        return replace(self, sequence=None, switches_utc=tuple(epoch.iso(moment, "ms") for moment in moments))

    @property
    def bound(self) -> str | None:
        if self.sequence is None and self.switches_utc is None:
            return None
        return "the thermostat's moments are those of this record: only the field is carried over"


@dataclass(frozen=True)
class SwitchedField(SpacecraftField):
    """Constant field while a condition holds.

    condition: `flag:NAME` (a recorded flag), `eclipse` (the spacecraft in shadow), `night` (the ground below in
    shadow), `interval` (from `from_utc` to `to_utc`), or `region` (the ground below inside `region_deg`). With
    `region_deg` given, `eclipse` and `night` hold inside it only.
    """

    name = "switched_field"
    settled_by = "switching it on and off in sunlight and in shadow, with its flag in the telemetry"
    about = (
        "the condition is a flag, a clock interval, shadow, night or a region; positive along the axis "
        "(HCMM's night passes: Lerner & Shuster 1981)"
    )
    condition: str = "eclipse"
    from_utc: str | None = None
    to_utc: str | None = None
    region_deg: tuple[float, ...] | None = None
    """Southern and northern geocentric latitude, western and eastern longitude (west > east crosses 180), or latitude,
    longitude and radius of a circle."""

    parameters = vector_parameters("f", "nT", 100.0)

    def values(self, setting: Setting) -> FloatArray | None:
        """(N,) share of the row during which the condition holds, mostly 0 or 1; None when nothing tells.

        Raises BadInput for a condition that does not exist or lacks its interval or region.
        """
        if self.condition.startswith(FLAG):
            return known_column(setting, "flag_" + self.condition.removeprefix(FLAG))
        if self.condition in ("eclipse", "night"):
            dark = _dark(setting, self.condition)
            return dark if self.region_deg is None else dark * _inside_region(setting, self.region_deg)
        if self.condition == "interval":
            if self.from_utc is None or self.to_utc is None:
                raise BadInput("no interval", where="switched_field", wanted="from_utc and to_utc")
            start, end = epoch.parse_time(self.from_utc), epoch.parse_time(self.to_utc)
            if not start < end:
                raise BadInput(
                    f"{self.from_utc} to {self.to_utc}", where="switched_field", wanted="an end after the start"
                )
            return ((setting.time >= start) & (setting.time < end)).astype(np.float64)
        if self.condition == "region":
            return _inside_region(setting, self.region_deg)
        raise BadInput(
            f"condition {self.condition!r}", where=self.name, wanted=f"{FLAG}NAME or one of {', '.join(_PLAIN)}"
        )

    def condition_on(self, setting: Setting) -> str | None:
        if self.region_deg is not None:
            return "region"
        return {"night": "eclipse", "interval": None}.get(self.condition, self.condition)

    def alternatives(self, setting: Setting) -> tuple[SwitchedField, ...]:
        if self != SwitchedField():
            return (self,)
        flags = sorted(name.removeprefix("flag_") for name in setting.columns if name.startswith("flag_"))
        conditions = [*(FLAG + name for name in flags), "eclipse", "night"]
        choices = tuple(SwitchedField(condition) for condition in conditions)
        return tuple(choice for choice in choices if choice._switches(setting)) or (self,)

    def untestable(self, setting: Setting) -> str | None:
        if self == SwitchedField():
            if any(choice._switches(setting) for choice in self.alternatives(setting)):
                return None
            return "no flag switches, and neither shadow nor night begins or ends"
        if self.values(setting) is None:
            return f"the telemetry has no flag_{self.condition.removeprefix(FLAG)}"
        return None if self._switches(setting) else f"{self.condition} never begins or ends"

    @property
    def region_words(self) -> str:
        """When and where it is on, to read; empty where there is no region."""
        if self.region_deg is None:
            return ""
        return {"night": "by night ", "eclipse": "in eclipse "}.get(self.condition, "") + region_words(self.region_deg)

    @property
    def bound(self) -> str | None:
        if self.condition != "interval":
            return None
        return f"it was on from {self.from_utc} to {self.to_utc}: when it is on again is not known"

    def _switches(self, setting: Setting) -> bool:
        on = self.values(setting)
        return on is not None and varies(on)


def _dark(setting: Setting, condition: str) -> FloatArray:
    if condition == "eclipse":
        return 1.0 - lit(setting)
    height = np.einsum("ij,ij->i", setting.given[0], setting.sun_N)
    return np.asarray(height < 0.0, dtype=np.float64)


def _inside_region(setting: Setting, region_deg: tuple[float, ...] | None) -> FloatArray:
    if region_deg is None:
        raise BadInput("no region", where="switched_field", wanted=WANTED)
    latitude, longitude = (np.degrees(a) for a in setting.geocentric[:2])
    return (depth_deg(latitude, longitude, region_deg) >= 0.0).astype(np.float64)
