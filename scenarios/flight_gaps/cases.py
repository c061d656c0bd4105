"""The cases: a record, a field model, what is modelled; and what is known and withheld."""

from __future__ import annotations

from pathlib import Path

from fluxtwin.gap.problem.problem import DEFAULT_MODELLED
from fluxtwin.gap.records.diagnosis import Diagnosis
from fluxtwin.scenarios.flight_field.tracks import read_magsat, read_swarm
from fluxtwin.scenarios.flight_gaps import records
from fluxtwin.scenarios.flight_gaps.models import field_model
from fluxtwin.scenarios.recorded_files import Settings
from fluxtwin.sim.base.toml_input import Strict, read_model
from fluxtwin.sim.earth.field_models import FieldModel
from fluxtwin.sim.telemetry.record import Telemetry

PACKAGED = Path(__file__).parent / "cases.toml"


class Wanted(Strict):
    """What an answer must hold; what is empty is not asked for."""

    verdict: str = ""
    stage: str = ""
    named: list[str] = []
    unnamed: list[str] = []
    only: str = ""
    untestable: str = ""
    not_first: str = ""

    def met(self, found: Diagnosis) -> bool:
        """Whether the diagnosis holds all of it."""
        names, first = names_of(found), found.effects[0].group if found.effects else ()
        return (
            self.verdict in ("", found.verdict)
            and self.stage in ("", found.where.stage)
            and names.issuperset(self.named)
            and names.isdisjoint(self.unnamed)
            and (not self.only or {effect.name for effect in found.effects} == {self.only})
            and (not self.untestable or self.untestable in found.untestable)
            and (not self.not_first or tuple(first) != (self.not_first,))
        )


class Case(Strict):
    """One question to the diagnosis."""

    name: str
    part: str
    title: str
    model: str = "igrf14"
    file: int = 0
    """Which of the files of a part that has several."""
    modelled: list[str] = list(DEFAULT_MODELLED)
    known: str
    """The cause, in words."""
    expected: str = ""
    """What an answer should say, in words."""
    right: list[str] = []
    wanted: Wanted | None = None

    def load(self, folder: Path, settings: Settings) -> tuple[Telemetry, FieldModel]:
        """The record and the field model. Raises BadInput for a file that cannot be used."""
        model = field_model(self.model)
        if self.part == "storm":
            return storm_record(folder, settings), model
        if self.part == "magsat":
            return magsat_record(folder, settings), model
        if self.part == "swarm":
            day = records.of_residual_day(folder / settings.swarm.files[self.file], model)
            return day.select(slice(None, None, settings.swarm.every)), model
        if self.part == "dmsp":
            dmsp = settings.dmsp
            return records.of_body_residuals(folder / dmsp.files[self.file], model, dmsp.hours, dmsp.every), model
        given = records.read_compensation(folder / settings.aircraft.file)
        return records.of_aircraft(given, settings.aircraft.rate_Hz), model


class _Cases(Strict):
    case: list[Case]


def read_cases() -> list[Case]:
    """All cases, in the order of the report."""
    return read_model(PACKAGED, _Cases).case


def names_of(found: Diagnosis) -> set[str]:
    """Every name that the answer gives, groups included."""
    return {name for effect in found.effects for name in (effect.name, *effect.group)}


def storm_record(folder: Path, settings: Settings) -> Telemetry:
    """The arc of Swarm A at low latitude."""
    track = read_swarm(folder / settings.storm.file)
    return records.of_track(track).select(abs(track.latitude_deg) < settings.low_latitude_deg)


def magsat_record(folder: Path, settings: Settings, axes: str = "orbit") -> Telemetry:
    """MAGSAT's rows at the chosen spacing."""
    track = read_magsat(folder / settings.magsat.file)
    return records.of_track(track, axes).select(slice(None, None, settings.magsat.every))
