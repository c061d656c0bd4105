"""The study's numbers as tables and figures to read."""

from __future__ import annotations

import numpy as np

from fluxtwin.plots.filter_settings import Mark, SettingsPanel, draw_settings
from fluxtwin.plots.spin_attitude import AttitudeError, draw_attitude_error
from fluxtwin.scenarios.page import Cell, FigureBlock, Table
from fluxtwin.scenarios.st5 import mission
from fluxtwin.scenarios.st5.calibration_study import Hour
from fluxtwin.scenarios.st5.monte_carlo import MonteCarlo, Starts, truth_terms
from fluxtwin.scenarios.st5.terms import terms_of

NAMES = ("b x [mG]", "b y [mG]", "b z [mG]", "turn x [deg]", "turn y [deg]", "turn z [deg]")
"""The six parameters of the abstract."""


def attitude_table(hour: Hour) -> Table:
    """Before and after, with the abstract's."""
    printed = mission.published()
    rows: list[list[Cell]] = [
        ["before, abstract", *printed["pre_rms_deg"], printed["pre_rss_deg"], None],
        ["before, settings chosen by it", *hour.before.rms_deg.tolist(), hour.before.rss_deg, hour.before.nis],
        ["after, abstract", None, None, None, printed["post_rss_deg"], None],
        [
            "after, the abstract's steps, same settings",
            *hour.steps_alone.rms_deg.tolist(),
            hour.steps_alone.rss_deg,
            hour.steps_alone.nis,
        ],
        ["after, iterative", *hour.iterative.rms_deg.tolist(), hour.iterative.rss_deg, hour.iterative.nis],
        ["after, batch", *hour.batch.rms_deg.tolist(), hour.batch.rss_deg, hour.batch.nis],
    ]
    return Table(
        "Attitude error over the hour",
        ["", "X rms [deg]", "Y rms [deg]", "Z rms [deg]", "RSS [deg]", "squared innovations over noise [1]"],
        rows,
        note="The last column is 1 when the calibration is finished. Iterative and batch know no process noise and take the "
        "sun's noise as it is. The abstract's figures hang on settings it does not give; see the table of settings.",
    )


def parameter_table(hour: Hour) -> Table:
    """b and misalignment in the abstract's terms."""
    printed = mission.published()
    estimates = [*printed["b_estimated_mG"], *printed["misalignment_estimated_deg"]]
    assert hour.iterative.fit is not None and hour.batch.fit is not None
    ways = [terms_of(fit.calibration) for fit in (hour.iterative.fit, hour.batch.fit)]
    rows: list[list[Cell]] = []
    alone = terms_of(hour.alone).values
    for k, name in enumerate(NAMES):
        row: list[Cell] = [name, float(truth_terms()[k]), float(estimates[k]), f"{alone[k]:.4f}"]
        for way in ways:
            row += [f"{way.values[k]:.4f}", f"{way.sigma[k]:.4f}"]
        rows.append(row)
    return Table(
        "What is found (raw = R A H + b, R = exp(-[turn x]))",
        ["", "truth", "abstract", "its steps alone", "iterative", "sigma", "batch", "sigma"],
        rows,
    )


def settings_table(hour: Hour) -> Table:
    """Two choices of the two settings, what each used of the print and what it did not."""
    printed, rows = mission.published(), []
    rows.append(["abstract", None, None, *printed["pre_rms_deg"], printed["pre_rss_deg"], printed["post_rss_deg"]])
    for words, row in (("by the three rms before", hour.search.by_axes), ("by both RSS", hour.search.by_rss)):
        rows.append([words, row.walk_rad_s, row.sun_factor, *row.pre_deg.tolist(), row.pre_rss_deg, row.post_rss_deg])
    return Table(
        "Two settings of the filter chosen by what is printed",
        ["chosen", "random walk of L/Jt in 1 s [rad/s]", "sun noise taken [true]", "X before [deg]", "Y before [deg]",
         "Z before [deg]", "RSS before [deg]", "RSS after [deg]"],
        rows,
        note="Neither setting is in the abstract. The first choice predicts RSS after, the second how the axes share RSS "
        "before. After: with the batch's calibration; the abstract's own steps give the same.",
    )  # fmt: skip


def monte_carlo_table(many: MonteCarlo) -> Table:
    """Errors against sigmas."""
    rows: list[list[Cell]] = []
    for k, name in enumerate(NAMES):
        error, pull = many.errors_mG_deg[:, k], many.pulls[:, k]
        rows.append([name, float(error.mean()), float(error.std(ddof=1)), float(pull.mean()), float(pull.std(ddof=1))])
    low, high = many.nees_band
    return Table(
        f"Batch over {len(many.nees)} seeds",
        ["", "mean error", "rms about it", "mean pull [sigma]", "rms pull [sigma]"],
        rows,
        note=f"Normalised squared error of all 12 parameters: mean {many.nees.mean():.2f}, 95 % of such means lie in "
        f"{low:.2f} to {high:.2f}. Attitude RSS {many.attitude_rss_deg.mean():.4f} deg on average, "
        f"{many.attitude_rss_deg.max():.4f} deg at most.",
    )


def starts_table(starts: Starts) -> Table:
    """Blind starts."""
    good = starts.attitude_rss_deg[starts.attitude_rss_deg < float("inf")]
    return Table(
        "Blind starts from random spin axes",
        ["tried [1]", "found [1]", "median attitude RSS [deg]", "largest [deg]"],
        [[starts.tried, starts.found, float(sorted(good)[len(good) // 2]) if len(good) else None,
          float(good.max()) if len(good) else None]],
        note="Axis anywhere but within 30 deg of the sun's line, any phase, nutation 0.2 to 4 deg, other noise each time.",
    )  # fmt: skip


def figures(hour: Hour) -> list[FigureBlock]:
    """Figures 1 and 2 of the abstract, and the batch's."""
    out = []
    for name, title, caption, solved in (
        (
            "figure_1",
            "Figure 1, simulated: before calibration",
            "Attitude estimate less truth, simulated readings as they come, the filter's settings chosen by the printed rms "
            "before calibration.",
            hour.before,
        ),
        (
            "figure_2",
            "Figure 2, simulated: after the iteration",
            "The same after the abstract's three steps, with the same settings.",
            hour.steps_alone,
        ),
        ("batch", "Simulated: after the batch", "The same by one batch over the hour.", hour.batch),
    ):
        record = AttitudeError(hour.rows.start, hour.rows.t_s, solved.error_deg)
        out.append(FigureBlock(name, caption, draw_attitude_error(record, title=title)))
    return out


def settings_figure(hour: Hour) -> FigureBlock:
    """Error before and after calibration over the two settings that were searched."""
    searched, printed = hour.search, mission.published()
    panels = [
        SettingsPanel("before", searched.rss_deg("pre"), printed["pre_rss_deg"]),
        SettingsPanel("after", searched.rss_deg("post"), printed["post_rss_deg"]),
    ]
    marks = [
        Mark(words, setting.walk_rad_s, setting.sun_factor)
        for words, setting in (("by the rms before", searched.by_axes), ("by both RSS", searched.by_rss))
    ]
    caption = (
        "Root sum of squares of the attitude error over the simulated hour, before and after calibration, for two settings "
        "of the filter that the abstract does not give. Heavy: what the abstract prints."
    )
    made = draw_settings(
        panels, marks, walks_rad_s=np.array(searched.walks_rad_s), factors=np.array(searched.factors),
        title="Simulated: attitude error over two open settings",
    )  # fmt: skip
    return FigureBlock("settings", caption, made)
