"""The study's numbers as tables and figures to read."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from fluxtwin.plots import calibration as calibration_plots
from fluxtwin.plots import yaw as yaw_plots
from fluxtwin.scenarios.page import FigureBlock, Table
from fluxtwin.scenarios.seasat import geometry, mission
from fluxtwin.scenarios.seasat.calibration_study import NAMES, CalibrationStudy, rms_mG, vector
from fluxtwin.scenarios.seasat.claims import Results
from fluxtwin.scenarios.seasat.judges_calibration import COLUMN_2, uncorrected_column_2
from fluxtwin.scenarios.seasat.mission import DATA_SETS, PAPER_COLUMN
from fluxtwin.scenarios.seasat.yaw_study import STEP_S
from fluxtwin.scenarios.yaw_comparison import NEAR_NODE_DEG
from fluxtwin.sim.base.types import FloatArray

_SOURCE_WORDS = {
    "lsb": "magnetometer LSB, {magnetometer LSB}",
    "attitude": "reference attitude, {reference attitude error}",
    "torquer": "torquers, {electromagnet activity}",
    "field": "field model, {field model error}",
    "known": "known, together",
    "unknown": "unknown",
    "all": "all",
}

_DAY = np.datetime_as_string(geometry.day(geometry.DATA_DAYS[0]), unit="D") + " (day 205)"

POINTING = (
    "The papers print no pointing for Seasat, but that yaw = 0 was mostly nearer than the magnetometer's yaw, "
    f"{mission.printed_value('yaw', 'value', quantity='sigma_y equator')} deg at the equator (C 12)."
)


def printed_columns() -> FloatArray:
    """(data sets, 12) printed values of S and b [mG]; only the last column of the paper's table has signs for S."""
    rows = {(row["parameter"], row["data_set"]): float(row["value"]) for row in mission.read_table("calibration")}
    return np.array([[rows[name, PAPER_COLUMN[d]] for name in NAMES] for d in DATA_SETS])


def calibration_table(study: CalibrationStudy) -> Table:
    """Table 1: our columns with sigma beside the printed ones."""
    printed = printed_columns()
    order = [len(DATA_SETS) - 1, *range(len(DATA_SETS) - 1)]
    columns = ["parameter"]
    for d in order:
        columns += [list(DATA_SETS)[d], "printed"]
    rows: list[list[str]] = []
    values = np.array([vector(study.fits[d]) for d in DATA_SETS])
    sigmas = np.array([study.scatter(d) for d in DATA_SETS])
    for k, parameter in enumerate(NAMES):
        in_mG = parameter.startswith("b")
        row = [f"{parameter} [mG]" if in_mG else parameter]
        for d in order:
            row.append(_with_sigma(values[d, k], sigmas[d, k], 1 if in_mG else 3))
            row.append(_printed(printed[d, k], signed=in_mG or d == len(DATA_SETS) - 1, digits=1 if in_mG else 3))
        rows.append(row)
    residuals = [f"{rms_mG(study.fits[d]):.1f}" for d in DATA_SETS]
    counts = [str(len(study.fits[d].time)) for d in DATA_SETS]
    for title, ours, theirs in (
        ("residual [mG]", residuals, _printed_row("noise", ".1f")),
        ("samples", counts, _printed_row("samples", ".0f")),
    ):
        rows.append(_row(title, [ours[d] for d in order], [theirs[d] for d in order]))
    return Table(
        "Table 1 (C): calibration by data set",
        columns,
        rows,
        "Ours: the papers' regression (eq. 8-9) and, in parentheses in units of the last digit, 1 sigma from the Monte "
        "Carlo, which holds all errors, slow ones too. A slow unknown is partly taken up by the fit of one orbit, so our "
        "one-orbit residuals are smaller. Printed "
        "magnitudes without a sign are as the scan shows them. 193 is days 205 and 225; the printed base of 210 "
        "samples is no sum of these days. Our days start at hours of our choice, so the one-orbit columns can agree in "
        "scatter only.",
    )


