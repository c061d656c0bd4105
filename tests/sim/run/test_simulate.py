"""Properties of a whole run: streams by name, one door for telemetry, every mode and part flies."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import xarray
from scipy.spatial.transform import Rotation
from worlds import PARTS, scenario_text

from fluxtwin.sim.base.errors import BadInput
from fluxtwin.sim.base.random_streams import stream
from fluxtwin.sim.earth import frames
from fluxtwin.sim.run.simulate import _differenced_rate, _true_motion, simulate
from fluxtwin.sim.run.world import orbit_from
from fluxtwin.sim.scenario.scenario import parse_scenario
from fluxtwin.sim.scenario.sections import OrbitSection
from fluxtwin.sim.telemetry.telemetry_files import read_telemetry, write_telemetry

pytestmark = pytest.mark.property

SECTIONS = """
[attitude]
yaw_rms_deg = 1.0
[attitude.reference]
sigma_deg = 0.1
tau_s = 120.0
[magnetometer]
S = [[0.01, 0.002, 0.0], [0.0, -0.01, 0.0], [0.001, 0.0, 0.02]]
b_nT = [1000.0, -500.0, 200.0]
noise_nT = 20.0
lsb_nT = 10.0
[magnetometer.unknown]
kind = "white"
rms_nT = 30.0
[magnetometer_2]
S = [[-0.01, 0.002, 0.003], [0.0, 0.02, 0.0], [0.005, 0.0, 0.01]]
b_nT = [-300.0, 200.0, 700.0]
noise_nT = 5.0
[sun_sensor.1]
azimuth_deg = 0.0
elevation_deg = 90.0
noise_deg = 0.1
[horizon_scanner]
noise_deg = 0.1
[gyro]
noise_deg_s = 0.01
"""
FULL = scenario_text(
    SECTIONS + PARTS,
    seed=5,
    inertia_kg_m2=[[10.0, 0.0, 0.0], [0.0, 12.0, 0.0], [0.0, 0.0, 15.0]],
    raan_deg=100.0,
    segment="duration_min = 97.0, step_s = 20.0",
)


@pytest.fixture(scope="module")
def scenario():
    return parse_scenario(FULL)


@pytest.fixture(scope="module")
def run(scenario):
    return simulate(scenario)


@pytest.mark.parametrize(
    ("switch", "kept"),
    [
        ({"magnetometer.noise_nT": 0.0}, ("mag2_B_nT", "q_NB", "sun_B", "nadir_B", "rate_B_rad_s", "dipole_B_Am2")),
        ({"attitude.reference.sigma_deg": 0.0}, ("mag_B_nT", "mag2_B_nT", "sun_B", "nadir_B", "rate_B_rad_s")),
        ({"gyro": None}, ("mag_B_nT", "mag2_B_nT", "q_NB", "sun_B", "nadir_B")),
        ({"magnetometer_2": None}, ("mag_B_nT", "q_NB", "sun_B", "nadir_B", "rate_B_rad_s", "dipole_B_Am2")),
        ({"magnetometer_2.noise_nT": 0.0}, ("mag_B_nT", "q_NB", "sun_B", "nadir_B", "rate_B_rad_s")),
        ({"magnetometer.unknown": None}, ("mag2_B_nT", "q_NB", "sun_B", "nadir_B", "rate_B_rad_s")),
        ({"torquers": None}, ("q_NB", "sun_B", "nadir_B", "rate_B_rad_s")),
        ({"sun_sensor.2": {"azimuth_deg": 90.0}}, ("mag_B_nT", "q_NB", "nadir_B", "rate_B_rad_s")),
    ],
)
def test_switching_a_source_moves_no_other_stream(scenario, run, switch, kept):
    """Random streams derive from (seed, source name), so everything else stays bit-identical."""
    other = simulate(scenario.updated(switch))[0]
    for name in kept:
        assert np.array_equal(getattr(run[0], name), getattr(other, name), equal_nan=True), name


def test_streams_differ_by_name_and_seed():
    draws = [stream(*key).random(4).tolist() for key in ((1, "a"), (1, "b"), (2, "a"))]
    assert len({tuple(d) for d in draws}) == 3
    assert stream(1, "a").random(4).tolist() == draws[0]


def test_equation_1_holds_along_the_whole_run(run, close):
    """Lerner & Shuster 1981, eq. 1: (I+S) B + b + T D is the field at the sensor, here with the unknown in it."""
    _, truth = run
    back = truth.ideal_B_nT @ (np.eye(3) + truth.S).T + truth.b_nT + truth.dipole_B_Am2 @ truth.T_nT_per_Am2.T
    wanted = truth.field_B_nT + truth.unknown_B_nT
    close(back, wanted, atol=1e-8, unit="nT", because="rounding of a 3x3 solve at 5e4 nT")
    transposed = truth.ideal_B_nT @ (np.eye(3) + truth.S) + truth.b_nT
    assert np.abs(transposed - wanted).max() > 10.0


def test_true_field_is_the_ambient_field_seen_from_the_body(run, close):
    telemetry, truth = run
    turned = frames.rotation_from_q(truth.q_NB).apply(truth.field_N_nT)
    close(turned, truth.field_B_nT, atol=1e-8, unit="nT", because="the same rotation")
    strength = np.linalg.norm(truth.field_N_nT, axis=1)
    # WMM/IGRF: 18,000 to 52,000 nT at 650 km, NOAA's published maps of total intensity scaled by (a/r)^3.
    assert 15000 < strength.min() < strength.max() < 55000
    assert len(telemetry) == len(truth.time)


def test_reported_attitude_has_the_stated_error(scenario):
    """2000 samples 30 time constants apart are independent: the rms of three axes is known to 1/sqrt(2*6000) = 0.9 %;
    5 % is 5.5 sigma."""
    far = scenario.updated(
        {
            "schedule.segments": [{"start_utc": "2020-03-01T00:00:00Z", "samples": 2000, "step_s": 3600.0}],
            "power": None,
            "thermal": None,
        }
    )
    telemetry, truth = simulate(far)
    error = frames.rotation_from_q(telemetry.q_NB) * frames.rotation_from_q(truth.q_NB).inv()
    rms_deg = np.degrees(np.sqrt(np.mean(error.as_rotvec() ** 2)))
    assert abs(rms_deg - 0.1) < 0.005


def test_telemetry_carries_no_truth(run, tmp_path):
    path = write_telemetry(run[0], tmp_path / "t.nc")
    content = path.read_bytes()
    for word in (b"unknown", b"truth", b"seed", b"rms_nT"):
        assert word not in content
    assert "unknown" not in " ".join([*run[0].provenance, *run[0].provenance.values()])


def test_truth_is_written_apart_and_whole(run, tmp_path):
    path = run[1].write(tmp_path / "truth.nc")
    with xarray.open_dataset(path, engine="h5netcdf") as opened:
        for item in dataclasses.fields(run[1]):
            if item.name != "time":
                assert np.array_equal(opened[item.name].values, getattr(run[1], item.name)), item.name


@pytest.mark.parametrize(
    "mode",
    [
        {"attitude": {"mode": "inertial_hold", "q_NB": [0.0, 0.0, 0.6, 0.8]}},
        {"attitude": {"mode": "tumble", "rate_deg_s": [0.2, -0.1, 0.3]}},
        {
            "attitude": {"mode": "spin", "spin_rate_rpm": 2.0, "nutation_deg": 1.0},
            "spacecraft.inertia_kg_m2": [[10.0, 0, 0], [0, 10.0, 0], [0, 0, 15.0]],
        },
        {"attitude": {"mode": "slews", "waypoints": [{"after_s": 0.0}, {"after_s": 900.0, "yaw_deg": 30.0}]}},
    ],
    ids=["inertial_hold", "tumble", "spin", "slews"],
)
def test_every_mode_flies_with_housekeeping(scenario, mode):
    """The attitude behind the warm-up of the housekeeping is the motion of the run itself: a battery column on a run
    split in two is the same as on the whole one, except for the state it starts from."""
    telemetry, _ = simulate(scenario.updated(mode))
    for name in ("array_current_A", "battery_current_A", "temperature_degC", "heater_on", "wheel_speed_rpm"):
        column = getattr(telemetry, name)
        assert column is not None
        assert np.isfinite(column).all(), name
    assert np.allclose(telemetry.wheel_speed_rpm, 2000.0)  # its bias: no momentum swings here
    half = [
        {"start_utc": "2020-03-01T00:00:00Z", "samples": 100, "step_s": 20.0},
        {"start_utc": "2020-03-01T00:33:20Z", "samples": 192, "step_s": 20.0},
    ]
    split, _ = simulate(scenario.updated({**mode, "schedule.segments": half}))
    assert np.allclose(split.array_current_A, telemetry.array_current_A, atol=1e-6, rtol=0)


def test_attitude_from_sensors_only_where_a_head_sees_the_sun(scenario):
    other = scenario.updated({"attitude.reference": {"source": "sensors"}})
    telemetry, truth = simulate(other)
    assert 0 < telemetry.has_attitude.mean() < 1
    assert not telemetry.has_attitude[telemetry.sun_sensor_head == 0].any()
    seen = telemetry.has_attitude
    error = frames.rotation_from_q(telemetry.q_NB[seen]) * frames.rotation_from_q(truth.q_NB[seen]).inv()
    # 0.1 deg noise on sun and nadir; the turn about nadir is worse where the sun is high (1/sin 3 deg at most).
    assert np.degrees(np.median(error.magnitude())) < 0.6


def test_replay_keeps_the_record_and_simulates_the_magnetometer(scenario, run, tmp_path, close):
    write_telemetry(run[0], tmp_path / "recorded.nc")
    text = "\n".join(
        [
            "seed = 8",
            "[spacecraft]",
            'name = "test"',
            "[replay]",
            'telemetry = "recorded.nc"',
            "[magnetometer]",
            "b_nT = [10.0, 20.0, 30.0]",
        ]
    )
    path = tmp_path / "replay.toml"
    path.write_text(text, encoding="utf-8")
    from fluxtwin.sim.scenario.scenario import load_scenario

    telemetry, truth = simulate(load_scenario(path))
    recorded = read_telemetry(tmp_path / "recorded.nc")
    assert np.array_equal(telemetry.q_NB, recorded.q_NB)
    assert np.array_equal(telemetry.temperature_degC, recorded.temperature_degC)
    assert np.array_equal(truth.dipole_B_Am2, recorded.dipole_B_Am2)
    corrected = telemetry.mag_B_nT + np.array([10.0, 20.0, 30.0])
    close(corrected, truth.field_B_nT, atol=1e-8, unit="nT", because="eq. 1 with b alone")
    write_telemetry(run[0].replace(v_N_km_s=None), tmp_path / "recorded.nc")
    known = telemetry.v_N_km_s[np.isin(telemetry.time, (found := simulate(load_scenario(path))[0]).time)]
    close(
        found.v_N_km_s, known, atol=1e-3, unit="km/s", because="a cubic spline through rows of 10 s, less at its ends"
    )
    lacking = run[0].replace(q_NB=None)
    write_telemetry(lacking, tmp_path / "recorded.nc")
    with pytest.raises(BadInput, match="q_NB"):
        simulate(load_scenario(path))
    write_telemetry(run[0].replace(q_NB=np.full_like(run[0].q_NB, np.nan)), tmp_path / "recorded.nc")
    with pytest.raises(BadInput, match="no row has position, velocity and attitude"):
        simulate(load_scenario(path))


def test_a_tumble_is_about_principal_axes():
    inertia = [[0.05, 0.001, 0.0], [0.001, 0.06, 0.0], [0.0, 0.0, 0.04]]
    text = scenario_text('[attitude]\nmode = "spin"\nspin_rate_rpm = 1.0\n', inertia_kg_m2=inertia)
    with pytest.raises(BadInput, match="the inertia tensor has products of inertia"):
        simulate(parse_scenario(text))


def test_the_elements_of_an_orbit_are_in_degrees() -> None:
    names = ("inclination", "raan", "argument_of_perigee", "argument_of_latitude")
    given = {f"{name}_deg": 10.0 * number for number, name in enumerate(names, start=1)}
    found = orbit_from(OrbitSection(epoch_utc="2020-03-01T00:00:00Z", altitude_km=600.0, **given))
    assert [getattr(found, f"{name}_rad") for name in names] == pytest.approx(np.arange(1, 5) * np.pi / 18.0)


def test_the_true_motion_of_a_recorded_one_is_off_by_the_stated_error(scenario):
    """White, of 0.1 deg an axis; the angle is sqrt(3) of that, known to 1 / sqrt(6 n)."""
    given = scenario.updated({"attitude.reference": {"sigma_deg": 0.1, "tau_s": 0.0}})
    telemetry, _ = simulate(given)
    off = frames.rotation_from_q(_true_motion(given, telemetry).q_NB) * frames.rotation_from_q(telemetry.q_NB).inv()
    rms = np.sqrt(np.mean(np.degrees(off.magnitude()) ** 2))
    assert rms == pytest.approx(0.1 * np.sqrt(3.0), rel=4.0 / np.sqrt(6.0 * len(telemetry)))


def test_a_motion_recorded_without_rates_turns_as_its_attitudes_do() -> None:
    """At a constant rate w of the body a vector at rest turns by exp(-[w] t) in its axes."""
    rate_rad_s, seconds = np.array([0.01, -0.02, 0.03]), np.array([0.0, 1.0, 3.0, 4.0])
    time = np.datetime64("2020-03-01T00:00:00", "ns") + (seconds * 1e9).astype("timedelta64[ns]")
    R_BN = Rotation.from_rotvec(-seconds[:, None] * rate_rad_s) * Rotation.from_rotvec([0.3, -0.2, 0.9])
    assert _differenced_rate(time, R_BN) == pytest.approx(np.tile(rate_rad_s, (4, 1)), rel=1e-9)


def test_readings_have_the_noise_that_is_stated() -> None:
    """20 nT over 18,000 readings: their rms is known to 0.53 %, here to four standard deviations."""
    text = scenario_text("[magnetometer]\nnoise_nT = NOISE\n", segment="samples = 6000, step_s = 1.0")
    noisy, plain = (simulate(parse_scenario(text.replace("NOISE", noise)))[0] for noise in ("20.0", "0.0"))
    rms_nT = np.sqrt(np.mean((np.asarray(noisy.mag_B_nT) - np.asarray(plain.mag_B_nT)) ** 2))
    assert rms_nT == pytest.approx(20.0, rel=4.0 * 0.0053)


def test_the_angles_of_a_waypoint_are_where_the_body_is_held(scenario, close):
    """Where yaw, roll and pitch are zero the body axes are the orbital ones; a pitch alone leaves y, a roll alone x."""
    points = [
        {"after_s": 0.0, "hold_s": 600.0, "roll_deg": 20.0},
        {"after_s": 1800.0, "hold_s": 600.0, "pitch_deg": 30.0},
    ]
    _, truth = simulate(scenario.updated({"attitude": {"mode": "slews", "waypoints": points}}))
    for row, roll, pitch in ((15, 20.0, 0.0), (105, 0.0, 30.0)):
        down_B = frames.rotation_from_q(truth.q_NB[[row]]).apply(-truth.r_N_km[[row]])
        size = np.linalg.norm(down_B)
        found = np.degrees(np.arcsin([down_B[0, 1] / size, -down_B[0, 0] / size]))
        close(found, [roll, pitch], atol=1e-6, unit="deg", because="rounding; the down of a sphere is the z axis of O")
