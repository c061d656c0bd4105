"""The study's numbers as tables and figures to read."""

from __future__ import annotations

import numpy as np

from fluxtwin.plots import calibration as calibration_plots
from fluxtwin.plots import passes as pass_plots
from fluxtwin.plots import yaw as yaw_plots
from fluxtwin.scenarios.hcmm.calibration_study import KINDS, NAMES, SETS, CalibrationStudy, rms_mG, vector, vector_sigma
from fluxtwin.scenarios.hcmm.claims import Results
from fluxtwin.scenarios.hcmm.judges_calibration import printed_column
from fluxtwin.scenarios.hcmm.mission import printed_value
from fluxtwin.scenarios.hcmm.pass_study import printed_rms
from fluxtwin.scenarios.page import Cell, FigureBlock, Table
from fluxtwin.sim import epoch

_SOURCE_WORDS = {
    "lsb": "magnetometer LSB, 4.7 mG",
    "attitude": "reference attitude (sun sensor, scanner)",
    "torquer": "torquers, compensated",
    "field": "field model, IGRF 1975",
    "all": "all",
}

_FAR = 1.5
"""A stated sigma is named if it is off by more than this factor."""
POINTING = "Wanted: roll 0.7, pitch 0.5, yaw 2.0 deg (C, J)."
_NULL_WORDS = {
    "dipole": "dipole only", "degree2": "degrees 1 and 2", "degree4": "degrees 1 to 4",
    "field_10deg": "field turned by 10 deg", "node_15min": "node 15 min off",
}  # fmt: skip


def orbit_table(r: Results) -> Table:
    """The orbit from the record."""
    f = r.orbit
    late_u, late_node = 0.5 * 360.0 * 60.0 / f.orbit.nodal_period_s, 0.5 * 360.0 / 1436.07
    units = {
        "semi_major_axis_km": "a [km]",
        "raan_deg": "node [deg]",
        "argument_of_latitude_deg": "arg. of latitude [deg]",
    }
    rows: list[list[Cell]] = [
        [units[name], f"{value:.2f}", f"{sigma:.2f}"]
        for name, value, sigma in zip(f.names, f.values, f.sigmas, strict=True)
    ]
    rows += [
        ["nodal period [min]", f"{f.orbit.nodal_period_s / 60:.3f}", ""],
        ["rise less printed acquisition, rms [min]", f"{np.sqrt(np.mean(f.rise_min**2)):.2f}", ""],
        ["first datum after acquisition, mean [min]", f"{f.start_offset_min:.2f}", ""],
    ]
    return Table(
        "Orbit from 43 acquisition times and sun-nadir ranges",
        ["quantity", "value", "1 sigma"],
        rows,
        f"Circular, J2, inclination held at 97.6 deg; epoch {epoch.iso(f.orbit.epoch_utc)}, true equator and equinox "
        "of date. "
        "Sigma from the scatter of the passes. If the printed times are cut, not rounded, to the minute, the "
        "argument of "
        f"latitude is {late_u:.1f} deg smaller and the node {late_node:.2f} deg larger.",
    )


def flight_test_table(r: Results) -> Table:
    """The test against flight with its null tests."""
    t = r.flight_test
    rows: list[list[Cell]] = [
        ["digits as scanned", f"{t.median_as_scanned_deg:.2f}", "", f"{t.ends_within(1.0, as_scanned=True)} of 48"],
        ["documented digits", f"{t.median_deg:.2f}", "", f"{t.ends_within(1.0)} of 48"],
    ]
    rows += [[_NULL_WORDS[k], f"{v:.2f}", f"{v / t.median_deg:.1f}", ""] for k, v in t.nulls_deg.items()]
    return Table(
        "Sun-field angles of 24 sunlit passes, predicted",
        ["case", "median error [deg]", "times worse", "ends within 1 deg"],
        rows,
        "Nothing of these angles entered the orbit. Windows from the printed sun-nadir ranges; field IGRF-14. Of two "
        "directions of a turn the one that does better is given.",
    )


