"""The study's numbers as tables and figures to read."""

from __future__ import annotations

import numpy as np

from fluxtwin.plots import calibration as calibration_plots
from fluxtwin.plots import passes as pass_plots
from fluxtwin.plots import yaw as yaw_plots
from fluxtwin.scenarios.hcmm.calibration_study import (
    FIELD_ERROR_NT,
    KINDS,
    NAMES,
    SETS,
    CalibrationStudy,
    rms_mG,
    vector,
    vector_sigma,
)
from fluxtwin.scenarios.hcmm.claims import Results
from fluxtwin.scenarios.hcmm.judges_calibration import printed_column
from fluxtwin.scenarios.hcmm.mission import DAYS, printed_value, quantity
from fluxtwin.scenarios.hcmm.pass_tables import span
from fluxtwin.scenarios.hcmm.yaw_study import PRINTED_SIGMA_DEG, SIGMA_B_MG, SIGMA_DEG
from fluxtwin.scenarios.hcmm_orbit.nadir_field import DIPOLE, MAIN_FIELD, NEAR_DEG
from fluxtwin.scenarios.page import Cell, FigureBlock, Table
from fluxtwin.sim.earth import epoch
from fluxtwin.sim.earth.constants import NT_PER_MG

_SOURCE_WORDS = {
    "lsb": "magnetometer LSB, {lsb:.1f} mG",
    "attitude": "reference attitude (sun sensor, scanner)",
    "torquer": "torquers, compensated",
    "field": "field model, IGRF 1975",
    "all": "all",
}
_SOURCE_LABELS = {
    "lsb": "magnetometer LSB", "attitude": "reference attitude", "torquer": "torquers", "field": "field model", "all": "all",
}  # fmt: skip

_ELEMENT_WORDS = {
    "semi_major_axis_km": "semi-major axis [km]",
    "raan_deg": "right ascension of the ascending node [deg]",
    "argument_of_latitude_deg": "argument of latitude [deg]",
}
_SET_WORDS = {"A": "set A", "B": "set B", "AB": "A and B"}
_FAR = 1.5
"""A stated sigma is named if it is off by more than this factor."""
_WANTED = ", ".join(f"{name} {quantity(name + ' wanted'):.1f}" for name in ("roll", "pitch", "yaw"))
POINTING = f"Wanted: {_WANTED} deg (C, J)."
_NULL_WORDS = {
    "dipole": "dipole only", "degree2": "degrees 1 and 2", "degree4": "degrees 1 to 4",
    "field_10deg": "field turned by 10 deg", "node_15min": "node 15 min off",
}  # fmt: skip


def orbit_table(r: Results) -> Table:
    """The orbit from the record."""
    f = r.orbit
    late_u, late_node = 0.5 * 360.0 * 60.0 / f.orbit.nodal_period_s, 0.5 * 360.0 / 1436.07
    rows: list[list[Cell]] = [
        [_ELEMENT_WORDS[name], f"{value:.2f}", f"{sigma:.2f}"]
        for name, value, sigma in zip(f.names, f.values, f.sigmas, strict=True)
    ]
    rows += [
        ["nodal period [min]", f"{f.orbit.nodal_period_s / 60:.3f}", ""],
        ["ascending node, local apparent solar time [h]", f"{f.node_apparent_h:.2f}", f"{f.sigmas[1] / 15.0:.2f}"],
        ["rise less printed acquisition, rms [min]", f"{np.sqrt(np.mean(f.rise_min**2)):.2f}", ""],
        ["first datum after acquisition, mean [min]", f"{f.start_offset_min:.2f}", ""],
    ]
    correlation = f.covariance / np.outer(f.sigmas, f.sigmas)
    return Table(
        "Orbit from 43 acquisition times and sun-nadir ranges",
        ["quantity", "value", "1 sigma"],
        rows,
        f"Circular, J2, inclination held at {np.degrees(f.orbit.inclination_rad):.1f} deg; epoch "
        f"{epoch.iso(f.orbit.epoch_utc)}, true equator and equinox of date. Sigma from the scatter of the passes; "
        f"correlations: axis and node {correlation[0, 1]:.2f}, axis and argument of latitude {correlation[0, 2]:.2f}, node "
        f"and argument of latitude {correlation[1, 2]:.2f}. If the printed times are cut, not rounded, to the minute, the "
        f"argument of latitude is {late_u:.1f} deg smaller and the node {late_node:.2f} deg larger.",
    )


