"""A second magnetometer in the withheld benchmark: what reaches it of every kind of truth, and what does not."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np
import pytest
from withheld_cases import joining
from withheld_cases.cases import PACKETS, PLAIN, POINTED, TURNING, TWO, answer, make_case, question
from withheld_cases.chain import Truth, fly, noise_free, second_reading_nT
from withheld_cases.outside import OUTSIDE
from withheld_cases.worlds import World, draw_second, shift
from withheld_worlds import small_world

pytestmark = pytest.mark.property

Close = Callable[..., None]
MAKERS = {**PLAIN, **OUTSIDE, "mounting_step": joining.mounting_step}
FIRST_ALONE = ("boom_bending", "mounting_step", "bit_errors")
"""Beside the sensor stage: turns of the first sensor, and bits of its words."""


def drawn(name: str) -> tuple[World, Truth]:
    """A kind at the size where its search begins, in a small world with a second sensor of no noise and 1e-6 nT steps."""
    regime = "nadir" if name in POINTED and name not in TURNING else "slews"
    for seed in range(18):
        world = small_world(regime, seed=seed, rows=300, step_s=3.0 if name in PACKETS else 40.0)
        second = draw_second(world.key)
        perfect = dataclasses.replace(second.budget, noise_nT=0.0, lsb_nT=1e-6)
        world = dataclasses.replace(world, second=dataclasses.replace(second, budget=perfect, spacecraft_factor=0.4))
        draft = MAKERS[name](world, np.random.default_rng(11))
        if draft is not None:
            return draft.world, draft.at(draft.start)
    raise AssertionError(f"{name}: no world shows it")


def at_second(world: World, *truths: Truth) -> np.ndarray:
    """(N, 3) equation 1 of the second sensor, solved back for the field there."""
    assert world.second is not None
    return second_reading_nT(world, truths) @ (np.eye(3) + world.second.S).T + world.second.b_nT


def at_first(world: World, truth: Truth) -> np.ndarray:
    """(N, 3) what a truth adds to the field at the first sensor."""
    return (noise_free(world, [truth]).reading_nT - noise_free(world, ()).reading_nT) @ (np.eye(3) + world.S).T


@pytest.mark.parametrize("name", MAKERS)
def test_each_kind_reaches_the_second_sensor_as_its_stage_says(name: str, close: Close) -> None:
    world, truth = drawn(name)
    bare, found = at_second(world), at_second(world, truth)
    if truth.stage in ("orbit", "attitude", "sensor") or name in FIRST_ALONE:
        assert np.array_equal(found, bare)
        spoiled, plain = fly(world, [truth]), fly(world, ())
        moved = [
            k for k in ("mag_B_nT", "r_N_km", "q_NB") if not np.array_equal(getattr(spoiled, k), getattr(plain, k))
        ]
        assert moved == [{"orbit": "r_N_km", "attitude": "q_NB"}.get(truth.stage, "mag_B_nT")]
    elif truth.stage == "time":
        assert truth.clock is not None
        then = dataclasses.replace(world, time=shift(world.time, truth.clock(world, world.time)))
        close(found, at_second(then), atol=1e-3, unit="nT", because="the same instants")
        assert np.abs(found - bare).max() > 5.0, "at its stamps it would have read something else"
    elif truth.stage == "telemetry":
        good, bad = (np.hstack([fly(world, t).mag_B_nT, fly(world, t).mag2_B_nT]) for t in ((), [truth]))
        kept = {tuple(row) for row in good}
        assert all(tuple(row) in kept for row in bad), "both readings of a row go together"
        assert not np.array_equal(good[:, 3:], bad[:, 3:])
    else:
        factor = {"field": 1.0, "spacecraft": 0.4}[truth.stage]
        wanted = factor * at_first(world, truth)
        close(found - bare, wanted, atol=1e-4, unit="nT", because="steps of 1e-6 nT, rounding of 5e4 nT")
        assert np.abs(wanted).max() > 1.0


def test_a_second_sensor_is_drawn_by_itself(close: Close) -> None:
    seconds = [draw_second(key) for key in range(400)]
    factors = np.array([one.spacecraft_factor for one in seconds])
    assert 0.0 <= factors.min() < 0.05 and 0.65 < factors.max() <= 0.7
    close(factors.mean(), 0.35, atol=0.04, unit="1", because="uniform: sigma 0.01, four of them")
    close(np.std([one.b_nT for one in seconds]), 1000.0, atol=120.0, unit="nT", because="1200 draws: sigma 20")
    assert len({one.budget.noise_nT for one in seconds}) > 300


@pytest.mark.parametrize(("population", "number"), [("outside_two", 13), ("singles_two", 20), ("singles_two", 2)])
def test_the_same_flight_has_a_second_magnetometer_and_nothing_else(population: str, number: int) -> None:
    two, one = make_case(4, population, number), make_case(4, TWO[population], number)
    more, less = fly(two.world, two.truths), fly(one.world, one.truths)
    assert less.mag2_B_nT is None and np.isfinite(more.mag2_B_nT).all()
    for name in ("time", "mag_B_nT", "r_N_km", "q_NB", "sunlit", "dipole_B_Am2"):
        assert np.array_equal(getattr(more, name), getattr(less, name), equal_nan=name == "q_NB"), name
    full, bare = question(two), question(one)
    assert full.pop("case") != bare.pop("case") and full == bare
    sealed, plain = answer(two), answer(one)
    assert sealed["truths"] == plain["truths"] and "second_magnetometer" not in plain
    assert sealed["second_magnetometer"]["spacecraft_factor"] == two.world.second.spacecraft_factor  # type: ignore[union-attr]
