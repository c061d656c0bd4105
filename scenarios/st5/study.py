"""The ST5 study: a spinning spacecraft's magnetometer calibrated without being given its attitude.

The hour calibrated three ways: not at all, by the abstract's iteration, by one batch; and the batch many times.

Two settings of the filter are left open by the abstract: its process noise and its weight of the sun. Two figures fitted by
two free settings prove nothing, so each choice leaves printed numbers out, and those are compared: one takes the three
errors before calibration and predicts the error after it; the other takes both root sums of squares and predicts how the
error before is shared by the axes. What is not calibrated, and the abstract's iteration, run with the first choice.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from scipy.optimize import least_squares
from scipy.stats import chi2

from fluxtwin.calib.common.calibration_file import write_calibration
from fluxtwin.calib.common.options import SpinOptions
from fluxtwin.calib.common.records import Calibration
from fluxtwin.calib.spin.calibrate import SpinFit, fit_spin, scalar_start
from fluxtwin.calib.spin.filter import Filtered, FilterSettings, spin_filter
from fluxtwin.calib.spin.motion import SpinMotion
from fluxtwin.calib.spin.rows import SpinRows, assemble_spin
from fluxtwin.calib.spin.sedlak import at, iterate
from fluxtwin.calib.spin.start import blind_start
from fluxtwin.scenarios.flights import Flight, Numbers, provenance, rms, rms_along, write_flight
from fluxtwin.scenarios.page import StudyResult
from fluxtwin.scenarios.st5 import mission
from fluxtwin.scenarios.st5.mission import attitude_error_deg, terms_of, truth_terms
from fluxtwin.scenarios.words import Words
from fluxtwin.sim.base.errors import NoAnswer
from fluxtwin.sim.base.progress import Progress, part_of, silent
from fluxtwin.sim.base.random_streams import stream
from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.earth import frames
from fluxtwin.sim.earth.field import FieldModel, load_field
from fluxtwin.sim.run.world import World, build_world
from fluxtwin.sim.scenario.scenario import Scenario

WALKS_RAD_S = tuple(np.geomspace(5e-5, 1e-2, 7).tolist())
"""Process noise: random walk of L/Jt in a second. 4e-4 is 1e-7 (N m s)^2/s."""
FACTORS = tuple(np.geomspace(1.0, 12.0, 6).tolist())
"""The sun's noise as the filter takes it, over what it is."""
RUNS = 50
STARTS = 100
GOOD_DEG = 0.1
"""An attitude error below which a blind start has found the motion."""
SUN_CONE_DEG = 30.0
"""Random spin axes keep so far from the sun's line: nearer, a slit sees no azimuth worth the name."""
_STEP = 0.01  # of the searched range: the filter's error is smooth on that scale
_CLOSE = 1e-3
_MOST_STEPS = 12


def _solved(fit: SpinFit | None, error_deg: FloatArray, nis: float) -> Numbers:
    """One way: the fit where there is one, and the error (N, 3) of the attitude about body x, y, z, at the readings."""
    rms_deg = rms_along(error_deg, axis=0)
    return Numbers(
        fit=fit,
        error_deg=error_deg,
        # (3,) over the hour, and their root sum of squares.
        rms_deg=rms_deg,
        rss_deg=np.linalg.norm(rms_deg),
        # Mean squared innovation (iterative, none) or residual (batch) of the field over its noise.
        nis=nis,
    )


def options(method: str) -> SpinOptions:
    """The abstract's inputs: noise of the sensors, and for the iteration the inertia."""
    printed, known = mission.published(), mission.noises()
    inertia = printed["inertia_kg_m2"]
    return SpinOptions(
        method=method,
        noise_nT=known.field_nT,
        lsb_nT=0.0,
        sun_sigma_deg=float(np.degrees(known.sun_rad)),
        robust="none",
        inertia_ratio=inertia[2] / inertia[0] if method == "iterative" else None,
    )