def scatter_table(study: CalibrationStudy) -> Table:
    """Why only the second column of S scatters."""
    rows: list[list[str | float | int]] = []
    for name in DATA_SETS:
        sigma, index = study.scatter(name), study.index(name)
        others = [k for k in range(9) if k not in COLUMN_2]
        field = np.nanmedian(study.field_rms_mG[:, index], axis=0)
        rows.append(
            [name, *(f"{value:.0f}" for value in field), f"{sigma[list(COLUMN_2)].mean():.3f}",
             f"{sigma[others].mean():.4f}", f"{sigma[9:].max():.1f}", study.refused(name)]
        )  # fmt: skip
    for place, name in enumerate(("205", "all")):
        sigma = np.nanstd(study.white_estimates[:, place], axis=0, ddof=1)
        others = [k for k in range(9) if k not in COLUMN_2]
        rows.append(
            [f"{name}, white unknown", "", "", "", f"{sigma[list(COLUMN_2)].mean():.3f}",
             f"{sigma[others].mean():.4f}", f"{sigma[9:].max():.1f}", ""]
        )  # fmt: skip
    return Table(
        f"Monte Carlo, {len(study.estimates)} runs: scatter of the estimates",
        [
            "data set", "weakest [mG]", "middle [mG]", "strongest [mG]", "sigma of S12 S22 S32",
            "sigma of the rest of S", "largest sigma of b [mG]", "refused",
        ],
        rows,
        "Every run has its own seed and start hours. The first three columns are the rms variation of the field along "
        "its principal directions in the body (medians). The weakest lies along Y, the orbit normal, so only the column "
        "of S that multiplies B_y scatters, and its bias with it. Refused: the field varied less than the noise. The "
        "last two rows: had the unknown been white instead of slow, which the papers do not say.",
    )  # fmt: skip


def attenuation_table(results: Results) -> Table:
    """What noise in the regressor does to the weak column."""
    rows: list[list[str]] = []
    study = results.calibration
    for name in ("205", "all"):
        plain, corrected = study.mean_error(name), study.mean_error(name, corrected=True)
        spread = study.scatter(name)
        rows += [[name, NAMES[k], f"{plain[k]:+.4f}", f"{corrected[k]:+.4f}", f"{spread[k]:.4f}"] for k in COLUMN_2]
    plain, corrected = uncorrected_column_2(results)
    return Table(
        "Mean error of the second column of S over the Monte Carlo",
        ["data set", "parameter", "papers' regression", "corrected for noise in B", "scatter"],
        rows,
        "The reading is noisy and stands on the right side of the regression, which pulls S22 down (errors in "
        f"variables): by {abs(plain[1]):.3f} in one orbit, {abs(corrected[1]):.3f} after the correction.",
    )


def error_table(results: Results) -> Table:
    """Table 2, each row twice."""
    e = results.errors
    rows: list[list[str | float]] = []
    sizes = {row["source"]: row["magnitude"] for row in mission.read_table("errors")}
    observed = f"{mission.printed_value('errors', 'rms_mG', source='observed rms'):.2f}"
    p = e.paper_rule
    for source in ("lsb", "attitude", "torquer", "field", "known", "unknown", "all"):
        simulated = f"{e.simulated[source]:.2f} ± {e.simulated_spread[source]:.2f}"
        rows.append([_SOURCE_WORDS[source].format_map(sizes), simulated, f"{e.paper_rule[source]:.2f}"])
    rows.append(["residual of the 12-parameter fit, known only", f"{e.fit_known:.2f}", ""])
    rows.append(["residual of the 12-parameter fit, all", f"{e.fit_all:.2f}", observed])
    rows.append([f"the same with an unknown of {e.unknown_for_paper:.2f} mG", f"{e.fit_with_that:.2f}", observed])
    return Table(
        "Table 2 (C) / Table 1 (J): sources of the residual [mG, rms per component]",
        ["source", "simulated alone", "papers' arithmetic"],
        rows,
        "Simulated: error of eq. 1 at the true S and b with that source alone switched on, and its spread over seeds. "
        f"The papers' arithmetic uses LSB/sqrt 12, the printed {p['attitude']:g}, the torquers' bound of {p['torquer']:g} "
        f"and the printed {p['field']:g} as "
        "rms values; a bound is no rms, so an honest simulation gives less.",
    )


