"""The maker of the withheld truths, against facts that can be written down without it.

If a forward model of the benchmark were wrong, right answers would look wrong and nothing would be proved. So each
is held to the meaning of its name: sign, size and the columns that carry it.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from withheld_cases import of_place, of_sensor, of_spacecraft, spacecraft
from withheld_cases.chain import Truth, fly, noise_free, twin
from withheld_cases.visible import noise_rms_nT
from withheld_cases.worlds import World, shift
from withheld_worlds import drawn, small_world

from fluxtwin.sim.earth import epoch, frames
from fluxtwin.sim.earth.field import design_matrix_E
from fluxtwin.sim.earth.field_models import load_field

pytestmark = pytest.mark.property

Close = Callable[..., None]


def wertz_matrix(q: np.ndarray) -> np.ndarray:
    """Attitude matrix of a quaternion, scalar last: Wertz 1978, equation 12-13a, element by element."""
    q1, q2, q3, q4 = q
    return np.array(
        [
            [q1**2 - q2**2 - q3**2 + q4**2, 2 * (q1 * q2 + q3 * q4), 2 * (q1 * q3 - q2 * q4)],
            [2 * (q1 * q2 - q3 * q4), -(q1**2) + q2**2 - q3**2 + q4**2, 2 * (q2 * q3 + q1 * q4)],
            [2 * (q1 * q3 + q2 * q4), 2 * (q2 * q3 - q1 * q4), -(q1**2) - q2**2 + q3**2 + q4**2],
        ]
    )


def field_by_coefficients(world: World, time: np.ndarray, at_epoch: np.ndarray, r_N_km: np.ndarray) -> np.ndarray:
    """IGRF with the coefficients of `at_epoch` at Earth-fixed positions of `time`, in N: design matrix times them."""
    model = load_field("igrf14")
    turn = frames.rotation_EN(time)
    A = design_matrix_E(13, turn.apply(np.array(r_N_km)))
    return np.asarray(turn.inv().apply(np.einsum("nik,nk->ni", A, model.coefficients_nT(at_epoch))))


def body_field(world: World, shift_s: float = 0.0) -> np.ndarray:
    """A B0 from the telemetered quaternion of the noise-free flight, by Wertz's matrix."""
    time = shift(world.time, shift_s)
    moved = dataclasses.replace(world, time=time)
    record = twin(moved, ())
    b_N = field_by_coefficients(world, time, time, np.array(record.r_N_km))
    return np.stack([wertz_matrix(q) @ b for q, b in zip(np.asarray(record.q_NB), b_N, strict=True)])


def corrected(world: World, reading: np.ndarray) -> np.ndarray:
    """Equation 1's right side: (I+S) B + b."""
    return reading @ (np.eye(3) + world.S).T + world.b_nT


def added_at_sensor(world: World, truth: Truth) -> np.ndarray:
    """What a truth adds to A B0 as equation 1 sees it: (I+S) times the change of the reading."""
    return (noise_free(world, [truth]).reading_nT - noise_free(world, ()).reading_nT) @ (np.eye(3) + world.S).T


# --- equation 1, quaternion, noise ------------------------------------------------------------------------------------


@pytest.mark.parametrize("regime", ["nadir", "tumble", "slews", "spin"])
def test_equation_1_holds_with_wertz_matrix(regime: str, close: Close) -> None:
    world = small_world(regime)
    reading = np.asarray(twin(world, ()).mag_B_nT)
    wanted = body_field(world)
    close(corrected(world, reading), wanted, atol=1e-4, unit="nT", because="rounding of 50,000 nT")
    mutant = dataclasses.replace(world, b_nT=-world.b_nT)
    assert np.abs(corrected(mutant, reading) - wanted).max() > 100.0
    transposed = np.stack([wertz_matrix(q).T for q in np.asarray(twin(world, ()).q_NB)])
    assert np.abs(np.einsum("nji,nj->ni", transposed, wanted) - wanted).max() > 1000.0


