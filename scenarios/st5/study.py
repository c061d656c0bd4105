"""The ST5 study: a spinning spacecraft's magnetometer calibrated without being given its attitude."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path

from scipy.stats import chi2

from fluxtwin.calib.common.calibration_file import write_calibration
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
    claims = words().judge(hour=results.hour)
    return words().result("st5", shown, claims=claims, **vars(results))


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


@cache
def words() -> Words:
    """The sections of `words.md`."""
    return Words(
        mission.PRINTED.package,
        "words.md",
        "../studies.md",
        chi2=chi2,
        names=NAMES,
        published=lambda: mission.published(),  # looked up when it is called
        terms_of=mission.terms_of,
        truth_terms=mission.truth_terms,
    )