def settings(walk_rad_s: float = 0.0, sun_factor: float = 1.0) -> FilterSettings:
    """Of the filter: the abstract's noise, the sun's times `sun_factor`, and a random walk of L/Jt."""
    known = mission.noises()
    return FilterSettings(known.field_nT, known.sun_rad * sun_factor, walk_rad_s)


def filtered(rows: SpinRows, field_B_nT: FloatArray, motion: SpinMotion, chosen: FilterSettings) -> Filtered:
    """One pass over readings (N, 3) from the motion at the first event, with the abstract's inertia."""
    begin_s = float(min(rows.t_s[0], rows.pulse_s[0]))
    inertia: Sequence[float] = mission.published()["inertia_kg_m2"]
    return spin_filter(rows, field_B_nT, *at(motion, begin_s), inertia[2] / inertia[0], chosen)


def run_hour(flight: Flight, ground: FieldModel, progress: Progress = silent, **grid: Sequence[float]) -> Numbers:
    """The search and the three ways. `grid`: `walks_rad_s` and `factors` of another search."""
    rows = assemble_spin(flight.telemetry, ground)
    q_true = flight.truth.q_NB
    start = blind_start(rows, mission.noises(), np.eye(3), np.zeros(3)).state.motion
    solved = {}
    for share, method, last in ((0.0, "iterative", "nis_last"), (0.1, "batch", "field_chi2")):
        progress(method, share)
        fit = fit_spin(rows, options(method), model_name=ground.name)
        A = frames.rotation_from_q(fit.q_NB).as_matrix()
        solved[method] = _solved(fit, attitude_error_deg(A, q_true), fit.quality[last])
    true_side = fit.calibration.apply(rows.B_nT)

    def passed(walk: float, factor: float, field_B_nT: FloatArray = rows.B_nT) -> Numbers:
        found = filtered(rows, field_B_nT, start, settings(walk, factor))
        return _solved(None, attitude_error_deg(found.A, q_true), found.field_nis)

    def run(walk: float, factor: float) -> Numbers:
        pre, post = passed(walk, factor), passed(walk, factor, true_side)
        return Numbers(
            walk_rad_s=walk,
            sun_factor=factor,
            # (3,) rms about body x, y, z before calibration, and with the batch's; and their root sums of squares.
            pre_deg=pre.rms_deg,
            post_deg=post.rms_deg,
            pre_rss_deg=pre.rss_deg,
            post_rss_deg=post.rss_deg,
        )

    searched = search(run, mission.published(), progress=part_of(progress, 0.15, 0.95), **grid)
    steps_alone, alone = _steps_alone(rows, q_true, searched.by_axes)
    return Numbers(
        flight=flight,
        rows=rows,
        search=searched,
        # Readings as they come, the filter with the settings that the printed errors before calibration choose.
        before=passed(searched.by_axes.walk_rad_s, searched.by_axes.sun_factor),
        # The abstract's three steps with those settings, without the regression at the end; and what they give, which has no
        # covariance.
        steps_alone=steps_alone,
        alone=alone,
        # The steps with no process noise and the sun's own noise, and our regression after them; and the batch.
        **solved,
    )


