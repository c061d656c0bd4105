"""Day 279: the calibration of the four days tried on a day that did not enter it (claim 32)."""

from __future__ import annotations

import numpy as np

from fluxtwin.calib.common.residuals import residuals_of
from fluxtwin.scenarios.flights import day
from fluxtwin.scenarios.numbers import Numbers
from fluxtwin.scenarios.seasat import geometry, mission
from fluxtwin.scenarios.seasat.calibration_study import calibrations, reference_error_rad
from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.earth import frames
from fluxtwin.sim.earth.constants import NT_PER_MG
from fluxtwin.sim.earth.field import FieldModel
from fluxtwin.sim.run.world import build_world
from fluxtwin.sim.scenario.scenario import Scenario

SEEDS = 10
_MINUTES = 125


def run_check_day(config: Scenario, ground: FieldModel) -> Numbers:
    """Fly the four days and day 279 with SEEDS seeds, each calibrated anew.

    rms over the samples in which a head sees the sun south of 45 S or north of 30 N.
    """
    later = mission.with_schedule(config, day(geometry.CHECK_DAY), _MINUTES, 60.0)
    base, world = build_world(config), build_world(later)
    latitude = np.degrees(frames.geocentric(frames.rotation_EN(world.time).apply(world.r_N_km))[0])
    rows = []
    for seed in range(config.seed + 1, config.seed + 1 + SEEDS):
        full, _ = calibrations(mission.fly(config.updated({"seed": seed}), base), ground)
        flight = mission.fly(later.updated({"seed": seed}), world)
        assert flight.telemetry.sun_sensor_head is not None
        chosen = (flight.telemetry.sun_sensor_head > 0) & ((latitude < -45.0) | (latitude > 30.0))
        error = reference_error_rad(flight)[chosen]
        field = flight.truth.field_B_nT[chosen] / NT_PER_MG
        residual = residuals_of(flight.telemetry.select(chosen), full, ground) / NT_PER_MG
        rows.append([_rms(residual), np.degrees(_rms(error)), _rms(np.cross(error, field))])
    rms, attitude_deg, attitude_mG = np.moveaxis(np.array(rows), 1, 0)
    nadir_N = -world.r_N_km / np.linalg.norm(world.r_N_km, axis=1)[:, None]
    angle = np.degrees(np.arccos(np.sum(nadir_N * world.sun_N, axis=1)))[chosen]
    return Numbers(
        # (SEEDS, 3) residual per body axis.
        rms_mG=rms,
        # (SEEDS, 3) error of the reference attitude about each body axis (roll, pitch, yaw), and what it leaves.
        attitude_deg=attitude_deg,
        attitude_mG=attitude_mG,
        # (3,) true field per body axis.
        field_mG=_rms(field),
        # Least and greatest angle between sun and nadir.
        sun_nadir_deg=(float(angle.min()), float(angle.max())),
        samples=chosen.sum(),
    )


def _rms(values: FloatArray) -> FloatArray:
    return np.asarray(np.sqrt(np.mean(values**2, axis=0)))
