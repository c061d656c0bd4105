"""Yaw by journal eqs. 12 to 14 against rotations built by scipy, with the journal's misprint as a mutant."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from fluxtwin.calib.attitude import yaw as yaw_of
from fluxtwin.calib.common.records import Calibration
from fluxtwin.sim.base.errors import NoAnswer
from fluxtwin.sim.earth import frames
from fluxtwin.sim.earth.field import field_N_nT, load_field
from fluxtwin.sim.earth.orbit import Orbit
from fluxtwin.sim.spacecraft.sensors.magnetometer import Magnetometer
from fluxtwin.sim.telemetry.record import Telemetry

pytestmark = pytest.mark.reference

RNG = np.random.default_rng(1979)
N = 400


def small_angles(size_rad: float) -> tuple[np.ndarray, ...]:
    """Yaw, roll, pitch."""
    return tuple(RNG.uniform(-size_rad, size_rad, size=(3, N)))


def test_the_full_solution_is_exact_for_large_angles() -> None:
    b0 = RNG.normal(size=(N, 3)) * 2e4
    yaw, roll, pitch = RNG.uniform(-3.1, 3.1, N), RNG.uniform(-1.0, 1.0, N), RNG.uniform(-1.0, 1.0, N)
    body = frames.rotation_BO(yaw, roll, pitch).apply(b0)
    found = yaw_of.yaw_full(body, b0, roll, pitch)
    assert np.abs(np.angle(np.exp(1j * (found - yaw)))).max() < 1e-11  # rounding over a small horizontal field


def test_equation_12_is_right_to_first_order() -> None:
    """The error falls with the square of the angles: 4 times for half the angle (analytic)."""
    b0 = RNG.normal(size=(N, 3)) * 1e4 + np.array([2e4, 1e4, 3e4])
    angles = np.array(small_angles(0.02))
    errors = []
    for share in (1.0, 0.5):
        yaw, roll, pitch = angles * share
        body = frames.rotation_BO(yaw, roll, pitch).apply(b0)
        errors.append(np.sqrt(np.mean((yaw_of.yaw_first_order(body, b0, roll, pitch) - yaw) ** 2)))
    assert errors[0] < 2e-3
    assert 3.5 < errors[0] / errors[1] < 4.5


def test_the_journals_misprint_is_wrong_to_first_order() -> None:
    """Eq. 12 as printed, with B2 for B3: halving the angles only halves its error."""
    b0 = RNG.normal(size=(N, 3)) * 1e4 + np.array([2e4, 1e4, 3e4])
    angles = np.array(small_angles(0.02))
    errors = []
    for share in (1.0, 0.5):
        yaw, roll, pitch = angles * share
        b = frames.rotation_BO(yaw, roll, pitch).apply(b0).T
        misprint = (b0[:, 1] * (b[0] + pitch * b[1]) - b0[:, 0] * (b[1] - roll * b[1])) / (b0[:, :2] ** 2).sum(axis=1)
        errors.append(np.sqrt(np.mean((misprint - yaw) ** 2)))
    assert errors[0] > 1e-2
    assert errors[0] / errors[1] < 2.2


def test_equation_12_is_the_pseudo_inverse_of_equation_13() -> None:
    """Least squares of B = B0 + y (B02, -B01, 0) + r, p terms, as the paper says it was obtained."""
    b0, body = RNG.normal(size=(N, 3)) * 2e4, RNG.normal(size=(N, 3)) * 2e4
    _, roll, pitch = small_angles(0.1)
    found = yaw_of.yaw_first_order(body, b0, roll, pitch)
    for k in range(0, N, 50):
        column = np.array([b0[k, 1], -b0[k, 0], 0.0])
        # rows of eq. 13 without yaw; B3 of the body stands for B03 in the products with r and p
        rest = body[k] - np.array([b0[k, 0] - pitch[k] * body[k, 2], b0[k, 1] + roll[k] * body[k, 2], b0[k, 2]])
        assert found[k] == pytest.approx(np.linalg.lstsq(column[:, None], rest, rcond=None)[0][0], abs=1e-12)


def test_equation_14_against_monte_carlo() -> None:
    """20,000 draws at three places; sigma of the sample sigma 0.5 %, band 2 %."""
    sigma_B, sigma_a = 370.0, np.radians(0.1)
    for b0 in ([23000.0, 0.0, 0.0], [15000.0, 5000.0, 30000.0], [2000.0, 1000.0, -45000.0]):
        field = np.tile(b0, (20_000, 1))
        body = field + RNG.normal(size=field.shape) * sigma_B
        roll, pitch = RNG.normal(size=(2, len(field))) * sigma_a
        spread = yaw_of.yaw_first_order(body, field, roll, pitch).std()
        predicted = yaw_of.yaw_sigma(field[:1], sigma_B, sigma_a)[0]
        # for the last place the errors are 0.1 rad and more, and eq. 12 stays linear in them
        assert spread == pytest.approx(predicted, rel=0.02)


def test_the_papers_number_at_the_equator(close: Any) -> None:
    """Claim 24: 3.7 mG over 230 mG is 0.92 deg."""
    sigma = np.degrees(yaw_of.yaw_sigma(np.array([[23000.0, 0.0, 0.0]]), 370.0, 0.0))
    close(sigma, 0.92, atol=0.005, unit="deg", because="printed to 0.01 deg")


def test_vertical_field_has_no_yaw() -> None:
    assert np.isinf(yaw_of.yaw_sigma(np.array([[0.0, 0.0, 4e4]]), 370.0, 0.0))[0]


def test_averages_over_fixed_intervals() -> None:
    """Analytic: means of a ramp, and an angle that crosses half a turn."""
    time = np.datetime64("2020-01-01T00:00:00", "ns") + np.array([0, 30, 60, 90, 130, 600]) * np.timedelta64(1, "s")
    average = yaw_of.average_yaw(time, np.array([0.0, 0.01, 0.02, 0.03, 0.1, 0.2]), 120.0)
    assert average.samples.tolist() == [4, 1, 1]
    assert np.allclose(average.yaw_rad, [0.015, 0.1, 0.2], rtol=0, atol=1e-6)
    assert average.time.tolist() == (time[0] + np.array([60, 180, 660]) * np.timedelta64(1, "s")).tolist()
    last = np.timedelta64(119, "s")
    assert yaw_of.average_yaw(time[0] + np.array([0, 1]) * last, np.zeros(2), 120.0).samples.tolist() == [2]
    around = yaw_of.average_yaw(time[:2], np.array([np.pi - 0.1, -np.pi + 0.1]), 120.0)
    assert abs(abs(around.yaw_rad[0]) - np.pi) < 1e-12


@pytest.fixture(scope="module")
def flight() -> tuple[Telemetry, Calibration, np.ndarray, Any]:
    """One orbit with librations; the record, the right calibration, the true yaw."""
    orbit = Orbit(
        epoch_utc=np.datetime64("1978-07-24", "ns"), altitude_km=789.9, inclination_rad=np.radians(108), raan_rad=1.0
    )
    time = np.datetime64("1978-07-24T01:00:00", "ns") + np.arange(200) * np.timedelta64(30, "s")
    r, v = orbit.propagate(time)
    yaw, roll, pitch = (np.radians(a) * np.sin(np.arange(200) / k) for a, k in ((2.0, 7.0), (0.5, 11.0), (0.4, 5.0)))
    R_BN = frames.rotation_BO(yaw, roll, pitch) * frames.rotation_ON(r, v)
    model = load_field("igrf14")
    S, b = np.diag([0.02, -0.01, 0.005]), np.array([7000.0, -3000.0, -6000.0])
    reading = Magnetometer(S, b).ideal_reading(R_BN.apply(field_N_nT(model, time, r)))
    record = Telemetry(time=time, mag_B_nT=reading, r_N_km=r, v_N_km_s=v, q_NB=frames.q_from_rotation(R_BN))
    return record, Calibration(S, b, sigma_nT=370.0), yaw, model


def test_yaw_of_a_record(flight: Any) -> None:
    record, calibration, yaw, model = flight
    found = yaw_of.yaw_from_field(record, calibration, model)
    assert np.abs(found.yaw_rad - yaw).max() < 1e-9
    assert np.abs(found.yaw_reference_rad - yaw).max() < 1e-9
    assert found.rms_error_rad() < 1e-9
    assert found.rms_error_rad(np.zeros(200)) == pytest.approx(np.sqrt((yaw**2).mean()), rel=1e-6)
    wrong = yaw_of.yaw_from_field(record, Calibration(calibration.S, -calibration.b_nT), model)
    assert wrong.rms_error_rad() > 0.05


def test_the_references_own_yaw_is_not_used(flight: Any) -> None:
    """The record's yaw turned by 10 deg, roll and pitch kept: the answer does not move."""
    record, calibration, yaw, model = flight
    R_ON = frames.rotation_ON(record.r_N_km, record.v_N_km_s)
    y, roll, pitch = frames.yaw_roll_pitch(frames.rotation_from_q(record.q_NB) * R_ON.inv())
    turned = frames.rotation_BO(y + np.radians(10.0), roll, pitch) * R_ON
    found = yaw_of.yaw_from_field(record.replace(q_NB=frames.q_from_rotation(turned)), calibration, model)
    assert np.abs(found.yaw_rad - yaw).max() < 1e-9
    assert np.degrees(found.rms_error_rad()) == pytest.approx(10.0, abs=1e-6)


