"""What the study of HCMM says: its words and claims, with the numbers and forms they need."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np

from fluxtwin.gap.records import Diagnosis, EffectParameter
from fluxtwin.scenarios.calibration_records import NAMES, rms_mG, vector, vector_sigma
from fluxtwin.scenarios.claims import Claim
from fluxtwin.scenarios.hcmm import mission
from fluxtwin.scenarios.hcmm.accuracy_study import AccuracyStudy
from fluxtwin.scenarios.hcmm.calibration_study import FIELD_ERROR_NT, KINDS, SETS, CalibrationStudy
from fluxtwin.scenarios.hcmm.dawn_study import DawnStudy
from fluxtwin.scenarios.hcmm.error_study import NEAR_EQUATOR_DEG, NEAR_POLES_DEG, ErrorStudy
from fluxtwin.scenarios.hcmm.field_evidence import FieldEvidence
from fluxtwin.scenarios.hcmm.gallery_study import REGION_DEG, Answer
from fluxtwin.scenarios.hcmm.horizon_study import CORRECTED, EARTHS, PUBLISHED, SCANS, HorizonStudy
from fluxtwin.scenarios.hcmm.missing_study import NUMBERS, SURE, Hypothesis, MissingStudy
from fluxtwin.scenarios.hcmm.pass_study import ANOMALOUS, PassStudy
from fluxtwin.scenarios.hcmm.real_passes import Question, RealPasses
from fluxtwin.scenarios.hcmm.scanner_study import ScannerStudy
from fluxtwin.scenarios.hcmm.yaw_study import PRINTED_SIGMA_DEG, SIGMA_B_MG, SIGMA_DEG, YawStudy
from fluxtwin.scenarios.hcmm_orbit.fit import OrbitFit
from fluxtwin.scenarios.hcmm_orbit.flight_test import FlightTest
from fluxtwin.scenarios.hcmm_orbit.nadir_field import DIPOLE, MAIN_FIELD, NEAR_DEG, NadirField
from fluxtwin.scenarios.hcmm_orbit.record import Range
from fluxtwin.scenarios.hcmm_orbit.windows import Windows
from fluxtwin.scenarios.motion import Motion
from fluxtwin.scenarios.report import Report, matrix
from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.earth import epoch
from fluxtwin.sim.earth.horizon import INFRARED_SOURCE
from fluxtwin.sim.scenario.scenario import Scenario


@dataclass(frozen=True)
class Results:
    """All that a run has found."""

    scenario: Scenario
    motion: Motion
    """Of the three days of Table 5."""
    orbit: OrbitFit
    windows: Windows
    """Of all 43 passes, from the sun-nadir ranges with their documented digits."""
    flight_test: FlightTest
    nadir_field: NadirField
    evidence: FieldEvidence
    calibration: CalibrationStudy
    errors: ErrorStudy
    passes: PassStudy
    dawn: DawnStudy
    yaw: YawStudy
    accuracy: AccuracyStudy
    scanner: ScannerStudy
    horizon: HorizonStudy
    missing: MissingStudy
    real_passes: RealPasses
    gallery: tuple[Answer, ...]
    gallery_law: Answer | None
    """Case (c) with the coils driven by the control law; None where the motion of the study is prescribed too."""


NULLS = {
    "dipole": "dipole only",
    "degree2": "degrees 1 and 2",
    "degree4": "degrees 1 to 4",
    "field_10deg": "field turned by 10 deg",
    "node_15min": "node 15 min off",
}
"""What is wrong in each null test."""


def pulls(r: Results) -> FloatArray:
    """(12,) estimate of both sets less truth, over its rms error in many runs."""
    return (vector(r.calibration.fits["AB"]) - r.calibration.truth) / r.calibration.rms_error("AB")


def judge_claims(results: Results) -> list[Claim]:
    """Every claim of the packaged list, in order. Raises KeyError for a claim without words."""
    return words("claims.md").judge(mission.PRINTED, r=results)


@cache
def words(file: str = "words.md") -> Report:
    """The sections of one of the study's files."""
    return Report(
        "fluxtwin.scenarios.hcmm",
        file,
        filters=_FILTERS,
        clock=lambda time: epoch.iso(time)[11:19],
        corrected_earth=CORRECTED.words,
        days=mission.DAYS,
        diagnosed=_diagnosed,
        differ=differ,
        dipole_part=DIPOLE,
        earths=[earth.words for earth in EARTHS],
        excluded=_excluded,
        field_error_nT=FIELD_ERROR_NT,
        infrared_source=INFRARED_SOURCE,
        iso=epoch.iso,
        kinds=KINDS,
        main_field=MAIN_FIELD,
        matrix=matrix,
        names=NAMES,
        near_deg=NEAR_DEG,
        near_equator_deg=NEAR_EQUATOR_DEG,
        near_poles_deg=NEAR_POLES_DEG,
        numbers=NUMBERS,
        print_of=_printed_column,
        printed=mission.printed_value,
        printed_sigma_deg=PRINTED_SIGMA_DEG,
        published_earths=PUBLISHED,
        pulls=pulls,
        quantity=mission.quantity,
        ranges=_ranges,
        region_deg=REGION_DEG,
        residuals=_residuals,
        rms_mG=rms_mG,
        rounded=_rounded,
        say=lambda name, **values: words("claims.md").say(name, **values),
        scans=list(SCANS),
        null_words=NULLS,
        sets=SETS,
        sigma_B_mG=SIGMA_B_MG,
        sigma_deg=SIGMA_DEG,
        size=lambda source: next(row["magnitude"] for row in mission.read_table("errors") if row["source"] == source),
        sure=SURE,
        vector=vector,
        vector_sigma=vector_sigma,
        words=lambda name, **values: words("gallery.md" if file == "gallery.md" else "words.md").say(name, **values),
    )


