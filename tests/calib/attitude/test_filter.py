"""The filter of attitude: its start against scipy, its sigmas against truth by day and by night, and what must fail."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import fluxtwin
from fluxtwin.calib.attitude.filter import FilterRows, Noises, assemble_rows, fixes, learned, q_method, run, starts
from fluxtwin.calib.attitude.three_axis import consistency
from fluxtwin.calib.common.records import Calibration
from fluxtwin.sim.attitude.gauss_markov import gauss_markov
from fluxtwin.sim.base.errors import BadInput, NoAnswer
from fluxtwin.sim.earth import frames
from fluxtwin.sim.earth.field import field_N_nT, load_field
from fluxtwin.sim.earth.orbit import Orbit
from fluxtwin.sim.earth.sun import illumination, sun_direction_N, sun_N_km
from fluxtwin.sim.run.simulate import simulate
from fluxtwin.sim.scenario.scenario import Scenario, parse_scenario

pytestmark = pytest.mark.closure

STEP_S, COUNT, SUBSTEPS = 10.0, 700, 5
NOISES = Noises(
    walk_x_rad_s=2e-6,
    walk_y_rad_s=1e-6,
    walk_z_rad_s=3e-6,
    field_nT=40.0,
    slow_nT=60.0,
    slow_s=400.0,
    sun_rad=1.5e-3,
    white_rad=5e-4,
    drift_rad=1.5e-3,
    drift_s=100.0,
)
S = np.array([[0.02, -0.01, 0.004], [0.013, -0.02, -0.004], [0.007, -0.003, 0.01]])
B_NT = np.array([1500.0, -800.0, 300.0])
P = np.concatenate([S.ravel(), B_NT])
NOTHING = np.zeros((0, 0))
SCENARIO = """seed = 4
[spacecraft]
name = "night"
[orbit]
epoch_utc = "2026-03-01T00:00:00Z"
altitude_km = 620.0
inclination_deg = 97.6
raan_deg = 0.0
argument_of_latitude_deg = 0.0
[attitude]
mode = "earth_pointing"
yaw_rms_deg = 0.6
roll_rms_deg = 0.2
pitch_rms_deg = 0.2
[magnetometer]
S = [[0.02, -0.01, 0.004], [0.013, -0.02, -0.004], [0.007, -0.003, 0.01]]
b_nT = [1500.0, -800.0, 300.0]
noise_nT = 50.0
[sun_sensor.1]
azimuth_deg = 0.0
elevation_deg = 40.0
noise_deg = 0.1
[sun_sensor.2]
azimuth_deg = 180.0
elevation_deg = 40.0
noise_deg = 0.1
[horizon_scanner]
noise_deg = 0.1
tau_s = 60.0
[schedule]
segments = [{ start_utc = "2026-03-01T00:00:00Z", duration_min = 100.0, step_s = 20.0 }]
"""
"""Rows of 20 s: the scanner's errors last 60 s, so rows of 10 s would say little more of them, and cost twice."""


@pytest.fixture(scope="module")
def orbit() -> dict[str, np.ndarray]:
    """Field, nadir and sun of one orbit with an eclipse in its middle."""
    time = np.datetime64("2026-03-01", "ns") + np.arange(COUNT) * np.timedelta64(int(STEP_S * 1e9), "ns")
    r, v = Orbit(epoch_utc=time[0], altitude_km=620.0, inclination_rad=np.radians(97.6), raan_rad=0.0).propagate(time)
    return {
        "time": time,
        "r": r,
        "field_N": field_N_nT(load_field("igrf14"), time, r),
        "sun_N": sun_direction_N(time, r),
        "lit": illumination(r, sun_N_km(time)),
        "first": frames.rotation_ON(r[:1], v[:1]).as_matrix()[0],
    }