def ideas_table(r: Results) -> Table:
    """The nadir-field column, idea by idea."""
    n = r.nadir_field
    rows: list[list[Cell]] = []
    for idea in n.ideas:
        cells = [f"{n.median_abs(idea, poleward=p, sunlit=s):.1f}" for p in (True, False) for s in (True, False)]
        chance = f"{idea.by_chance[0]:.0f} ± {idea.by_chance[1]:.0f}"
        rows.append([idea.name, *cells, idea.explained, idea.explained_with_digits, chance])
    return Table(
        "The open question: what the nadir-field column holds",
        ["idea", "poleward, sunlit [deg]", "poleward, night [deg]", "equatorward, sunlit [deg]",
         "equatorward, night [deg]", "ends within 1.5 deg", "with one confused digit", "by chance"],
        rows,
        "Median error of the printed ends, 86 in all. By chance: ends explained when the printed ranges are dealt "
        "out at "
        "random among the passes of a hemisphere. The best part of each window has two free numbers a pass for two "
        "printed "
        "numbers. By night the sun-nadir range does not fix the equatorward end.",
    )  # fmt: skip


def nadir_field_rows(r: Results) -> Table:
    """The column row by row: printed, main field, dipole."""
    n = r.nadir_field
    by_name = {idea.name: idea.error_deg for idea in n.ideas}
    main, dipole = by_name["the main field (IGRF-14)"], by_name["its dipole alone"]
    rows: list[list[Cell]] = []
    for k, item in enumerate(n.passes):
        low, high = item.nadir_field_read
        shown = [f"{low + e[k, 0]:.0f}-{high + e[k, 1]:.0f}" for e in (main, dipole)]
        rows.append([item.label, "sunlit" if item.sunlit else "night", f"{low:.0f}-{high:.0f}", *shown])
    return Table(
        "Nadir-field ranges [deg]",
        ["pass", "light", "printed, as scanned", "IGRF-14", "its dipole"],
        rows,
        "In the window of the sun-nadir range. By night only the end near the pole is fixed.",
    )


def calibration_table(r: Results) -> Table:
    """Table 3 with three kinds of sigma."""
    study = r.calibration
    columns = ["parameter"]
    for name in SETS:
        columns += [name, "printed"]
    columns += ["sigma white", "by pass", "and field model", "error in many runs"]
    rows: list[list[Cell]] = []
    for k, parameter in enumerate(NAMES):
        digits = 1 if parameter.startswith("b") else 3
        row: list[Cell] = [f"{parameter} [mG]" if digits == 1 else parameter]
        for name in SETS:
            value, sigma = vector(study.fits[name])[k], vector_sigma(study.fits[name])[k]
            row += [f"{value:.{digits}f}({round(sigma * 10**digits)})", f"{printed_column(name)[k]:.{digits}f}"]
        stated = (
            study.white_sigma["AB"],
            study.pass_sigma["AB"],
            vector_sigma(study.fits["AB"]),
            study.rms_error("AB"),
        )
        row += [f"{sigma[k]:.{digits + 1}f}" for sigma in stated]
        rows.append(row)
    for title, key in (("residual [mG]", "rms"), ("samples", "samples")):
        row = [title]
        for name in SETS:
            ours = f"{rms_mG(study.fits[name]):.1f}" if key == "rms" else f"{study.fits[name].calibration.samples}"
            row += [ours, f"{printed_value('calibration', name, parameter=key):g}"]
        rows.append([*row, "", "", "", ""])
    ratios = [f"{study.sigma_ratio('AB', kind):.1f}" for kind in KINDS]
    rows.append(["error over sigma", *[""] * 6, *ratios, ""])
    return Table(
        "Table 3 (C): calibration by data set",
        columns,
        rows,
        "In parentheses 1 sigma in units of the last digit, by pass and with 1.25 mG allowed for the field model. "
        "White: "
        "every sample an error of its own, as the papers' arithmetic has it; its sigmas are too small, because the "
        "error of "
        "the field model is the same in every sample of a pass and comes back in every pass over the same station. "
        "Error "
        f"in many runs: rms of estimate less truth over {len(study.estimates)} flights with other passes. "
        + _dishonest(study),
    )


def _dishonest(study: CalibrationStudy) -> str:
    """Which stated sigmas are not what the many runs show: the ratio of the last line is a mean over all twelve."""
    ratio = study.rms_error("AB") / vector_sigma(study.fits["AB"])
    small = [f"{name} {value:.1f}" for name, value in zip(NAMES, ratio, strict=True) if value > _FAR]
    large = [f"{name} {1.0 / value:.1f}" for name, value in zip(NAMES, ratio, strict=True) if value < 1.0 / _FAR]
    return (
        f"Error over sigma: root mean square over all {len(NAMES)}, which hides that single sigmas with the field model "
        f"allowed for are too small ({', '.join(small) or 'none'} times) or too large ({', '.join(large) or 'none'} times; "
        f"those off by more than {_FAR:g} are named)."
    )


