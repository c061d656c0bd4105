"""`fluxtwin run flight-gaps`: the diagnosis on records that flew, whose cause it is not given.

In plain least squares nothing is whitened, penalised or searched. It is the look that a person takes first, and the table
next to which the diagnosis must be read: many names explain much of one and the same residual.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path

import numpy as np

from fluxtwin.calib.common.digits import plain
from fluxtwin.gap.diagnose import diagnose
from fluxtwin.gap.law.words import made_of
from fluxtwin.gap.problem.problem import DEFAULT_MODELLED, pose
from fluxtwin.gap.records.diagnosis import Diagnosis
from fluxtwin.gap.report.words import at_the_end
from fluxtwin.scenarios.flight_field.tracks import read_kp, read_magsat, read_swarm
from fluxtwin.scenarios.flight_gaps import records
from fluxtwin.scenarios.flight_gaps.records import Compensation, field_model
from fluxtwin.scenarios.flights import Numbers, latitude_deg, rms, rms_along
from fluxtwin.scenarios.page import StudyResult
from fluxtwin.scenarios.recorded_files import Settings, run_on_files
from fluxtwin.scenarios.words import Words
from fluxtwin.sim.base.progress import Progress, part_of
from fluxtwin.sim.base.toml_input import Strict, read_model
from fluxtwin.sim.base.types import BoolArray, FloatArray
from fluxtwin.sim.earth.field_models import FieldModel
from fluxtwin.sim.effects.ambient_field import FieldTruncation
from fluxtwin.sim.effects.base import SignalEffect
from fluxtwin.sim.effects.catalogue import CATALOGUE, find_effect
from fluxtwin.sim.effects.chain import jacobian
from fluxtwin.sim.telemetry.record import Telemetry

PACKAGED = Path(__file__).parent / "cases.toml"
BANDS_DEG = (0.0, 30.0, 50.0, 60.0, 75.0, 90.0)
STORM_NT = 50.0
"""The ring current whose visibility is counted."""
_MISSING_NT = 1e5
_POLAR_DEG = 65.0
_ORBIT_S = 5640
_RCOND = 1e-12


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
    """One question to the diagnosis: a record, a field model, what is modelled; and what is known and withheld."""

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
    expert: str = ""
    """What an expert would say to a law of this record, in words."""
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


class LeastSquares:
    """A record's residual to a field model, and the columns of what is modelled. Raises as `pose` does."""

    def __init__(self, telemetry: Telemetry, model: FieldModel, modelled: Sequence[str]) -> None:
        """Pose the problem."""
        self._problem = pose(telemetry, model, modelled=modelled)
        self.residual_nT: FloatArray = np.asarray(self._problem.residual_nT).reshape(-1)
        self.nuisance = self._problem.nuisance.reshape(self.residual_nT.size, -1)

    def image(self, effect: SignalEffect) -> FloatArray:
        """(M, P) change of the residual by the parameters of an effect."""
        image = jacobian(self._problem.chain, effect, at=self._problem.modelled_active)
        return np.asarray(image).reshape(self.residual_nT.size, -1)

    def remaining_nT(self, *effects: SignalEffect) -> tuple[FloatArray, list[FloatArray]]:
        """The residual (M,) once what is modelled and the effects are fitted, and the coefficients of each effect."""
        images = [self.image(effect) for effect in effects]
        fitted, values = _fit(np.concatenate([self.nuisance, *images], axis=1), self.residual_nT)
        ends = np.cumsum([self.nuisance.shape[1], *(image.shape[1] for image in images)])
        return self.residual_nT - fitted, [values[a:b] for a, b in itertools.pairwise(ends)]


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
        assert self.found.series is not None and self.found.series.cut is not None
        return self.found.series.cut

    @property
    def polar_steps_nT(self) -> FloatArray | None:
        """(3,) rms change of the residual from row to row beyond 65 deg of latitude; None where nothing is known there."""
        change = np.diff(self.left_nT, axis=0)[np.abs(self.latitude_deg[1:]) > _POLAR_DEG]
        return rms_along(change, axis=0) if np.isfinite(change).any() else None

    @property
    def stage_share(self) -> float:
        """Probability of the stage that is named; 0 where none is."""
        return self.found.where.probabilities["stage"].get(self.found.where.stage or "", 0.0)


