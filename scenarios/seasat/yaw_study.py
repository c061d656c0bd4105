"""Figures 1 and 2: yaw from the magnetometer on day 205, with mean biases and with the full calibration.

The papers do not say how large Seasat's yaw was, and that decides whether yaw = 0 is the better estimate; so
the amplitude of a prescribed motion is swept and the crossover reported.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fluxtwin.calib.linear import calibrate_linear
from fluxtwin.calib.records import Calibration
from fluxtwin.calib.residuals import residuals_of
from fluxtwin.calib.yaw import YawSolution, average_yaw, yaw_from_field
from fluxtwin.plots.yaw import YawComparison, YawSweep
from fluxtwin.scenarios.motion import prescribed
from fluxtwin.scenarios.seasat import geometry, mission
from fluxtwin.scenarios.seasat.mission import Flight
from fluxtwin.sim import epoch, frames
from fluxtwin.sim.constants import NT_PER_MG
from fluxtwin.sim.field import FieldModel
from fluxtwin.sim.progress import Progress
from fluxtwin.sim.scenario import Scenario
from fluxtwin.sim.types import FloatArray
from fluxtwin.sim.world import build_world

STEP_S = 4.0
"""Assumed spacing of the samples in the figures; the papers do not give it."""
ORBIT_SAMPLES = 1510
WINDOW_S = 120.0
AMPLITUDES_DEG = (0.2, 0.3, 0.5, 0.7, 1.0, 1.4, 2.0)
SEEDS = 10
CHECK_MINUTES = 125


@dataclass(frozen=True)
class YawErrors:
    """How one calibration does against yaw = 0, over the windows of an orbit."""

    rms_deg: float
    """rms of magnetometer yaw less sun-sensor yaw over the windows."""
    zero_rms_deg: float
    """rms of yaw = 0 less sun-sensor yaw."""
    zero_wins: float
    """Share of windows in which yaw = 0 is nearer to the sun-sensor yaw."""
    zero_wins_at_nodes: float
    """The same over windows within 10 deg of the equator."""


@dataclass(frozen=True)
class YawStudy:
    """Everything about yaw on day 205 and on the day of the check."""

    bias_only: Calibration
    bias_errors: YawErrors
    full_errors: YawErrors
    figure_1: YawComparison
    figure_2: YawComparison
    sweep: YawSweep
    check_rms_mG: FloatArray
    """(SEEDS, 3) residual per axis on day 279, samples of the two heads named in claim 32, each seed calibrated anew."""
    check_samples: int


def run_yaw(config: Scenario, full: Calibration, ground: FieldModel, progress: Progress) -> YawStudy:
    """Calibrate with a mean bias, solve for yaw both ways, sweep the true amplitude, check day 279."""
    progress("yaw on day 205", 0.0)
    coarse = mission.fly(config)
    bias_only = _calibrations(coarse, ground)[1]
    fine = mission.fly(fine_scenario(config))
    solutions = [yaw_from_field(fine.telemetry, c, ground) for c in (bias_only, full)]
    sweep = _sweep(config, fine, ground, progress)
    progress("day 279", 0.9)
    checks = [_check_day(config, ground, config.seed + 1 + number) for number in range(SEEDS)]
    return YawStudy(
        bias_only=bias_only,
        bias_errors=judge(fine, solutions[0]),
        full_errors=judge(fine, solutions[1]),
        figure_1=_comparison(fine, solutions[0]),
        figure_2=_comparison(fine, solutions[1]),
        sweep=sweep,
        check_rms_mG=np.array([rms for rms, _ in checks]),
        check_samples=checks[0][1],
    )


def fine_scenario(config: Scenario) -> Scenario:
    """One orbit of day 205, a sample every few seconds."""
    return mission.with_schedule(config, geometry.day(geometry.DATA_DAYS[0]), ORBIT_SAMPLES, STEP_S)


def judge(flight: Flight, solution: YawSolution) -> YawErrors:
    """Compare averages over windows with the sun sensor's, as the figures do."""
    sun = average_yaw(solution.time, solution.yaw_reference_rad, WINDOW_S).yaw_rad
    found = solution.averages.yaw_rad
    error = np.degrees(np.arctan2(np.sin(found - sun), np.cos(found - sun)))
    zero = np.degrees(-sun)
    wins = np.abs(zero) < np.abs(error)
    r_E_km = frames.rotation_EN(flight.world.time).apply(flight.world.r_N_km)
    latitude = average_yaw(solution.time, frames.geocentric(r_E_km)[0][solution.rows], WINDOW_S).yaw_rad
    at_nodes = np.abs(latitude) < np.radians(10.0)
    return YawErrors(
        rms_deg=float(np.sqrt(np.mean(error**2))),
        zero_rms_deg=float(np.sqrt(np.mean(zero**2))),
        zero_wins=float(wins.mean()),
        zero_wins_at_nodes=float(wins[at_nodes].mean()),
    )