def test_noise_has_the_size_that_visible_divides_by(close: Close) -> None:
    world = small_world("tumble", rows=4000, step_s=9.0)
    quiet = noise_free(world, ())
    record = fly(world, ())
    R_BN = frames.rotation_from_q(np.asarray(record.q_NB))
    predicted = R_BN.apply(world.real_field_N_nT(world.time, quiet.r_N_km))
    residual = corrected(world, np.asarray(record.mag_B_nT)) - predicted
    budget = noise_rms_nT(world)
    found = float(np.sqrt(np.mean(residual**2)))
    close(found / budget, 1.0, atol=0.08, unit="1", because="4000 rows, attitude error correlated over up to 600 s")


def test_reported_attitude_error_is_as_large_as_said(close: Close) -> None:
    budget = dataclasses.replace(small_world().budget, attitude_tau_s=0.0)
    world = dataclasses.replace(small_world(rows=3000, step_s=10.0), budget=budget)
    error = (frames.rotation_from_q(np.asarray(fly(world, ()).q_NB)) * noise_free(world, ()).R_BN.inv()).as_rotvec()
    ratio = error.std(axis=0) / budget.attitude_sigma_rad
    close(ratio, np.ones(3), atol=0.06, unit="1", because="3000 draws an axis: 1.3 % sigma")


# --- time, orbit, field, attitude --------------------------------------------------------------------------------------


def test_time_tag_plus_is_sampled_later(close: Close) -> None:
    world = small_world("tumble")
    world, truth = drawn(of_place.time_tag_offset, world, 4.0)
    offset = truth.parameters["offset_s"]
    late = np.linalg.solve(np.eye(3) + world.S, (body_field(world, offset) - world.b_nT).T).T
    found = noise_free(world, [truth])
    close(found.reading_nT, late, atol=1e-3, unit="nT", because="the field at the later instant")
    before = noise_free(world, ())
    assert np.array_equal(found.r_N_km, before.r_N_km)
    assert np.array_equal(found.R_BN.as_quat(), before.R_BN.as_quat())


def test_along_track_reports_a_place_ahead(close: Close) -> None:
    world, truth = drawn(of_place.along_track_error, small_world(), 15.0)
    ahead = truth.parameters["ahead_km"]
    assert abs(ahead) == 15.0
    bare, moved = noise_free(world, ()), noise_free(world, [truth])
    along = bare.v_N_km_s / np.linalg.norm(bare.v_N_km_s, axis=1)[:, None]
    step = moved.r_N_km - bare.r_N_km
    close(np.sum(step * along, axis=1), ahead, atol=0.01, unit="km", because="the arc bends by d^2/2r = 16 m")
    assert np.linalg.norm(np.cross(step, along), axis=1).max() < 0.05
    assert np.array_equal(moved.reading_nT, bare.reading_nT)
    assert np.array_equal(moved.R_BN.as_quat(), bare.R_BN.as_quat())


def test_field_epoch_plus_is_a_field_ahead_of_the_model(close: Close) -> None:
    world, truth = drawn(of_place.field_epoch, small_world(), 2.5)
    years = truth.parameters["ahead_yr"]
    later = shift(world.time, years * 365.25 * 86400.0)
    clean = noise_free(world, [truth])
    b_N = field_by_coefficients(world, world.time, later, clean.r_N_km)
    wanted = clean.R_BN.apply(b_N)
    close(corrected(world, clean.reading_nT), wanted, atol=1e-4, unit="nT", because="the same coefficients")


