"""Sun and nadir of the withheld records: held to the true directions, and to what each fault means."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np
import pytest
from withheld_cases import of_place, shapes, spacecraft
from withheld_cases.attitude_sensors import (
    clean_roll_pitch,
    clean_sun,
    draw_sensors,
    nadir,
    vectors,
    wandering,
)
from withheld_cases.cases import PLAIN, make_case
from withheld_cases.chain import Truth, fly, noise_free
from withheld_cases.worlds import World, draw_world

pytestmark = pytest.mark.property

Close = Callable[..., None]
SMALL_RAD = 1e-9


@pytest.fixture(scope="module")
def world() -> World:
    """One that points to the Earth, in which each head sees the sun for a while."""
    rng = np.random.default_rng(4)
    while True:
        drawn = draw_world(rng, "nadir")
        if of_place.sun_sensor_head_misalignment(drawn, np.random.default_rng(1)) is not None:
            return dataclasses.replace(
                drawn, time=drawn.time[:2000], missing=drawn.missing[:2000], sensors=draw_sensors(drawn.key)
            )


def made(maker: Callable[..., object], world: World, size: float) -> tuple[World, Truth]:
    draft = maker(world, np.random.default_rng(1))
    return draft.world, draft.at(size)  # type: ignore[attr-defined]


def reported(world: World, truth: Truth) -> tuple[np.ndarray, np.ndarray]:
    """Sun and nadir as the reported attitude has them."""
    clean = noise_free(world, [truth])
    down = -world.where(world.time)[0]
    return clean.R_BN.apply(world.sun(world.time)[0]), clean.R_BN.apply(down / np.linalg.norm(down, axis=1)[:, None])


@pytest.mark.parametrize("maker", [of_place.sun_sensor_head_misalignment, shapes.head_other_view])
def test_a_turned_head_turns_the_sun_as_it_turns_the_attitude(maker, world: World, close: Close) -> None:
    world, truth = made(maker, world, 1.0)
    sun_B, nadir_B = clean_sun(world, [truth]), nadir(clean_roll_pitch(world, [truth]))
    wanted, turned_nadir = reported(world, truth)
    close(sun_B, wanted, atol=SMALL_RAD, unit="1", because="one rotation, by two ways")
    assert np.abs(sun_B - clean_sun(world, [])).max() > 0.005
    close(nadir_B, nadir(clean_roll_pitch(world, [])), atol=SMALL_RAD, unit="1", because="the scanner is not the head")
    assert np.abs(nadir_B - turned_nadir).max() > 0.003


@pytest.mark.parametrize("maker", [of_place.horizon_scanner_bias, shapes.horizon_third])
def test_a_biased_scanner_turns_nadir_as_it_turns_the_attitude(maker, world: World, close: Close) -> None:
    world, truth = made(maker, world, 1.0)
    wanted = reported(world, truth)[1]
    found = nadir(clean_roll_pitch(world, [truth]))
    close(found, wanted, atol=SMALL_RAD, unit="1", because="roll and pitch of the orbital frame, by two ways")
    mirrored = nadir(2.0 * clean_roll_pitch(world, []) - clean_roll_pitch(world, [truth]))
    assert np.abs(mirrored - wanted).max() > 0.005
    close(clean_sun(world, [truth]), clean_sun(world, []), atol=SMALL_RAD, unit="1", because="no head is at fault")


def test_only_faults_of_these_sensors_touch_them(world: World) -> None:
    before = vectors(world, [])
    names = (
        "sun_sensor_head_misalignment",
        "horizon_scanner_bias",
        "yaw_drift",
        "along_track_error",
        "time_tag_offset",
        "ring_current",
        "scale_misalignment",
        "bias_step",
    )
    touched = []
    for name in names:
        _, truth = made(PLAIN[name], world, 0.5)
        if not all(np.array_equal(*pair, equal_nan=True) for pair in zip(vectors(world, [truth]), before, strict=True)):
            touched.append(name)
    assert touched == ["sun_sensor_head_misalignment", "horizon_scanner_bias"]


def test_the_vectors_err_as_drawn(world: World, close: Close) -> None:
    assert world.sensors is not None
    world = dataclasses.replace(world, sensors=dataclasses.replace(world.sensors, sun_lsb_rad=1e-7, nadir_lsb_rad=1e-7))
    sensors = world.sensors
    assert sensors is not None
    sun_B, nadir_B = vectors(world, [])
    seen = spacecraft.head_in_use(world, world.time) > 0
    assert np.array_equal(np.isfinite(sun_B).all(axis=1), seen), "no sun where no head sees it"
    close(np.linalg.norm(sun_B[seen], axis=1), 1.0, atol=1e-12, unit="1", because="unit vectors")
    true = clean_sun(world, [])
    miss = np.linalg.norm(np.cross(sun_B[seen], true[seen]), axis=1)
    rms = float(np.sqrt(np.mean(miss**2))) / sensors.sun_noise_rad
    assert 0.5 < rms < np.sqrt(2.0) * 1.1, "two angles; away from the boresight they span less of the sphere"
    off = nadir(clean_roll_pitch(world, []))
    miss = np.linalg.norm(np.cross(nadir_B, off), axis=1)
    wanted = np.sqrt(2.0 * (sensors.nadir_noise_rad**2 + sensors.nadir_wander_rad**2))
    close(float(np.sqrt(np.mean(miss**2))) / wanted, 1.0, atol=0.25, unit="1", because="wander of few time constants")


def test_wander_has_its_correlation(close: Close) -> None:
    values = wandering(10.0 * np.arange(20000), 50.0, np.random.default_rng(2))
    close(values.std(axis=0), 1.0, atol=0.05, unit="1", because="20,000 rows, 5 rows a time constant: 0.8 % sigma x 5")
    lagged = np.mean(values[5:] * values[:-5])
    close(lagged, np.exp(-1.0), atol=0.05, unit="1", because="one time constant apart")


def test_they_move_nothing_else(world: World) -> None:
    with_them, without = fly(world, ()), fly(dataclasses.replace(world, sensors=None), ())
    assert with_them.sun_B is not None and without.sun_B is None and without.nadir_B is None
    assert np.array_equal(np.asarray(with_them.mag_B_nT), np.asarray(without.mag_B_nT))
    assert np.array_equal(np.asarray(with_them.q_NB), np.asarray(without.q_NB), equal_nan=True)


def test_half_of_those_that_point_to_the_earth_have_them() -> None:
    rng = np.random.default_rng(8)
    share = np.mean([draw_world(rng, "nadir").sensors is not None for _ in range(120)])
    assert 0.35 < share < 0.65  # three sigma of a fair coin
    assert all(draw_world(rng, regime).sensors is None for regime in ("tumble", "slews", "spin") for _ in range(4))


def test_a_sensed_record_comes_twice() -> None:
    one, other = (make_case(3, "sensed", number) for number in (2, 3))
    assert one.world.sensors is not None and other.world.sensors is None
    assert one.identity != other.identity and one.world.key == other.world.key and one.sizes == other.sizes
    assert np.array_equal(
        np.asarray(fly(one.world, one.truths).mag_B_nT), np.asarray(fly(other.world, other.truths).mag_B_nT)
    )
