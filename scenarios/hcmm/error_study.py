"""Table 4: what makes up the residual, each source twice: simulated alone, and by the papers' arithmetic."""

from __future__ import annotations

from typing import Any

import numpy as np

from fluxtwin.scenarios.calibration_records import error_square_mG2, rms_mG
from fluxtwin.scenarios.hcmm import mission
from fluxtwin.scenarios.hcmm.calibration_study import choose_rows, fit_rows, with_random_phase
from fluxtwin.scenarios.hcmm.mission import Flight
from fluxtwin.scenarios.numbers import Numbers
from fluxtwin.sim.base.progress import Progress
from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.earth import frames
from fluxtwin.sim.earth.constants import NT_PER_MG
from fluxtwin.sim.earth.field import FieldModel, field_N_nT
from fluxtwin.sim.run.world import World, build_world
from fluxtwin.sim.scenario.scenario import Scenario
from fluxtwin.sim.spacecraft.torquers import coupling_nT_per_Am2

RUNS = 12
NEAR_EQUATOR_DEG, NEAR_POLES_DEG = 5.0, 75.0
"""Geocentric latitudes that count as near the equator and near the poles."""


def run_errors(config: Scenario, ground: FieldModel, progress: Progress, runs: int = RUNS) -> Numbers:
    """Switch the sources on one at a time, then together."""
    days = mission.on_days(config)
    cases = {source: (source,) for source in mission.SOURCES} | {"all": mission.SOURCES}
    squares: dict[str, list[float]] = {case: [] for case in cases}
    fits, turned = [], []
    for run in range(runs):
        progress(f"error budget, run {run + 1} of {runs}", run / runs)
        moved = with_random_phase(days, config.seed + 1 + run)
        worlds = {True: build_world(moved), False: build_world(mission.only(moved))}
        for case, sources in cases.items():
            flight = mission.fly(mission.only(moved, *sources), worlds["field" in sources])
            rows = choose_rows(flight, "AB")
            squares[case].append(error_square_mG2(flight, flight.telemetry.select(rows), ground))
            if case == "all":
                fits.append(rms_mG(fit_rows(flight, rows, ground, "white")) ** 2)
                turned.append(_reference_error_square(flight, rows))
    assert config.torquers is not None
    coupling = np.linalg.norm(coupling_nT_per_Am2(np.array(config.torquers.positions_m)), axis=0).max()
    axial_mG = coupling * config.torquers.Am2 / NT_PER_MG
    return Numbers(
        flights=runs,
        # [mG, rms per component over the 443 samples] Error of equation 1 at the true S, b, T = 0, with that source alone:
        # mean square over seeds and phases, and standard deviation.
        simulated={case: float(np.sqrt(np.mean(values))) for case, values in squares.items()},
        simulated_spread={case: float(np.std(np.sqrt(values))) for case, values in squares.items()},
        paper_rule=paper_rule(config),
        # Residual of the 12-parameter fit with all sources.
        fit=np.sqrt(np.mean(fits)),
        # Field of one coil at the magnetometer on its axis, and what the compensation leaves of it.
        coil_axial_mG=axial_mG,
        coil_left_mG=axial_mG * (1.0 - config.torquers.compensation),
        # (3,) rms error of the reference attitude in yaw, roll, pitch; sunlit rows, heads 2 and 3.
        reference_deg=np.degrees(np.sqrt(np.mean(turned, axis=0))),
        **_field_model(config, ground),
    )


def paper_rule(config: Scenario) -> dict[str, tuple[float, float]]:
    """LSB/sqrt 12, the printed 1.1, below 1, and 1.0 to 1.5; and their root sums of squares."""
    lsb = config.magnetometer.step_nT / NT_PER_MG / float(np.sqrt(12.0))
    attitude = mission.printed_value("errors", "rms_lo_mG", source="reference attitude error")
    torquer = mission.printed_value("errors", "rms_hi_mG", source="electromagnet activity")
    low, high = (mission.printed_value("errors", f"rms_{k}_mG", source="field model error") for k in ("lo", "hi"))
    rule = {"lsb": (lsb, lsb), "attitude": (attitude, attitude), "torquer": (0.0, torquer), "field": (low, high)}
    total = [float(np.sqrt(sum(pair[k] ** 2 for pair in rule.values()))) for k in (0, 1)]
    return rule | {"all": (total[0], total[1])}


def _reference_error_square(flight: Flight, rows: np.ndarray) -> FloatArray:
    """(3,) mean square error of the reference attitude in yaw, roll and pitch [rad2]."""
    assert flight.telemetry.q_NB is not None
    R_NO = flight.world.R_ON.inv()[rows]
    reported = frames.yaw_roll_pitch(frames.rotation_from_q(np.array(flight.telemetry.q_NB)[rows]) * R_NO)
    true = (flight.truth.yaw_rad, flight.truth.roll_rad, flight.truth.pitch_rad)
    return np.array([np.mean((seen - real[rows]) ** 2) for seen, real in zip(reported, true, strict=True)])


def _field_model(config: Scenario, ground: FieldModel) -> dict[str, Any]:
    """The error of the ground's model along three days of the orbit, at 30 s."""
    assert config.schedule is not None
    segment = config.schedule.segments[0]
    everywhere = config.updated(
        {
            "schedule.in_view_of_stations": None,
            "schedule.segments": [
                {"start_utc": segment.start_utc, "duration_min": segment.duration_min, "step_s": 30.0}
            ],
        }
    )
    world = build_world(everywhere)
    strength, axis, angle = _differences(world, ground)
    rms_rad, seen_rad = np.sqrt(np.mean(angle**2)), _differences(build_world(config), ground)[2]
    return {
        # rms error of IGRF 1975 in field strength, and per axis.
        "field_scalar_mG": np.sqrt(np.mean(strength**2)) / NT_PER_MG,
        "field_axis_mG": np.sqrt(np.mean(axis**2)) / NT_PER_MG,
        # Mean strength of the field of 1978 near the equator and near the poles.
        "field_ends_mG": _field_ends_mG(world),
        # rms, three times that, largest of the three days, and largest over the passes of Table 5's stations.
        "field_direction_deg": np.degrees([rms_rad, 3.0 * rms_rad, angle.max(), seen_rad.max()]),
    }


def _field_ends_mG(world: World) -> tuple[float, float]:
    """Mean strength within NEAR_EQUATOR_DEG and beyond NEAR_POLES_DEG of latitude [mG]."""
    latitude_deg = np.degrees(np.abs(frames.geocentric(frames.rotation_EN(world.time).apply(world.r_N_km))[0]))
    strength_mG = np.linalg.norm(world.field_N_nT, axis=1) / NT_PER_MG
    equator, poles = latitude_deg < NEAR_EQUATOR_DEG, latitude_deg > NEAR_POLES_DEG
    return float(strength_mG[equator].mean()), float(strength_mG[poles].mean())


def _differences(world: World, ground: FieldModel) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Error in strength [nT] (N,), per axis [nT] (N, 3) and in direction [rad] (N,)."""
    model = field_N_nT(ground, world.time, world.r_N_km)
    truth = world.field_N_nT
    angle = np.arctan2(np.linalg.norm(np.cross(model, truth), axis=1), np.sum(model * truth, axis=1))
    return np.linalg.norm(model, axis=1) - np.linalg.norm(truth, axis=1), model - truth, angle
