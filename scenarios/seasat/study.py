"""The Seasat study: fly 1978, calibrate as in 1979, and set our numbers beside the papers'."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from functools import cache
from itertools import combinations
from pathlib import Path

import numpy as np

from fluxtwin.calib.common.records import Calibration
from fluxtwin.scenarios.flights import ATTITUDES, NEAR_NODE_DEG, Numbers, motion_of, provenance, write_flight
from fluxtwin.scenarios.page import StudyResult
from fluxtwin.scenarios.regression import NAMES, calibration_summary, rms_mG, vector
from fluxtwin.scenarios.seasat import geometry, mission
from fluxtwin.scenarios.seasat.calibration import check_identities, run_calibrations, run_errors
from fluxtwin.scenarios.seasat.mission import DATA_SETS, printed_value
from fluxtwin.scenarios.seasat.yaw import SEEDS, STEP_S, run_accuracy, run_yaw
from fluxtwin.scenarios.words import Words
from fluxtwin.sim.base.progress import Progress, part_of, silent
from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.earth import constants
from fluxtwin.sim.earth.constants import NT_PER_MG
from fluxtwin.sim.earth.field import load_field


def run(
    out: Path, data: Path | None = None, progress: Progress = silent, *, attitude: str = ATTITUDES[0]
) -> StudyResult:
    """Run the study; `out` receives the scenario, telemetry and calibration. `data` is not used.

    attitude: how the vehicle moves, one of ATTITUDES.
    """
    results = compute(progress, attitude=attitude)
    # The calibration of all days with the covariance of the Monte Carlo, which holds errors that last an orbit.
    found: Calibration = results.calibration.fits["all"].calibration
    scale = np.repeat([1.0, NT_PER_MG], [9, 3])
    estimates = results.calibration.many.of("all")
    covariance = np.cov(estimates[np.isfinite(estimates).all(axis=1)].T) * np.outer(scale, scale)
    method = f"{found.method}; covariance from a Monte Carlo of {len(estimates)} runs"
    known = dataclasses.replace(found, covariance=covariance, covariance_kind="blocks", method=method)
    written = write_flight(out, mission.scenario_text(attitude), results.flight.telemetry, known)
    return dataclasses.replace(present(results), written=written)


def present(results: Numbers) -> StudyResult:
    """What the study says of its numbers."""
    said = words()
    return said.result(
        "seasat",
        provenance(results.scenario),
        claims=said.judge(r=results),
        r=results,
    )


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
        flight=flight,
        motion=motion_of(flight),
        calibration=calibration,
        errors=run_errors(config, ground, part_of(progress, 0.62, 0.80)),
        yaw=run_yaw(config, fit.calibration, ground, part_of(progress, 0.80, 0.93)),
        accuracy=run_accuracy(config, ground, rms_mG(fit), part_of(progress, 0.93, 0.99)),
        identities=check_identities(flight, fit, ground),
        nodes=nodes,
        heads=geometry.scan_heads(nodes.chosen_deg),
    )


def pulls(r: Numbers) -> FloatArray:
    """(12,) (estimate - truth) / sigma of the base of 325 samples; sigma is the scatter of the Monte Carlo."""
    c = r.calibration
    return np.asarray((vector(c.fits["all"]) - c.truth) / c.many.scatter("all"))


@cache
def words() -> Words:
    """The sections of `words.md`."""
    return Words(
        mission.PRINTED.package,
        "words.md",
        "../studies.md",
        known=(
            *(calibration_summary, combinations, constants, geometry),
            *(mission.quantity, printed_S, pulls, rms_mG, vector),
        ),
        data_sets=list(DATA_SETS),
        names=NAMES,
        near_node_deg=NEAR_NODE_DEG,
        printed=printed_value,
        seeds=SEEDS,
        size=mission.PRINTED.size,
        step_s=STEP_S,
    )


def printed_S(sets: Sequence[str]) -> FloatArray:
    """(D, 9) of Table 1; only its last column has signs."""
    return np.array(
        [[printed_value("calibration", "value", parameter=name, data_set=one) for name in NAMES[:9]] for one in sets]
    )