@pytest.mark.parametrize("seed", range(6))
def test_truncation_leaves_out_the_high_degrees(seed: int, close: Close) -> None:
    world, truth = drawn(of_place.field_truncation, small_world(), 1.0, seed)
    count = truth.parameters["degree"] * (truth.parameters["degree"] + 2)
    clean = noise_free(world, [truth])
    turn = frames.rotation_EN(world.time)
    A = design_matrix_E(13, turn.apply(clean.r_N_km))
    c = load_field("igrf14").coefficients_nT(world.time)
    whole = clean.R_BN.apply(turn.inv().apply(np.einsum("nik,nk->ni", A, c)))
    low = clean.R_BN.apply(turn.inv().apply(np.einsum("nik,nk->ni", A[:, :, :count], c[:, :count])))
    model_lacks = truth.parameters["lacks_them"] == "model"
    real, ground = (whole, low) if model_lacks else (low, whole)
    close(corrected(world, clean.reading_nT), real, atol=1e-4, unit="nT", because="the same coefficients")
    close(clean.predicted_nT, ground, atol=1e-4, unit="nT", because="the same coefficients")
    assert (world.degree == truth.parameters["degree"]) == model_lacks
    assert np.abs(whole - low).max() > 5.0


def test_ring_current_is_dst_at_the_dipole_equator_and_opposed_at_the_pole(close: Close) -> None:
    world = small_world()
    time = world.time[:2]
    axis = of_place.dipole_axis_E(world, time)
    assert axis[2] > 0.97, "the geomagnetic north pole lies in the north"
    aside = np.cross(axis, [0.0, 0.0, 1.0])
    places = 6371.2 * np.stack([aside / np.linalg.norm(aside), axis])
    turn = frames.rotation_EN(time)
    found = turn.apply(of_place.ring_field_N_nT(world, time, turn.inv().apply(places), np.full(2, -100.0)))
    close(found[0] @ axis, -100.0, atol=1e-9, unit="nT", because="that is what Dst means")
    close(found[1] @ axis, -100.0 * (1.0 - 2 * 0.27) / 1.27, atol=1e-9, unit="nT", because="q - 2 i over q + i")
    north = field_by_coefficients(world, time, time, turn.inv().apply(places))[0]
    assert turn.apply(np.stack([north, north]))[0] @ axis > 0, "a storm weakens the field at the equator"


def test_head_misalignment_turns_the_report_while_the_head_is_used(close: Close) -> None:
    world, truth = drawn(of_place.sun_sensor_head_misalignment, small_world("slews", rows=600), 0.3)
    theta = np.radians(truth.parameters["rotation_deg"])
    bare, turned = noise_free(world, ()), noise_free(world, [truth])
    used = np.asarray(twin(world, [truth]).sun_sensor_head) == truth.parameters["head"]
    assert 0.1 < used.mean() < 0.85
    change = turned.predicted_nT - bare.predicted_nT
    wanted = np.where(used[:, None], np.cross(theta, bare.predicted_nT), 0.0)
    close(change, wanted, atol=2.0, unit="nT", because="second order: half theta^2 B")
    assert np.array_equal(turned.reading_nT, bare.reading_nT)


def test_horizon_error_is_added_to_roll_and_pitch(close: Close) -> None:
    world, truth = drawn(of_place.horizon_scanner_bias, small_world("nadir"), 0.2)
    c = np.radians(truth.parameters["roll_sin_roll_cos2_pitch_sin_pitch_cos2_deg"])
    bare, turned = noise_free(world, ()), noise_free(world, [truth])
    R_ON = frames.rotation_ON(bare.r_N_km, bare.v_N_km_s)
    before, after = (np.stack(frames.yaw_roll_pitch(c_.R_BN * R_ON.inv()), axis=1) for c_ in (bare, turned))
    lat = np.arcsin(frames.rotation_EN(world.time).apply(bare.r_N_km)[:, 2] / np.linalg.norm(bare.r_N_km, axis=1))
    shapes = np.stack([np.sin(lat), np.cos(2 * lat)])
    wanted = np.stack([0 * lat, c[:2] @ shapes, c[2:] @ shapes], axis=1)
    close(after - before, wanted, atol=1e-9, unit="rad", because="angles add")
    assert np.ptp(lat) > 2.0


