"""The horizon scanner. The closed chain: sun sensor calibrates scanner, both give the reference attitude, that calibrates
the magnetometer. And is the night's larger residual of the nadir-field angle the scanner's?

A scanner with biases is flown. Its own calibration uses sun-nadir angles alone. What the biases do to the magnetometer's
S, before and after, shows why a second channel is needed: a constant error of the reference attitude and a misaligned
magnetometer are one and the same thing to a calibration that takes the attitude as right.

The papers do not say on which side the scanner looked, nor whether the Earth's flattening was taken out. So every kind is
tried: its horizon goes into the roll and pitch of the same telemetry, it is calibrated against the trusted sun-sensor heads
as it was in flight, the attitude is made anew, the magnetometer calibrated, and the 43 passes are compared. Two nulls: the
same errors with the season reversed, and moved along the orbit.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from fluxtwin.calib.attitude.horizon_scanner import ScannerCalibration, calibrate_scanner
from fluxtwin.gap.channels.sun_nadir import open_channel
from fluxtwin.scenarios.flights import Numbers
from fluxtwin.scenarios.hcmm import mission
from fluxtwin.scenarios.hcmm.calibration import choose_rows, fit_rows, pass_labels
from fluxtwin.scenarios.hcmm.mission import Flight
from fluxtwin.scenarios.hcmm.passes import column_of, rms_of, rows_of_passes, sun_nadir_deg
from fluxtwin.scenarios.hcmm.strength import rank_correlation
from fluxtwin.scenarios.hcmm_orbit.geometry import PassWindows
from fluxtwin.scenarios.hcmm_orbit.record import Pass, read_passes
from fluxtwin.scenarios.regression import papers_regression
from fluxtwin.sim.base.progress import Progress
from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.earth import frames, horizon
from fluxtwin.sim.earth.field import FieldModel
from fluxtwin.sim.spacecraft.sensors.horizon_scanner import ConicalScanner
from fluxtwin.sim.spacecraft.sensors.reference_attitude import attitude_from_sun_and_nadir
from fluxtwin.sim.telemetry.record import Telemetry

BIAS_DEG = (0.40, -0.30)
"""Roll and pitch bias put into the scanner; assumed, of the size of its requirement."""
TRUSTED_HEADS = (2, 3)
"""Heads that define the attitude reference (C, text)."""
SCANS, EARTHS = mission.CASES["scans"], mission.CASES["earth"]
"""By name, the sign of body y of each scan axis; and the Earth that is seen, and what it is taken for."""
CORRECTED, WORST = "infrared, flattening corrected", "infrared, taken for a sphere"
"""Two of EARTHS."""
SHIFTS_DEG = np.arange(0.0, 360.0, 30.0)
_HALF_A_YEAR = np.timedelta64(183, "D")


def run_scanner(days: Flight, last: Flight, ground: FieldModel, progress: Progress) -> Numbers:
    """Fly with biases too on the days of Table 3 (`days`), and the three days of Table 5 (`last`) for head 1."""
    progress("horizon scanner", 0.0)
    biases = {"horizon_scanner.roll_bias_deg": BIAS_DEG[0], "horizon_scanner.pitch_bias_deg": BIAS_DEG[1]}
    flight = mission.fly(days.scenario.updated(biases), days.world)
    found, repaired = calibrated(flight, pass_labels(flight))
    rows = choose_rows(flight, "AB")
    records = (flight.telemetry, repaired.telemetry, days.telemetry)
    tilts = [_tilt_deg(record.select(rows), ground, flight.truth.S) for record in records]
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
        channel=open_channel(last.telemetry).weigh(),
        turned_magnetometer=open_channel(right.telemetry).weigh(),
    )


def calibrated(flight: Flight, labels: np.ndarray) -> tuple[ScannerCalibration, Flight]:
    """The scanner calibrated by the trusted heads, and the flight with its reference attitude made anew."""
    found = calibrate_scanner(flight.telemetry, heads=TRUSTED_HEADS, passes=labels)
    record, world = found.apply(flight.telemetry), flight.world
    assert record.sun_B is not None and record.nadir_B is not None
    q_NB = attitude_from_sun_and_nadir(record.sun_B, record.nadir_B, world.sun_N, -world.r_N_km)
    return found, replace(flight, telemetry=record.replace(q_NB=q_NB))


def _tilt_deg(telemetry: Telemetry, ground: FieldModel, truth_S: FloatArray) -> float:
    """Size of the rotation by which the found I+S differs from the true one."""
    S = papers_regression(telemetry, ground).calibration.S
    between = (np.eye(3) + S) @ np.linalg.inv(np.eye(3) + truth_S)
    turn = 0.5 * (between - between.T)
    return float(np.degrees(np.linalg.norm([turn[2, 1], turn[0, 2], turn[1, 0]])))


def _head_1(flight: Flight, found: ScannerCalibration) -> tuple[float, float]:
    """Mean residual at dawn after the scanner's correction, and what the misalignment should give [deg]."""
    corrected = found.apply(flight.telemetry)
    assert corrected.nadir_B is not None and corrected.sun_sensor_head is not None
    rows = np.flatnonzero((corrected.sun_sensor_head == 1) & np.isfinite(corrected.nadir_B).all(axis=1))
    # A head turned by theta reports the sun turned by minus theta: what that does to the angle from nadir.
    theta = np.radians(flight.scenario.sun_sensor["1"].misalignment_deg)
    B, sun_N, nadir_N = (v[rows] for v in (flight.truth.q_NB, flight.world.sun_N, -flight.world.r_N_km))
    sun_B, nadir_B = (frames.rotation_from_q(B).apply(v) for v in (sun_N, nadir_N))
    expected = frames.angle_between(sun_B - np.cross(theta, sun_B), nadir_B) - frames.angle_between(sun_N, nadir_N)
    return float(sun_nadir_deg(corrected)[rows].mean()), float(np.degrees(expected.mean()))