def world(orbit: dict[str, np.ndarray], seed: int) -> tuple[FilterRows, np.ndarray]:
    """Rows whose errors are those of NOISES, and the true attitude (N, 3, 3)."""
    rng, n, time = np.random.default_rng(seed), NOISES, orbit["time"]
    h = STEP_S / SUBSTEPS
    kicks = np.array(n[:3]) * np.sqrt(h) * rng.normal(size=((COUNT - 1) * SUBSTEPS, 3))
    w = np.cumsum([[0.0, -1.08e-3, 0.0], *kicks[:-1]], axis=0)
    A = [orbit["first"]]
    for turn in Rotation.from_rotvec(-w * h).as_matrix():
        A.append(turn @ A[-1])
    truth = np.array(A[::SUBSTEPS])

    def seen(v_N: np.ndarray, turn: np.ndarray) -> np.ndarray:
        return Rotation.from_rotvec(turn).apply(np.einsum("kij,kj->ki", truth, v_N))

    slow = gauss_markov(time, n.slow_nT, n.slow_s, rng, columns=3)
    field_B = np.einsum("kij,kj->ki", truth, orbit["field_N"]) + slow
    drift = gauss_markov(time, n.drift_rad, n.drift_s, rng, columns=3) + n.white_rad * rng.normal(size=(COUNT, 3))
    nadir_N = -orbit["r"] / np.linalg.norm(orbit["r"], axis=1)[:, None]
    sun_B = seen(orbit["sun_N"], n.sun_rad * rng.normal(size=(COUNT, 3)))
    sun_B[orbit["lit"] < 0.5] = np.nan
    reading = (field_B - B_NT) @ np.linalg.inv(np.eye(3) + S).T + n.field_nT * rng.normal(size=(COUNT, 3))
    rows = FilterRows(
        time=time,
        t_s=STEP_S * np.arange(COUNT),
        reading_nT=reading,
        coupling_nT=np.zeros((COUNT, 3)),
        field_N_nT=orbit["field_N"],
        nadir_B=seen(nadir_N, drift),
        nadir_N=nadir_N,
        sun_B=sun_B,
        sun_N=orbit["sun_N"],
        R_BN=np.full((COUNT, 3, 3), np.nan),
        rows=np.arange(COUNT),
        left_out={},
    )
    return rows, truth


