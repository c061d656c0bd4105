"""The computing half of the study: files in, diagnoses and least-squares tables out. Nothing is drawn or written here."""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fluxtwin.gap.diagnose import diagnose
from fluxtwin.gap.problem.problem import DEFAULT_MODELLED
from fluxtwin.gap.records.diagnosis import Diagnosis
from fluxtwin.scenarios.flight_field.residuals import rms
from fluxtwin.scenarios.flight_field.tracks import read_kp, read_swarm
from fluxtwin.scenarios.flight_gaps import records
from fluxtwin.scenarios.flight_gaps.alone import LeastSquares, Shares, alone, visible_nT
from fluxtwin.scenarios.flight_gaps.cases import Case, magsat_record, names_of, read_cases, storm_record
from fluxtwin.scenarios.flight_gaps.models import field_model
from fluxtwin.scenarios.flight_gaps.tolles_lawson import Coefficients, coefficients
from fluxtwin.scenarios.recorded_files import Settings
from fluxtwin.sim.base.progress import Progress, part_of
from fluxtwin.sim.base.types import BoolArray, FloatArray
from fluxtwin.sim.earth import frames
from fluxtwin.sim.earth.field_models import FieldModel
from fluxtwin.sim.effects.ambient_field import FieldTruncation
from fluxtwin.sim.effects.base import SignalEffect
from fluxtwin.sim.effects.catalogue import find_effect
from fluxtwin.sim.telemetry.record import Telemetry

BANDS_DEG = (0.0, 30.0, 50.0, 60.0, 75.0, 90.0)
STORM_NT = 50.0
"""The ring current whose visibility is counted."""
_MISSING_NT = 1e5
_ORBIT_S = 5640


@dataclass(frozen=True)
class Answer:
    """What the diagnosis said of a case."""

    case: Case
    found: Diagnosis
    latitude_deg: FloatArray
    """(N,) geocentric, at the rows of its series."""
    filled: BoolArray
    """(N,) rows with a fill value."""

    @property
    def agrees(self) -> bool | None:
        """Whether it is as expected; None where nothing was expected."""
        return None if self.case.wanted is None else self.case.wanted.met(self.found)

    @property
    def wrong(self) -> list[str]:
        """Names in the answer that are no cause here, in order."""
        return sorted(names_of(self.found) - set(self.case.right))

    @property
    def left_nT(self) -> FloatArray:
        """(N, 3) the residual with what is modelled re-estimated, held out."""
        assert self.found.series is not None
        return self.found.series.before_nT

    @property
    def cut(self) -> BoolArray:
        """(N,) rows that were cut as spikes."""
        return np.asarray(np.isnan(self.left_nT).any(axis=1))


@dataclass(frozen=True)
class Left:
    """A residual after a plain fit, N rows."""

    latitude_deg: FloatArray
    """(N,) geocentric."""
    residual_nT: FloatArray
    """(N, 3)."""

    def bands(self) -> list[tuple[float, float, int, float]]:
        """Latitudes from and to, rows, rms per component [nT], either hemisphere."""
        size = np.abs(self.latitude_deg)
        bands = [(low, high, (size >= low) & (size < high)) for low, high in itertools.pairwise(BANDS_DEG)]
        return [(low, high, int(rows.sum()), rms(self.residual_nT[rows])) for low, high, rows in bands if rows.any()]


@dataclass(frozen=True)
class Visible:
    """How much of a ring current of 50 nT some data show."""

    rows: str
    """Which rows, in words."""
    samples: int
    whole_nT: float
    """rms of it along the rows."""
    beside_b_and_S_nT: float
    """rms after projecting out b and S."""


@dataclass(frozen=True)
class Outcome:
    """All that the study found."""

    answers: tuple[Answer, ...]
    storm: Shares
    """Swarm A in the storm, nothing modelled."""
    storm_visible: tuple[Visible, ...]
    magsat: Mapping[str, Shares]
    """MAGSAT by model and axes, b and S free."""
    magsat_left: Left
    """What IGRF-14 with b and S free leaves along MAGSAT's orbit."""
    degree_left: tuple[Left, Left]
    """The same for IGRF-14 cut at degree 8, without and with field_truncation."""
    kp: FloatArray
    """Eight values of the day of MAGSAT."""
    coefficients: Coefficients
    """Of the aircraft, from the published values."""

    def answer(self, name: str) -> Answer:
        """The answer to the case of that name."""
        return next(one for one in self.answers if one.case.name == name)

    def part(self, name: str) -> list[Answer]:
        """The answers to the cases of that part."""
        return [one for one in self.answers if one.case.part == name]