def flight_test_table(r: Results) -> Table:
    """The test against flight with its null tests."""
    t = r.flight_test
    rows: list[list[Cell]] = [
        [
            f"{int(t.untouched.sum())} ends whose digits nobody touched",
            f"{t.median_deg:.2f}",
            "",
            f"{int((np.abs(t.error_deg[t.untouched]) <= 1.0).sum())} of {int(t.untouched.sum())}",
        ],
        [
            "all 48, digits as scanned",
            f"{t.median_as_scanned_deg:.2f}",
            "",
            f"{t.ends_within(1.0, as_scanned=True)} of 48",
        ],
        ["all 48, documented corrections", f"{t.median_corrected_deg:.2f}", "", f"{t.ends_within(1.0)} of 48"],
    ]
    rows += [[_NULL_WORDS[k], f"{v:.2f}", f"{v / t.median_deg:.1f}", ""] for k, v in t.nulls_deg.items()]
    return Table(
        "Sun-field angles of 24 sunlit passes, predicted",
        ["case", "median error [deg]", "times worse", "ends within 1 deg"],
        rows,
        "Nothing of these angles entered the orbit. Windows from the printed sun-nadir ranges; field IGRF-14. Of two "
        "directions of a turn the one that does better is given.",
    )


def ideas_tables(r: Results) -> list[Table]:
    """The nadir-field column, idea by idea: where the gap lies, and how many ends each explains."""
    n = r.nadir_field
    lies: list[list[Cell]] = []
    explained: list[list[Cell]] = []
    for idea in n.ideas:
        lies.append(
            [
                idea.name,
                *(f"{n.median_abs(idea, poleward=p, sunlit=s):.1f}" for p in (True, False) for s in (True, False)),
            ]
        )
        chance = f"{idea.by_chance[0]:.0f} ± {idea.by_chance[1]:.0f}"
        explained.append([idea.name, f"{idea.explained}", chance, f"{idea.explained_with_digits}"])
    return [
        Table(
            "The open question: where the nadir-field column disagrees, median error [deg]",
            ["idea", "poleward, sunlit", "poleward, night", "equatorward, sunlit", "equatorward, night"],
            lies,
            "Of the printed ends, poleward and equatorward, of sunlit and night passes apart. By night the sun-nadir "
            "range does "
            "not fix the equatorward end.",
        ),
        Table(
            f"The open question: how many of the {2 * len(n.passes)} ends each idea explains",
            ["idea", f"within {NEAR_DEG:g} deg", "by chance", "with one confused digit allowed"],
            explained,
            "By chance: ends explained when the printed ranges are dealt out at random among the passes of a "
            "hemisphere. The "
            "best part of each window has two free numbers a pass for two printed numbers.",
        ),
    ]


def nadir_field_rows(r: Results) -> Table:
    """The column row by row: printed, main field, dipole."""
    n = r.nadir_field
    by_name = {idea.name: idea.error_deg for idea in n.ideas}
    main, dipole = by_name[MAIN_FIELD], by_name[DIPOLE]
    rows: list[list[Cell]] = []
    for k, item in enumerate(n.passes):
        low, high = item.nadir_field_read
        shown = [span((low + e[k, 0], high + e[k, 1])) for e in (main, dipole)]
        rows.append([item.label, "sunlit" if item.sunlit else "night", span((low, high)), *shown])
    return Table(
        "Nadir-field ranges [deg]",
        ["pass", "light", "printed, as scanned", "IGRF-14", "its dipole"],
        rows,
        "Lowest to highest in the window of the sun-nadir range; a single number where the print has one. By night only the "
        "end near the pole is fixed.",
    )