def _comparison(flight: Flight, solution: YawSolution) -> YawComparison:
    start = solution.time[0]
    reading = flight.telemetry.mag_B_nT[solution.rows]
    change = np.vstack([np.zeros((1, 3), dtype=bool), np.diff(reading, axis=0) != 0])
    head = flight.telemetry.sun_sensor_head
    seen = np.ones(len(solution.rows), dtype=bool) if head is None else head[solution.rows] > 0
    return YawComparison(
        minutes=epoch.seconds_since(solution.time, start) / 60.0,
        sun_deg=np.where(seen, np.degrees(solution.yaw_reference_rad), np.nan),
        magnetometer_deg=np.degrees(solution.yaw_first_order_rad),
        change_x=change[:, 0],
        change_y=change[:, 1],
        mean_minutes=epoch.seconds_since(solution.averages.time, start) / 60.0,
        mean_deg=np.degrees(solution.averages.yaw_rad),
        window_s=WINDOW_S,
    )


def _sweep(config: Scenario, fine: Flight, ground: FieldModel, progress: Progress) -> YawSweep:
    """Share of windows won by yaw = 0. Each seed draws its own libration, noise, torquer activity and calibration."""
    kinds = {"slow": config, "white": config.updated({"magnetometer.unknown.kind": "white"})}
    worlds = {"base": build_world(config), "fine": fine.world}
    shares = {name: np.empty((len(AMPLITUDES_DEG), SEEDS)) for name in ("full", "bias_only", "white")}
    for number in range(SEEDS):
        progress(f"yaw sweep: seed {number + 1} of {SEEDS}", 0.1 + 0.75 * number / SEEDS)
        for kind, scenario in kinds.items():
            seeded = scenario.updated({"seed": config.seed + 1 + number})
            full, bias_only = _calibrations(mission.fly(seeded, worlds["base"]), ground)
            for row, amplitude in enumerate(AMPLITUDES_DEG):
                moved = prescribed(seeded).updated({"attitude.yaw_rms_deg": amplitude / np.sqrt(2.0)})
                flight = mission.fly(fine_scenario(moved), worlds["fine"])
                won = judge(flight, yaw_from_field(flight.telemetry, full, ground)).zero_wins
                shares["full" if kind == "slow" else "white"][row, number] = won
                if kind == "slow":
                    solution = yaw_from_field(flight.telemetry, bias_only, ground)
                    shares["bias_only"][row, number] = judge(flight, solution).zero_wins
    amplitude_deg = np.array(AMPLITUDES_DEG)
    mean = {name: values.mean(axis=1) for name, values in shares.items()}
    spread = {name: values.std(axis=1) for name, values in shares.items()}
    return YawSweep(
        amplitude_deg=amplitude_deg,
        share_full=mean["full"],
        spread_full=spread["full"],
        share_bias_only=mean["bias_only"],
        spread_bias_only=spread["bias_only"],
        share_white=mean["white"],
        spread_white=spread["white"],
        crossover_deg=_crossover(amplitude_deg, mean["full"]),
        crossover_white_deg=_crossover(amplitude_deg, mean["white"]),
        seeds_won=np.mean(shares["full"] > 0.5, axis=1),
    )


def _calibrations(flight: Flight, ground: FieldModel) -> tuple[Calibration, Calibration]:
    """The full calibration of all days, and the mean bias of day 205."""
    whole = calibrate_linear(flight.telemetry, ground, errors_in_variables=False, robust="none", covariance="white")
    day_205 = flight.telemetry.select(flight.rows("205"))
    bias_only = calibrate_linear(day_205, ground, parameters="b", robust="none", covariance="white")
    return whole.calibration, bias_only.calibration


def _crossover(amplitude_deg: FloatArray, share: FloatArray) -> float | None:
    """Amplitude at which the share falls through one half, linear in between."""
    below = np.flatnonzero((share[:-1] >= 0.5) & (share[1:] < 0.5))
    if not below.size:
        return None
    k = int(below[0])
    part = (share[k] - 0.5) / (share[k] - share[k + 1])
    return float(amplitude_deg[k] + part * (amplitude_deg[k + 1] - amplitude_deg[k]))


def _check_day(config: Scenario, ground: FieldModel, seed: int) -> tuple[FloatArray, int]:
    """Residual rms per axis [mG] on day 279 where a head sees the sun south of 45 S or north of 30 N."""
    seeded = config.updated({"seed": seed})
    full, _ = _calibrations(mission.fly(seeded), ground)
    start = geometry.day(geometry.CHECK_DAY)
    flight = mission.fly(mission.with_schedule(seeded, start, CHECK_MINUTES, 60.0))
    r_E_km = frames.rotation_EN(flight.world.time).apply(flight.world.r_N_km)
    latitude = np.degrees(frames.geocentric(r_E_km)[0])
    assert flight.telemetry.sun_sensor_head is not None
    chosen = (flight.telemetry.sun_sensor_head > 0) & ((latitude < -45.0) | (latitude > 30.0))
    residual = residuals_of(flight.telemetry.select(chosen), full, ground)
    return np.sqrt(np.mean(residual**2, axis=0)) / NT_PER_MG, int(chosen.sum())
