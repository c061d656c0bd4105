"""The ST5 study: a spinning spacecraft's magnetometer calibrated without being given its attitude."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import cache, partial
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from scipy.stats import chi2

from fluxtwin.calib.common.calibration_file import write_calibration
from fluxtwin.plots.filter_settings import Mark, SettingsPanel, draw_settings
from fluxtwin.plots.spin_attitude import AttitudeError, draw_attitude_error
from fluxtwin.scenarios.claims import Claim
from fluxtwin.scenarios.flights import Numbers, provenance, write_flight
from fluxtwin.scenarios.page import StudyResult
from fluxtwin.scenarios.st5 import mission
from fluxtwin.scenarios.st5.calibration import RUNS, STARTS, run_hour, run_monte_carlo, run_starts
from fluxtwin.scenarios.words import Words
from fluxtwin.sim.base.progress import Progress, part_of, silent
from fluxtwin.sim.earth.field import load_field
from fluxtwin.sim.run.world import build_world

NAMES = ("b x [mG]", "b y [mG]", "b z [mG]", "turn x [deg]", "turn y [deg]", "turn z [deg]")
"""The six parameters of the abstract."""
TABLES = ("attitude", "parameters", "settings", "monte_carlo", "starts", "claims")
"""Those of the terminal, in order."""


def run(out: Path, data: Path | None = None, progress: Progress = silent) -> StudyResult:
    """Run the study; `out` receives the scenario, telemetry and calibrations. `data` is not used."""
    results = compute(progress)
    hour = results.hour
    written = [
        *write_flight(out, mission.scenario_text(), hour.flight.telemetry, hour.batch.fit.calibration),
        write_calibration(hour.iterative.fit.calibration, out / "calibration-iterative.toml"),
    ]
    return replace(present(results), written=written)


def present(results: Numbers) -> StudyResult:
    """What the study says of its numbers."""
    about = provenance(results.hour.flight.scenario)
    shown = {"seed": about["seed"], "field": about["truth field"]} | {
        k: about[k] for k in ("fluxtwin", "numpy", "python")
    }
    claims = judge_claims(results.hour)
    return words().result("st5", TABLES, figures(results.hour), shown, claims=claims, **vars(results))


def compute(progress: Progress = silent, *, runs: int = RUNS, starts: int = STARTS, **grid: Sequence[float]) -> Numbers:
    """All the numbers. `runs`, `starts`: sizes of the Monte Carlo; `grid`: of the search; for quick looks."""
    config = mission.scenario()
    ground = load_field(config.field.model)
    progress("flying the hour", 0.0)
    world = build_world(config)
    return Numbers(
        hour=run_hour(mission.fly(config, world), ground, part_of(progress, 0.02, 0.3), **grid),
        many=run_monte_carlo(config, world, ground, part_of(progress, 0.3, 0.55), runs),
        starts=run_starts(config, world, ground, part_of(progress, 0.55, 1.0), starts),
    )


def judge_claims(hour: Numbers) -> list[Claim]:
    """Every claim of the packaged list, in order."""
    return words().judge(mission.PRINTED.claims(), hour=hour)


@cache
def words() -> Words:
    """The sections of `words.md`."""
    return Words(
        mission.PRINTED.package,
        chi2=chi2,
        distances=_distances,
        names=NAMES,
        published=lambda: mission.published(),
        terms_of=mission.terms_of,
        truth_terms=mission.truth_terms,
    )


def _distances(
    b_mG: object, misalignment_deg: object, truth: Mapping[str, object] | None = None
) -> tuple[float, float]:
    """Largest difference of b [mG] and misalignment [deg] from the abstract's truth."""
    truth = mission.published() if truth is None else truth
    pairs = ((b_mG, truth["b_mG"]), (misalignment_deg, truth["misalignment_deg"]))
    off_b, off_v = (float(np.abs(np.asarray(ours, float) - np.asarray(theirs, float)).max()) for ours, theirs in pairs)
    return off_b, off_v


def figures(hour: Numbers) -> dict[str, Callable[[], Figure]]:
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
    chosen = {"by the rms before": searched.by_axes, "by both RSS": searched.by_rss}
    settings = partial(
        draw_settings,
        [
            SettingsPanel(words, searched.rss_deg(when), printed[f"{when}_rss_deg"])
            for when, words in (("pre", "before"), ("post", "after"))
        ],
        [Mark(name, setting.walk_rad_s, setting.sun_factor) for name, setting in chosen.items()],
        walks_rad_s=np.array(searched.walks_rad_s),
        factors=np.array(searched.factors),
        title="Simulated: attitude error over two open settings",
    )
    return {**drawn, "settings": settings}