def calibration_table(r: Results) -> Table:
    """Table 3, ours beside the printed columns."""
    study = r.calibration
    columns = ["parameter"]
    for name in SETS:
        columns += [_SET_WORDS[name], "printed"]
    rows: list[list[Cell]] = []
    for k, parameter in enumerate(NAMES):
        digits = 1 if parameter.startswith("b") else 3
        row: list[Cell] = [f"{parameter} [mG]" if digits == 1 else parameter]
        for name in SETS:
            value, sigma = vector(study.fits[name])[k], vector_sigma(study.fits[name])[k]
            row += [f"{value:.{digits}f}({round(sigma * 10**digits)})", f"{printed_column(name)[k]:.{digits}f}"]
        rows.append(row)
    for title, key in (("residual [mG]", "rms"), ("samples", "samples")):
        row = [title]
        for name in SETS:
            ours = f"{rms_mG(study.fits[name]):.1f}" if key == "rms" else f"{study.fits[name].calibration.samples}"
            theirs = printed_value("calibration", name, parameter=key)
            row += [ours, f"{theirs:.1f}" if key == "rms" else f"{theirs:.0f}"]
        rows.append(row)
    days = "; ".join(f"{name} " + ", ".join(map(str, DAYS[name])) for name in ("A", "B"))
    return Table(
        "Table 3 (C): calibration by data set",
        columns,
        rows,
        "In parentheses 1 sigma in units of the last digit: errors that last a pass and "
        f"{FIELD_ERROR_NT / NT_PER_MG:.2f} mG of the field model allowed for. Days of 1978: {days}; which of their "
        "passes the "
        "papers took is not known, so the columns can agree within sigma only. The printed columns of A and B stand as "
        "corrected in calibration.csv.",
    )


def sigma_table(r: Results) -> Table:
    """How honest three kinds of sigma are, both sets together."""
    study = r.calibration
    stated = (study.white_sigma["AB"], study.pass_sigma["AB"], vector_sigma(study.fits["AB"]), study.rms_error("AB"))
    rows: list[list[Cell]] = []
    for k, parameter in enumerate(NAMES):
        digits = 2 if parameter.startswith("b") else 4
        name = f"{parameter} [mG]" if digits == 2 else parameter
        rows.append([name, *(f"{sigma[k]:.{digits}f}" for sigma in stated)])
    rows.append(["error / sigma", *(f"{study.sigma_ratio('AB', kind):.1f}" for kind in KINDS), ""])
    return Table(
        "Sets A and B: what sigma says, and what the error is",
        ["parameter", "sigma, white", "sigma by pass", "by pass and field model", "error in many runs"],
        rows,
        "White: every sample an error of its own, as the papers' arithmetic has it; its sigmas are too small, because the "
        "error of the field model is the same in every sample of a pass and comes back in every pass over the same station. "
        f"Error in many runs: rms of estimate less truth over {len(study.estimates)} flights with other passes. "
        + _dishonest(study),
    )


def _dishonest(study: CalibrationStudy) -> str:
    """Which stated sigmas are not what the many runs show: the ratio of the last line is a mean over all twelve."""
    ratio = study.rms_error("AB") / vector_sigma(study.fits["AB"])
    small = [f"{name} {value:.1f}" for name, value in zip(NAMES, ratio, strict=True) if value > _FAR]
    large = [f"{name} {1.0 / value:.1f}" for name, value in zip(NAMES, ratio, strict=True) if value < 1.0 / _FAR]
    return (
        f"Error / sigma: root mean square over all {len(NAMES)}, which hides that single sigmas with the field model "
        f"allowed for are too small ({', '.join(small) or 'none'} times) or too large ({', '.join(large) or 'none'} times; "
        f"those off by more than {_FAR:g} are named)."
    )


def error_table(r: Results) -> Table:
    """Table 4, each row twice."""
    e = r.errors
    rows: list[list[Cell]] = []
    for source, (low, high) in e.paper_rule.items():
        ours = f"{e.simulated[source]:.2f} ± {e.simulated_spread[source]:.2f}"
        words = _SOURCE_WORDS[source].format(lsb=quantity("LSB"))
        rows.append([words, ours, f"{low:.2f}" if low == high else f"{low:.2f} to {high:.2f}"])
    observed = printed_value("errors", "rms_lo_mG", source="observed")
    rows.append(["residual of the 12-parameter fit", f"{e.fit:.2f}", f"{observed:.1f} observed"])
    return Table(
        "Table 4 (C) / Table 2 (J): sources of the residual [mG, rms per component]",
        ["source", "simulated alone", "papers' arithmetic"],
        rows,
        "Simulated: error of eq. 1 at the true S and b with that source alone, and its scatter over "
        f"{e.flights} flights; all: with all sources on. The papers' arithmetic: LSB/sqrt 12, their sizes of the others, "
        f"and the root sum of squares. One coil gives {e.coil_axial_mG:.0f} mG on its axis at 1 m, {e.coil_left_mG:.1f} mG "
        "after compensation"
        + ("; the control law drives it so gently that little of it is seen." if r.motion.dynamic else "."),
    )


