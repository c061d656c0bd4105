"""The ST5 study: a spinning spacecraft's magnetometer calibrated without being told its attitude."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from fluxtwin.calib.common.calibration_file import write_calibration
from fluxtwin.scenarios.claims import Claim, claims_table, counted
from fluxtwin.scenarios.numbers import Numbers
from fluxtwin.scenarios.page import Page, StudyResult, Table
from fluxtwin.scenarios.st5 import mission
from fluxtwin.scenarios.st5.calibration_study import run_hour
from fluxtwin.scenarios.st5.monte_carlo import RUNS, STARTS, run_monte_carlo, run_starts
from fluxtwin.scenarios.st5.report import figures, judge_claims, summary, words
from fluxtwin.scenarios.study_files import provenance, write_flight
from fluxtwin.sim.base.progress import Progress, part_of, silent
from fluxtwin.sim.earth.field import load_field
from fluxtwin.sim.run.world import build_world


def run(out: Path, data: Path | None = None, progress: Progress = silent) -> StudyResult:
    """Run the study; `out` receives the scenario, telemetry and calibrations. `data` is not used."""
    results = compute(progress)
    hour = results.hour
    claims = judge_claims(hour)
    assert hour.iterative.fit is not None and hour.batch.fit is not None
    line = words().say("status", **vars(results), counted=counted(claims))
    return StudyResult(
        name="st5",
        status_line=line,
        summary=summary(results, claims),
        tables=[*tables(results, claims).values()],
        page=page(results, claims, line),
        written=[
            *write_flight(out, mission.scenario_text(), hour.flight.telemetry, hour.batch.fit.calibration),
            write_calibration(hour.iterative.fit.calibration, out / "calibration-iterative.toml"),
        ],
    )


def compute(progress: Progress = silent, *, runs: int = RUNS, starts: int = STARTS, **grid: Sequence[float]) -> Numbers:
    """All the numbers. `runs`, `starts`: sizes of the Monte Carlo; `grid`: of the search; for quick looks."""
    config = mission.scenario()
    ground = load_field(config.field.model)
    progress("flying the hour", 0.0)
    world = build_world(config)
    hour = run_hour(mission.fly(config, world), ground, part_of(progress, 0.02, 0.3), **grid)
    many = run_monte_carlo(config, world, ground, part_of(progress, 0.3, 0.55), runs)
    found = run_starts(config, world, ground, part_of(progress, 0.55, 1.0), starts)
    return Numbers(hour=hour, many=many, starts=found)


def tables(results: Numbers, claims: list[Claim]) -> dict[str, Table]:
    """All of them, in the order of the terminal."""
    names = ("attitude", "parameters", "settings", "monte_carlo", "starts")
    return {**words().tables(names, **vars(results)), "claims": claims_table(claims, with_why=True)}


def page(results: Numbers, claims: list[Claim], verdict: str) -> Page:
    """The report."""
    about = provenance(results.hour.flight.scenario)
    return words().page(
        "page",
        verdict,
        tables(results, claims),
        figures(results.hour),
        {"seed": about["seed"], "field": about["truth field"]} | {k: about[k] for k in ("fluxtwin", "numpy", "python")},
        **vars(results),
    )
