"""The cases: a record, a field model, what is modelled, and beside them what is known and withheld."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fluxtwin.gap.problem import DEFAULT_MODELLED
from fluxtwin.gap.records import Diagnosis
from fluxtwin.scenarios.flight_field.tracks import Track, read_magsat, read_swarm
from fluxtwin.scenarios.flight_gaps import models, readers, records
from fluxtwin.scenarios.flight_gaps.settings import Settings
from fluxtwin.sim.earth.field_models import FieldModel, load_field
from fluxtwin.sim.telemetry.record import Telemetry

STORM, MAGSAT, SWARM, DMSP, AIRCRAFT = "storm", "magsat", "swarm", "dmsp", "aircraft"
_EDDY = ("bias", "scale_misalignment", "eddy_current")


@dataclass(frozen=True)
class Case:
    """One question to the diagnosis. `known`, `expected` and `agrees` never reach it."""

    name: str
    part: str
    title: str
    make: Callable[[], tuple[Telemetry, FieldModel]]
    modelled: tuple[str, ...]
    known: str
    """The cause, in words."""
    expected: str
    """What an answer should say, in words; empty: nothing was foretold."""
    agrees: Callable[[Diagnosis], bool] | None = None
    """Whether it says so."""
    right: tuple[str, ...] = ()
    """The names of the cause; every other name in an answer is wrong."""


def names_of(found: Diagnosis) -> set[str]:
    """Every name that the answer gives, groups included."""
    return {name for effect in found.effects for name in (effect.name, *effect.group)}


def cases(folder: Path, settings: Settings) -> list[Case]:
    """All cases over the files of a folder, in the order of the report; files are read when a case is made."""
    return [
        *_storm(folder, settings), *_magsat(folder, settings), *_swarm(folder, settings), *_dmsp(folder, settings),
        *_aircraft(folder, settings),
    ]  # fmt: skip


def storm_record(folder: Path, settings: Settings) -> tuple[Telemetry, Track]:
    """The arc at low latitude, and the whole track."""
    track = read_swarm(folder / settings.storm.file)
    low = np.abs(track.latitude_deg) < settings.low_latitude_deg
    return records.of_track(track).select(low), track


def magsat_record(folder: Path, settings: Settings, axes: str = "orbit") -> tuple[Telemetry, Track]:
    """Every so many rows of MAGSAT, and the whole track."""
    track = read_magsat(folder / settings.magsat.file)
    return records.of_track(track, axes).select(slice(None, None, settings.magsat.every)), track


def _storm(folder: Path, settings: Settings) -> Iterator[Case]:
    def make() -> tuple[Telemetry, FieldModel]:
        return storm_record(folder, settings)[0], load_field("igrf14")

    yield Case(
        "storm-none", STORM, "Swarm A in the storm, nothing modelled", make, (), "a ring current",
        "the names compete: ring_current does not stand first by itself",
        lambda found: not found.effects or tuple(found.effects[0].group) != ("ring_current",),
        ("ring_current", "bias", "scale_misalignment"),
    )  # fmt: skip
    yield Case(
        "storm-default", STORM, "the same, b and S modelled", make, DEFAULT_MODELLED, "a ring current",
        "ring_current is untestable", lambda found: "ring_current" in found.untestable,
    )  # fmt: skip


def _magsat(folder: Path, settings: Settings) -> Iterator[Case]:
    def case(
        name: str, title: str, model: Callable[[], FieldModel], known: str, expected: str,
        agrees: Callable[[Diagnosis], bool] | None, right: tuple[str, ...] = (),
    ) -> Case:  # fmt: skip
        def make() -> tuple[Telemetry, FieldModel]:
            return magsat_record(folder, settings)[0], model()

        return Case(name, MAGSAT, title, make, DEFAULT_MODELLED, known, expected, agrees, right)

    yield case(
        "magsat-degree-8", "MAGSAT, IGRF-14 cut at degree 8", models.degree_8, "degrees 9 to 13 are missing",
        "field_truncation among the confirmed", lambda found: "field_truncation" in names_of(found),
        ("field_truncation",),
    )  # fmt: skip
    yield case(
        "magsat-igrf1975-held", "MAGSAT, IGRF 1975 as of 1975.0", lambda: models.held_back(load_field("igrf1975")),
        "five years of secular variation, and the errors of IGRF 1975", "field_epoch takes a part",
        lambda found: "field_epoch" in names_of(found), ("field_epoch", "field_truncation"),
    )  # fmt: skip
    yield case(
        "magsat-igrf1975-carried", "MAGSAT, IGRF 1975 brought to 1980",
        lambda: models.carried_on(load_field("igrf1975")), "wrong coefficients and a wrong forecast, no shift in time",
        "unknown, at the stage field", lambda found: found.verdict == "unknown" and found.where.stage == "field",
    )  # fmt: skip
    yield case(
        "magsat-igrf14", "MAGSAT, IGRF-14", lambda: load_field("igrf14"),
        "auroral currents, a small ring current, and about a second between stamps and positions", "", None,
    )  # fmt: skip


def _swarm(folder: Path, settings: Settings) -> Iterator[Case]:
    for file in settings.swarm.files:
        letter = file.split("_")[1].upper()

        def make(file: str = file) -> tuple[Telemetry, FieldModel]:
            model = load_field("igrf14")
            day = readers.read_residual_day(folder / file)
            return records.of_residual_day(day, model).select(slice(None, None, settings.swarm.every)), model

        yield Case(
            f"swarm-{letter.lower()}", SWARM, f"Swarm {letter}, 8 September 2014", make, DEFAULT_MODELLED,
            "currents outside the satellite: auroral and in the magnetosphere", "unknown, at the stage field",
            lambda found: found.verdict == "unknown" and found.where.stage == "field",
        )  # fmt: skip


def _dmsp(folder: Path, settings: Settings) -> Iterator[Case]:
    for file in settings.dmsp.files:
        name = file.split("_")[1].upper()

        def make(file: str = file) -> tuple[Telemetry, FieldModel]:
            model = load_field("igrf14")
            day = readers.read_body_residuals(folder / file)
            return records.of_body_residuals(day, model, settings.dmsp.hours, settings.dmsp.every), model

        yield Case(
            f"dmsp-{name.lower()}", DMSP, f"DMSP {name}, {settings.dmsp.hours:g} hours", make, DEFAULT_MODELLED,
            "the spacecraft's own fields, auroral currents, the model of the ground processing; fill values",
            "unknown; fill values cut, no bit errors named",
            lambda found: found.verdict == "unknown" and "bit_errors" not in names_of(found),
        )  # fmt: skip


def _aircraft(folder: Path, settings: Settings) -> Iterator[Case]:
    def make() -> tuple[Telemetry, FieldModel]:
        given = readers.read_compensation(folder / settings.aircraft.file)
        return records.of_aircraft(given, settings.aircraft.rate_Hz), records.aircraft_model()

    known = {"bias": "permanent", "scale_misalignment": "induced", "eddy_current": "eddy-current"}
    yield Case(
        "aircraft-none", AIRCRAFT, "Aircraft, nothing modelled", make, (), "permanent, induced and eddy-current terms",
        "bias, scale_misalignment and eddy_current", lambda found: set(_EDDY) <= names_of(found), _EDDY,
    )  # fmt: skip
    for name in _EDDY:
        yield Case(
            f"aircraft-{name}", AIRCRAFT, f"Aircraft, the {known[name]} terms withheld", make,
            tuple(other for other in _EDDY if other != name), f"{known[name]} terms", name,
            lambda found, name=name: {effect.name for effect in found.effects} == {name},  # type: ignore[misc]
            (name,),
        )  # fmt: skip
