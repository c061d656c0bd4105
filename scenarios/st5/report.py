"""What the study of ST5 says: its words and claims with the numbers they need, its figures, its summary."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import cache, partial
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from scipy.stats import chi2

from fluxtwin.plots.filter_settings import Mark, SettingsPanel, draw_settings
from fluxtwin.plots.spin_attitude import AttitudeError, draw_attitude_error
from fluxtwin.scenarios.claims import Claim
from fluxtwin.scenarios.numbers import Numbers
from fluxtwin.scenarios.report import Report
from fluxtwin.scenarios.st5 import mission
from fluxtwin.scenarios.st5.calibration_study import Hour
from fluxtwin.scenarios.st5.monte_carlo import truth_terms
from fluxtwin.scenarios.st5.open_settings import Setting
from fluxtwin.scenarios.st5.terms import terms_of

NAMES = ("b x [mG]", "b y [mG]", "b z [mG]", "turn x [deg]", "turn y [deg]", "turn z [deg]")
"""The six parameters of the abstract."""


def judge_claims(hour: Hour) -> list[Claim]:
    """Every claim of the packaged list, in order."""
    return words().judge(mission.PRINTED, hour=hour)


@cache
def words() -> Report:
    """The sections of `words.md`."""
    return Report(
        "fluxtwin.scenarios.st5",
        chi2=chi2,
        distances=_distances,
        names=NAMES,
        published=lambda: mission.published(),
        setting=_setting,
        terms_of=terms_of,
        truth_terms=truth_terms,
    )


def _distances(
    b_mG: object, misalignment_deg: object, truth: Mapping[str, object] | None = None
) -> tuple[float, float]:
    """Largest difference of b [mG] and misalignment [deg] from the abstract's truth."""
    truth = mission.published() if truth is None else truth
    pairs = ((b_mG, truth["b_mG"]), (misalignment_deg, truth["misalignment_deg"]))
    off_b, off_v = (float(np.abs(np.asarray(ours, float) - np.asarray(theirs, float)).max()) for ours, theirs in pairs)
    return off_b, off_v


def figures(hour: Hour) -> dict[str, Callable[[], Figure]]:
    """Figures 1 and 2 of the abstract, the batch's, and the error over the two settings that were searched."""
    errors = {
        "figure_1": ("Figure 1, simulated: before calibration", hour.before),
        "figure_2": ("Figure 2, simulated: after the iteration", hour.steps_alone),
        "batch": ("Simulated: after the batch", hour.batch),
    }
    drawn = {
        name: partial(draw_attitude_error, AttitudeError(hour.rows.start, hour.rows.t_s, way.error_deg), title=title)
        for name, (title, way) in errors.items()
    }
    searched, printed = hour.search, mission.published()
    panels = [
        SettingsPanel("before", searched.rss_deg("pre"), printed["pre_rss_deg"]),
        SettingsPanel("after", searched.rss_deg("post"), printed["post_rss_deg"]),
    ]
    chosen = {"by the rms before": searched.by_axes, "by both RSS": searched.by_rss}
    settings = partial(
        draw_settings,
        panels,
        [Mark(name, setting.walk_rad_s, setting.sun_factor) for name, setting in chosen.items()],
        walks_rad_s=np.array(searched.walks_rad_s),
        factors=np.array(searched.factors),
        title="Simulated: attitude error over two open settings",
    )
    return {**drawn, "settings": settings}


def summary(results: Numbers, claims: list[Claim]) -> dict[str, Any]:
    """The content of `summary.json`."""
    return {**words().summary(**vars(results)), "claims": [claim.to_dict() for claim in claims]}


def _setting(row: Setting) -> dict[str, Any]:
    return {
        "walk_rad_s": row.walk_rad_s,
        "sun_factor": row.sun_factor,
        "pre_rms_deg": row.pre_deg.tolist(),
        "pre_rss_deg": row.pre_rss_deg,
        "post_rms_deg": row.post_deg.tolist(),
        "post_rss_deg": row.post_rss_deg,
    }