def run_horizon(days: Flight, flight: Flight, ground: FieldModel, windows: PassWindows, progress: Progress) -> Numbers:
    """Every scanner on `days`, those of Table 3, and on `flight`, the three of Table 5."""
    rows, labels = choose_rows(days, "AB"), pass_labels(days)

    def left_by(one: Flight, other: Flight) -> Numbers:
        found, repaired = calibrated(one, labels)
        calibration = fit_rows(repaired, rows, ground, "white").calibration
        return _seen(rows_of_passes(found.apply(other.telemetry), calibration, ground, windows))

    def seen_by(scans: str, earth: str, shift_deg: float = 0.0) -> Numbers:
        progress(f"scanner: {scans}", list(SCANS).index(scans) / len(SCANS))
        return left_by(
            *(with_horizon(one, SCANS[scans], **EARTHS[earth], shift_deg=shift_deg) for one in (days, flight))
        )

    cases = {(scans, earth): seen_by(scans, earth) for scans in SCANS for earth in EARTHS}
    shifted = {
        scans: (cases[scans, WORST], *(seen_by(scans, WORST, float(shift)) for shift in SHIFTS_DEG[1:]))
        for scans in SCANS
    }
    printed = _seen(read_passes())
    worst = {scans: cases[scans, WORST] for scans in SCANS}
    return Numbers(
        # The papers' own rows, and the scanner of the study, whose horizon is without error.
        printed=printed,
        disc=left_by(days, flight),
        # By scans and Earth (names of SCANS and EARTHS).
        cases=cases,
        # The scans that come nearest to the printed ratio where the Earth is WORST, and what they leave.
        nearest=min(worst.items(), key=lambda item: abs(item[1].ratio - printed.ratio)),
        # WORST with its errors moved along the orbit by each of SHIFTS_DEG, by scans.
        moved={
            name: {scans: np.array([getattr(one, name) for one in seen]) for scans, seen in shifted.items()}
            for name in ("ratio", "correlation")
        },
        # The errors elsewhere on the orbit, all scans; without half an orbit, from where an ellipsoid looks the same.
        nulls=[seen[at] for seen in shifted.values() for at in np.flatnonzero(SHIFTS_DEG % 180.0)],
    )


def with_horizon(
    flight: Flight,
    axes: Sequence[int],
    seen: str,
    assumed: str,
    *,
    radiance: float = 1.0,
    reversed_season: bool = False,
    shift_deg: float = 0.0,
) -> Flight:
    """The flight with what the horizon does to roll and pitch added to the scanner's own errors.

    seen: the Earth that the scanner sees; assumed: what it is taken for; shift_deg: the errors are those of the place so
    far ahead on the orbit.
    """
    world, R_BN = flight.world, frames.rotation_from_q(flight.truth.q_NB)
    normal = np.cross(world.r_N_km, world.v_N_km_s)
    turn = Rotation.from_rotvec(np.radians(shift_deg) * normal / np.linalg.norm(normal, axis=1)[:, None])
    time = world.time + _HALF_A_YEAR if reversed_season else world.time
    found = ConicalScanner(tuple(axes)).nadir(
        turn.apply(world.r_N_km),
        horizon.north_N(world.time),
        R_BN * turn.inv(),
        world.R_ON * turn.inv(),
        horizon.surface(seen, time, radiance),
        horizon.surface(assumed, time),
    )
    down_B = R_BN.apply(-world.r_N_km / np.linalg.norm(world.r_N_km, axis=1)[:, None])
    nadir_B = np.array(flight.telemetry.nadir_B)
    angles = frames.roll_pitch(nadir_B) + frames.roll_pitch(found) - frames.roll_pitch(down_B)
    return replace(flight, telemetry=flight.telemetry.replace(nadir_B=frames.nadir_of(angles)))


def _seen(rows: Sequence[Numbers] | Sequence[Pass]) -> Numbers:
    """From rows of the study, or from those of print."""
    passes = read_passes()
    night, dawn = (np.array(v) for v in ([not p.sunlit for p in passes], [p.dawn for p in passes]))
    night_deg, day_deg = (rms_of(rows, "delta_nadir_field_deg", chosen) for chosen in (night, ~night))
    printed, ours = (column_of(one, "delta_nadir_field_deg")[night] for one in (passes, rows))
    return Numbers(
        # [deg, rms] Nadir-field residual of the passes without and with sun, and the one over the other.
        night=night_deg,
        day=day_deg,
        ratio=night_deg / day_deg,
        # Sunlit passes, without those at dawn.
        sun_nadir=rms_of(rows, "delta_sun_nadir_deg", ~night & ~dawn),
        # Rank correlation of the night passes' nadir-field residuals with those printed.
        correlation=rank_correlation(printed, ours),
    )
