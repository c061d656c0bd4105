"""Figures 1 and 2: yaw from the magnetometer on day 205, with mean biases and with the full calibration.

The papers do not say how large Seasat's yaw was, and that decides whether yaw = 0 is the better estimate; so
the amplitude of a prescribed motion is swept and the crossover reported.
"""

from __future__ import annotations

import numpy as np

from fluxtwin.calib.attitude.yaw import yaw_from_field
from fluxtwin.calib.common.records import Calibration
from fluxtwin.plots.yaw import YawComparison, YawSweep
from fluxtwin.scenarios.flights import day
from fluxtwin.scenarios.motion import prescribed
from fluxtwin.scenarios.numbers import Numbers
from fluxtwin.scenarios.seasat import geometry, mission
from fluxtwin.scenarios.seasat.calibration_study import calibrations
from fluxtwin.scenarios.seasat.check_day import SEEDS, run_check_day
from fluxtwin.scenarios.seasat.mission import Flight
from fluxtwin.scenarios.yaw_comparison import compare_yaw
from fluxtwin.sim.base.progress import Progress
from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.earth.field import FieldModel
from fluxtwin.sim.run.world import build_world
from fluxtwin.sim.scenario.scenario import Scenario

STEP_S = 4.0
"""Assumed spacing of the samples in the figures; the papers do not give it."""
ORBIT_SAMPLES = 1510
AMPLITUDES_DEG = (0.2, 0.3, 0.5, 0.7, 1.0, 1.4, 2.0)


def run_yaw(config: Scenario, full: Calibration, ground: FieldModel, progress: Progress) -> Numbers:
    """Calibrate with a mean bias, solve for yaw both ways, sweep the true amplitude, check day 279."""
    progress("yaw on day 205", 0.0)
    coarse = mission.fly(config)
    bias_only = calibrations(coarse, ground)[1]
    fine = mission.fly(fine_scenario(config))
    figure_1, figure_2 = (_compared(fine, c, ground) for c in (bias_only, full))
    sweep = _sweep(config, fine, ground, progress)
    progress("day 279", 0.9)
    return Numbers(
        bias_errors=judge(figure_1),
        full_errors=judge(figure_2),
        figure_1=figure_1,
        figure_2=figure_2,
        sweep=sweep,
        check=run_check_day(config, ground),
    )


def fine_scenario(config: Scenario) -> Scenario:
    """One orbit of day 205, a sample every few seconds."""
    return mission.with_schedule(config, day(geometry.DATA_DAYS[0]), ORBIT_SAMPLES, STEP_S)


def judge(record: YawComparison) -> Numbers:
    """How one calibration does against yaw = 0, over the windows of an orbit and those near the equator."""
    error, zero, at_nodes = record.mean_error_deg, record.mean_sun_deg, record.near_node
    return Numbers(
        # Yaw of the magnetometer, and yaw = 0, less that of the sun sensor.
        rms_deg=np.sqrt(np.mean(error**2)),
        rms_at_nodes_deg=np.sqrt(np.mean(error[at_nodes] ** 2)),
        zero_rms_deg=np.sqrt(np.mean(zero**2)),
        # Share of windows in which yaw = 0 is nearer.
        zero_wins=1.0 - record.nearer.mean(),
        zero_wins_at_nodes=1.0 - record.nearer[at_nodes].mean(),
    )


def _compared(flight: Flight, calibration: Calibration, ground: FieldModel) -> YawComparison:
    return compare_yaw(flight.telemetry, yaw_from_field(flight.telemetry, calibration, ground))


def _sweep(config: Scenario, fine: Flight, ground: FieldModel, progress: Progress) -> YawSweep:
    """Share of windows won by yaw = 0. Each seed draws its own libration, noise, torquer activity and calibration."""
    kinds = {"slow": config, "white": config.updated({"magnetometer.unknown.kind": "white"})}
    worlds = {"base": build_world(config), "fine": fine.world}
    shares = {name: np.empty((len(AMPLITUDES_DEG), SEEDS)) for name in ("full", "bias_only", "white")}
    for number in range(SEEDS):
        progress(f"yaw sweep: seed {number + 1} of {SEEDS}", 0.1 + 0.75 * number / SEEDS)
        for kind, scenario in kinds.items():
            seeded = scenario.updated({"seed": config.seed + 1 + number})
            full, bias_only = calibrations(mission.fly(seeded, worlds["base"]), ground)
            for row, amplitude in enumerate(AMPLITUDES_DEG):
                moved = prescribed(seeded).updated({"attitude.yaw_rms_deg": amplitude / np.sqrt(2.0)})
                flight = mission.fly(fine_scenario(moved), worlds["fine"])
                won = judge(_compared(flight, full, ground)).zero_wins
                shares["full" if kind == "slow" else "white"][row, number] = won
                if kind == "slow":
                    shares["bias_only"][row, number] = judge(_compared(flight, bias_only, ground)).zero_wins
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


def _crossover(amplitude_deg: FloatArray, share: FloatArray) -> float | None:
    """Amplitude at which the share falls through one half, linear in between."""
    below = np.flatnonzero((share[:-1] >= 0.5) & (share[1:] < 0.5))
    if not below.size:
        return None
    k = int(below[0])
    part = (share[k] - 0.5) / (share[k] - share[k + 1])
    return float(amplitude_deg[k] + part * (amplitude_deg[k + 1] - amplitude_deg[k]))
