"""What a scenario says is what its telemetry has: sizes, signs and units, from the file of the user to the reading.

Each test takes the chain that `simulate` runs, not the parts it is made of; `benchmarks/mutants.py` breaks that chain in
thirty ways, and the tests nearest to each must notice. Sample sizes make statistical errors small: a standard deviation of
n numbers is known to 1/sqrt(2 n), and the tolerances are four of those.
"""

from __future__ import annotations

import erfa
import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from worlds import scenario_text

from fluxtwin.sim.earth import frames
from fluxtwin.sim.earth.field import field_N_nT, load_field
from fluxtwin.sim.run.simulate import simulate
from fluxtwin.sim.run.truth import Truth
from fluxtwin.sim.scenario.scenario import Scenario, parse_scenario
from fluxtwin.sim.telemetry.record import Telemetry

pytestmark = pytest.mark.property

ROWS = 9000
FOUR_SIGMA = 4.0 / np.sqrt(2.0 * 3.0 * ROWS)
"""Of the standard deviation of three components of so many rows: 1.7 %."""
SECTIONS = """
[attitude]
yaw_rms_deg = 3.0
roll_rms_deg = 2.0
pitch_rms_deg = 1.0
shortest_period_min = 12.0
[attitude.reference]
sigma_deg = 0.0
[magnetometer]
S = [[0.01, 0.002, -0.003], [0.004, -0.01, 0.006], [0.001, -0.005, 0.02]]
b_nT = [1000.0, -500.0, 200.0]
"""
PLAIN = scenario_text(SECTIONS, seed=11, name="chain", raan_deg=100.0, segment="duration_min = 1500.0, step_s = 10.0")
SHORT = {"schedule.segments": [{"start_utc": "2020-03-01T00:00:00Z", "duration_min": 100.0, "step_s": 10.0}]}


@pytest.fixture(scope="module")
def plain() -> Scenario:
    return parse_scenario(PLAIN, where="test")


def flown(scenario: Scenario, **changes: object) -> tuple[Telemetry, Truth]:
    return simulate(scenario.updated({name.replace("__", "."): value for name, value in changes.items()}))


@pytest.fixture(scope="module")
def perfect(plain: Scenario) -> tuple[Telemetry, Truth]:
    return flown(plain)


def test_the_noise_of_a_reading_is_the_scenarios(plain: Scenario, perfect: tuple[Telemetry, Truth]) -> None:
    """White noise of 20 nT on each axis, and nothing else."""
    noise = flown(plain, magnetometer__noise_nT=20.0)[0].mag_B_nT - perfect[0].mag_B_nT
    assert abs(noise.std() / 20.0 - 1.0) < FOUR_SIGMA
    assert abs(np.corrcoef(noise[1:, 0], noise[:-1, 0])[0, 1]) < 4.0 / np.sqrt(ROWS)
    assert np.abs(np.corrcoef(noise.T) - np.eye(3)).max() < 4.0 / np.sqrt(ROWS)


def test_the_unknown_field_has_the_size_that_was_given(plain: Scenario, perfect: tuple[Telemetry, Truth]) -> None:
    unknown = {"kind": "white", "rms_nT": 260.0}
    extra = flown(plain, magnetometer__unknown=unknown)[0].mag_B_nT - perfect[0].mag_B_nT
    assert abs(extra.std() / 260.0 - 1.0) < FOUR_SIGMA + 0.015  # (I + S)^-1 changes a size by 1.5 % at most


def test_readings_are_rounded_to_the_nearest_step(plain: Scenario, perfect: tuple[Telemetry, Truth]) -> None:
    """Nearest, so that no mean error stays: a floor would leave half a step."""
    rounded = flown(plain, magnetometer__lsb_nT=100.0)[0].mag_B_nT
    assert np.abs(rounded / 100.0 - np.rint(rounded / 100.0)).max() < 1e-9
    error = rounded - perfect[0].mag_B_nT
    assert np.abs(error).max() <= 50.0 + 1e-6
    assert abs(error.mean()) < 2.0
    assert abs(error.std() / (100.0 / np.sqrt(12.0)) - 1.0) < 0.03


