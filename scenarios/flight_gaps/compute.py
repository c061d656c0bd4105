"""The computing half of the study: files in, diagnoses and least-squares tables out. Nothing is drawn or told here."""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fluxtwin.gap.diagnose import diagnose
from fluxtwin.gap.problem import DEFAULT_MODELLED, pose
from fluxtwin.gap.records import Diagnosis
from fluxtwin.scenarios.flight_field.tracks import read_kp
from fluxtwin.scenarios.flight_gaps import models, readers, records
from fluxtwin.scenarios.flight_gaps.alone import Alone, alone, least_squares, visible_nT
from fluxtwin.scenarios.flight_gaps.cases import DMSP, Case, cases, magsat_record, names_of, storm_record
from fluxtwin.scenarios.flight_gaps.settings import Settings
from fluxtwin.scenarios.flight_gaps.tolles_lawson import Coefficients, coefficients
from fluxtwin.sim.base.progress import Progress, part_of
from fluxtwin.sim.base.types import BoolArray, FloatArray
from fluxtwin.sim.earth import frames
from fluxtwin.sim.earth.field_models import FieldModel, load_field
from fluxtwin.sim.effects.base import SignalEffect
from fluxtwin.sim.effects.catalogue import find_effect
from fluxtwin.sim.effects.chain import jacobian
from fluxtwin.sim.effects.field_truncation import FieldTruncation
from fluxtwin.sim.telemetry.record import Telemetry

BANDS_DEG = (0.0, 30.0, 50.0, 60.0, 75.0, 90.0)
STORM_NT = 50.0
"""The ring current whose visibility is counted."""
_MISSING_NT = 1e5


@dataclass(frozen=True)
class Answer:
    """What the diagnosis said of a case."""

    case: Case
    found: Diagnosis
    latitude_deg: FloatArray
    """(N,) geocentric, at the rows of its series."""

    @property
    def agrees(self) -> bool | None:
        """Whether it is as expected; None where nothing was foretold."""
        return None if self.case.agrees is None else self.case.agrees(self.found)

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
        size, found = np.abs(self.latitude_deg), []
        for low, high in itertools.pairwise(BANDS_DEG):
            rows = (size >= low) & (size < high)
            if rows.any():
                found.append((low, high, int(rows.sum()), float(np.sqrt(np.mean(np.square(self.residual_nT[rows]))))))
        return found


@dataclass(frozen=True)
class Outcome:
    """All that the study found."""

    answers: tuple[Answer, ...]
    storm: Alone
    """Swarm A in the storm, nothing modelled."""
    storm_visible: tuple[tuple[str, int, float, float], ...]
    """Which rows, how many, and the rms of a ring current of 50 nT along them, whole and beside b and S."""
    magsat: Mapping[str, Alone]
    """MAGSAT by model and axes, b and S free."""
    magsat_left: Left
    """What IGRF-14 with b and S free leaves along MAGSAT's orbit."""
    degree_left: tuple[Left, Left]
    """The same for IGRF-14 cut at degree 8, without and with field_truncation."""
    kp: FloatArray
    """Eight values of the day of MAGSAT."""
    fill_rows: Mapping[str, tuple[int, int]]
    """Rows with a fill value by case, and how many of them were cut."""
    coefficients: Coefficients
    """Of the aircraft, from the published values."""

    def answer(self, name: str) -> Answer:
        """The answer to the case of that name."""
        return next(one for one in self.answers if one.case.name == name)


def compute(folder: Path, settings: Settings, progress: Progress) -> Outcome:
    """Diagnose every case. Raises BadInput for a file that cannot be used."""
    progress("reading the recorded files", 0.0)
    storm, visible = _storm_tables(folder, settings)
    magsat = _magsat_tables(folder, settings)
    orbit = magsat_record(folder, settings)[0]
    cut = models.degree_8()
    asked = cases(folder, settings)
    answers = []
    for number, case in enumerate(asked):
        share = part_of(progress, 0.1 + 0.9 * number / len(asked), 0.1 + 0.9 * (number + 1) / len(asked))
        answers.append(_answer(case, share))
    given = readers.read_compensation(folder / settings.aircraft.file)
    fill = {answer.case.name: _fill_rows(answer) for answer in answers if answer.case.part == DMSP}
    return Outcome(
        answers=tuple(answers),
        storm=storm,
        storm_visible=visible,
        magsat=magsat,
        magsat_left=_left(orbit, load_field("igrf14")),
        degree_left=(_left(orbit, cut), _left(orbit, cut, FieldTruncation(8, "richer"))),
        kp=read_kp(folder / settings.magsat.kp_file, magsat_record(folder, settings)[1].time[0]),
        fill_rows=fill,
        coefficients=coefficients(given, settings.aircraft.rate_Hz),
    )