@pytest.mark.parametrize("seed", range(4))
def test_yaw_error_grows_and_only_then(seed: int, close: Close) -> None:
    world, truth = drawn(of_place.yaw_drift, small_world("nadir", rows=500, step_s=20.0), 0.4, seed)
    bare, turned = noise_free(world, ()), noise_free(world, [truth])
    R_ON = frames.rotation_ON(bare.r_N_km, bare.v_N_km_s)
    before, after = (np.stack(frames.yaw_roll_pitch(c.R_BN * R_ON.inv()), axis=1) for c in (bare, turned))
    hours = epoch.seconds_since(world.time, world.time[0]) / 3600.0
    dark = world.sun(world.time)[1] <= 0.5
    rate = np.radians(truth.parameters["rate_deg_h"])
    yaw = (after - before)[:, 0]
    assert np.abs((after - before)[:, 1:]).max() < 1e-9
    if truth.parameters["when"] == "always":
        close(yaw, rate * hours, atol=1e-9, unit="rad", because="a rate times time")
        return
    assert dark.any() and np.abs(yaw[~dark]).max() < 1e-12
    entry = np.flatnonzero(dark & ~np.roll(dark, 1))[1]
    inside = slice(entry, entry + 60)
    growth = np.polyfit(hours[inside], yaw[inside], 1)[0]
    close(growth, rate, atol=0.02 * abs(rate), unit="rad/h", because="a grid of 5 s")
    assert abs(yaw[entry]) < abs(rate) * 25.0 / 3600.0


# --- spacecraft ---------------------------------------------------------------------------------------------------------


def test_torquer_adds_coupling_times_dipole(close: Close) -> None:
    world, truth = drawn(of_spacecraft.torquer_coupling, small_world("nadir", rows=600), 3.0)
    C = np.reshape(truth.parameters["coupling_nT_per_Am2"], (3, 3))
    dipole = np.asarray(twin(world, [truth]).dipole_B_Am2)
    close(added_at_sensor(world, truth), dipole @ C.T, atol=1e-4, unit="nT", because="equation 1 with T = -C")
    assert len({round(abs(value), 6) for value in dipole.ravel()}) >= 3, "off, low and high"


def test_currents_follow_sun_and_load(close: Close) -> None:
    world = small_world("nadir", rows=900, step_s=20.0)
    record = twin(world, ())
    array, battery = np.asarray(record.array_current_A), np.asarray(record.battery_current_A)
    dark = world.sun(world.time)[1] < 1e-9
    assert dark.any() and not array[dark].any()
    close(
        battery[dark], -world.craft.load_A, atol=0.0051, unit="A", because="in shadow it feeds the load; two decimals"
    )
    charging = array > world.craft.load_A + 0.01
    assert (battery[charging] >= 0).all() and battery.max() > 0.1
    for maker, column in ((of_spacecraft.solar_array_current, array), (of_spacecraft.battery_current, battery)):
        changed, truth = drawn(maker, world, 10.0)
        k = np.array(truth.parameters["k_nT_per_A"])
        close(added_at_sensor(changed, truth), np.outer(column, k), atol=0.2, unit="nT", because="columns have 0.01 A")


def test_heater_and_switch_have_two_levels(close: Close) -> None:
    found = 0
    for seed in range(6):
        base = small_world("nadir", rows=400, step_s=20.0, seed=seed)
        draft = of_spacecraft.heater_switching(base, np.random.default_rng(1))
        if draft is None:
            continue
        found += 1
        truth = draft.at(120.0)
        on = np.asarray(twin(base, [truth]).heater_on)
        wanted = np.outer(on, truth.parameters["field_nT"])
        close(added_at_sensor(base, truth), wanted, atol=1e-4, unit="nT", because="on or off")
    assert found >= 1
    kinds = set()
    world = small_world("nadir", rows=800, step_s=50.0)
    for seed in range(18):
        draft = of_spacecraft.switched_field(world, np.random.default_rng(seed))
        if draft is None:
            continue
        truth = draft.at(50.0)
        added = added_at_sensor(draft.world, truth)
        kinds.add(str(truth.parameters["condition"]))
        on = np.abs(added).max(axis=1) > 1.0
        close(added[on], truth.parameters["field_nT"], atol=1e-4, unit="nT", because="one level")
        close(on.mean(), truth.parameters["share"], atol=1e-12, unit="1", because="the state itself")
        if truth.parameters["condition"] == "eclipse":
            assert np.array_equal(on, world_dark(draft.world))
    assert kinds == {"flag:payload", "clock", "eclipse", "region"}