def test_the_reading_solves_equation_1_with_the_scenarios_numbers(perfect: tuple[Telemetry, Truth]) -> None:
    """(I + S) B + b = A B0, in the field of IGRF-14 at the reported place, turned by the reported attitude."""
    record, _ = perfect
    assert record.r_N_km is not None and record.q_NB is not None
    S = np.array([[0.01, 0.002, -0.003], [0.004, -0.01, 0.006], [0.001, -0.005, 0.02]])
    field = field_N_nT(load_field("igrf14"), record.time, record.r_N_km)
    seen = Rotation.from_quat(record.q_NB).apply(field, inverse=True)  # textbook: body to GCRS
    back = record.mag_B_nT @ (np.eye(3) + S).T + np.array([1000.0, -500.0, 200.0])
    np.testing.assert_allclose(back, seen, atol=1e-3)


def test_angles_of_the_motion_are_degrees_in_the_scenario(perfect: tuple[Telemetry, Truth]) -> None:
    """rms of 3, 2 and 1 deg over some 120 of the shortest periods: to a fifth."""
    truth = perfect[1]
    for angle, wanted in ((truth.yaw_rad, 3.0), (truth.roll_rad, 2.0), (truth.pitch_rad, 1.0)):
        assert abs(np.degrees(np.sqrt(np.mean(angle**2))) / wanted - 1.0) < 0.2


def test_the_frame_of_the_attitude_is_the_orbital_one(perfect: tuple[Telemetry, Truth]) -> None:
    """Yaw about nadir, roll about the velocity, pitch about the negative orbit normal, as vector algebra has them."""
    record, truth = perfect
    assert record.r_N_km is not None and record.v_N_km_s is not None and record.q_NB is not None
    down = -record.r_N_km / np.linalg.norm(record.r_N_km, axis=1)[:, None]
    left = -np.cross(record.r_N_km, record.v_N_km_s)
    left /= np.linalg.norm(left, axis=1)[:, None]
    axes = np.stack([np.cross(left, down), left, down], axis=1)  # rows: x, y, z of the orbital frame in GCRS
    turn = Rotation.from_quat(record.q_NB).inv() * Rotation.from_matrix(axes).inv()  # orbital to body
    vector = turn.as_rotvec()  # small angles: minus the rotation of the axes; second order 0.1 deg
    for axis, angle in ((0, truth.roll_rad), (1, truth.pitch_rad), (2, truth.yaw_rad)):
        np.testing.assert_allclose(-vector[:, axis], angle, atol=np.radians(0.6))


def test_stamps_and_the_turning_earth(perfect: tuple[Telemetry, Truth]) -> None:
    """One second turns the Earth by 15 arc seconds: ERFA's angle is met to a hundredth of that."""
    record, _ = perfect
    seconds = (record.time[:500] - np.datetime64("2000-01-01T12:00:00", "ns")).astype("int64") * 1e-9
    days = seconds / 86400.0
    ours = frames.rotation_EN(record.time[:500]).apply(np.array([1.0, 0.0, 0.0]))
    longitude = -np.degrees(np.arctan2(ours[:, 1], ours[:, 0]))
    era = np.degrees(erfa.era00(2451545.0, days))
    off = (longitude - era + 180.0) % 360.0 - 180.0
    assert np.abs(off - off.mean()).max() * 3600.0 < 0.15  # the mean holds precession, 0.26 deg in right ascension
    assert abs(off.mean()) < 0.3


def test_the_coupling_of_torquers_has_the_sign_of_the_dipole_law(plain: Scenario) -> None:
    """A dipole of 50 A m2 along z, two metres away along z: 2 mu0 m / (4 pi r^3) = 1250 nT along +z in the reading."""
    torquers = {
        "dipole_Am2": 50.0,
        "activity": "constant",
        "positions_m": [[9e3, 0.0, 0.0], [0.0, 9e3, 0.0], [0.0, 0.0, 2.0]],
    }
    changes = {"torquers": torquers, "magnetometer.S": np.zeros((3, 3)).tolist(), **SHORT}
    with_it, without = simulate(plain.updated(changes))[0], simulate(plain.updated({**changes, "torquers": None}))[0]
    np.testing.assert_allclose(
        with_it.mag_B_nT - without.mag_B_nT, np.tile([0.0, 0.0, 1250.0], (len(without), 1)), atol=0.1
    )


