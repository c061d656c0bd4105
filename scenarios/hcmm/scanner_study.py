"""The closed chain: sun sensor calibrates scanner, both give the reference attitude, that calibrates the magnetometer.

A scanner with biases is flown. Its own calibration uses sun-nadir angles alone. What the biases do to the magnetometer's
S, before and after, shows why a second channel is needed: a constant error of the reference attitude and a misaligned
magnetometer are one and the same thing to a calibration that takes the attitude as right.
"""

from __future__ import annotations

import numpy as np

from fluxtwin.calib.attitude.horizon_scanner import ScannerCalibration, calibrate_scanner
from fluxtwin.gap.channels.sun_nadir import weigh_sun_nadir
from fluxtwin.scenarios.calibration_records import papers_regression
from fluxtwin.scenarios.hcmm import mission
from fluxtwin.scenarios.hcmm.calibration_study import choose_rows, pass_labels
from fluxtwin.scenarios.hcmm.mission import Flight
from fluxtwin.scenarios.hcmm_orbit.geometry import angle_between
from fluxtwin.scenarios.numbers import Numbers
from fluxtwin.sim.base.progress import Progress
from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.earth import frames
from fluxtwin.sim.earth.field import FieldModel
from fluxtwin.sim.spacecraft.sensors.reference_attitude import attitude_from_sun_and_nadir
from fluxtwin.sim.telemetry.record import Telemetry

BIAS_DEG = (0.40, -0.30)
"""Roll and pitch bias put into the scanner; assumed, of the size of its requirement."""
TRUSTED_HEADS = (2, 3)
"""Heads that define the attitude reference (C, text)."""


def run_scanner(days: Flight, last: Flight, ground: FieldModel, progress: Progress) -> Numbers:
    """Fly with biases too on the days of Table 3 (`days`), and the three days of Table 5 (`last`) for head 1."""
    progress("horizon scanner", 0.0)
    biases = {"horizon_scanner.roll_bias_deg": BIAS_DEG[0], "horizon_scanner.pitch_bias_deg": BIAS_DEG[1]}
    flight = mission.fly(days.scenario.updated(biases), days.world)
    labels = pass_labels(flight)
    found = calibrate_scanner(flight.telemetry, heads=TRUSTED_HEADS, passes=labels)
    repaired = with_new_attitude(flight, found.apply(flight.telemetry))
    rows = choose_rows(flight, "AB")
    tilts = [_tilt_deg(t.select(rows), ground, flight.truth.S) for t in (flight.telemetry, repaired, days.telemetry)]
    progress("head 1 at dawn", 0.7)
    offset, truth = _head_1(mission.fly(last.scenario.updated(biases), last.world), found)
    right = mission.fly(last.scenario.updated({"sun_sensor.1.misalignment_deg": None}), last.world)
    return Numbers(
        # Roll and pitch put in.
        bias_deg=BIAS_DEG,
        found=found,
        # Sun-nadir residual before and after, heads 2 and 3.
        rms_before_deg=np.degrees(found.rms_before_rad),
        rms_after_deg=np.degrees(found.rms_after_rad),
        # Rotation in S that is none of the magnetometer's: from the reference attitude as it comes, after the scanner is
        # calibrated, and of a flight whose scanner has no bias, which is what field model and noise leave.
        tilt_biased_deg=tilts[0],
        tilt_corrected_deg=tilts[1],
        tilt_unbiased_deg=tilts[2],
        # Misalignment of head 1 towards nadir, found at dawn with the scanner calibrated by heads 2 and 3.
        head_1_deg=offset,
        head_1_truth_deg=truth,
        # The sun-nadir channel of the three days, the scanner without bias: head 1 turned; and head 1 right, with the
        # magnetometer's S as it is.
        channel=weigh_sun_nadir(last.telemetry),
        turned_magnetometer=weigh_sun_nadir(right.telemetry),
    )


def with_new_attitude(flight: Flight, telemetry: Telemetry) -> Telemetry:
    """The reference attitude made anew from the record's sun and nadir."""
    assert telemetry.sun_B is not None and telemetry.nadir_B is not None
    nadir_N = -flight.world.r_N_km
    q = attitude_from_sun_and_nadir(telemetry.sun_B, telemetry.nadir_B, flight.world.sun_N, nadir_N)
    return telemetry.replace(q_NB=q)


def _tilt_deg(telemetry: Telemetry, ground: FieldModel, truth_S: FloatArray) -> float:
    """Size of the rotation by which the found I+S differs from the true one."""
    S = papers_regression(telemetry, ground).calibration.S
    between = (np.eye(3) + S) @ np.linalg.inv(np.eye(3) + truth_S)
    turn = 0.5 * (between - between.T)
    return float(np.degrees(np.linalg.norm([turn[2, 1], turn[0, 2], turn[1, 0]])))


def _head_1(flight: Flight, found: ScannerCalibration) -> tuple[float, float]:
    """Mean residual at dawn after the scanner's correction, and what the misalignment should give [deg]."""
    corrected = found.apply(flight.telemetry)
    assert corrected.sun_B is not None and corrected.nadir_B is not None and corrected.sun_sensor_head is not None
    rows = np.flatnonzero((corrected.sun_sensor_head == 1) & np.isfinite(corrected.nadir_B).all(axis=1))
    computed = angle_between(flight.world.sun_N[rows], -flight.world.r_N_km[rows])
    residual = angle_between(np.array(corrected.sun_B)[rows], np.array(corrected.nadir_B)[rows]) - computed
    # A head turned by theta reports the sun turned by minus theta: what that does to the angle from nadir.
    theta = np.radians(flight.scenario.sun_sensor["1"].misalignment_deg)
    B = frames.rotation_from_q(flight.truth.q_NB[rows])
    sun_B, nadir_B = B.apply(flight.world.sun_N[rows]), B.apply(-flight.world.r_N_km[rows])
    expected = angle_between(sun_B - np.cross(theta, sun_B), nadir_B) - computed
    return float(np.degrees(residual.mean())), float(np.degrees(expected.mean()))