def _answer(case: Case, progress: Progress) -> Answer:
    telemetry, model = case.make()

    def told(words: str, share: float) -> None:
        progress(f"{case.title}: {words}", share)

    found = diagnose(telemetry, model, modelled=case.modelled, progress=told)
    return Answer(case, found, _latitude_deg(telemetry))


def _effects(*names: str) -> tuple[SignalEffect, ...]:
    found = [find_effect(name) for name in names]
    assert all(isinstance(effect, SignalEffect) for effect in found)
    return tuple(effect for effect in found if isinstance(effect, SignalEffect))


def _storm_tables(folder: Path, settings: Settings) -> tuple[Alone, tuple[tuple[str, int, float, float], ...]]:
    arc, track = storm_record(folder, settings)
    model = load_field("igrf14")
    names = ("ring_current", "bias", "scale_misalignment", "along_track_error", "time_tag_offset", "field_epoch")
    table = alone(arc, model, (), [_effects(name) for name in names])
    day = records.of_residual_day(readers.read_residual_day(folder / settings.swarm.files[0]), model)
    orbit = int(np.searchsorted(day.time, day.time[0] + np.timedelta64(5640, "s")))
    kinds = [
        ("this arc", arc),
        ("the whole pass over the pole", records.of_track(track)),
        ("one orbit of Swarm A", day.select(slice(0, orbit))),
        ("one day of Swarm A", day.select(slice(None, None, settings.swarm.every))),
    ]
    (ring,) = _effects("ring_current")
    visible = [
        (words, len(rows), *visible_nT(rows, model, DEFAULT_MODELLED, ring, STORM_NT)) for words, rows in kinds
    ]  # fmt: skip
    return table, tuple(visible)


def _magsat_tables(folder: Path, settings: Settings) -> Mapping[str, Alone]:
    igrf14, igrf1975 = load_field("igrf14"), load_field("igrf1975")
    wanted = [_effects(name) for name in ("field_epoch", "along_track_error", "time_tag_offset", "ring_current")]
    wanted.append(_effects("along_track_error", "field_epoch"))
    cut = (FieldTruncation(8, "richer"),)
    found = {}
    for axes in ("orbit", "NEC"):
        telemetry = magsat_record(folder, settings, axes)[0]
        found[f"IGRF-14, {axes}"] = alone(telemetry, igrf14, DEFAULT_MODELLED, wanted)
        found[f"degree 8, {axes}"] = alone(telemetry, models.degree_8(), DEFAULT_MODELLED, [cut, *wanted[:2]])
        old = (models.held_back(igrf1975), models.carried_on(igrf1975))
        for words, model in zip(("IGRF 1975 of 1975.0", "IGRF 1975 in 1980"), old, strict=True):
            found[f"{words}, {axes}"] = alone(telemetry, model, DEFAULT_MODELLED, [*wanted[:2], cut])
    return found


def _left(telemetry: Telemetry, model: FieldModel, *effects: SignalEffect) -> Left:
    """What a model with b, S and the effects fitted leaves."""
    problem = pose(telemetry, model, modelled=DEFAULT_MODELLED)
    residual = np.asarray(problem.residual_nT)
    images = [jacobian(problem.chain, one, at=problem.modelled_active) for one in effects]
    design = np.concatenate([problem.nuisance, *images], axis=2).reshape(residual.size, -1)
    fitted, _ = least_squares(design, residual.reshape(-1))
    return Left(_latitude_deg(telemetry), residual - fitted.reshape(-1, 3))


def _fill_rows(answer: Answer) -> tuple[int, int]:
    telemetry, _ = answer.case.make()
    filled = np.any(np.abs(telemetry.mag_B_nT) > _MISSING_NT, axis=1)
    return int(filled.sum()), int((filled & answer.cut).sum())


def _latitude_deg(telemetry: Telemetry) -> FloatArray:
    """(N,) geocentric latitude of the rows."""
    assert telemetry.r_N_km is not None
    r_E_km = frames.rotation_EN(telemetry.time).apply(np.array(telemetry.r_N_km))
    latitude: FloatArray = np.degrees(frames.geocentric(r_E_km)[0])
    return latitude
