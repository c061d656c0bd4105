"""Figures 1 and 2: yaw from the magnetometer on day 205, with mean biases and with the full calibration.

The papers do not say how large Seasat's yaw was, and that decides whether yaw = 0 is the better estimate; so
the amplitude is swept and the crossover reported.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fluxtwin.calib.linear import calibrate_linear
from fluxtwin.calib.records import Calibration
from fluxtwin.calib.residuals import residuals_of
from fluxtwin.calib.yaw import YawSolution, average_yaw, yaw_from_field
from fluxtwin.plots.yaw import YawComparison, YawSweep
from fluxtwin.scenarios.seasat import geometry, mission
from fluxtwin.scenarios.seasat.mission import Flight
from fluxtwin.sim import epoch, frames
from fluxtwin.sim.constants import NT_PER_MG
from fluxtwin.sim.field import FieldModel
from fluxtwin.sim.progress import Progress
from fluxtwin.sim.scenario import Scenario
from fluxtwin.sim.types import FloatArray

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
    sun_yaw_3sigma_deg: float
    """Three times the rms error of the reference yaw."""
    check_rms_mG: FloatArray
    """(3,) residual per axis on day 279, samples of the two heads named in claim 32."""
    check_samples: int


def run_yaw(config: Scenario, full: Calibration, ground: FieldModel, progress: Progress) -> YawStudy:
    """Calibrate with a mean bias, solve for yaw both ways, sweep the true amplitude, check day 279."""
    progress("yaw on day 205", 0.0)
    coarse = mission.fly(config)
    day_205 = coarse.telemetry.select(coarse.rows("205"))
    bias_only = calibrate_linear(day_205, ground, parameters="b").calibration
    fine = mission.fly(fine_scenario(config))
    solutions = [yaw_from_field(fine.telemetry, c, ground) for c in (bias_only, full)]
    sweep = _sweep(config, fine, (bias_only, full), ground, progress)
    progress("day 279", 0.95)
    check, samples = _check_day(config, full, ground)
    truth = fine.truth.yaw_rad
    return YawStudy(
        bias_only=bias_only,
        bias_errors=judge(fine, solutions[0]),
        full_errors=judge(fine, solutions[1]),
        figure_1=_comparison(fine, solutions[0]),
        figure_2=_comparison(fine, solutions[1]),
        sweep=sweep,
        sun_yaw_3sigma_deg=float(3 * np.degrees(np.std(solutions[1].yaw_reference_rad - truth))),
        check_rms_mG=check,
        check_samples=samples,
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


def _sweep(
    config: Scenario,
    fine: Flight,
    calibrations: tuple[Calibration, Calibration],
    ground: FieldModel,
    progress: Progress,
) -> YawSweep:
    """Share of windows won by yaw = 0; each seed draws its own libration, noise and torquer activity."""
    shares = np.empty((2, len(AMPLITUDES_DEG), SEEDS))
    for column, amplitude in enumerate(AMPLITUDES_DEG):
        progress(f"yaw sweep: amplitude {amplitude} deg", 0.1 + 0.85 * column / len(AMPLITUDES_DEG))
        for number in range(SEEDS):
            changes = {"attitude.yaw_rms_deg": amplitude / np.sqrt(2.0), "seed": config.seed + number}
            flight = mission.fly(fine.scenario.updated(changes), fine.world)
            for row, calibration in enumerate(calibrations):
                errors = judge(flight, yaw_from_field(flight.telemetry, calibration, ground))
                shares[row, column, number] = errors.zero_wins
    amplitude_deg = np.array(AMPLITUDES_DEG)
    return YawSweep(
        amplitude_deg=amplitude_deg,
        share_bias_only=shares[0].mean(axis=1),
        spread_bias_only=shares[0].std(axis=1),
        share_full=shares[1].mean(axis=1),
        spread_full=shares[1].std(axis=1),
        crossover_deg=_crossover(amplitude_deg, shares[1].mean(axis=1)),
    )


def _crossover(amplitude_deg: FloatArray, share: FloatArray) -> float | None:
    """Amplitude at which the share falls through one half, linear in between."""
    below = np.flatnonzero((share[:-1] >= 0.5) & (share[1:] < 0.5))
    if not below.size:
        return None
    k = int(below[0])
    part = (share[k] - 0.5) / (share[k] - share[k + 1])
    return float(amplitude_deg[k] + part * (amplitude_deg[k + 1] - amplitude_deg[k]))


def _check_day(config: Scenario, calibration: Calibration, ground: FieldModel) -> tuple[FloatArray, int]:
    """Residual rms per axis [mG] on day 279 where a head sees the sun south of 45 S or north of 30 N."""
    start = geometry.day(geometry.CHECK_DAY)
    flight = mission.fly(mission.with_schedule(config, start, CHECK_MINUTES, 60.0))
    r_E_km = frames.rotation_EN(flight.world.time).apply(flight.world.r_N_km)
    latitude = np.degrees(frames.geocentric(r_E_km)[0])
    assert flight.telemetry.sun_sensor_head is not None
    chosen = (flight.telemetry.sun_sensor_head > 0) & ((latitude < -45.0) | (latitude > 30.0))
    residual = residuals_of(flight.telemetry.select(chosen), calibration, ground)
    return np.sqrt(np.mean(residual**2, axis=0)) / NT_PER_MG, int(chosen.sum())