def yaw_table(results: Results) -> Table:
    """Equations 11-14 and the yaw comparison."""
    a, y = results.accuracy, results.yaw
    q = a.worst_quantiles_deg
    observed = mission.printed_value("errors", "rms_mG", source="observed rms")
    names = ("sigma_y equator", "sigma_y pole max", "LSB yaw error X axis", "LSB yaw error Y axis")
    styles = (".2f", ".0f", ".1f", ".1f")
    equator, worst, lsb_x, lsb_y = (
        format(mission.printed_value("yaw", "value", quantity=name), style)
        for name, style in zip(names, styles, strict=True)
    )
    rows = [
        [f"sigma at the equator at {observed:.1f} mG [deg]", f"{a.sigma_equator_deg:.2f}", equator, "C 12, J 14"],
        ["sigma at the equator at our residual [deg]", f"{a.sigma_equator_ours_deg:.2f}", "", "C 12, J 14"],
        ["largest sigma of a data base, median [deg]", f"{q['50 %']:.1f}", worst, "C 13"],
        ["its 5-95 % range [deg]", f"{q['5 %']:.1f} to {q['95 %']:.1f}", "", "C 13"],
        ["one LSB of X at the equator [deg]", f"{a.lsb_x_deg:.2f}", lsb_x, "text"],
        ["one LSB of Y at the equator [deg]", f"{a.lsb_y_deg:.2f}", lsb_y, "text"],
        ["mean bias only against the sun sensor, rms [deg]", f"{y.bias_errors.rms_deg:.2f}", "", "figure 1"],
        ["full calibration against the sun sensor, rms [deg]", f"{y.full_errors.rms_deg:.2f}", "", "figure 2"],
        ["yaw = 0 against the sun sensor, rms [deg]", f"{y.full_errors.zero_rms_deg:.2f}", "", "figures 1, 2"],
    ]
    return Table("Yaw", ["quantity", "here", "printed", "where"], rows)


def calibration_figures(results: Results) -> list[FigureBlock]:
    """Scatter of S, error budget, scan of the node."""
    study, e = results.calibration, results.errors
    scatter = calibration_plots.ParameterScatter(
        NAMES[:9], list(DATA_SETS), study.estimates[:, :, :9], study.truth[:9], printed_columns()[:, :9],
        np.array([name == "all" for name in DATA_SETS]),
    )  # fmt: skip
    shown = ("lsb", "attitude", "torquer", "field", "known", "unknown", "all")
    budget = calibration_plots.ErrorBudget(
        ["LSB", *shown[1:]], np.array([e.simulated[s] for s in shown]), np.array([e.paper_rule[s] for s in shown])
    )
    node = calibration_plots.NodeMisfit(
        results.nodes.raan_deg, results.nodes.misfit, results.nodes.chosen_deg, results.nodes.launch_deg
    )
    return [
        FigureBlock(
            "table_1_scatter",
            "Spread of the nine elements of S by data set, simulated, beside the printed values. The scan has lost the "
            "signs of the columns of days and of 193 samples, so those are drawn with both; which is right is not known. "
            "The scale of the second column, S12, S22 and S32, is wider.",
            calibration_plots.draw_scatter(scatter, title="S by data set: simulated, and as printed"),
        ),
        FigureBlock(
            "table_2_errors",
            "Sources of the residual: simulated one at a time, and by the papers' arithmetic.",
            calibration_plots.draw_budget(budget, title="Sources of the residual"),
        ),
        FigureBlock(
            "node_scan",
            "Misfit of the sun-sensor record against the node of the orbit. The launch was not used.",
            calibration_plots.draw_node_misfit(node, title="Which node fits the sun-sensor record"),
        ),
    ]


