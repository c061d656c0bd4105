"""What the study of HCMM says: its words and claims, with the numbers and forms they need."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cache
from typing import Any

import numpy as np

from fluxtwin.gap.channels.sun_nadir import open_channel
from fluxtwin.gap.records.diagnosis import Diagnosis, EffectParameter
from fluxtwin.gap.report.words import located
from fluxtwin.scenarios.flights import NAMES, Numbers, calibration_summary, rms_along, rms_mG, vector, vector_sigma
from fluxtwin.scenarios.hcmm import calibration, mission, scanner, strength, yaw
from fluxtwin.scenarios.hcmm.gallery import REGION_DEG
from fluxtwin.scenarios.hcmm.passes import ANOMALOUS, column_of, rms_of
from fluxtwin.scenarios.hcmm_orbit import predictions
from fluxtwin.scenarios.hcmm_orbit.record import Range
from fluxtwin.scenarios.words import Words
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
    c = r.calibration
    return np.asarray((vector(c.fits["AB"]) - c.truth) / c.many.rms_error("AB"))


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
            "parameters": [vars(one) for one in answer.compared],
            "passes_not_used": answer.later
            and {
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
def words() -> Words:
    """The sections of the study's files."""
    return Words(
        mission.PRINTED.package,
        "words.md",
        "claims.md",
        "gallery.md",
        filters=_FILTERS,
        calibration=calibration,
        calibration_summary=calibration_summary,
        clock=lambda time: epoch.iso(time)[11:19],
        column_of=column_of,
        days=mission.DAYS,
        diagnosed=_diagnosed,
        differ=differ,
        four=[number - 1 for number in ANOMALOUS],
        infrared_source=INFRARED_SOURCE,
        gallery=gallery_summary,
        iso=epoch.iso,
        located=located,
        names=NAMES,
        null_words=NULLS,
        open_channel=open_channel,
        predictions=predictions,
        print_of=_printed_column,
        printed=mission.printed_value,
        pulls=pulls,
        quantity=mission.quantity,
        ranges=_ranges,
        region_deg=REGION_DEG,
        residuals=_residuals,
        rms_mG=rms_mG,
        rms_of=rms_of,
        rounded=_rounded,
        scanner=scanner,
        seconds_since=epoch.seconds_since,
        size=mission.PRINTED.size,
        strength=strength,
        vector=vector,
        vector_sigma=vector_sigma,
        yaw=yaw,
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


def _diagnosed(found: Diagnosis | None) -> str:
    if found is None:
        return "not asked"
    effects = [f"{e.name} ({', '.join(_value(*item) for item in e.parameters.items())})" for e in found.effects]
    where = f", at the stage {found.where.stage}" if found.verdict == "unknown" else ""
    return "; ".join(effects) or found.verdict.replace("_", " ") + where


def _value(name: str, parameter: EffectParameter) -> str:
    sigma = "" if parameter.sigma is None else f" ± {parameter.sigma:.2g}"
    return f"{name} {parameter.value:.3g}{sigma}{'' if parameter.unit == '1' else f' {parameter.unit}'}"


def _rounded(value: float, sigma: float | None) -> str:
    """To the second digit of its sigma; to four digits where it has none."""
    if not sigma:
        return f"{value:.4g}"
    return f"{value:.{max(0, 1 - int(np.floor(np.log10(sigma))))}f}"


def differ(one: Numbers) -> str:
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
    "rms": lambda values: rms_along(values, axis=0),
    "span": _span,
    "unbroken": _unbroken,
    "unitless": lambda name: name.split(" [")[0],
}
"""How the tables write passes, ranges and p-values."""