def compute(folder: Path, settings: Settings, progress: Progress) -> Numbers:
    """Diagnose every case. Raises BadInput for a file that cannot be used."""
    progress("reading the recorded files", 0.0)
    storm, visible = _storm_tables(folder, settings)
    magsat = _magsat_tables(folder, settings)
    orbit = magsat_record(folder, settings)
    asked = read_cases()
    answers = {}
    for number, case in enumerate(asked):
        share = part_of(progress, 0.1 + 0.9 * number / len(asked), 0.1 + 0.9 * (number + 1) / len(asked))
        answers[case.name] = _answer(case, folder, settings, share)
    given = records.read_compensation(folder / settings.aircraft.file)
    return Numbers(
        answers=answers,
        # Swarm A in the storm, nothing modelled; and how much of a ring current of 50 nT some data show.
        storm=storm,
        storm_visible=visible,
        # MAGSAT by model and axes, b and S free; and what IGRF-14 then leaves along the orbit.
        magsat=magsat,
        magsat_left=_left(orbit, field_model("igrf14")),
        # Eight values of the day of MAGSAT.
        kp=read_kp(folder / settings.magsat.kp_file, orbit.time[0]),
        # Of the aircraft, from the published values.
        coefficients=coefficients(given, settings.aircraft.rate_Hz),
    )


def _answer(case: Case, folder: Path, settings: Settings, progress: Progress) -> Answer:
    telemetry, model = case.load(folder, settings)

    def titled(words: str, share: float) -> None:
        progress(f"{case.title}: {words}", share)

    found = diagnose(telemetry, model, modelled=case.modelled, progress=titled)
    filled = np.any(np.abs(telemetry.mag_B_nT) > _MISSING_NT, axis=1)
    return Answer(case, found, latitude_deg(telemetry), filled)


def _effects(*names: str) -> tuple[SignalEffect, ...]:
    return tuple(effect for effect in map(find_effect, names) if isinstance(effect, SignalEffect))


def _storm_tables(folder: Path, settings: Settings) -> tuple[Numbers, tuple[Numbers, ...]]:
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
    visible = []
    for words, rows in kinds.items():
        # rms along the rows, and after projecting out b and S
        whole, beside = visible_nT(rows, model, DEFAULT_MODELLED, ring, STORM_NT)
        visible.append(Numbers(rows=words, samples=len(rows), whole_nT=whole, beside_b_and_S_nT=beside))
    return table, tuple(visible)


def _magsat_tables(folder: Path, settings: Settings) -> Mapping[str, Numbers]:
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


def _left(telemetry: Telemetry, model: FieldModel) -> Numbers:
    """What a model with b and S fitted leaves."""
    remaining_nT, _ = LeastSquares(telemetry, model, DEFAULT_MODELLED).remaining_nT()
    along_deg, residual_nT = latitude_deg(telemetry), remaining_nT.reshape(-1, 3)
    bands = [
        (low, high, (np.abs(along_deg) >= low) & (np.abs(along_deg) < high))
        for low, high in itertools.pairwise(BANDS_DEG)
    ]
    return Numbers(
        # (N,) geocentric, and (N, 3).
        latitude_deg=along_deg,
        residual_nT=residual_nT,
        # Latitudes from and to, rows, rms per component [nT], either hemisphere.
        bands=[(low, high, int(rows.sum()), rms(residual_nT[rows])) for low, high, rows in bands if rows.any()],
    )


def alone(
    telemetry: Telemetry, model: FieldModel, modelled: Sequence[str], wanted: Sequence[tuple[SignalEffect, ...]]
) -> Numbers:
    """Least squares of each set of effects and what is modelled, all components alike. Raises as `pose` does."""
    problem, shares = LeastSquares(telemetry, model, modelled), {}
    for effects in wanted:
        remaining_nT, values = problem.remaining_nT(*effects)
        names = tuple(one.name for one in effects)
        shares[" + ".join(names)] = Numbers(
            effects=names,
            parameters=sum(part.size for part in values),
            left_nT=rms(remaining_nT),
            # The fitted value of each effect with one parameter, else its largest, in units of that parameter.
            sizes=tuple(float(part[np.argmax(np.abs(part))]) for part in values),
        )
    return Numbers(
        # rms per component [nT] with nothing fitted; with what is modelled; and with each set of effects as well, by name.
        raw_nT=rms(problem.residual_nT),
        modelled=tuple(modelled),
        base_nT=rms(problem.remaining_nT()[0]),
        shares=shares,
    )