def errors(A: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """(N, 3) turn from the estimate to the truth about body axes [rad]."""
    return -(Rotation.from_matrix(truth) * Rotation.from_matrix(A).inv()).as_rotvec()


def test_field_and_nadir_of_one_row_fix_its_attitude(orbit: dict[str, np.ndarray], close: Callable[..., None]) -> None:
    """Without errors; the readings have b, and an S that is not symmetric."""
    rows, truth = world(orbit, 3)
    field_B, nadir_B = (np.einsum("kij,kj->ki", truth, v) for v in (rows.field_N_nT, rows.nadir_N))
    rows = replace(rows, reading_nT=(field_B - B_NT) @ np.linalg.inv(np.eye(3) + S).T, nadir_B=nadir_B)
    found, covariance = fixes(replace(rows, sun_B=np.full_like(nadir_B, np.nan)), P)
    assert np.isfinite(covariance).all()
    close(errors(found.as_matrix(), truth), 0.0, atol=1e-7, unit="rad", because="two exact directions")


def test_the_q_method_is_the_weighted_solution_of_wahba(close: Callable[..., None]) -> None:
    rng = np.random.default_rng(1)
    truth, sigma = Rotation.random(30, random_state=2), np.array([0.01, 0.002, 0.05])
    known = rng.normal(size=(30, 3, 3))
    seen = np.stack([truth[k].apply(known[k]) for k in range(30)]) * rng.uniform(0.5, 2.0, (30, 3, 1))
    seen += 0.01 * np.linalg.norm(seen, axis=2)[:, :, None] * rng.normal(size=seen.shape)
    found, _ = q_method(seen, known, sigma)
    for k in range(30):
        unit = [v / np.linalg.norm(v, axis=1)[:, None] for v in (seen[k], known[k])]
        witness, _ = Rotation.align_vectors(*unit, weights=sigma**-2)
        close((found[k] * witness.inv()).magnitude(), 0.0, atol=1e-7, unit="rad", because="the same sum of squares")
    one = seen.copy()
    one[:, 1:] = np.nan
    assert np.isinf(q_method(one, known, sigma)[1]).all(), "one direction leaves a turn about itself"
    pairs = np.stack(
        [
            Rotation.from_rotvec(sigma[:, None] * rng.normal(size=(3, 3))).apply(truth[0].apply(known[0]))
            for _ in range(4000)
        ]
    )
    drawn = (q_method(pairs, np.broadcast_to(known[0], pairs.shape), sigma)[0] * truth[0].inv()).as_rotvec()
    ratio = np.diag(drawn.T @ drawn) / len(drawn) / np.diag(q_method(seen[:1], known[:1], sigma)[1][0])
    close(ratio, 1.0, atol=0.12, unit="1", because="4000 draws: five sigma; the weights' directions are noisy by 1 %")


def test_sigmas_hold_by_day_and_by_night(orbit: dict[str, np.ndarray]) -> None:
    """Forty worlds as the filter takes them. The mean NEES of 3 components then lies in 0.8 to 1.25 with wide margin."""
    night = orbit["lit"] < 0.5
    nees, beyond, sizes = [], [], []
    for seed in range(40):
        rows, truth = world(orbit, seed)
        done = run(rows, starts(rows, P), NOISES, P, NOTHING)
        known = np.isfinite(done.A[:, 0, 0])
        theta, C = errors(done.A[known], truth[known]), done.covariance[known]
        nees.append(np.einsum("ki,kij,kj->k", theta, np.linalg.inv(C), theta) / 3.0)
        sizes.append(np.sqrt(np.einsum("kii->ki", C)))
        beyond.append(np.abs(theta)[night[known]] > 3.0 * sizes[-1][night[known]])
    by_night = night[known]
    assert 0.8 < np.mean(nees) < 1.25
    assert 0.8 < np.mean(np.array(nees)[:, by_night]) < 1.25
    assert np.mean(beyond) < 0.01
    mean = np.sqrt((np.array(sizes) ** 2).mean(axis=0))
    assert mean[by_night, 2].mean() > 1.5 * mean[~by_night, 2].mean(), "without the sun yaw is known less well"


def test_the_noise_is_found_and_a_wrong_world_is_seen(orbit: dict[str, np.ndarray]) -> None:
    rows, _ = world(orbit, 50)
    begun = starts(rows, P)
    taken = learned(rows, begun, {}, P, NOTHING)
    assert taken.settled and not taken.at_bound
    found = taken.noises
    for name, factor in (
        ("field_nT", 1.2),
        ("sun_rad", 1.2),
        ("drift_rad", 1.6),
        ("walk_x_rad_s", 2.0),
        ("walk_z_rad_s", 2.0),
    ):
        ratio = getattr(found, name) / getattr(NOISES, name)
        assert 1.0 / factor < ratio < factor, name
    assert consistency(run(rows, begun, found, P, NOTHING))[2] == ()
    for wrong in ({"field_nT": 80.0, "slow_nT": 120.0}, {"field_nT": 20.0, "slow_nT": 30.0}, {"sun_rad": 4e-4}):
        assert consistency(run(rows, begun, NOISES._replace(**wrong), P, NOTHING))[2], wrong


def test_a_wild_reference_attitude_is_marked_as_one(orbit: dict[str, np.ndarray]) -> None:
    """Five degrees off in one row, where nothing else but the field is measured: of the sun nothing is said."""
    rows, truth = world(orbit, 51)
    seen = truth.copy()
    seen[300] = Rotation.from_rotvec([0.0, np.radians(5.0), 0.0]).as_matrix() @ truth[300]
    none = np.full((COUNT, 3), np.nan)
    rows = replace(rows, nadir_B=none, sun_B=none, R_BN=seen)
    inflated = run(rows, starts(rows, P), NOISES, P, NOTHING).inflated
    assert np.flatnonzero(inflated[:, 1] == 1.0).tolist() == [300]
    assert np.isnan(inflated[:, 2]).all()


def with_rows_every(step_s: float) -> Scenario:
    segment = {"start_utc": "2026-03-01T00:00:00Z", "duration_min": 100.0, "step_s": step_s}
    return parse_scenario(SCENARIO, where="test").updated({"schedule.segments": [segment]})


@pytest.fixture(scope="module")
def flown() -> tuple[Any, Any]:
    """Telemetry and truth of a scenario."""
    return simulate(parse_scenario(SCENARIO, where="test"))


def test_the_verb_follows_through_the_night_and_wild_readings_do_not_move_it(flown: tuple[Any, Any]) -> None:
    telemetry, truth = flown
    known = Calibration(truth.S, truth.b_nT)
    mag = np.array(telemetry.mag_B_nT)
    wild = np.arange(40, len(mag), 60)
    mag[wild] += 5000.0
    found = fluxtwin.attitude(telemetry.replace(mag_B_nT=mag), known)
    assert found.level == "good", (*found.reasons, *found.limits)
    assert found.inflated[np.isin(found.rows, wild)].all()
    theta = errors(
        frames.rotation_from_q(found.q_NB).as_matrix(), frames.rotation_from_q(truth.q_NB[found.rows]).as_matrix()
    )
    assert (np.abs(theta) < 3.0 * found.sigma_rad).mean() > 0.98
    angles = np.stack([truth.yaw_rad, truth.roll_rad, truth.pitch_rad], axis=1)[found.rows]
    assert np.degrees(np.abs(found.yaw_roll_pitch_rad - angles)).max() < 1.5
    assert not found.aided.all() and found.aided.any()
    day, night = (np.array(found.expected_deg(aided)) for aided in (True, False))
    assert (night > day).all()
    assert found.to_dict()["q_w"][0] == found.q_NB[0, 3]


def test_without_S_the_night_is_worse_and_the_sigma_says_so() -> None:
    telemetry, truth = simulate(with_rows_every(10.0))
    yaw = {}
    for name, known in (
        ("full", Calibration(truth.S, truth.b_nT)),
        ("bias", Calibration(np.zeros((3, 3)), truth.b_nT)),
    ):
        found = fluxtwin.attitude(telemetry, known)
        night = ~found.aided
        yaw[name] = np.degrees(found.yaw_roll_pitch_rad[:, 0] - truth.yaw_rad[found.rows])[night].std()
        yaw[f"{name} sigma"] = found.expected_deg(False)[2]
    assert yaw["bias"] > 2.0 * yaw["full"]
    assert yaw["bias sigma"] > 2.0 * yaw["full sigma"]


def test_a_calibration_that_is_little_known_widens_the_sigma(flown: tuple[Any, Any]) -> None:
    telemetry, truth = flown
    sizes = []
    for sigma in (0.0, 0.01):
        covariance = np.diag(np.repeat([sigma**2, (3e4 * sigma) ** 2], [9, 3]))
        found = fluxtwin.attitude(telemetry, Calibration(truth.S, truth.b_nT, covariance=covariance))
        sizes.append(found.expected_deg(False)[2])
    assert sizes[1] > 1.2 * sizes[0]


def test_what_cannot_be_started_or_is_no_size_is_refused(flown: tuple[Any, Any]) -> None:
    telemetry, truth = flown
    known = Calibration(truth.S, truth.b_nT)
    bare = telemetry.replace(q_NB=None, nadir_B=None, sun_B=None)
    with pytest.raises(NoAnswer, match="the filter cannot start"):
        fluxtwin.attitude(bare, known)
    with pytest.raises(BadInput, match="noise_nT"):
        fluxtwin.attitude(telemetry, known, noise_nT=-1.0)
    with pytest.raises(BadInput, match="attitude_tau_s"):
        fluxtwin.attitude(telemetry, known, attitude_tau_s=10.0)
    with pytest.raises(BadInput, match="finite"):
        fluxtwin.attitude(telemetry, known, attitude_sigma_deg=0.1, attitude_tau_s=float("inf"))
    with pytest.raises(BadInput, match="below 90"):
        fluxtwin.attitude(telemetry, known, attitude_sigma_deg=720.0)
    with pytest.raises(BadInput, match="not corrected"):
        fluxtwin.attitude(telemetry)
    with pytest.raises(NoAnswer, match="no position"):
        assemble_rows(telemetry.replace(r_N_km=None, v_N_km_s=None), load_field("igrf14"))


def turned(known: Calibration, axis: str, degrees: float) -> Calibration:
    """As if the magnetometer sat turned."""
    R = Rotation.from_euler(axis, degrees, degrees=True).as_matrix()
    return Calibration(R @ (np.eye(3) + known.S) - np.eye(3), R @ known.b_nT)


@pytest.mark.parametrize("wrong", ["S of the wrong sign", "mounting", "clock", "sun sensor"])
def test_a_wrong_world_whose_sizes_are_found_is_not_called_good(flown: tuple[Any, Any], wrong: str) -> None:
    telemetry, truth = flown
    known = Calibration(truth.S, truth.b_nT)
    if wrong == "S of the wrong sign":
        known = Calibration(-truth.S, truth.b_nT)
    elif wrong == "mounting":
        known = turned(known, "z", 5.0)
    elif wrong == "clock":
        telemetry = telemetry.replace(time=telemetry.time + np.timedelta64(3600, "s"))
    else:
        sun = np.array(telemetry.sun_B)
        seen = np.isfinite(sun[:, 0])
        sun[seen] = Rotation.from_euler("z", 1.0, degrees=True).apply(sun[seen])
        telemetry = telemetry.replace(sun_B=sun)
    found = fluxtwin.attitude(telemetry, known)
    assert found.level != "good"
    assert any("the field is off by" in text for text in found.limits), found.limits


def test_a_calibration_blind_to_rotation_is_never_called_good(flown: tuple[Any, Any]) -> None:
    telemetry, _ = flown
    known = fluxtwin.calibrate(telemetry, method="scalar").calibration
    assert any("without attitude" in text for text in fluxtwin.attitude(telemetry, known, force=True).limits)


def test_few_rows_show_no_sizes_and_are_refused(flown: tuple[Any, Any]) -> None:
    telemetry, truth = flown
    with pytest.raises(NoAnswer, match="2 rows are too few"):
        fluxtwin.attitude(telemetry.select(np.arange(2)), Calibration(truth.S, truth.b_nT))


@pytest.mark.parametrize("wild", [np.array([20000.0, 0.0, 0.0]), None])
def test_a_wild_first_reading_starts_nothing(flown: tuple[Any, Any], wild: np.ndarray | None) -> None:
    telemetry, truth = flown
    mag = np.array(telemetry.mag_B_nT)
    mag[0] = -mag[0] if wild is None else mag[0] + wild
    record = telemetry.replace(mag_B_nT=mag, sun_B=None, q_NB=None)
    found = fluxtwin.attitude(record, Calibration(truth.S, truth.b_nT))
    assert found.rows[0] == 1
    theta = frames.rotation_from_q(found.q_NB) * frames.rotation_from_q(truth.q_NB[found.rows]).inv()
    assert np.degrees(theta.magnitude()).max() < 5.0


def test_sun_and_field_are_enough_and_one_row_of_a_source_replaces_no_other(flown: tuple[Any, Any]) -> None:
    telemetry, _ = flown
    model = load_field("igrf14")
    assert assemble_rows(telemetry.replace(nadir_B=None, q_NB=None), model).source == "sun"
    q, sun = np.array(telemetry.q_NB), np.full((len(telemetry), 3), np.nan)
    seen = int(np.flatnonzero(np.isfinite(telemetry.sun_B[:, 0]))[3])
    sun[seen] = telemetry.sun_B[seen]
    assert assemble_rows(telemetry.replace(sun_B=sun), model).source == "reference attitude"
    q[np.arange(len(q)) != 9] = np.nan
    stray = assemble_rows(telemetry.replace(sun_B=None, q_NB=q), model)
    assert (stray.source, stray.set_aside) == ("nadir", "reference attitude")


def nees(found: Any, truth: Any) -> float:
    """Mean squared error over what was predicted, a component; 1 is right."""
    turn = frames.rotation_from_q(found.q_NB) * frames.rotation_from_q(truth.q_NB[found.rows]).inv()
    theta = turn.as_rotvec()
    return float(np.einsum("ki,kij,kj->k", theta, np.linalg.inv(found.covariance), theta).mean() / 3.0)


@pytest.mark.parametrize(
    ("changes", "name", "size"),
    [
        ({"sun_sensor.1.noise_deg": 1.0, "sun_sensor.2.noise_deg": 1.0}, "sun_rad", np.radians(1.0)),
        ({"horizon_scanner.noise_deg": 1.0}, "drift_rad", np.radians(1.0)),
        ({"magnetometer.noise_nT": 1000.0}, "field_nT", 1000.0),
    ],
)
def test_coarse_sensors_are_found_to_be_coarse(changes: dict[str, float], name: str, size: float) -> None:
    """301 rows; the scanner's errors last three of them, so about a hundred independent ones of two components: 7 %."""
    telemetry, truth = simulate(parse_scenario(SCENARIO, where="test").updated(changes))
    found = fluxtwin.attitude(telemetry, Calibration(truth.S, truth.b_nT))
    assert found.level == "good", (*found.reasons, *found.limits)
    assert 0.75 < getattr(found.noises, name) / size < 1.25
    assert 0.5 < nees(found, truth) < 2.0


def test_the_sun_is_learned_where_it_is_seen_in_a_long_record_that_begins_in_eclipse() -> None:
    telemetry, truth = simulate(with_rows_every(1.0))
    sun = np.array(telemetry.sun_B)
    sun[:1500] = np.nan
    found = fluxtwin.attitude(telemetry.replace(sun_B=sun), Calibration(truth.S, truth.b_nT))
    assert found.level == "good", (*found.reasons, *found.limits)
    assert 0.8 < found.noises.sun_rad / np.radians(0.1) < 1.25
    assert 0.5 < nees(found, truth) < 2.0


def test_a_turn_that_may_be_the_other_way_round_is_refused(flown: tuple[Any, Any]) -> None:
    telemetry, truth = flown
    q = np.array(telemetry.q_NB)
    spun = Rotation.from_rotvec(np.outer(3.0 * np.arange(len(q)), [0.0, 0.0, 1.0]))
    q = frames.q_from_rotation(spun * frames.rotation_from_q(np.array(truth.q_NB)))
    with pytest.raises(NoAnswer, match=r"by 17[0-9.]* deg.* its rate cannot be found"):
        fluxtwin.attitude(telemetry.replace(q_NB=q, nadir_B=None, sun_B=None), Calibration(truth.S, truth.b_nT))