def world_dark(world: World) -> np.ndarray:
    """Rows in shadow by the recorded column."""
    return np.asarray(twin(world, ()).sunlit) == 0


def test_wheel_turns_at_its_speed(close: Close) -> None:
    world = small_world("nadir", rows=400, step_s=0.002)
    world = dataclasses.replace(world, craft=dataclasses.replace(world.craft, wheel_swing_rpm=40.0))
    world, truth = drawn(of_spacecraft.wheel_field, world, 50.0)
    phase = spacecraft.wheel_phase_rad(world, world.time)
    rpm = np.asarray(twin(world, [truth]).wheel_speed_rpm)[:, 0]
    rate = np.gradient(phase, 0.002) * 60.0 / (2 * np.pi)
    close(rate[1:-1], rpm[1:-1], atol=1e-3, unit="rpm", because="the phase is the integral of the speed")
    added = added_at_sensor(world, truth)
    wanted = np.outer(np.cos(phase), truth.parameters["cos_nT"]) + np.outer(np.sin(phase), truth.parameters["sin_nT"])
    close(added, wanted, atol=1e-4, unit="nT", because="a turning dipole")


def test_eddy_field_opposes_the_change(close: Close) -> None:
    world, truth = drawn(of_spacecraft.eddy_current, small_world("tumble", rows=200, step_s=0.5), 2.0)
    K = np.reshape(truth.parameters["K_s"], (3, 3))
    assert np.allclose(K, K.T) and abs(np.trace(K)) < 1e-7
    rate = np.gradient(body_field(world), 0.5, axis=0)
    found = added_at_sensor(world, truth)[1:-1]
    close(found, -(rate @ K.T)[1:-1], atol=0.5, unit="nT", because="differences over 1 s of a turn of minutes")
    assert np.abs(found).max() > 20.0


def test_a_warm_boom_turns_the_sensor(close: Close) -> None:
    """The sensor turned by +a about an axis sees the field turned by -a about it, with the recorded temperature."""
    world, truth = drawn(of_spacecraft.boom_bending, small_world(rows=600), 0.02)
    warmer = np.asarray(twin(world, [truth]).temperature_degC) - 10.0
    turn = np.radians(np.outer(warmer, truth.parameters["turn_deg_per_K"]))
    field = body_field(world)
    wanted = Rotation.from_rotvec(turn).inv().apply(field) - field
    close(added_at_sensor(world, truth), wanted, atol=2.0, unit="nT", because="0.05 K of 0.035 deg/K of 50,000 nT")
    assert np.abs(wanted).max() > 100.0


# --- sensor and telemetry -----------------------------------------------------------------------------------------------


def test_bias_and_scale_enter_equation_1(close: Close) -> None:
    world, truth = drawn(of_sensor.bias, small_world(), 80.0)
    clean = noise_free(world, [truth])
    assert not world.b_nT.any() and "bias" not in world.modelled
    whole = clean.reading_nT @ (np.eye(3) + world.S).T + truth.parameters["b_nT"]
    close(whole, body_field(world), atol=1e-4, unit="nT", because="equation 1")
    world, truth = drawn(of_sensor.scale_misalignment, small_world(), 0.004)
    clean = noise_free(world, [truth])
    assert not world.S.any() and "scale_misalignment" not in world.modelled
    S = np.reshape(truth.parameters["S"], (3, 3))
    whole = clean.reading_nT @ (np.eye(3) + S).T + world.b_nT
    close(whole, body_field(world), atol=1e-4, unit="nT", because="equation 1")