def visible_nT(
    telemetry: Telemetry, model: FieldModel, modelled: Sequence[str], effect: SignalEffect, size: float
) -> tuple[float, float]:
    """rms per component of an effect with one parameter of that size: whole, and after projecting out what is modelled."""
    problem = LeastSquares(telemetry, model, modelled)
    image = size * problem.image(effect)[:, 0]
    return rms(image), rms(image - _fit(problem.nuisance, image)[0])


def _fit(design: FloatArray, residual: FloatArray, rcond: float = _RCOND) -> tuple[FloatArray, FloatArray]:
    """What columns (M, P) of any units explain of the residual (M,), and their coefficients."""
    length = np.linalg.norm(design, axis=0)
    length = np.where(length > 0, length, 1.0)
    found = np.linalg.lstsq(design / length, residual, rcond=rcond)[0]
    return np.asarray(design / length @ found), np.asarray(found / length)


def coefficients(given: Compensation, rate_Hz: float) -> Numbers:
    """The 18 coefficients of a published Tolles-Lawson compensation, recovered exactly.

    With the fluxgate's reading f and its direction u the compensation is u . (p + S f + K df/dt): permanent, induced (S
    symmetric) and eddy-current terms (Tolles & Lawson 1950; Leliak 1961, doi 10.1109/TANE3.1961.4201799). df/dt is the
    central difference that the source took, so the 18 coefficients repeat the published values to their last digit.
    """
    flux = given.fluxgate_B_nT
    u = flux / np.linalg.norm(flux, axis=1)[:, None]
    rows, columns = np.triu_indices(3)
    induced = u[:, rows] * flux[:, columns]
    eddy = np.einsum("ni,nj->nij", u, np.gradient(flux, 1.0 / rate_Hz, axis=0)).reshape(-1, 9)
    design = np.concatenate([u, induced, eddy], axis=1)
    _, found = _fit(design, given.taken_nT, 1e-13)
    S = np.zeros((3, 3))
    S[rows, columns] = 0.5 * found[3:9]
    K = found[9:].reshape(3, 3)
    symmetric = 0.5 * (K + K.T)
    return Numbers(
        # (3,), (3, 3) symmetric, and (3, 3), of which the last also without its antisymmetric part and its trace.
        permanent_nT=found[:3],
        induced=S + S.T,
        eddy_s=K,
        symmetric_eddy_s=symmetric - np.eye(3) * np.trace(symmetric) / 3.0,
        # Largest difference between the published compensation and the one of these coefficients.
        worst_nT=np.abs(design @ found - given.taken_nT).max(),
        # rms along the field of the three parts, and of the eddy terms that are antisymmetric.
        parts_nT=(rms(u @ found[:3]), rms(induced @ found[3:9]), rms(eddy @ found[9:])),
        antisymmetric_nT=rms(eddy @ (K - symmetric).reshape(-1)),
    )


SETTINGS = Path(__file__).parent / "flight_gaps.toml"
"""What the study runs with; a copy lies beside its results."""
_AURORA_DEG = 60.0


def present(outcome: Numbers, settings: Settings) -> StudyResult:
    """What the study says of its outcome."""
    provenance = {
        "settings": "flight_gaps.toml beside this page",
        "files": ", ".join(settings.files),
        "effects in the catalogue": str(len(CATALOGUE)),
    }
    return words().result("flight-gaps", provenance, o=outcome, settings=settings.tree)


@cache
def words() -> Words:
    """The sections of `words.md`, with what speaks of an answer."""
    return Words(
        "fluxtwin.scenarios.flight_gaps",
        filters={
            "before_comma": lambda text: text.partition(",")[0],
            "unnamed": lambda found: words().say("unnamed", found=found),
        },
        known=(at_the_end, fits_of, find_effect, made_of, names_of, plain),
        aurora_deg=_AURORA_DEG,
        storm_nT=STORM_NT,
    )


def fits_of(tables: Mapping[str, Numbers]) -> list[dict[str, object]]:
    """One row for each fit of the tables: what is modelled alone, and each set of effects as well."""
    rows: list[dict[str, object]] = []
    for name, table in tables.items():
        rows.append({"table": name, "effects": ("b and S",), "left_nT": table.base_nT, "sizes": ()})
        rows += [{"table": "", **vars(share)} for share in table.shares.values()]
    return rows


run = partial(run_on_files, SETTINGS, compute, present)
