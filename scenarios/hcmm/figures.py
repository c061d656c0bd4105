"""The figures of the HCMM study, by the names in its words."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial

import numpy as np
from matplotlib.figure import Figure

from fluxtwin.gap.sun_nadir import open_channel
from fluxtwin.plots import calibration as calibration_plots
from fluxtwin.plots import gallery as gallery_plots
from fluxtwin.plots import passes as pass_plots
from fluxtwin.plots import yaw as yaw_plots
from fluxtwin.scenarios.hcmm.gallery_study import REGION_DEG, Answer
from fluxtwin.scenarios.hcmm.horizon_study import SHIFTS_DEG
from fluxtwin.scenarios.hcmm.report import NULLS, Results, differ, p_is
from fluxtwin.sim.earth import epoch

_SOURCES = {
    "lsb": "magnetometer LSB",
    "attitude": "reference attitude",
    "torquer": "torquers",
    "field": "field model",
    "all": "all",
}


def figures(r: Results) -> dict[str, Callable[[], Figure]]:
    """Those of the report."""
    return {
        "flight_test": partial(_flight_test, r),
        "null_tests": partial(_null_tests, r),
        "nadir_field": partial(_nadir_field, r),
        "field_model_error": partial(_field_model_error, r),
        "bias_of_passes": partial(_bias_of_passes, r),
        "table_4_errors": partial(_errors, r),
        "figure_3": lambda: yaw_plots.draw_pass(
            r.yaw.figure, r.yaw.error_bar_deg, title="Figure 3, simulated: yaw over Winkfield, 1978-11-29"
        ),
        "scanner_nulls": partial(_scanner_nulls, r),
        "real_passes": partial(_real_passes, r),
    }


def _flight_test(r: Results) -> Figure:
    sunlit = [p for p in r.nadir_field.passes if p.sunlit]
    used = np.array([p.sun_field for p in sunlit], dtype=float)
    scanned = np.array([p.sun_field_read for p in sunlit], dtype=float)
    return pass_plots.draw_ranges(
        pass_plots.AngleRanges(r.flight_test.labels, used, r.flight_test.predicted_deg, used != scanned, scanned),
        title="Predicted and printed sun-field angles, 29 November to 1 December 1978",
        unit="sun-field angle [deg]",
    )


def _null_tests(r: Results) -> Figure:
    t = r.flight_test
    wrong = {NULLS[name]: value for name, value in t.nulls_deg.items()}
    record = pass_plots.NullTests(t.median_deg, wrong, int(t.untouched.sum()))
    return pass_plots.draw_nulls(record, title="Could the test tell?")


def _nadir_field(r: Results) -> Figure:
    ideas = r.nadir_field.ideas
    record = pass_plots.Ideas(
        [i.name for i in ideas],
        [i.explained for i in ideas],
        [i.explained_with_digits for i in ideas],
        [i.by_chance[0] for i in ideas],
        2 * len(r.nadir_field.passes),
    )
    return pass_plots.draw_ideas(record, title="The open question: the nadir-field column")


def _field_model_error(r: Results) -> Figure:
    e = r.evidence
    record = pass_plots.ResidualEvidence(
        e.labels, e.printed_mG, e.predicted_mG, e.night, e.turns_deg, e.turned_correlation
    )
    return pass_plots.draw_evidence(record, title="The residuals of 1978 and the error of IGRF 1975")


def _bias_of_passes(r: Results) -> Figure:
    bias, truth = r.calibration.bias_only, r.calibration.truth
    explained = bias.mean_field_mG @ truth[:3] + truth[9]
    record = pass_plots.BiasOfPasses(bias.mean_field_mG[:, 0], bias.b_mG[:, 0], explained)
    return pass_plots.draw_bias(record, title="The X bias of single passes")


def _errors(r: Results) -> Figure:
    simulated, rule = r.errors.simulated, r.errors.paper_rule
    ranges = np.array([rule[source] for source in simulated])
    record = calibration_plots.ErrorBudget(
        [_SOURCES[source] for source in simulated], np.array(list(simulated.values())), ranges.mean(axis=1), ranges
    )
    return calibration_plots.draw_budget(record, title="Sources of the residual")


def _scanner_nulls(r: Results) -> Figure:
    h = r.horizon
    record = pass_plots.MovedErrors(
        SHIFTS_DEG,
        {name: np.array([one.ratio for one in seen]) for name, seen in h.shifted.items()},
        {name: np.array([one.correlation for one in seen]) for name, seen in h.shifted.items()},
        h.printed.ratio,
        h.disc.ratio,
        h.disc.correlation,
    )
    return pass_plots.draw_moved(record, title="The scanner's errors, where they belong and elsewhere")


def _real_passes(r: Results) -> Figure:
    real = r.real_passes
    raw, left = (real.question("station against station", corrected=c) for c in (False, True))
    labels = (
        f"as printed: stations {differ(raw)}, p {p_is(raw.p_counted)}",
        f"IGRF 1975's error out: p {p_is(left.p_counted)}",
    )
    record = gallery_plots.RealResiduals(real.stations, real.night, real.printed_mG, real.ratio, labels)
    return gallery_plots.draw_real_passes(record, title="43 passes of 1978")


def gallery_figures(answers: Sequence[Answer]) -> dict[str, Callable[[], Figure]]:
    """Those of the gallery, of each case its evidence and the passes that were not used."""
    evidence = {"a": _heads, "b": _night_map, "c": _torquers, "d": _readings}
    drawn: dict[str, Callable[[], Figure]] = {}
    for answer in answers:
        key = answer.case.key
        drawn |= {f"{key}_evidence": partial(evidence[key], answer), f"{key}_passes": partial(_later, answer)}
    return drawn


def _later(answer: Answer) -> Figure:
    later = answer.later
    assert later is not None
    record = gallery_plots.PassResiduals(
        later.labels, later.unit, later.before, later.after, later.concerned, later.floor
    )
    return gallery_plots.draw_later(record, title="Passes not used")


def _heads(answer: Answer) -> Figure:
    channel, t = open_channel(answer.telemetry), answer.telemetry
    assert t.sun_sensor_head is not None
    hours = epoch.seconds_since(t.time[channel.rows], t.time[0]) / 3600.0
    record = gallery_plots.HeadAngles(
        hours, np.degrees(channel.residual_rad), np.array(t.sun_sensor_head)[channel.rows]
    )
    return gallery_plots.draw_heads(record, title="The angle between sun and nadir")


def _night_map(answer: Answer) -> Figure:
    night = ~answer.known
    found = answer.diagnosis.effects[0].settings.get("region_deg") if answer.diagnosis.effects else None
    record = gallery_plots.NightMap(
        answer.place_deg[night, 0],
        answer.place_deg[night, 1],
        answer.residual_nT[night, 0],
        REGION_DEG,
        None if found is None else (found[0], found[1], found[2], found[3]),
    )
    return gallery_plots.draw_night_map(record, title="Night passes, size of the field")


def _torquers(answer: Answer) -> Figure:
    dipole = np.array(answer.telemetry.dipole_B_Am2)[answer.known]
    record = gallery_plots.Following(dipole, answer.residual_nT[answer.known], "dipole [A m2]")
    return gallery_plots.draw_following(record, title="What the torquers do to the readings")


def _readings(answer: Answer) -> Figure:
    reading_uT = np.array(answer.telemetry.mag_B_nT)[answer.known] / 1000.0
    record = gallery_plots.Following(reading_uT, answer.residual_nT[answer.known], "reading [uT]")
    return gallery_plots.draw_following(record, title="What a bias alone leaves")