def search(
    run: Callable[[float, float], Numbers],
    printed: Mapping[str, Any],
    *,
    walks_rad_s: Sequence[float] = WALKS_RAD_S,
    factors: Sequence[float] = FACTORS,
    progress: Progress = silent,
) -> Numbers:
    """The grid of `run(walk, factor)`, and from its best points the two choices by least squares within the grid."""
    grid: list[Numbers] = []
    for walk in walks_rad_s:
        progress("the filter's open settings", len(grid) / (len(walks_rad_s) * len(factors) + 20))
        grid += [run(walk, factor) for factor in factors]
    low, high = (np.log([end(walks_rad_s), end(factors)]) for end in (min, max))

    def axes(setting: Numbers) -> FloatArray:
        return np.asarray(setting.pre_deg - np.array(printed["pre_rms_deg"]), dtype=np.float64)

    def sums(setting: Numbers) -> FloatArray:
        before, after = setting.pre_rss_deg / printed["pre_rss_deg"], setting.post_rss_deg / printed["post_rss_deg"]
        return np.log(np.array([before, after], dtype=np.float64))  # ratios: one is ten times the other

    def at(place: FloatArray) -> Numbers:
        walk, factor = np.exp(low + (place - 1.0) * (high - low))
        return run(float(walk), float(factor))

    def nearest(misfit: Callable[[Numbers], FloatArray]) -> Numbers:
        best = min(grid, key=lambda setting: float(np.sum(misfit(setting) ** 2)))
        begin = 1.0 + (np.log([best.walk_rad_s, best.sun_factor]) - low) / (high - low)

        def off(place: FloatArray) -> FloatArray:
            return misfit(at(place))

        found = least_squares(
            off,
            np.clip(begin, 1.0, 2.0),
            bounds=(1.0, 2.0),
            diff_step=[_STEP, _STEP],
            xtol=_CLOSE,
            ftol=_CLOSE,
            max_nfev=_MOST_STEPS,
        )
        return at(found.x)

    shape = (len(walks_rad_s), len(factors))
    return Numbers(
        walks_rad_s=walks_rad_s,
        factors=factors,
        # All pairs, the factor running fastest.
        grid=tuple(grid),
        # (W, F) root sum of squares before and after calibration over the grid.
        rss_deg={
            when: np.array([getattr(one, f"{when}_rss_deg") for one in grid]).reshape(shape) for when in ("pre", "post")
        },
        # Nearest to the three printed rms before calibration; nothing that is printed of the time after was used.
        by_axes=nearest(axes),
        # Nearest to the two printed root sums of squares, before and after; how the axes share them was not used.
        by_rss=nearest(sums),
    )


def _steps_alone(rows: SpinRows, q_true: FloatArray, chosen: Numbers) -> tuple[Numbers, Calibration]:
    """TWOSTEP, filter and alignment as the abstract has them."""
    known = options("iterative")
    G, o_nT, _, _ = scalar_start(rows, known)
    motion = blind_start(rows, mission.noises(), G, o_nT).state.motion
    true_side = np.linalg.inv(G)
    assert known.inertia_ratio is not None
    done = iterate(
        rows,
        (rows.B_nT - o_nT) @ true_side.T,
        motion,
        known.inertia_ratio,
        settings(chosen.walk_rad_s, chosen.sun_factor),
        np.radians(known.sun_alignment_deg),
    )
    M = done.turn.T @ true_side
    error = attitude_error_deg(done.last.A, q_true)
    return _solved(None, error, done.last.field_nis), Calibration(M - np.eye(3), -M @ o_nT)


def run_monte_carlo(
    config: Scenario, world: World, ground: FieldModel, progress: Progress = silent, runs: int = RUNS
) -> Numbers:
    """`runs` seeds, each solved by the batch from a blind start: its errors against its sigmas."""
    found = []
    for run in range(runs):
        progress(f"run {run + 1} of {runs}", run / runs)
        found.append(_one(config.updated({"seed": config.seed + 1 + run}), world, ground))
    terms, nees, rss = zip(*found, strict=True)
    errors = np.array([one.values for one in terms]) - truth_terms()
    return Numbers(
        # (R, 6) errors of b and misalignment, and the same over their sigmas.
        errors_mG_deg=errors,
        pulls=errors / np.array([one.sigma for one in terms]),
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


def _one(config: Scenario, world: World, ground: FieldModel) -> tuple[Numbers, float, float]:
    """Terms, normalised squared error of the 12 parameters, and RSS of the attitude [deg]."""
    flight = mission.fly(config, world)
    fit = fit_spin(assemble_spin(flight.telemetry, ground), options("batch"), model_name=ground.name)
    truth = flight.truth
    off = fit.calibration.values - np.concatenate([truth.S.ravel(), truth.b_nT])
    score = float(off @ np.linalg.solve(fit.calibration.covariance, off))
    error = attitude_error_deg(frames.rotation_from_q(fit.q_NB).as_matrix(), truth.q_NB)
    return terms_of(fit.calibration), score, rms(np.linalg.norm(error, axis=1))


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