def error_table(r: Results) -> Table:
    """Table 4, each row twice."""
    e = r.errors
    rows: list[list[Cell]] = []
    for source, (low, high) in e.paper_rule.items():
        ours = f"{e.simulated[source]:.2f} ± {e.simulated_spread[source]:.2f}"
        rows.append([_SOURCE_WORDS[source], ours, f"{low:.2f}" if low == high else f"{low:.2f} to {high:.2f}"])
    rows.append(["residual of the 12-parameter fit", f"{e.fit:.2f}", "2.2"])
    return Table(
        "Table 4 (C) / Table 2 (J): sources of the residual [mG, rms per component]",
        ["source", "simulated alone", "papers' arithmetic"],
        rows,
        "Simulated: error of eq. 1 at the true S and b with that source alone. One coil gives "
        f"{e.coil_axial_mG:.0f} mG on its axis at 1 m, {e.coil_left_mG:.1f} mG after compensation.",
    )


def passes_table(r: Results) -> Table:
    """Table 5 in full: ours, the printed value after a slash."""
    rows: list[list[Cell]] = []
    numbers = zip(r.passes.passes, r.passes.rows, r.passes.field_model_eps_mG, r.passes.eps_range_mG, strict=True)
    for item, ours, model, (low, high) in numbers:
        rows.append(
            [
                item.label + ("*" if item.dawn else ""), ours.samples, f"{ours.eps_M_mG:.2f} / {item.eps_M_mG:.2f}",
                f"{low:.1f}-{high:.1f}", f"{model:.2f}", _pair(ours.sun_field, item.sun_field),
                _two(ours.delta_sun_field, item.delta_sun_field_deg), _pair(ours.nadir_field, item.nadir_field_read),
                _two(ours.delta_nadir_field, item.delta_nadir_field_deg), _pair(ours.sun_nadir, item.sun_nadir),
                _two(ours.delta_sun_nadir, item.delta_sun_nadir_deg),
            ]
        )  # fmt: skip
    rows += _rms_rows(r)
    return Table(
        "Table 5 (C): 43 passes, ours / printed",
        ["pass", "samples", "field strength [mG]", "5-95 % [mG]", "error of IGRF 1975 [mG]",
         "sun-field [deg]", "rms", "nadir-field [deg]",
         "rms", "sun-nadir [deg]", "rms"],
        rows,
        "* dawn pass over Orroral, head 1. Ranges are computed ones in the window that the printed sun-nadir range "
        "fixes; "
        "printed nadir-field angles as scanned. 5-95 %: of our residual over calibrations made with other passes.",
    )  # fmt: skip


def _rms_rows(r: Results) -> list[list[Cell]]:
    p = r.passes
    lit, everything = p.sunlit & ~p.dawn, np.ones(43, dtype=bool)
    out: list[list[Cell]] = []
    for title, chosen in (("rms, 39 passes", p.quiet), ("rms, 43 passes", everything)):
        eps = printed_rms([x.eps_M_mG for x, c in zip(p.passes, chosen, strict=True) if c])
        d_em = printed_rms([x.delta_nadir_field_deg for x, c in zip(p.passes, chosen, strict=True) if c])
        d_sm = printed_rms([x.delta_sun_field_deg for x, c in zip(p.passes, lit, strict=True) if c])
        d_se = printed_rms([x.delta_sun_nadir_deg for x, c in zip(p.passes, lit, strict=True) if c])
        out.append(
            [
                title, "", _two(p.rms("eps_M_mG", chosen), eps), "", "", "", _two(p.rms("delta_sun_field", lit), d_sm), "",
                _two(p.rms("delta_nadir_field", chosen), d_em), "", _two(p.rms("delta_sun_nadir", lit), d_se),
            ]
        )  # fmt: skip
    return out


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
        ["station", "equation 11", "printed", "with the printed 1.7 deg", "Monte Carlo", "field of 1978"],
        rows,
        "Equation 11 with 1.7 mG, 0.17 deg and the dipole of equation 20. The text's 1.7 deg is a slip.",
    )