def test_a_velocity_that_is_not_given_is_that_of_the_positions() -> None:
    two = Telemetry(
        np.array([0, 2], dtype="datetime64[s]"), np.zeros((2, 3)), r_N_km=np.array([[7e3, 0, 0], [7e3, 15, 1]])
    )
    assert np.array_equal(yaw_of.velocity_of(two), [[0.0, 7.5, 0.5]] * 2)


def test_roll_and_pitch_from_the_measured_nadir_where_attitude_is_missing(flight: Any) -> None:
    """In orbit night the horizon scanner alone gives roll and pitch; velocity from the positions."""
    record, calibration, yaw, model = flight
    nadir_N = -record.r_N_km / np.linalg.norm(record.r_N_km, axis=1)[:, None]
    nadir_B = frames.rotation_from_q(record.q_NB).apply(nadir_N)
    q = record.q_NB.copy()
    q[50:150] = np.nan
    night = record.replace(q_NB=q, nadir_B=nadir_B, v_N_km_s=None)
    found = yaw_of.yaw_from_field(night, calibration, model)
    assert len(found.time) == 200
    assert np.isnan(found.yaw_reference_rad[60])
    # a plane from neighbouring positions differs from the velocity's plane by the node's motion
    assert np.abs(np.degrees(found.yaw_rad - yaw)).max() < 0.1
    import json

    json.dumps(found.to_dict(), allow_nan=False)
    missing = yaw_of.yaw_from_field(record.replace(q_NB=q), calibration, model)
    assert missing.left_out == {"no roll and pitch": 100}
    with pytest.raises(NoAnswer, match="roll and pitch"):
        yaw_of.yaw_from_field(record.replace(q_NB=None), calibration, model)


def test_the_sigma_of_yaw_is_that_of_its_derivatives() -> None:
    """To first order: of the two horizontal components, and of roll and pitch, each by a small difference."""
    field, none, step = np.array([[2e4, 5e3, 3e4]]), np.zeros(1), 1e-6
    moved = [yaw_of.yaw_full(field + 3e4 * step * axis, field, none, none) / (3e4 * step) for axis in np.eye(3)]
    turned = [yaw_of.yaw_full(field, field, a, b) / step for a, b in ((none + step, none), (none, none + step))]
    sigma = np.sqrt(sum((20.0 * one) ** 2 for one in moved) + sum((0.002 * one) ** 2 for one in turned))
    assert yaw_of.yaw_sigma(field, 20.0, 0.002) == pytest.approx(sigma, rel=1e-4)