def yaw_table(r: Results) -> Table:
    """Table 6."""
    rows: list[list[Cell]] = [
        [
            s.station,
            f"{s.dipole:.2f}",
            f"{s.printed:.2f}",
            f"{s.dipole_printed_sigma:.2f}",
            f"{s.scatter:.2f}",
            f"{s.main_field:.2f}",
        ]
        for s in r.yaw.stations
    ]
    return Table(
        "Table 6 (C): yaw error over the stations [deg]",
        [
            "station",
            "equation 11",
            "printed",
            f"with the printed {PRINTED_SIGMA_DEG:g} deg",
            "Monte Carlo",
            "field of 1978",
        ],
        rows,
        f"Equation 11 with {SIGMA_B_MG:g} mG, {SIGMA_DEG:g} deg and the dipole of equation 20. The text's "
        f"{PRINTED_SIGMA_DEG:g} deg is a slip. Monte Carlo: scatter of the full yaw solution for such errors in the same "
        "dipole. Field of 1978: equation 11 in the field that is known today, where the ground track passes within 2 deg of "
        "the station.",
    )


def scanner_table(r: Results) -> Table:
    """The closed chain of sensors."""
    s = r.scanner
    bias, sigma = np.degrees(s.found.bias_rad), np.degrees(s.found.sigmas_rad)
    printed = quantity("sun-nadir residual")
    rows: list[list[Cell]] = [
        ["roll bias of the scanner [deg]", f"{bias[0]:.3f} ± {sigma[0]:.3f}", f"{s.bias_deg[0]:.3f} put in"],
        ["pitch bias of the scanner [deg]", f"{bias[1]:.3f} ± {sigma[1]:.3f}", f"{s.bias_deg[1]:.3f} put in"],
        ["sun-nadir residual before, rms [deg]", f"{s.rms_before_deg:.2f}", ""],
        ["sun-nadir residual after, rms [deg]", f"{s.rms_after_deg:.2f}", f"{printed:.2f} printed (C)"],
        ["turn of S that is none of the magnetometer's, before [deg]", f"{s.tilt_biased_deg:.2f}", ""],
        ["the same after [deg]", f"{s.tilt_corrected_deg:.2f}", f"{s.tilt_unbiased_deg:.2f} with no bias put in"],
        ["head 1, mean sun-nadir error at dawn [deg]", f"{s.head_1_deg:.2f}", f"{s.head_1_truth_deg:.2f} put in"],
    ]
    return Table(
        "The chain sun sensor - scanner - magnetometer",
        ["quantity", "found", "to compare"],
        rows,
        "The scanner is calibrated from the angles between sun and nadir, heads 2 and 3 trusted. To a calibration "
        "that takes the attitude as right, a biased scanner is a turned magnetometer; the sun-nadir angle tells them apart. "
        "What remains after the correction is what a scanner without bias leaves: noise and the field model.",
    )