def compute(folder: Path, settings: Settings, progress: Progress) -> Outcome:
    """Diagnose every case. Raises BadInput for a file that cannot be used."""
    progress("reading the recorded files", 0.0)
    storm, visible = _storm_tables(folder, settings)
    magsat = _magsat_tables(folder, settings)
    orbit, cut = magsat_record(folder, settings), field_model("igrf14, degree 8")
    asked = read_cases()
    answers = []
    for number, case in enumerate(asked):
        share = part_of(progress, 0.1 + 0.9 * number / len(asked), 0.1 + 0.9 * (number + 1) / len(asked))
        answers.append(_answer(case, folder, settings, share))
    given = records.read_compensation(folder / settings.aircraft.file)
    return Outcome(
        answers=tuple(answers),
        storm=storm,
        storm_visible=visible,
        magsat=magsat,
        magsat_left=_left(orbit, field_model("igrf14")),
        degree_left=(_left(orbit, cut), _left(orbit, cut, FieldTruncation(8, "richer"))),
        kp=read_kp(folder / settings.magsat.kp_file, orbit.time[0]),
        coefficients=coefficients(given, settings.aircraft.rate_Hz),
    )


def _answer(case: Case, folder: Path, settings: Settings, progress: Progress) -> Answer:
    telemetry, model = case.load(folder, settings)

    def titled(words: str, share: float) -> None:
        progress(f"{case.title}: {words}", share)

    found = diagnose(telemetry, model, modelled=case.modelled, progress=titled)
    filled = np.any(np.abs(telemetry.mag_B_nT) > _MISSING_NT, axis=1)
    return Answer(case, found, _latitude_deg(telemetry), filled)


def _effects(*names: str) -> tuple[SignalEffect, ...]:
    return tuple(effect for effect in map(find_effect, names) if isinstance(effect, SignalEffect))


def _storm_tables(folder: Path, settings: Settings) -> tuple[Shares, tuple[Visible, ...]]:
    arc, model = storm_record(folder, settings), field_model("igrf14")
    names = ("ring_current", "bias", "scale_misalignment", "along_track_error", "time_tag_offset", "field_epoch")
    table = alone(arc, model, (), [_effects(name) for name in names])
    day = records.of_residual_day(folder / settings.swarm.files[0], model)
    orbit = int(np.searchsorted(day.time, day.time[0] + np.timedelta64(_ORBIT_S, "s")))
    (ring,) = _effects("ring_current")
    kinds = {
        "this arc": arc,
        "the whole pass over the pole": records.of_track(read_swarm(folder / settings.storm.file)),
        "one orbit of Swarm A": day.select(slice(0, orbit)),
        "one day of Swarm A": day.select(slice(None, None, settings.swarm.every)),
    }
    return table, tuple(
        Visible(words, len(rows), *visible_nT(rows, model, DEFAULT_MODELLED, ring, STORM_NT))
        for words, rows in kinds.items()
    )


def _magsat_tables(folder: Path, settings: Settings) -> Mapping[str, Shares]:
    epoch, track, tag, ring = map(_effects, ("field_epoch", "along_track_error", "time_tag_offset", "ring_current"))
    cut = (FieldTruncation(8, "richer"),)
    asked = {
        "IGRF-14": ("igrf14", [epoch, track, tag, ring, (*track, *epoch)]),
        "degree 8": ("igrf14, degree 8", [cut, epoch, track]),
        "IGRF 1975 of 1975.0": ("igrf1975, held back", [epoch, track, cut]),
        "IGRF 1975 in 1980": ("igrf1975, carried on", [epoch, track, cut]),
    }
    return {
        f"{words}, {axes}": alone(magsat_record(folder, settings, axes), field_model(name), DEFAULT_MODELLED, wanted)
        for axes in ("orbit", "NEC")
        for words, (name, wanted) in asked.items()
    }


def _left(telemetry: Telemetry, model: FieldModel, *effects: SignalEffect) -> Left:
    """What a model with b, S and the effects fitted leaves."""
    remaining_nT, _ = LeastSquares(telemetry, model, DEFAULT_MODELLED).remaining_nT(*effects)
    return Left(_latitude_deg(telemetry), remaining_nT.reshape(-1, 3))


def _latitude_deg(telemetry: Telemetry) -> FloatArray:
    """(N,) geocentric latitude of the rows."""
    assert telemetry.r_N_km is not None
    r_E_km = frames.rotation_EN(telemetry.time).apply(np.array(telemetry.r_N_km))
    latitude: FloatArray = np.degrees(frames.geocentric(r_E_km)[0])
    return latitude