def _printed_column(name: str) -> FloatArray:
    """(12,) the printed column of Table 3, S row by row and b [mG]."""
    return np.array([mission.printed_value("calibration", name, parameter=parameter) for parameter in NAMES])


def _span(ends: Range) -> str:
    """As 17-31, or one number if both are the same."""
    low, high = (f"{value:.0f}" for value in ends)
    return low if low == high else f"{low}-{high}"


def _unbroken(text: str) -> str:
    """On one line however narrow the column."""
    return text.replace(" ", "\u00a0")


def _ranges(ours: Range | None, printed: Range | None) -> str:
    """Two cells."""
    return " | " if ours is None or printed is None else f"{_span(ours)} | {_span(printed)}"


def _residuals(ours: float | None, printed: float | None) -> str:
    """Two cells."""
    if ours is None and printed is None:
        return " | "
    return " | ".join("-" if value is None else f"{value:.2f}" for value in (ours, printed))


def _excluded(one: Hypothesis, study: MissingStudy, between: str) -> str:
    return between.join(name.split(" [")[0] for name in one.excluded_by(study.printed))


def _diagnosed(found: Diagnosis | None) -> str:
    if found is None:
        return "not asked"
    effects = [f"{e.name} ({', '.join(_value(*item) for item in e.parameters.items())})" for e in found.effects]
    where = f", at the stage {found.where.stage}" if found.verdict == "unknown" else ""
    return "; ".join(effects) or found.verdict.replace("_", " ") + where


def _value(name: str, parameter: EffectParameter) -> str:
    sigma = "" if parameter.sigma is None else f" ± {parameter.sigma:.2g}"
    return f"{name} {parameter.value:.3g}{sigma} {parameter.unit}"


def _rounded(value: float, sigma: float | None) -> str:
    """To the second digit of its sigma; to four digits where it has none."""
    if not sigma:
        return f"{value:.4g}"
    return f"{value:.{max(0, 1 - int(np.floor(np.log10(sigma))))}f}"


def differ(one: Question) -> str:
    """Whether stations are seen to differ."""
    return "differ" if one.certain else "are not seen to differ"


def p_is(value: float) -> str:
    """As `= 0.03` or `< 0.0001`."""
    return _p(value) if value < 0.0001 else f"= {_p(value)}"


def _p(value: float) -> str:
    if value < 0.0001:
        return "<\u00a00.0001"
    return f"{value:.4f}" if value < 0.01 else f"{value:.2f}"


_FILTERS: Mapping[str, Any] = {
    "marked": lambda item: _unbroken(item.label + ("*" if item.dawn else "**" if item.number in ANOMALOUS else "")),
    "p": _p,
    "p_is": p_is,
    "rms": lambda values: np.sqrt(np.mean(np.square(values), axis=0)),
    "span": _span,
    "unbroken": _unbroken,
}
"""How the tables write passes, ranges and p-values."""
