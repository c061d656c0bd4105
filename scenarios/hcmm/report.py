"""What the study of HCMM says: its words and claims, with the numbers and forms they need."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cache
from typing import Any

import numpy as np

from fluxtwin.gap.records.diagnosis import Diagnosis, EffectParameter
from fluxtwin.scenarios.calibration_records import NAMES, calibration_summary, rms_mG, vector, vector_sigma
from fluxtwin.scenarios.claims import Claim
from fluxtwin.scenarios.hcmm import calibration_study, error_study, horizon_study, missing_study, mission, yaw_study
from fluxtwin.scenarios.hcmm.gallery_study import REGION_DEG
from fluxtwin.scenarios.hcmm.missing_study import Hypothesis
from fluxtwin.scenarios.hcmm.pass_study import ANOMALOUS
from fluxtwin.scenarios.hcmm.real_passes import Question
from fluxtwin.scenarios.hcmm_orbit import nadir_field
from fluxtwin.scenarios.hcmm_orbit.record import Range
from fluxtwin.scenarios.numbers import Numbers
from fluxtwin.scenarios.report import Report, matrix
from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.earth import epoch
from fluxtwin.sim.earth.horizon import INFRARED_SOURCE

NULLS = {
    "dipole": "dipole only",
    "degree2": "degrees 1 and 2",
    "degree4": "degrees 1 to 4",
    "field_10deg": "field turned by 10 deg",
    "node_15min": "node 15 min off",
}
"""What is wrong in each null test."""


def pulls(r: Numbers) -> FloatArray:
    """(12,) estimate of both sets less truth, over its rms error in many runs."""
    return np.asarray((vector(r.calibration.fits["AB"]) - r.calibration.truth) / r.calibration.rms_error("AB"))


def judge_claims(results: Numbers) -> list[Claim]:
    """Every claim of the packaged list, in order. Raises KeyError for a claim without words."""
    return words("claims.md").judge(mission.PRINTED, r=results)


def summary(results: Numbers, claims: list[Claim]) -> dict[str, Any]:
    """The content of `summary.json`."""
    return {**words().summary(r=results), "claims": [claim.to_dict() for claim in claims]}


def gallery_summary(answers: Sequence[Numbers]) -> list[dict[str, Any]]:
    """For `summary.json`."""
    return [
        {
            "case": answer.case.key,
            "title": answer.case.title,
            "verdict": answer.diagnosis.verdict,
            "named": answer.name,
            "right": answer.right,
            "where": {name: getattr(answer.diagnosis.where, name) for name in ("stage", "axis", "frame", "condition")},
            "located": answer.located,
            "parameters": [
                {"name": c.name, "put_in": c.put_in, "found": c.found, "sigma": c.sigma, "unit": c.unit}
                for c in answer.compared
            ],
            "passes_not_used": None
            if answer.later is None
            else {
                "unit": answer.later.unit,
                "before": answer.later.rms[0],
                "after": answer.later.rms[1],
                "floor": answer.later.floor,
                "concerned": int(answer.later.concerned.sum()),
                "passes": len(answer.later.labels),
            },
        }
        for answer in answers
    ]


@cache
def words(file: str = "words.md") -> Report:
    """The sections of one of the study's files."""
    other = "gallery.md" if file == "gallery.md" else "words.md"
    return Report(
        "fluxtwin.scenarios.hcmm",
        file,
        filters=_FILTERS,
        calibration_study=calibration_study,
        calibration_summary=calibration_summary,
        clock=lambda time: epoch.iso(time)[11:19],
        days=mission.DAYS,
        diagnosed=_diagnosed,
        differ=differ,
        error_study=error_study,
        excluded=_excluded,
        four=[number - 1 for number in ANOMALOUS],
        gallery=gallery_summary,
        horizon_study=horizon_study,
        infrared_source=INFRARED_SOURCE,
        iso=epoch.iso,
        matrix=matrix,
        missing_study=missing_study,
        nadir_study=nadir_field,
        names=NAMES,
        null_words=NULLS,
        print_of=_printed_column,
        printed=mission.printed_value,
        pulls=pulls,
        quantity=mission.quantity,
        ranges=_ranges,
        region_deg=REGION_DEG,
        residuals=_residuals,
        rms_mG=rms_mG,
        rounded=_rounded,
        say=lambda name, **values: words("claims.md").say(name, **values),
        size=lambda source: next(row["magnitude"] for row in mission.read_table("errors") if row["source"] == source),
        vector=vector,
        vector_sigma=vector_sigma,
        words=lambda name, **values: words(other).say(name, **values),
        yaw_study=yaw_study,
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


def _excluded(one: Hypothesis, study: Numbers, between: str) -> str:
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