def yaw_figures(results: Results) -> list[FigureBlock]:
    """Figures 1 and 2 of the papers, expected accuracy and the sweep."""
    y = results.yaw
    return [
        FigureBlock(
            "figure_1",
            "Simulated; drawn as figure 1 of the papers: day 205 of 1978, mean bias only (T = S = 0). Dashed: sun sensor; "
            f"dotted: magnetometer; each averaged over {y.figure_1.window_s:.0f} s. {_mean_bias_words(results)}",
            yaw_plots.draw_mean_bias(y.figure_1, title=f"Figure 1, simulated: {_DAY}, mean bias for the orbit"),
        ),
        FigureBlock(
            "figure_2",
            "Simulated; drawn as figure 2 of the papers: day 205 of 1978, full calibration. Dashed: sun sensor; broken "
            f"lines: magnetometer, each sample ({STEP_S:g} s apart), with the axis at each bit change; dotted: averages "
            f"over {y.figure_2.window_s:.0f} s; triangles at an edge: beyond the panel. One flight: yaw = 0 is "
            f"nearer in {100 * y.full_errors.zero_wins:.0f} % of its windows, in "
            f"{100 * np.interp(0.5 * np.sqrt(2.0), y.sweep.amplitude_deg, y.sweep.share_full):.0f} % over many flights of "
            "an assumed yaw of 0.5 deg rms.",
            yaw_plots.draw_full(y.figure_2, title=f"Figure 2, simulated: {_DAY}, full calibration"),
        ),
        FigureBlock(
            "yaw_sigma",
            "Expected yaw error (equation 14) along one orbit in the field of 1978, and the largest value of many orbits "
            "and data bases with "
            f"the printed {results.accuracy.figure.printed_deg:g} deg.",
            yaw_plots.draw_sigma(
                results.accuracy.figure,
                title=f"Expected yaw error at {mission.printed_value('errors', 'rms_mG', source='observed rms'):.1f} mG",
            ),
        ),
        FigureBlock(
            "yaw_sweep",
            "How often yaw = 0 is the better estimate, by the amplitude of the true yaw (bars: spread over seeds).",
            yaw_plots.draw_sweep(y.sweep, title="When is yaw = 0 the better estimate?"),
        ),
    ]


def _mean_bias_words(results: Results) -> str:
    """Where the curve of figure 1 is as bad as the papers say, and where it is not."""
    y = results.yaw
    figure, errors = y.figure_1, y.bias_errors
    near = figure.mean_minutes[figure.nearer]
    if not near.size:
        return "As the papers say, it is worse than yaw = 0 over the entire orbit, even near the nodes."
    return (
        f"The papers call it worse than yaw = 0 over the entire orbit, even near the nodes; here it is in "
        f"{100 * errors.zero_wins:.0f} % of the windows and in {100 * errors.zero_wins_at_nodes:.0f} % of those within "
        f"{NEAR_NODE_DEG:g} deg of the equator, where it errs by {errors.rms_at_nodes_deg:.2f} deg rms "
        f"({errors.rms_deg:.2f} over the orbit). It is the better one in {near.size} (shaded, at "
        f"{', '.join(f'{m:.0f}' for m in near)} min)."
    )


def _with_sigma(value: float, sigma: float, digits: int) -> str:
    """Concise notation: 0.021(7) is 0.021 with a sigma of 0.007."""
    return f"{value:.{digits}f}({round(sigma * 10**digits)})"


def _printed(value: float, *, signed: bool, digits: int) -> str:
    return f"{value:.{digits}f}" if signed else f"|{abs(value):.{digits}f}|"


def _printed_row(parameter: str, style: str) -> list[str]:
    rows = {(row["parameter"], row["data_set"]): float(row["value"]) for row in mission.read_table("calibration")}
    return [format(rows[parameter, PAPER_COLUMN[d]], style) for d in DATA_SETS]


def _row(name: str, ours: Sequence[str], printed: Sequence[str]) -> list[str]:
    row = [name]
    for mine, theirs in zip(ours, printed, strict=True):
        row += [mine, theirs]
    return row