def test_the_error_of_the_reference_is_degrees_an_axis_with_its_memory(
    plain: Scenario, perfect: tuple[Telemetry, Truth]
) -> None:
    record, _ = flown(plain, attitude__reference={"sigma_deg": 0.5, "tau_s": 100.0})
    assert record.q_NB is not None and perfect[0].q_NB is not None
    error = np.degrees((Rotation.from_quat(record.q_NB).inv() * Rotation.from_quat(perfect[0].q_NB)).as_rotvec())
    assert abs(error.std() / 0.5 - 1.0) < 4.0 / np.sqrt(2.0 * 3.0 * ROWS / 10.0)  # 10 rows in a memory
    memory = np.mean(error[1:] * error[:-1]) / error.var()
    assert abs(memory - np.exp(-0.1)) < 0.02


def test_noises_of_the_other_sensors_are_degrees(plain: Scenario) -> None:
    """Sun sensor, horizon scanner and gyro, each against the same flight without its noise."""
    sensors = {
        "sun_sensor.1": {"azimuth_deg": 0.0, "elevation_deg": 90.0, "half_fov_deg": 80.0},
        "horizon_scanner": {},
        "gyro": {},
    }
    noisy = {
        "sun_sensor.1": {**sensors["sun_sensor.1"], "noise_deg": 0.3},
        "horizon_scanner": {"noise_deg": 0.2},
        "gyro": {"noise_deg_s": 0.01},
    }
    quiet, loud = simulate(plain.updated(sensors))[0], simulate(plain.updated(noisy))[0]
    assert quiet.sun_B is not None and loud.sun_B is not None
    seen = np.isfinite(quiet.sun_B).all(axis=1) & np.isfinite(loud.sun_B).all(axis=1)
    between = np.degrees(np.linalg.norm(loud.sun_B[seen] - quiet.sun_B[seen], axis=1))
    assert (
        0.25 < np.sqrt(np.mean(between**2)) / np.sqrt(2.0) < 0.45
    )  # two angles of a head, foreshortened towards its edge
    assert quiet.nadir_B is not None and loud.nadir_B is not None
    nadir = np.degrees(np.linalg.norm(loud.nadir_B - quiet.nadir_B, axis=1))
    assert abs(np.sqrt(np.mean(nadir**2)) / np.sqrt(2.0) / 0.2 - 1.0) < 0.05
    assert quiet.rate_B_rad_s is not None and loud.rate_B_rad_s is not None
    rate = np.degrees(loud.rate_B_rad_s - quiet.rate_B_rad_s)
    assert abs(rate.std() / 0.01 - 1.0) < FOUR_SIGMA
    turn = np.degrees(np.linalg.norm(quiet.rate_B_rad_s, axis=1))
    assert abs(np.median(turn) - 360.0 / 5860.0) < 0.02  # once an orbit of 97.7 min, in deg/s


def test_a_misalignment_of_a_head_is_degrees(plain: Scenario) -> None:
    head = {"azimuth_deg": 0.0, "elevation_deg": 90.0, "half_fov_deg": 80.0}
    right = simulate(plain.updated({"sun_sensor.1": head, **SHORT}))[0].sun_B
    turned = simulate(plain.updated({"sun_sensor.1": {**head, "misalignment_deg": [0.0, 0.0, 2.0]}, **SHORT}))[0].sun_B
    assert right is not None and turned is not None
    seen = np.isfinite(right).all(axis=1) & np.isfinite(turned).all(axis=1)
    between = np.degrees(np.arctan2(np.linalg.norm(np.cross(right, turned), axis=1), np.sum(right * turned, axis=1)))[
        seen
    ]
    assert 0.5 < between.max() <= 2.0 + 1e-6