def test_thermal_drifts_follow_the_recorded_temperature(close: Close) -> None:
    world, truth = drawn(of_sensor.thermal_bias_drift, small_world(rows=600), 4.0)
    warmer = np.asarray(twin(world, [truth]).temperature_degC) - 10.0
    k = np.array(truth.parameters["slope_nT_per_K"])
    close(
        added_at_sensor(world, truth), -np.outer(warmer, k), atol=0.6, unit="nT", because="0.1 K steps; b is subtracted"
    )
    world, truth = drawn(of_sensor.thermal_scale_drift, small_world(rows=600), 2e-4)
    clean = noise_free(world, [truth])
    S = world.S + warmer[:, None, None] * np.diag(truth.parameters["slope_per_K"])
    whole = np.einsum("nij,nj->ni", np.eye(3) + S, clean.reading_nT) + world.b_nT
    close(whole, body_field(world), atol=0.8, unit="nT", because="0.05 K of 2e-4 of 50,000 nT")
    dark, light = (float(np.mean(warmer[mask])) for mask in (world_dark(world), ~world_dark(world)))
    assert light > dark


def test_bias_step_jumps_once_in_b(close: Close) -> None:
    world, truth = drawn(of_sensor.bias_step, small_world(), 60.0)
    after = world.time >= np.datetime64(truth.parameters["at"])
    assert 0.15 < after.mean() < 0.85
    wanted = -np.outer(after, truth.parameters["jump_nT"])
    close(added_at_sensor(world, truth), wanted, atol=1e-4, unit="nT", because="b is subtracted from the field")


def test_random_walk_has_independent_steps_of_its_rate(close: Close) -> None:
    world, truth = drawn(of_sensor.bias_random_walk, small_world(rows=4000, step_s=10.0), 3.0)
    steps = np.diff(added_at_sensor(world, truth), axis=0)
    close(steps.std(), 3.0 * np.sqrt(10.0), atol=0.25, unit="nT", because="12,000 steps: sigma 0.7 %, four of them")
    lagged = np.mean(steps[1:] * steps[:-1]) / np.mean(steps**2)
    assert abs(lagged) < 0.04


@pytest.mark.parametrize(("maker", "order"), [(of_sensor.quadratic_nonlinearity, 2), (of_sensor.cubic_nonlinearity, 3)])
def test_nonlinearity_is_its_coefficient_at_full_field(maker: Any, order: int, close: Close) -> None:
    world, truth = drawn(maker, small_world(), 200.0)
    assert truth.sense is not None
    c = np.reshape(truth.parameters["c_nT"], (3, {2: 6, 3: 10}[order]))
    field = np.array([[5e4, 0.0, 0.0], [0.0, 0.0, -2.5e4]])
    found = truth.sense(world, world.time[:2], field, lambda t: field) - field
    close(found[0], c[:, 0], atol=1e-4, unit="nT", because="eight digits are kept")
    close(found[1], c[:, -1] * (-0.5) ** order, atol=1e-4, unit="nT", because="z at minus half of it")
    clean, bare = noise_free(world, [truth]), noise_free(world, ())
    x = bare.reading_nT / 5e4
    one = sum(c[1, k] * np.prod(x[:, list(w)], axis=1) for k, w in enumerate(_powers(order)))
    close((clean.reading_nT - bare.reading_nT)[:, 1], one, atol=1e-4, unit="nT", because="all products of y's row")


def _powers(order: int) -> list[tuple[int, ...]]:
    if order == 2:
        return [(0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)]
    return [
        (0, 0, 0),
        (0, 0, 1),
        (0, 0, 2),
        (0, 1, 1),
        (0, 1, 2),
        (0, 2, 2),
        (1, 1, 1),
        (1, 1, 2),
        (1, 2, 2),
        (2, 2, 2),
    ]


def test_hysteresis_remembers_the_branch() -> None:
    world, truth = drawn(of_sensor.hysteresis, small_world(rows=600), 100.0)
    added = noise_free(world, [truth]).reading_nT - noise_free(world, ()).reading_nT
    h = np.array(truth.parameters["h_nT"])
    assert (np.abs(added) <= np.abs(h) + 1e-4).all()
    state = added / h
    assert state.max() > 0.99 and state.min() < -0.99
    x = body_field(world)[:, 2]
    middle = np.abs(x - np.median(x)) < 2000.0
    rising = np.gradient(x) > 0
    assert state[middle & rising, 2].mean() > 0.5 and state[middle & ~rising, 2].mean() < -0.5


