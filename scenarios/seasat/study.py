"""The Seasat study: fly 1978, calibrate as in 1979, and set our numbers beside the papers'."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np

from fluxtwin.calib.common.records import Calibration
from fluxtwin.scenarios.calibration_records import rms_mG
from fluxtwin.scenarios.claims import Claim, claims_table, counted, whys_table
from fluxtwin.scenarios.motion import ATTITUDES, motion_of
from fluxtwin.scenarios.numbers import Numbers
from fluxtwin.scenarios.page import Page, StudyResult, Table
from fluxtwin.scenarios.seasat import geometry, mission
from fluxtwin.scenarios.seasat.accuracy_study import run_accuracy
from fluxtwin.scenarios.seasat.calibration_study import run_calibrations
from fluxtwin.scenarios.seasat.error_study import run_errors
from fluxtwin.scenarios.seasat.identities import check_identities
from fluxtwin.scenarios.seasat.report import figures, judge_claims, summary, words
from fluxtwin.scenarios.seasat.yaw_study import run_yaw
from fluxtwin.scenarios.study_files import provenance, write_flight
from fluxtwin.sim.base.progress import Progress, part_of, silent
from fluxtwin.sim.earth.constants import NT_PER_MG
from fluxtwin.sim.earth.field import load_field


def run(
    out: Path, data: Path | None = None, progress: Progress = silent, *, attitude: str = ATTITUDES[0]
) -> StudyResult:
    """Run the study; `out` receives the scenario, telemetry and calibration. `data` is not used.

    attitude: how the vehicle moves, one of `motion.ATTITUDES`.
    """
    results = compute(progress, attitude=attitude)
    claims = judge_claims(results)
    telemetry = mission.fly(results.scenario).telemetry
    line = words().say("status", r=results, counted=counted(claims))
    return StudyResult(
        name="seasat",
        status_line=line,
        summary=summary(results, claims),
        tables=[*tables(results).values(), claims_table(claims), whys_table(claims)],
        page=page(results, claims, line),
        written=write_flight(out, mission.scenario_text(attitude), telemetry, _with_monte_carlo(results)),
    )


def _with_monte_carlo(results: Numbers) -> Calibration:
    """The calibration of all days with the covariance of the Monte Carlo, which holds errors that last an orbit."""
    found: Calibration = results.calibration.fits["all"].calibration
    scale = np.repeat([1.0, NT_PER_MG], [9, 3])
    estimates = results.calibration.estimates[:, results.calibration.index("all")]
    covariance = np.cov(estimates[np.isfinite(estimates).all(axis=1)].T) * np.outer(scale, scale)
    method = f"{found.method}; covariance from a Monte Carlo of {len(estimates)} runs"
    return dataclasses.replace(found, covariance=covariance, covariance_kind="blocks", method=method)


def compute(progress: Progress = silent, *, runs: int | None = None, attitude: str = ATTITUDES[0]) -> Numbers:
    """All the numbers. `runs`: size of the Monte Carlo, for quick looks; attitude: as in `run`."""
    config = mission.scenario(attitude)
    ground = load_field(config.field.model)
    progress("flying the mission", 0.0)
    flight = mission.fly(config)
    extra = {} if runs is None else {"runs": runs}
    calibration = run_calibrations(flight, ground, part_of(progress, 0.02, 0.60), **extra)
    progress("geometry of the orbit", 0.60)
    nodes = geometry.scan_node()
    fit = calibration.fits["all"]
    return Numbers(
        scenario=config,
        motion=motion_of(config, flight.telemetry, flight.truth),
        calibration=calibration,
        errors=run_errors(config, ground, part_of(progress, 0.62, 0.80)),
        yaw=run_yaw(config, fit.calibration, ground, part_of(progress, 0.80, 0.93)),
        accuracy=run_accuracy(config, ground, rms_mG(fit), part_of(progress, 0.93, 0.99)),
        identities=check_identities(flight, ground),
        nodes=nodes,
        heads=geometry.scan_heads(nodes.chosen_deg),
    )


def tables(results: Numbers) -> dict[str, Table]:
    """All but the claims, in the order of the terminal."""
    made = words().tables(("calibration", "scatter", "attenuation", "errors", "yaw"), r=results)
    return {**made, "motion": results.motion.table(words().say("pointing", r=results))}


def page(results: Numbers, claims: list[Claim], verdict: str) -> Page:
    """The report."""
    return words().page(
        "page",
        verdict,
        {**tables(results), "claims": claims_table(claims, with_why=True)},
        figures(results),
        provenance(results.scenario),
        r=results,
    )
