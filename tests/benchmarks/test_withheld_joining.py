"""Effects that join the table, as the withheld benchmark makes them: each held to facts written down without its maker."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np
import pytest
from withheld_cases import joining, shapes, spacecraft
from withheld_cases.chain import ambient, noise_free, twin
from withheld_cases.worlds import World, shift
from withheld_worlds import drawn, small_world

from fluxtwin.sim.earth import epoch, frames

pytestmark = pytest.mark.property

Close = Callable[..., None]


def change(world: World, truth: object) -> np.ndarray:
    """(N, 3) what a truth changes in the reading."""
    return noise_free(world, [truth]).reading_nT - noise_free(world, ()).reading_nT  # type: ignore[list-item]


def at_sensor(world: World, truth: object) -> np.ndarray:
    """The same in the field as equation 1 sees it."""
    return change(world, truth) @ (np.eye(3) + world.S).T


def days(world: World) -> np.ndarray:
    return epoch.seconds_since(world.time, world.start) / 86400.0


def test_one_axis_lags_and_solves_its_equation(close: Close) -> None:
    world, truth = drawn(joining.lag_of_one_axis, small_world("tumble", rows=100), 5.0)
    axis, h = "xyz".index(truth.parameters["axis"]), 0.025
    at = [noise_free(dataclasses.replace(world, time=shift(world.time, s)), [truth]).reading_nT for s in (-h, 0.0, h)]
    perfect = noise_free(world, ()).reading_nT
    rate = (at[2] - at[0]) / (2.0 * h)
    close((5.0 * rate + at[1])[:, axis], perfect[:, axis], atol=0.5, unit="nT", because="tau y' + y = x by differences")
    others = [k for k in range(3) if k != axis]
    assert np.array_equal(at[1][:, others], perfect[:, others]) and np.abs(at[1] - perfect)[:, axis].max() > 50.0


def test_each_axis_is_read_at_its_own_instant(close: Close) -> None:
    world, truth = drawn(joining.axis_skew, small_world("tumble", rows=100), 2.0)
    found = noise_free(world, [truth]).reading_nT
    for axis, late_s in enumerate((0.0, *truth.parameters["late_y_z_s"])):
        then = noise_free(dataclasses.replace(world, time=shift(world.time, late_s)), ()).reading_nT
        close(found[:, axis], then[:, axis], atol=1e-3, unit="nT", because="the same instant, kept to eight digits")
    assert truth.parameters["late_y_z_s"][1] > truth.parameters["late_y_z_s"][0] == 2.0


@pytest.mark.parametrize("maker", [joining.track_with_rate, joining.far_along_track])
def test_the_reported_place_is_ahead_by_an_arc_that_grows(maker: Callable[..., object], close: Close) -> None:
    world, truth = drawn(maker, small_world("nadir"), 900.0, seed=4)
    bare, moved = noise_free(world, ()), noise_free(world, [truth])
    p = truth.parameters
    wanted_km = p["ahead_km"] + p["rate_km_h"] * 24.0 * days(world)
    radius = np.linalg.norm(bare.r_N_km, axis=1)
    normal = np.cross(bare.r_N_km, bare.v_N_km_s)
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    sine = np.sum(np.cross(bare.r_N_km, moved.r_N_km) * normal, axis=1)
    arc_km = np.arctan2(sine, np.sum(bare.r_N_km * moved.r_N_km, axis=1)) * radius
    close(arc_km / wanted_km, 1.0, atol=0.01, unit="1", because="eccentricity 0.001: speed and radius vary by so much")
    R_ON = [frames.rotation_ON(c.r_N_km, c.v_N_km_s) for c in (bare, moved)]
    turned = ((moved.R_BN * R_ON[1].inv()) * (bare.R_BN * R_ON[0].inv()).inv()).magnitude()
    kept = (moved.R_BN * bare.R_BN.inv()).magnitude()
    small, large = (turned, kept) if p["attitude_follows"] else (kept, turned)
    assert small.max() < 1e-9 and large.max() > 0.1
    assert np.array_equal(moved.reading_nT, bare.reading_nT)


def test_the_clock_drifts_by_what_it_says(close: Close) -> None:
    world, truth = drawn(joining.clock_with_drift, small_world("tumble"), 6.0)
    late_s = truth.parameters["offset_s"] + truth.parameters["drift_s_per_day"] * days(world)
    then = dataclasses.replace(world, time=shift(world.time, late_s))
    wanted = noise_free(then, ()).reading_nT
    close(noise_free(world, [truth]).reading_nT, wanted, atol=1e-3, unit="nT", because="the same instants")
    assert np.ptp(late_s) == pytest.approx(6.0)


def test_bias_and_scale_drift_at_their_rates(close: Close) -> None:
    world, truth = drawn(joining.drift_of_bias, small_world(), 80.0)
    slopes = np.polyfit(days(world), at_sensor(world, truth), 1)[0]
    close(slopes, -np.array(truth.parameters["rate_nT_per_day"]), atol=1e-3, unit="nT/day", because="b is subtracted")
    world, truth = drawn(joining.drift_of_scale, small_world(), 4e-3)
    rate = np.reshape(truth.parameters["rate_per_day"], (3, 3))
    middle = 0.5 * days(world)[-1]
    S = world.S + (days(world) - middle)[:, None, None] * rate
    whole = np.einsum("nij,nj->ni", np.eye(3) + S, noise_free(world, [truth]).reading_nT) + world.b_nT
    close(whole, ambient(world, (), world.time), atol=1e-2, unit="nT", because="equation 1, eight digits")
    assert truth.name == joining.NAMES["drift_of_bias"]


def test_one_gain_of_all_axes_lags_behind_sun_and_shadow() -> None:
    world, truth = drawn(joining.common_gain_drift, small_world("nadir", rows=700, step_s=20.0), 1e-3)
    ratio = noise_free(world, [truth]).reading_nT / noise_free(world, ()).reading_nT
    assert np.ptp(ratio, axis=1).max() < 1e-6 and np.ptp(ratio) > 5e-3, "one gain, offset and all"
    gain, tau_s = ratio[:, 0] - 1.0, truth.parameters["tau_s"]
    goal = gain[1:-1] + tau_s * (gain[2:] - gain[:-2]) / 40.0
    light = world.sun(world.time)[1]
    steady = [np.all(light[k - 3 : k + 4] == light[k]) for k in range(3, light.size - 3)]
    levels, k = goal[2:-2][steady], 1e-3
    wanted = [k * (world.craft.eclipse_degC - 10.0), k * (world.craft.sunlit_degC - 10.0)]
    off = np.abs(levels[:, None] - wanted).min(axis=1)
    assert off.max() < 0.02 * abs(wanted[1] - wanted[0]), "tau g' + g is one of two levels"


def test_steps_turn_the_report_or_the_sensor_from_one_moment_on(close: Close) -> None:
    for maker in (joining.attitude_step, joining.mounting_step):
        world, truth = drawn(maker, small_world(), 0.5)
        theta = np.radians(truth.parameters["rotation_deg"])
        after = (world.time >= np.datetime64(truth.parameters["at"]))[:, None]
        bare, moved = noise_free(world, ()), noise_free(world, [truth])
        if maker is joining.attitude_step:
            found, wanted = moved.predicted_nT - bare.predicted_nT, np.cross(theta, bare.predicted_nT)
            assert np.array_equal(moved.reading_nT, bare.reading_nT)
        else:
            found, wanted = at_sensor(world, truth), -np.cross(theta, ambient(world, (), world.time))
            assert np.array_equal(moved.predicted_nT, bare.predicted_nT)
        close(found, np.where(after, wanted, 0.0), atol=6.0, unit="nT", because="half of theta^2 B")
        assert 0.1 < after.mean() < 0.9 and np.abs(wanted).max() > 200.0


def test_a_stray_field_is_linear_in_the_sun_and_off_in_the_dark(close: Close) -> None:
    world, truth = drawn(joining.stray_field, small_world("slews", rows=400, step_s=20.0), 90.0)
    towards, light = world.sun(world.time)
    sun_B = noise_free(world, ()).R_BN.apply(towards)
    wanted = light[:, None] * (sun_B @ np.reshape(truth.parameters["by_sun_nT"], (3, 3)).T)
    close(at_sensor(world, truth), wanted, atol=1e-3, unit="nT", because="eight digits")
    assert (light == 0.0).any() and not {"array_current_A", "battery_current_A"} & world.recorded


@pytest.mark.parametrize("seed", range(8))
def test_a_driver_is_its_recorded_column_some_minutes_ago(seed: int) -> None:
    world, truth = drawn(joining.driver, small_world("nadir", rows=500, step_s=20.0), 100.0, seed)
    p, name = truth.parameters, truth.parameters["column"]
    late = dataclasses.replace(world, time=shift(world.time, -p["late_s"]))
    flown = twin(late, ())
    column = flown.flags["payload"] if name == "flag_payload" else np.asarray(getattr(flown, name))
    off = np.abs(at_sensor(world, truth) - np.outer(column, p["k_nT_per_unit"]))
    finest = {"flag_payload": 0.0, "temperature_degC": 0.05}.get(name, 0.005)
    slack = 2.0 * finest * np.abs(p["k_nT_per_unit"]).max() + 1e-3
    assert np.quantile(off, 0.99) <= slack, "the battery's charge of the other flight begins a little otherwise"
    assert column.std() * np.abs(p["k_nT_per_unit"]).max() > 20.0 * slack or name == "temperature_degC"


def test_a_field_is_there_in_its_interval_alone(close: Close) -> None:
    world, truth = drawn(joining.field_of_an_interval, small_world(), 70.0)
    begin, end = (np.datetime64(truth.parameters[k]) for k in ("from", "to"))
    inside = (world.time >= begin) & (world.time < end)
    wanted = np.outer(inside, truth.parameters["field_nT"])
    close(at_sensor(world, truth), wanted, atol=1e-4, unit="nT", because="one level")
    assert 0.05 < inside.mean() < 0.35


# --- new shapes ---------------------------------------------------------------------------------------------------------


def test_what_warms_faster_than_it_cools_has_two_rates() -> None:
    seconds = np.arange(0.0, 20000.0, 5.0)
    goal = np.where(seconds < 10000.0, 1.0, -1.0)
    course = spacecraft.lagged(seconds, goal, 500.0, 1500.0)
    rising, falling = seconds < 2000.0, (seconds > 10100.0) & (seconds < 14000.0)
    assert np.polyfit(seconds[falling], np.log(course[falling] + 1.0), 1)[0] == pytest.approx(-1.0 / 1500.0, rel=1e-6)
    begin = goal.mean()
    assert np.log((1.0 - begin) / (1.0 - course[rising][-1])) == pytest.approx(1995.0 / 500.0, rel=1e-6)


def test_new_shapes_are_what_they_say(close: Close) -> None:
    world, truth = drawn(shapes.quintic_beside_cubic, small_world(), 200.0)
    x = noise_free(world, ()).reading_nT / 5e4
    c, q = (np.array(truth.parameters[k]) for k in ("c_nT", "quintic_nT"))
    close(change(world, truth), c * x**3 + q * x**5, atol=1e-4, unit="nT", because="its own component alone")
    world, truth = drawn(shapes.torquer_remanence, small_world("nadir", rows=600), 3.0)
    C, dipole = np.reshape(truth.parameters["coupling_nT_per_Am2"], (3, 3)), np.asarray(twin(world, ()).dipole_B_Am2)
    left = at_sensor(world, truth) @ np.linalg.inv(C).T - dipole
    full = max(world.craft.torquers.amplitude_Am2)
    close(np.abs(left), 0.125 * full, atol=1e-3 * full, unit="A m2", because="an eighth, one way or the other")
    driven = dipole != 0.0
    assert np.mean(np.sign(left[driven]) == np.sign(dipole[driven])) > 0.98, "the nodes are 2 s apart"
    world, truth = drawn(shapes.two_current_loops, small_world("slews", rows=400), 20.0)
    amperes = np.asarray(twin(world, ()).array_current_A)
    low = (amperes < 0.6 * world.craft.full_sun_A - 0.01) & (amperes > 0.0)
    ratio = at_sensor(world, truth)[low] / amperes[low, None]
    near = amperes[low] > 1.0
    wanted = np.tile(truth.parameters["k_nT_per_A"], (int(near.sum()), 1))
    close(ratio[near], wanted, atol=0.6, unit="nT/A", because="a column of 0.01 A, 20 nT/A times 3 at most")
    world, truth = drawn(shapes.array_watts, small_world("nadir", rows=600, step_s=20.0), 20.0)
    amperes = np.asarray(twin(world, ()).array_current_A)
    on = amperes > 1.0
    volts = at_sensor(world, truth)[on, 0] / amperes[on] / truth.parameters["k_nT_per_A"][0]
    assert 0.99 < volts.min() < 1.1 < volts.max() < 2.0, "coldest, and so highest, after the night"
