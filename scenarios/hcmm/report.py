"""What the study of HCMM says: its words and claims, with the numbers and forms they need, and its figures."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import cache, partial
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from fluxtwin.gap.channels.sun_nadir import open_channel
from fluxtwin.gap.records.diagnosis import Diagnosis, EffectParameter
from fluxtwin.plots import calibration as calibration_plots
from fluxtwin.plots import gallery as gallery_plots
from fluxtwin.plots import passes as pass_plots
from fluxtwin.plots import yaw as yaw_plots
from fluxtwin.scenarios.claims import Claim
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
_SOURCES = {
    "lsb": "magnetometer LSB",
    "attitude": "reference attitude",
    "torquer": "torquers",
    "field": "field model",
    "all": "all",
}


def pulls(r: Numbers) -> FloatArray:
    """(12,) estimate of both sets less truth, over its rms error in many runs."""
    c = r.calibration
    return np.asarray((vector(c.fits["AB"]) - c.truth) / c.many.rms_error("AB"))


def judge_claims(results: Numbers) -> list[Claim]:
    """Every claim of the packaged list, in order. Raises KeyError for a claim without words."""
    return words().judge(mission.PRINTED.claims(), r=results)


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
        gallery=gallery_summary,
        infrared_source=INFRARED_SOURCE,
        iso=epoch.iso,
        names=NAMES,
        null_words=NULLS,
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
    return f"{name} {parameter.value:.3g}{sigma} {parameter.unit}"


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


def figures(r: Numbers) -> dict[str, Callable[[], Figure]]:
    """Those of the report, by the names in its words."""
    return {**_of_the_orbit(r), **_of_the_residual(r), **_of_the_passes(r)}


def _of_the_orbit(r: Numbers) -> dict[str, Callable[[], Figure]]:
    t, ideas, passes = r.flight_test, r.nadir_field.ideas, r.nadir_field.passes
    used, scanned = (
        np.array([getattr(p, name) for p in passes if p.sunlit], dtype=float)
        for name in ("sun_field", "sun_field_read")
    )
    return {
        "flight_test": partial(
            pass_plots.draw_ranges,
            labels=t.labels,
            printed_deg=used,
            predicted_deg=t.predicted_deg,
            misread=used != scanned,
            scanned_deg=scanned,
            title="Predicted and printed sun-field angles, 29 November to 1 December 1978",
            unit="sun-field angle [deg]",
        ),
        "null_tests": partial(
            pass_plots.draw_nulls,
            median_deg=t.median_deg,
            nulls_deg={NULLS[name]: value for name, value in t.nulls_deg.items()},
            ends=int(t.untouched.sum()),
            title="Could the test tell?",
        ),
        "nadir_field": partial(
            pass_plots.draw_ideas,
            **{key: [getattr(i, key) for i in ideas] for key in ("explained", "explained_with_digits")},
            names=[i.name for i in ideas],
            by_chance=[i.by_chance[0] for i in ideas],
            total=2 * len(passes),
            title="The open question: the nadir-field column",
        ),
    }


def _of_the_residual(r: Numbers) -> dict[str, Callable[[], Figure]]:
    v, h = r.evidence, r.horizon
    ranges = np.array([r.errors.paper_rule[source] for source in r.errors.simulated])
    return {
        "field_model_error": partial(
            pass_plots.draw_evidence,
            labels=v.labels,
            printed_mG=v.printed_mG,
            predicted_mG=v.predicted_mG,
            night=v.night > 0.5,
            turns_deg=v.turns_deg,
            turned_correlation=v.turned_correlation,
            title="The residuals of 1978 and the error of IGRF 1975",
        ),
        "table_4_errors": partial(
            calibration_plots.draw_budget,
            sources=[_SOURCES[source] for source in r.errors.simulated],
            simulated_mG=np.array(list(r.errors.simulated.values())),
            paper_rule_mG=ranges.mean(axis=1),
            paper_range_mG=ranges,
            title="Sources of the residual",
        ),
        "scanner_nulls": partial(
            pass_plots.draw_moved,
            shifts_deg=scanner.SHIFTS_DEG,
            ratio=h.moved("ratio"),
            correlation=h.moved("correlation"),
            printed_ratio=h.printed.ratio,
            ratio_without=h.disc.ratio,
            correlation_without=h.disc.correlation,
            title="The scanner's errors, where they belong and elsewhere",
        ),
    }


def _of_the_passes(r: Numbers) -> dict[str, Callable[[], Figure]]:
    real, bias = r.real_passes, r.calibration.bias_only
    raw, left = (real.asked["station against station", corrected] for corrected in (False, True))
    return {
        "bias_of_passes": partial(
            pass_plots.draw_bias,
            mean_x_mG=bias.mean_field_mG[:, 0],
            bias_x_mG=bias.b_mG[:, 0],
            explained_mG=bias.mean_field_mG @ r.calibration.truth[:3] + r.calibration.truth[9],
            title="The X bias of single passes",
        ),
        "figure_3": partial(
            yaw_plots.draw_pass,
            r.yaw.figure,
            r.yaw.error_bar_deg,
            title="Figure 3, simulated: yaw over Winkfield, 1978-11-29",
        ),
        "real_passes": partial(
            gallery_plots.draw_real_passes,
            stations=real.stations,
            night=real.night,
            printed_mG=real.printed_mG,
            ratio=real.ratio,
            notes=(
                f"as printed: stations {differ(raw)}, p {p_is(raw.p_counted)}",
                f"IGRF 1975's error out: p {p_is(left.p_counted)}",
            ),
            title="43 passes of 1978",
        ),
    }


def gallery_figures(answers: Sequence[Numbers]) -> dict[str, Callable[[], Figure]]:
    """Those of the gallery, of each case its evidence and the passes that were not used."""
    evidence = {"a": _heads, "b": _night_map, "c": _torquers, "d": _readings}
    drawn: dict[str, Callable[[], Figure]] = {}
    for answer in answers:
        key = answer.case.key
        drawn |= {f"{key}_evidence": partial(evidence[key], answer), f"{key}_passes": partial(_later, answer)}
    return drawn


def _later(answer: Numbers) -> Figure:
    shown = {name: value for name, value in vars(answer.later).items() if name != "rms"}
    return gallery_plots.draw_later(**shown, title="Passes not used")


def _heads(answer: Numbers) -> Figure:
    channel, t = open_channel(answer.telemetry), answer.telemetry
    hours = epoch.seconds_since(t.time[channel.rows], t.time[0]) / 3600.0
    head = np.array(t.sun_sensor_head)[channel.rows]
    return gallery_plots.draw_heads(
        hours, np.degrees(channel.residual_rad), head, title="The angle between sun and nadir"
    )


def _night_map(answer: Numbers) -> Figure:
    night = ~answer.known
    found = answer.diagnosis.effects[0].settings.get("region_deg") if answer.diagnosis.effects else None
    return gallery_plots.draw_night_map(
        latitude_deg=answer.place_deg[night, 0],
        longitude_deg=answer.place_deg[night, 1],
        residual_nT=answer.residual_nT[night, 0],
        put_in_deg=REGION_DEG,
        found_deg=found,
        title="Night passes, size of the field",
    )


def _torquers(answer: Numbers) -> Figure:
    dipole = np.array(answer.telemetry.dipole_B_Am2)
    return _following(answer, dipole, "dipole [A m2]", "What the torquers do to the readings")


def _readings(answer: Numbers) -> Figure:
    reading_uT = np.array(answer.telemetry.mag_B_nT) / 1000.0
    return _following(answer, reading_uT, "reading [uT]", "What a bias alone leaves")


def _following(answer: Numbers, driver: np.ndarray, label: str, title: str) -> Figure:
    residual_nT = answer.residual_nT[answer.known]
    return gallery_plots.draw_following(driver[answer.known], residual_nT, label, title=title)
