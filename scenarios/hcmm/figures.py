"""The figures of the HCMM study, by the names in its words."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial

import numpy as np
from matplotlib.figure import Figure

from fluxtwin.gap.channels.sun_nadir import open_channel
from fluxtwin.plots import calibration as calibration_plots
from fluxtwin.plots import gallery as gallery_plots
from fluxtwin.plots import passes as pass_plots
from fluxtwin.plots import yaw as yaw_plots
from fluxtwin.scenarios.hcmm.gallery_study import REGION_DEG
from fluxtwin.scenarios.hcmm.horizon_study import SHIFTS_DEG
from fluxtwin.scenarios.hcmm.report import NULLS, differ, p_is
from fluxtwin.scenarios.numbers import Numbers
from fluxtwin.sim.earth import epoch

_SOURCES = {
    "lsb": "magnetometer LSB",
    "attitude": "reference attitude",
    "torquer": "torquers",
    "field": "field model",
    "all": "all",
}


def figures(r: Numbers) -> dict[str, Callable[[], Figure]]:
    """Those of the report."""
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
            names=[i.name for i in ideas],
            explained=[i.explained for i in ideas],
            explained_with_digits=[i.explained_with_digits for i in ideas],
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
            shifts_deg=SHIFTS_DEG,
            ratio={name: np.array([one.ratio for one in seen]) for name, seen in h.shifted.items()},
            correlation={name: np.array([one.correlation for one in seen]) for name, seen in h.shifted.items()},
            printed_ratio=h.printed.ratio,
            ratio_without=h.disc.ratio,
            correlation_without=h.disc.correlation,
            title="The scanner's errors, where they belong and elsewhere",
        ),
    }


def _of_the_passes(r: Numbers) -> dict[str, Callable[[], Figure]]:
    real, bias = r.real_passes, r.calibration.bias_only
    raw, left = (real.question("station against station", corrected=c) for c in (False, True))
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
    assert answer.later is not None
    shown = {name: value for name, value in vars(answer.later).items() if name != "rms"}
    return gallery_plots.draw_later(**shown, title="Passes not used")


def _heads(answer: Numbers) -> Figure:
    channel, t = open_channel(answer.telemetry), answer.telemetry
    assert t.sun_sensor_head is not None
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
