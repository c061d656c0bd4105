"""The study's numbers as tables and figures to read."""

from __future__ import annotations

from fluxtwin.plots.spin_attitude import AttitudeError, draw_attitude_error
from fluxtwin.scenarios.page import Cell, FigureBlock, Table
from fluxtwin.scenarios.st5 import mission
from fluxtwin.scenarios.st5.calibration_study import Hour, Solved
from fluxtwin.scenarios.st5.monte_carlo import MonteCarlo, Starts, truth_terms
from fluxtwin.scenarios.st5.terms import terms_of

NAMES = ("b x [mG]", "b y [mG]", "b z [mG]", "turn x [deg]", "turn y [deg]", "turn z [deg]")
"""The six parameters of the abstract."""


def attitude_table(hour: Hour) -> Table:
    """Before and after, with the abstract's."""
    printed = mission.published()
    rows: list[list[Cell]] = [
        ["before, abstract", *printed["pre_rms_deg"], printed["pre_rss_deg"], None],
        ["before", *hour.before.rms_deg.tolist(), hour.before.rss_deg, hour.before.nis],
        ["after, abstract", None, None, None, printed["post_rss_deg"], None],
        [
            "after, the abstract's steps alone",
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
        note="The last column is 1 when the calibration is finished. The abstract's figures hang on settings it does not "
        "give; see the table of settings before reading a difference.",
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
    """How far the filter's settings move the figures."""
    rows = [
        [row.walk_rad_s, row.sun_factor, *row.pre_deg.tolist(), row.pre_rss_deg, row.post_rss_deg] for row in hour.sweep
    ]
    return Table(
        "The same hour with other settings of the filter",
        ["random walk of L/Jt in 1 s [rad/s]", "sun noise taken [true]", "X before [deg]", "Y before [deg]",
         "Z before [deg]", "RSS before [deg]", "RSS after [deg]"],
        rows,
        note="None of these settings is in the abstract. After: with the batch's calibration.",
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
            "Figure 1: before calibration",
            "Attitude estimate less truth, readings as they come.",
            hour.before,
        ),
        ("figure_2", "Figure 2: after the iteration", "The same after the abstract's three steps.", hour.steps_alone),
        ("batch", "After the batch", "The same by one batch over the hour.", hour.batch),
    ):
        out.append(FigureBlock(name, caption, draw_attitude_error(_record(hour, solved), title=title)))
    return out


def _record(hour: Hour, solved: Solved) -> AttitudeError:
    return AttitudeError(hour.rows.t_s, solved.error_deg)