def flight_figures(r: Results) -> list[FigureBlock]:
    """The test against flight, and the nadir-field column."""
    sunlit = [p for p in r.nadir_field.passes if p.sunlit]
    used = np.array([p.sun_field for p in sunlit], dtype=float)
    scanned = np.array([p.sun_field_read for p in sunlit], dtype=float)
    ranges = pass_plots.AngleRanges(r.flight_test.labels, used, r.flight_test.predicted_deg, used != scanned, scanned)
    wrong = {_NULL_WORDS[name]: value for name, value in r.flight_test.nulls_deg.items()}
    nulls = pass_plots.NullTests(r.flight_test.median_deg, wrong, int(r.flight_test.untouched.sum()))
    ideas = pass_plots.Ideas(
        [i.name for i in r.nadir_field.ideas],
        [i.explained for i in r.nadir_field.ideas],
        [i.explained_with_digits for i in r.nadir_field.ideas],
        [i.by_chance[0] for i in r.nadir_field.ideas],
        2 * len(r.nadir_field.passes),
    )
    return [
        FigureBlock(
            "flight_test",
            "Sun-field angles of the 24 sunlit passes of 1978: printed range (bar) and the ends predicted from "
            "orbit, sun and "
            "IGRF-14. Rows 11-30 0324 and 12-01 0342 miss one end because the sun-nadir angle turns inside the pass "
            "and does "
            "not fix it.",
            pass_plots.draw_ranges(
                ranges,
                title="Predicted and printed sun-field angles, 29 November to 1 December 1978",
                unit="sun-field angle [deg]",
            ),
        ),
        FigureBlock(
            "null_tests",
            "The same test with one thing wrong, of the ends whose digits nobody touched. Of the field it is the low "
            "degrees that are tested: degrees 1 to 4 alone "
            f"make the error {r.flight_test.nulls_deg['degree4'] / r.flight_test.median_deg:.1f} times larger.",
            pass_plots.draw_nulls(nulls, title="Could the test tell?"),
        ),
        FigureBlock(
            "nadir_field",
            "How many of the 86 printed ends of the nadir-field angle each idea explains. Marks: how many it would "
            "explain by "
            "chance, the printed ranges dealt out at random. An idea with free numbers explains much by chance.",
            pass_plots.draw_ideas(ideas, title="The open question: the nadir-field column"),
        ),
    ]


def evidence_figure(r: Results) -> FigureBlock:
    """The printed residuals and the error of IGRF 1975."""
    e = r.evidence
    record = pass_plots.ResidualEvidence(
        e.labels, e.printed_mG, e.predicted_mG, e.night, e.turns_deg, e.turned_correlation
    )
    return FigureBlock(
        "field_model_error",
        "Left: printed residual in field strength of each real pass against the error of IGRF 1975 along it. Right: "
        "the rank "
        "correlation of the two when the map of errors is turned about the Earth's axis.",
        pass_plots.draw_evidence(record, title="The residuals of 1978 and the error of IGRF 1975"),
    )


def bias_figure(r: Results) -> FigureBlock:
    """Why b1 wandered."""
    bias, truth = r.calibration.bias_only, r.calibration.truth
    explained = bias.mean_field_mG @ truth[:3] + truth[9]
    record = pass_plots.BiasOfPasses(bias.mean_field_mG[:, 0], bias.b_mG[:, 0], explained)
    return FigureBlock(
        "bias_of_passes",
        f"What the flight software of 1978 saw: with b alone, b1 wanders by {bias.half_range_mG[0]:.0f} mG either "
        "way from "
        f"pass to pass. The first row of S explains {100 * bias.explained:.0f} % of its variance.",
        pass_plots.draw_bias(record, title="The X bias of single passes"),
    )


def other_figures(r: Results) -> list[FigureBlock]:
    """Error budget and figure 3."""
    e = r.errors
    shown = tuple(e.simulated)
    ranges = np.array([e.paper_rule[s] for s in shown])
    budget = calibration_plots.ErrorBudget(
        [_SOURCE_LABELS[s] for s in shown], np.array([e.simulated[s] for s in shown]), ranges.mean(axis=1), ranges
    )
    return [
        FigureBlock(
            "table_4_errors",
            "Sources of the residual: simulated one at a time, and by the papers' arithmetic. Where the papers give "
            "a range, "
            "the bar is its middle and the line its ends.",
            calibration_plots.draw_budget(budget, title="Sources of the residual"),
        ),
        FigureBlock(
            "figure_3",
            "Simulated; drawn as figure 3 of the conference paper: the pass over Winkfield on 29 November 1978, from "
            "rise at "
            f"{epoch.iso(r.yaw.contact.rise)[11:19]} UTC. Dashed: sun sensor and scanner; lines: magnetometer, sample by "
            "sample, broken where a reading steps by one bit (letters: its axis); dotted: magnetometer averaged over "
            f"{r.yaw.figure.window_s:.0f} s. Error bar by the papers' rule: {r.yaw.error_bar_deg:.2f} deg, printed "
            f"{quantity('figure 3 error bar'):.2f}; against the true yaw the magnetometer errs by "
            f"{r.yaw.magnetometer_yaw_rms_deg:.2f} deg rms.",
            yaw_plots.draw_pass(
                r.yaw.figure, r.yaw.error_bar_deg, title="Figure 3, simulated: yaw over Winkfield, 1978-11-29"
            ),
        ),
    ]