def scanner_table(r: Results) -> Table:
    """The closed chain of sensors."""
    s = r.scanner
    bias, sigma = np.degrees(s.found.bias_rad), np.degrees(s.found.sigmas_rad)
    rows: list[list[Cell]] = [
        ["roll bias of the scanner [deg]", f"{bias[0]:.3f} ± {sigma[0]:.3f}", f"{s.bias_deg[0]:.3f}"],
        ["pitch bias of the scanner [deg]", f"{bias[1]:.3f} ± {sigma[1]:.3f}", f"{s.bias_deg[1]:.3f}"],
        ["sun-nadir residual before [deg]", f"{s.rms_before_deg:.2f}", ""],
        ["sun-nadir residual after [deg]", f"{s.rms_after_deg:.2f}", "0.24 (C)"],
        ["turn of S that is none of the magnetometer's, before [deg]", f"{s.tilt_biased_deg:.2f}", ""],
        ["the same after [deg]", f"{s.tilt_corrected_deg:.2f}", f"{s.tilt_unbiased_deg:.2f}"],
        ["head 1, mean sun-nadir error at dawn [deg]", f"{s.head_1_deg:.2f}", f"{s.head_1_truth_deg:.2f}"],
    ]
    return Table(
        "The chain sun sensor - scanner - magnetometer",
        ["quantity", "found", "put in"],
        rows,
        "The scanner is calibrated from the angles between sun and nadir, heads 2 and 3 trusted. To a calibration "
        "that takes "
        "the attitude as right, a biased scanner is a turned magnetometer; the sun-nadir angle tells them apart. What "
        "remains after the correction is what a scanner without bias leaves: noise and the field model.",
    )


def flight_figures(r: Results) -> list[FigureBlock]:
    """The test against flight, and the nadir-field column."""
    sunlit = [p for p in r.nadir_field.passes if p.sunlit]
    used = np.array([p.sun_field for p in sunlit], dtype=float)
    scanned = np.array([p.sun_field_read for p in sunlit], dtype=float)
    ranges = pass_plots.AngleRanges(r.flight_test.labels, used, r.flight_test.predicted_deg, used != scanned, scanned)
    wrong = {_NULL_WORDS[name]: value for name, value in r.flight_test.nulls_deg.items()}
    nulls = pass_plots.NullTests(r.flight_test.median_deg, wrong)
    ideas = pass_plots.Ideas(
        [i.name for i in r.nadir_field.ideas],
        [i.explained for i in r.nadir_field.ideas],
        [i.explained_with_digits for i in r.nadir_field.ideas],
        86,
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
                ranges, title="Predicted and printed sun-field angles", unit="sun-field angle [deg]"
            ),
        ),
        FigureBlock(
            "null_tests",
            "The same test with one thing wrong. Degree 4 is nearly enough: the test is one of orbit, sun and main "
            "field.",
            pass_plots.draw_nulls(nulls, title="Could the test tell?"),
        ),
        FigureBlock(
            "nadir_field",
            "How many of the 86 printed ends of the nadir-field angle each idea explains.",
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
    rule = np.array([np.mean(e.paper_rule[s]) for s in shown])
    budget = calibration_plots.ErrorBudget(shown, np.array([e.simulated[s] for s in shown]), rule)
    return [
        FigureBlock(
            "table_4_errors",
            "Sources of the residual: simulated one at a time, and by the papers' arithmetic (middle of their range).",
            calibration_plots.draw_budget(budget, title="Sources of the residual"),
        ),
        FigureBlock(
            "figure_3",
            "As figure 3 of the conference paper: the pass over Winkfield on 29 November. Dashed: sun sensor and "
            "scanner; "
            f"dotted: magnetometer averaged over 120 s. Error bar by the papers' rule: {r.yaw.error_bar_deg:.2f} deg.",
            yaw_plots.draw_pass(r.yaw.figure, r.yaw.error_bar_deg, title="Figure 3: yaw over Winkfield"),
        ),
    ]


def _pair(ours: tuple[float, float] | None, printed: tuple[float, float] | None) -> str:
    if ours is None or printed is None:
        return ""
    return f"{ours[0]:.0f}-{ours[1]:.0f} / {printed[0]:.0f}-{printed[1]:.0f}"


def _two(ours: float | None, printed: float | None) -> str:
    if ours is None and printed is None:
        return ""
    return f"{'-' if ours is None else format(ours, '.2f')} / {'-' if printed is None else format(printed, '.2f')}"
