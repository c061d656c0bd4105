"""Many runs of the batch: its errors against its sigmas, and blind starts from random spins."""

from __future__ import annotations

import numpy as np
from scipy.stats import chi2

from fluxtwin.calib.spin.calibrate import fit_spin
from fluxtwin.calib.spin.rows import assemble_spin
from fluxtwin.scenarios.numbers import Numbers
from fluxtwin.scenarios.st5 import mission
from fluxtwin.scenarios.st5.calibration_study import options
from fluxtwin.scenarios.st5.mission import attitude_error_deg
from fluxtwin.scenarios.st5.terms import Terms, terms_of
from fluxtwin.sim.base.errors import NoAnswer
from fluxtwin.sim.base.progress import Progress, silent
from fluxtwin.sim.base.random_streams import stream
from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.earth import frames
from fluxtwin.sim.earth.field import FieldModel
from fluxtwin.sim.run.world import World
from fluxtwin.sim.scenario.scenario import Scenario

RUNS = 50
STARTS = 100
GOOD_DEG = 0.1
"""An attitude error below which a blind start has found the motion."""
SUN_CONE_DEG = 30.0
"""Random spin axes keep so far from the sun's line: nearer, a slit sees no azimuth worth the name."""


def truth_terms() -> FloatArray:
    """(6,) b [mG] and misalignment [deg] of the abstract."""
    printed = mission.published()
    return np.array([*printed["b_mG"], *printed["misalignment_deg"]])


def run_monte_carlo(
    config: Scenario, world: World, ground: FieldModel, progress: Progress = silent, runs: int = RUNS
) -> Numbers:
    """`runs` seeds, each solved by the batch from a blind start."""
    pulls, errors, nees, rss = [], [], [], []
    truth = truth_terms()
    for run in range(runs):
        progress(f"run {run + 1} of {runs}", run / runs)
        terms, score, error_deg = _one(config.updated({"seed": config.seed + 1 + run}), world, ground)
        errors.append(terms.values - truth)
        pulls.append(errors[-1] / terms.sigma)
        nees.append(score)
        rss.append(error_deg)
    return Numbers(
        # (R, 6) errors of b and misalignment, and the same over their sigmas.
        errors_mG_deg=np.array(errors),
        pulls=np.array(pulls),
        # (R,) normalised squared error of the 12 parameters of S and b, and 95 % of the mean of R sums of 12 squares.
        nees=np.array(nees),
        nees_band=[float(chi2.ppf(p, 12 * runs)) / runs for p in (0.025, 0.975)],
        # (R,)
        attitude_rss_deg=np.array(rss),
    )


def run_starts(
    config: Scenario, world: World, ground: FieldModel, progress: Progress = silent, starts: int = STARTS
) -> Numbers:
    """`starts` random spin axes, phases, phases of nutation by the phase, and seeds; RSS infinite where none was found."""
    found = []
    for run in range(starts):
        progress(f"start {run + 1} of {starts}", run / starts)
        rng = stream(config.seed, f"st5.start.{run}")
        changes = {
            "seed": config.seed + 1000 + run,
            "attitude.spin_axis_N": tuple(_axis(rng, world.sun_N[0]).tolist()),
            "attitude.phase_deg": float(rng.uniform(0.0, 360.0)),
            "attitude.nutation_deg": float(rng.uniform(0.2, 4.0)),
        }
        try:
            found.append(_one(config.updated(changes), world, ground)[2])
        except NoAnswer:
            found.append(float("inf"))
    rss = np.array(found)
    return Numbers(tried=starts, found=(rss < GOOD_DEG).sum(), attitude_rss_deg=rss)


def _axis(rng: np.random.Generator, sun_N: FloatArray) -> FloatArray:
    while True:
        axis: FloatArray = rng.normal(size=3)
        axis = axis / np.linalg.norm(axis)
        if abs(float(axis @ sun_N)) < np.cos(np.radians(SUN_CONE_DEG)):
            return axis


def _one(config: Scenario, world: World, ground: FieldModel) -> tuple[Terms, float, float]:
    """Terms, normalised squared error of the 12 parameters, and RSS of the attitude [deg]."""
    flight = mission.fly(config, world)
    fit = fit_spin(assemble_spin(flight.telemetry, ground), options("batch"), model_name=ground.name)
    truth = flight.truth
    off = fit.calibration.values - np.concatenate([truth.S.ravel(), truth.b_nT])
    score = float(off @ np.linalg.solve(fit.calibration.covariance, off))
    error = attitude_error_deg(frames.rotation_from_q(fit.q_NB).as_matrix(), truth.q_NB)
    return terms_of(fit.calibration), score, float(np.sqrt((error**2).sum(axis=1).mean()))