def test_saturation_keeps_readings_at_the_level() -> None:
    world, truth = drawn(of_sensor.saturation, small_world(), 4000.0)
    level = truth.parameters["level_nT"]
    bare, clean = noise_free(world, ()).reading_nT, noise_free(world, [truth]).reading_nT
    beyond = np.abs(bare) > level
    assert beyond.any() and np.abs(bare).max() == pytest.approx(level + 4000.0)
    assert np.array_equal(clean[~beyond], bare[~beyond])
    assert np.array_equal(clean[beyond], np.sign(bare[beyond]) * level)
    lsb = world.budget.lsb_nT
    assert np.abs(np.asarray(fly(world, [truth]).mag_B_nT)).max() <= level + lsb


@pytest.mark.parametrize(("regime", "tau_s"), [("nadir", 8.0), ("tumble", 5.0), ("spin", 0.4)])
def test_lag_solves_its_equation(regime: str, tau_s: float, close: Close) -> None:
    world = small_world(regime, rows=100)
    truth = Truth("sensor_lag", "sensor", {}, lag_s=tau_s)
    h = tau_s / 200.0
    at = [noise_free(dataclasses.replace(world, time=shift(world.time, s)), [truth]).reading_nT for s in (-h, 0.0, h)]
    perfect = noise_free(world, ()).reading_nT
    rate = (at[2] - at[0]) / (2 * h)
    close(tau_s * rate + at[1], perfect, atol=0.5, unit="nT", because="tau y' + y = x, differences over tau/100")
    assert np.abs(at[1] - perfect).max() > 50.0
    late = noise_free(dataclasses.replace(world, time=shift(world.time, -tau_s)), ()).reading_nT
    assert np.abs(at[1] - late).max() < 0.35 * np.abs(at[1] - perfect).max(), "a lag looks back, by about tau"


def test_coarse_steps_and_excess_noise(close: Close) -> None:
    world, truth = drawn(of_sensor.coarse_quantization, small_world(), 4.0)
    reading = np.asarray(fly(world, [truth]).mag_B_nT)
    step = truth.parameters["lsb_nT"]
    assert step == pytest.approx(4.0 * world.budget.lsb_nT)
    close(reading / step, np.rint(reading / step), atol=1e-9, unit="steps", because="every reading is a whole step")
    assert np.abs(reading / (2 * step) - np.rint(reading / (2 * step))).max() > 0.4
    world, truth = drawn(of_sensor.excess_noise, small_world(rows=3000), 300.0, seed=1)
    change = np.asarray(fly(world, [truth]).mag_B_nT) - np.asarray(fly(world, ()).mag_B_nT)
    on = [truth.parameters["axis"] in ("all", axis) for axis in "xyz"]
    wanted = np.where(on, np.hypot(300.0, world.budget.lsb_nT / np.sqrt(6.0)), 0.0)
    close(change.std(axis=0), wanted, atol=20.0, unit="nT", because="3000 draws: sigma 4 nT")


@pytest.mark.parametrize("seed", range(6))
def test_bit_errors_change_one_bit_of_single_readings(seed: int) -> None:
    world, truth = drawn(of_sensor.bit_errors, small_world(rows=3000), 0.01, seed)
    lsb, bit, stuck = world.budget.lsb_nT, truth.parameters["bit"], truth.parameters["stuck_at"]
    good, bad = (np.rint(np.asarray(fly(world, t).mag_B_nT) / lsb).astype(int) for t in ((), [truth]))
    changed = good != bad
    assert set(np.abs(bad - good)[changed].tolist()) == {2**bit}
    share = changed.mean() * (1.0 if stuck is None else 2.0)
    assert share == pytest.approx(0.01, abs=0.004)
    if stuck is not None:
        assert set(((bad[changed] + 2**24) >> bit & 1).tolist()) == {stuck}
