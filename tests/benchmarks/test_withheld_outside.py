"""Kinds of causes outside the catalogue: each held to facts that are written down without its maker."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np
import pytest
from withheld_cases import outside, outside_places, outside_sensor, spacecraft
from withheld_cases.chain import Truth, ambient, fly, noise_free, twin
from withheld_cases.worlds import World, shift
from withheld_worlds import drawn, small_world

from fluxtwin.sim.earth import epoch, frames

pytestmark = pytest.mark.property

Close = Callable[..., None]


def change(world: World, truth: Truth) -> np.ndarray:
    return noise_free(world, [truth]).reading_nT - noise_free(world, ()).reading_nT


def at_sensor(world: World, truth: Truth) -> np.ndarray:
    """(N, 3) what a truth adds to the field as equation 1 sees it."""
    return change(world, truth) @ (np.eye(3) + world.S).T


def seconds(world: World) -> np.ndarray:
    return epoch.seconds_since(world.time, world.start)


def gains(world: World, truth: Truth) -> np.ndarray:
    """(N, 3, 3) what a truth adds to S, from its hook."""
    assert truth.correction is not None
    S, b = truth.correction(world, world.time)
    whole = np.einsum("nij,nj->ni", np.eye(3) + world.S + S, noise_free(world, [truth]).reading_nT) + world.b_nT
    assert np.abs(whole - ambient(world, (), world.time)).max() < 1e-3 and not b.any(), "equation 1"
    return S


def test_the_counter_has_one_offset_between_two_resets(close: Close) -> None:
    world, truth = drawn(outside_sensor.counter_resets, small_world("tumble"), 5.0)
    assert truth.clock is not None
    late_s = truth.clock(world, world.time)
    close(np.unique(late_s), np.sort(truth.parameters["offsets_s"]), atol=1e-6, unit="s", because="eight digits")
    assert 4 <= np.count_nonzero(np.diff(late_s)) <= 9


def test_one_axis_has_anothers_past_in_it(close: Close) -> None:
    world, truth = drawn(outside_sensor.delayed_crosstalk, small_world(), 0.01)
    p = truth.parameters
    before = noise_free(dataclasses.replace(world, time=shift(world.time, -p["late_s"])), ()).reading_nT
    wanted = np.outer(0.01 * before[:, p["from"]], np.eye(3)[p["into"]])
    close(change(world, truth), wanted, atol=1e-6, unit="nT", because="a share of another reading")
    assert p["from"] != p["into"] and 0.07 < p["late_s"] / world.orbit.nodal_period_s < 0.21


def test_shear_and_gains_follow_what_they_are_named_after(close: Close) -> None:
    world, truth = drawn(outside_sensor.thermal_shear, small_world(rows=500), 1e-4)
    S, warmer = gains(world, truth), np.asarray(twin(world, ()).temperature_degC) - 10.0
    one, other = truth.parameters["axes"]
    close(S[:, one, other], 1e-4 * warmer, atol=6e-6, unit="1", because="the column has steps of 0.1 K")
    assert np.array_equal(S, S.transpose(0, 2, 1)) and np.count_nonzero(S[0]) == 2
    world, truth = drawn(outside_sensor.spin_gain, small_world("slews"), 2e-3)
    rate = np.linalg.norm(np.asarray(twin(world, ()).rate_B_rad_s), axis=1)
    wanted = (rate / truth.parameters["at_rate_rad_s"])[:, None] ** 2 * truth.parameters["scale"]
    close(np.diagonal(gains(world, truth), axis1=1, axis2=2), wanted, atol=1e-7, unit="1", because="eight digits")
    world, truth = drawn(outside_sensor.shocked_amplifier, small_world(), 5e-3)
    course = gains(world, truth)[:, 0, 0] / truth.parameters["scale"][0]
    falls = np.diff(course) < 0.0
    rate_s = -np.diff(np.log(np.maximum(course, 1e-300)))[falls] / 30.0
    close(rate_s, 1.0 / truth.parameters["tau_s"], atol=1e-8, unit="1/s", because="exponential between shocks")
    assert 0.3 < course.max() <= 1.0 and np.count_nonzero(np.diff(course) > 0.0) <= truth.parameters["shocks"]
    world, truth = drawn(outside.gain_ageing, small_world(), 4e-3)
    S = gains(world, truth)
    assert np.abs(S[[0, -1]]).max() < 1e-9 and np.abs(S[len(S) // 2]).max() == pytest.approx(4e-3, rel=1e-3)


def test_the_converter_errs_alike_one_tooth_on() -> None:
    world, truth = drawn(outside_sensor.converter_sawtooth, small_world(), 100.0)
    assert truth.sense is not None
    field = np.linspace(-3e4, 3e4, 900).reshape(-1, 3)
    err = truth.sense(world, world.time, field, lambda t: field) - field
    next_ = truth.sense(world, world.time, field + truth.parameters["period_nT"], lambda t: field)
    assert np.allclose(next_ - field - truth.parameters["period_nT"], err, atol=1e-6)
    assert 90.0 < err.max() <= 100.0 and -100.0 <= err.min() < -90.0 and abs(err.mean()) < 10.0


def test_the_line_has_its_frequency_at_the_temperature_of_the_moment(close: Close) -> None:
    world, truth = drawn(outside_sensor.chirping_line, small_world(rows=300), 80.0)
    p, late_s = truth.parameters, 1e-5
    assert truth.stray is not None
    here, next_, last = (truth.stray(world, shift(world.time, s), lambda t: t) for s in (0.0, late_s, -late_s))
    second = (next_ - 2.0 * here + last) / late_s**2
    hertz = np.sqrt(-np.sum(second * here, axis=1) / np.sum(here**2, axis=1)) / (2.0 * np.pi)
    warmer = np.asarray(twin(world, ()).temperature_degC) - 10.0
    close(hertz, p["hertz"] * (1.0 + p["per_K"] * warmer), atol=2e-3 * p["hertz"], unit="Hz", because="differences")
    swing = p["hertz"] * p["per_K"] * np.ptp(warmer) * world.span_s
    assert swing > 3.0, "cycles by which it leaves a steady line"


def test_the_place_is_turned_to_the_east(close: Close) -> None:
    world, truth = drawn(outside_places.longitude_error, small_world(), 0.5)
    turn = frames.rotation_EN(world.time)
    here, there = (frames.geocentric(turn.apply(noise_free(world, t).r_N_km)) for t in ((), [truth]))
    east = np.degrees(np.mod(there[1] - here[1] + np.pi, 2 * np.pi) - np.pi)
    close(east, truth.parameters["east_deg"], atol=6e-3, unit="deg", because="precession 0.07 deg, at 82 deg")
    close(np.degrees(there[0] - here[0]), 0.0, atol=1e-3, unit="deg", because="the same")


def test_the_dynamo_is_a_gradient_without_divergence_that_stands_under_the_sun(close: Close) -> None:
    world, truth = drawn(outside_places.sq_dynamo, small_world(), 100.0)
    assert truth.field is not None
    time, r0, h = world.time[:1], world.where(world.time[:1])[0], 5.0
    jacobian = np.stack(
        [
            (truth.field(world, time, r0 + h * e) - truth.field(world, time, r0 - h * e))[0] / (2.0 * h)
            for e in np.eye(3)
        ]
    )
    close(jacobian, jacobian.T, atol=1e-6, unit="nT/km", because="no curl; differences over 10 km")
    assert abs(np.trace(jacobian)) < 1e-6 < 1e-3 < np.abs(jacobian).max()
    later = time + np.timedelta64(6, "h")
    assert np.abs(truth.field(world, later, r0) - truth.field(world, time, r0)).max() < 1.0, "the sun moves 0.25 deg"


def test_bubbles_lie_along_the_field_in_the_evening() -> None:
    found = 0
    for seed in range(6):
        world = small_world("nadir", rows=600)
        world = dataclasses.replace(world, orbit=dataclasses.replace(world.orbit, raan_rad=1.9 + 0.1 * seed))
        draft = outside_places.plasma_depletions(world, np.random.default_rng(seed))
        if draft is None:
            continue
        found += 1
        added, field = at_sensor(world, draft.at(500.0)), ambient(world, (), world.time)
        assert (
            np.abs(np.cross(added, field)).max() < 1e-6 * 500.0 * 5e4 and (np.sum(added * field, axis=1) >= -1e-3).all()
        )
        on = np.abs(added).max(axis=1) > 1.0
        up = world.where(world.time)[0] / np.linalg.norm(world.where(world.time)[0], axis=1)[:, None]
        high = np.abs(np.degrees(np.arcsin(up[:, 2])))
        assert 0.02 < on.mean() < 0.4 and high[on].max() < 25.0 + 12.0, "the dipole leans by ten degrees"
        assert np.sum(up * world.sun(world.time)[0], axis=1)[on].max() < 0.0, "the sun has set below"
    assert found >= 2


def test_gyros_err_by_a_share_of_the_turn_since_the_fix() -> None:
    world, truth = drawn(outside_places.gyro_scale, small_world("nadir", rows=600), 1e-3)
    p, now = truth.parameters, seconds(world)
    error = (noise_free(world, [truth]).R_BN * noise_free(world, ()).R_BN.inv()).as_rotvec()
    rate = np.asarray(twin(world, ()).rate_B_rad_s)
    growth = np.diff(error, axis=0) / 30.0
    inside = np.diff(np.floor(now / p["every_s"])) == 0
    wanted = np.array(p["scale"]) * 0.5 * (rate[1:] + rate[:-1])
    assert np.abs(growth - wanted)[inside].max() < 0.03 * np.abs(wanted).max()
    fresh = np.mod(now, p["every_s"]) < 30.0
    assert np.abs(error[fresh]).max() < 30.0 * np.abs(wanted).max() and 2 <= np.count_nonzero(fresh) <= 15


def test_the_arm_comes_and_goes_with_the_cube_of_its_distance() -> None:
    world, truth = drawn(outside_places.scanning_arm, small_world(rows=900, step_s=20.0), 30.0)
    course = at_sensor(world, truth) @ truth.parameters["field_nT"] / np.sum(np.square(truth.parameters["field_nT"]))
    assert course.max() == pytest.approx(8.0, rel=0.03) and course.min() == pytest.approx(1.5**-3, rel=0.03)
    distance = course ** (-1.0 / 3.0)
    swing = np.fft.rfft(distance - distance.mean())
    period = world.span_s / np.argmax(np.abs(swing))
    assert period == pytest.approx(
        truth.parameters["period_s"], rel=0.5 * truth.parameters["period_s"] / world.span_s + 0.02
    )


def test_each_step_of_a_torquer_leaves_a_decay_that_goes_one_way() -> None:
    world, truth = drawn(outside_places.switching_transients, small_world(rows=900, step_s=10.0), 80.0)
    axis, tau_s = np.array(truth.parameters["field_nT"]), truth.parameters["tau_s"]
    course = at_sensor(world, truth) @ axis / (axis @ axis)
    assert course.min() > -1e-9
    fine = shift(world.time[0], np.arange(0.0, world.span_s, 1.0))
    steps = np.any(np.diff(spacecraft.dipole_B_Am2(world, fine), axis=0) != 0.0, axis=1)
    moments = np.flatnonzero(steps).astype(float)
    begin, end = seconds(world)[:-1], seconds(world)[1:]
    quiet = [not np.any((moments > a - 3.0) & (moments < b + 3.0)) for a, b in zip(begin, end, strict=True)]
    ratio = course[1:][quiet] / course[:-1][quiet]
    assert len(ratio) > 30 and ratio == pytest.approx(np.exp(-10.0 / tau_s), rel=2e-3)


def test_two_heaters_draw_less_together_than_apart() -> None:
    world, truth = drawn(outside_places.two_heaters, small_world(rows=1500, step_s=20.0), 80.0)
    levels = np.unique(np.round(at_sensor(world, truth), 3), axis=0)
    one, other = np.reshape(truth.parameters["fields_nT"], (2, 3))
    for wanted in (0.0 * one, one, other, 0.7 * (one + other)):
        assert np.abs(levels - wanted).max(axis=1).min() < 2e-3
    periods = truth.parameters["periods_s"]
    assert len(levels) == 4 and 1.05 < periods[1] / periods[0] < 1.17


def test_the_motional_current_is_a_rectified_v_cross_b(close: Close) -> None:
    world, truth = drawn(outside_places.motional_current, small_world(), 600.0)
    added, k = at_sensor(world, truth), np.array(truth.parameters["k_nT_per_V_m"])
    volt_m = added @ k / (k @ k)
    r_km, v_km_s = world.where(world.time)
    spin = np.stack([-7.292115e-5 * r_km[:, 1], 7.292115e-5 * r_km[:, 0], 0.0 * r_km[:, 0]], axis=1)
    R = twin(world, ())
    b_N = frames.rotation_from_q(np.asarray(R.q_NB)).inv().apply(ambient(world, (), world.time))
    strength = np.linalg.norm(np.cross(1e3 * (v_km_s - spin), 1e-9 * b_N), axis=1)
    assert (volt_m > -1e-9).all() and (volt_m <= strength + 1e-9).all() and 0.1 < np.mean(volt_m > 0.0) < 0.95
    e_B = frames.rotation_from_q(np.asarray(R.q_NB)).apply(np.cross(1e3 * (v_km_s - spin), 1e-9 * b_N))
    on = volt_m > 1e-6
    along = np.linalg.lstsq(e_B[on], volt_m[on], rcond=None)[0]
    close(np.linalg.norm(along), 1.0, atol=1e-4, unit="1", because="one direction of the structure")


def test_the_geared_magnet_turns_twice(close: Close) -> None:
    world, truth = drawn(outside.drive_magnet, small_world("slews", rows=400), 100.0)
    sun_B = noise_free(world, ()).R_BN.apply(world.sun(world.time)[0])
    x, y = (sun_B[:, (truth.parameters["axis"] + k) % 3] for k in (1, 2))
    angle = np.arctan2(y, x)
    columns = np.stack([np.cos(2 * angle), np.sin(2 * angle), np.cos(4 * angle)], axis=1)
    added = at_sensor(world, truth)
    close(columns @ np.linalg.lstsq(columns, added, rcond=None)[0], added, atol=1e-4, unit="nT", because="no others")


def test_packets_turned_in_their_ring_keep_their_rows() -> None:
    world = small_world("nadir", rows=600, step_s=3.0)
    draft = outside.missorted_samples(world, np.random.default_rng(11))
    assert draft is not None
    truth = draft.at(0.4)
    good, bad = (np.asarray(fly(world, t).mag_B_nT) for t in ((), [truth]))
    length, moved = truth.parameters["rows"], 0
    for first in range(0, len(good), length):
        one, other = good[first : first + length], bad[first : first + length]
        assert sorted(map(tuple, one)) == sorted(map(tuple, other))
        shifts = [k for k in range(len(one)) if np.array_equal(np.roll(one, -k, axis=0), other)]
        moved += shifts[0] > 0
    assert moved >= 2
