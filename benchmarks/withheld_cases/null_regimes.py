"""Perfect flights in regimes of their own: what a right diagnosis calls no gap.

Nothing is wrong in any of them but what every record has: noise, steps, an attitude error, and S and b, which are
re-estimated. `nulls` goes through all of them, with everything declared; three are asked without a flag as well, each
as a population of its own.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np

from fluxtwin.sim.base.types import FloatArray, TimeArray
from fluxtwin.sim.earth import epoch, sun
from withheld_cases import worlds
from withheld_cases.draft import direction, sign
from withheld_cases.worlds import Budget, World, between, draw_motion, draw_second, draw_world

ARC_S = 600.0
"""Length of a pass over a station."""
README_LABEL = "scenario of the README"


def passes_only(rng: np.random.Generator, regime: str) -> World:
    """Passes over stations, hours apart, with a fine sensor: the attitude error is all that is left."""
    world = draw_world(rng, regime)
    arcs = int(rng.integers(5, 15))
    begins = np.cumsum(3600.0 * rng.uniform(1.5, 12.0, arcs))
    step = round(float(np.clip(arcs * ARC_S / between(rng, 500.0, 2500.0), 1.0, 12.0)), 1)
    seconds = (begins[:, None] + np.arange(0.0, ARC_S, step)[None, :]).ravel()
    noise = between(rng, 2.0, 6.0)
    budget = Budget(
        noise_nT=round(noise, 2),
        lsb_nT=round(noise * between(rng, 0.1, 0.5), 2),
        attitude_sigma_rad=float(np.radians(round(float(rng.uniform(0.18, 0.27)), 4))),
        attitude_tau_s=between(rng, 200.0, 4000.0),
    )
    cross = direction(rng, 6) / 3.0
    S = np.diag(direction(rng))
    S[~np.eye(3, dtype=bool)] = cross
    S *= float(rng.uniform(0.015, 0.04))  # rms of the three scale errors; a third of it in the cross terms
    return flown(world, rng, epoch.add_seconds(world.orbit.epoch_utc, seconds), budget, S)


def short(rng: np.random.Generator, regime: str) -> World:
    """Few rows, so that a slow attitude error does not average out."""
    world = draw_world(rng, regime)
    period, rows = world.orbit.nodal_period_s, int(rng.integers(300, 601))
    step = round(float(np.clip(period * between(rng, 1.0, 6.0) / rows, 1.0, 60.0)), 1)
    budget = dataclasses.replace(
        world.budget,
        attitude_sigma_rad=float(np.radians(round(between(rng, 0.08, 0.25), 4))),
        attitude_tau_s=between(rng, 300.0, 4000.0),
    )
    return flown(world, rng, epoch.add_seconds(world.orbit.epoch_utc, step * np.arange(rows)), budget, world.S)


def coarse(rng: np.random.Generator, regime: str) -> World:
    """Steps of the readings 7 to 10 times the noise."""
    world = draw_world(rng, regime)
    noise = between(rng, 10.0, 80.0)
    budget = dataclasses.replace(
        world.budget, noise_nT=round(noise, 1), lsb_nT=round(noise * float(rng.uniform(7.0, 10.0)), 1)
    )
    return dataclasses.replace(world, budget=budget)


def flown(world: World, rng: np.random.Generator, time: TimeArray, budget: Budget, S: FloatArray) -> World:
    """The world at other stamps, with a motion for them; every row has its attitude."""
    motion = draw_motion(rng, world.regime, time)
    missing = np.zeros(time.size, dtype=bool)
    return dataclasses.replace(world, time=time, motion=motion, missing=missing, budget=budget, S=S)


def dawn_dusk(rng: np.random.Generator, regime: str) -> World:
    """A sun-synchronous orbit along the terminator, where the sun hardly ever sets.

    Its inclination is that whose node follows the mean sun: cos i = -(a / 12352 km)^(7/2).
    """
    world = draw_world(rng, regime)
    altitude_km = float(rng.uniform(600.0, 800.0))
    x, y, _ = sun.sun_N_km(world.time[:1])[0]
    orbit = dataclasses.replace(
        world.orbit,
        altitude_km=altitude_km,
        eccentricity=0.001,
        inclination_rad=float(np.arccos(-(((6378.137 + altitude_km) / 12352.0) ** 3.5))),
        raan_rad=float(np.mod(np.arctan2(y, x) + sign(rng) * np.pi / 2.0, 2.0 * np.pi)),
    )
    return dataclasses.replace(world, orbit=orbit)


def fifteen_orbits(rng: np.random.Generator, regime: str) -> World:
    """A day without a break."""
    world = draw_world(rng, regime)
    rows = int(between(rng, 1000, 3000))
    seconds = np.round(15.0 * world.orbit.nodal_period_s / rows, 1) * np.arange(rows)
    return flown(world, rng, epoch.add_seconds(world.orbit.epoch_utc, seconds), world.budget, world.S)


def gaps(rng: np.random.Generator, regime: str) -> World:
    """Three to ten stretches are not there, a tenth to a half of the rows in all."""
    world = draw_world(rng, regime)
    rows, count = world.time.size, int(rng.integers(3, 11))
    length = max(2, int(rows * float(rng.uniform(0.1, 0.5)) / count))
    kept = np.ones(rows, dtype=bool)
    for place in range(count):  # one in each part of the record: none runs into another
        begin = rows * place // count + int(rng.integers(1, max(2, rows // count - length)))
        kept[begin : begin + length] = False
    return dataclasses.replace(world, time=world.time[kept], missing=world.missing[kept])


def outliers(rng: np.random.Generator, regime: str) -> World:
    """One reading in a thousand rows, at least one, is off by 10 to 100 times the noise."""
    return dataclasses.replace(draw_world(rng, regime), outlier_share=0.001)


def two_sensors(rng: np.random.Generator, regime: str) -> World:
    """A second magnetometer with errors and noise of its own."""
    world = draw_world(rng, regime)
    return dataclasses.replace(world, second=draw_second(world.key))


def usual(rng: np.random.Generator, regime: str) -> World:
    """As the flights that have a truth."""
    return draw_world(rng, regime)


REGIMES: dict[str, Callable[[np.random.Generator, str], World]] = {
    maker.__name__: maker
    for maker in (passes_only, dawn_dusk, fifteen_orbits, short, coarse, gaps, outliers, two_sensors)
} | {"spin": usual, "slews": usual}
MOTIONS = {"spin": ("spin",), "slews": ("slews",), "fifteen_orbits": ("nadir", "tumble", "slews")}
"""Those that a regime may have, where not all."""
UNDECLARED = ("passes_only", "short", "coarse")
"""Regimes that are asked without a flag too."""
WORDS = {
    "passes_only": "station passes, fine sensor, slow attitude error",
    "dawn_dusk": "dawn-dusk orbit",
    "fifteen_orbits": "15 orbits long",
    "short": "300 to 600 rows, slow attitude error",
    "coarse": "steps 7 to 10 times the noise",
    "gaps": "gaps",
    "outliers": "0.1 % outliers",
    "two_sensors": "two sensors",
    "spin": "spin",
    "slews": "slews",
}


def chosen(population: str, number: int) -> tuple[str, str]:
    """The regime of a case and how its body turns; each motion comes equally often."""
    names = list(REGIMES)
    name, turn = (names[number % len(names)], number // len(names)) if population == "nulls" else (population, number)
    motions = MOTIONS.get(name, worlds.REGIMES)
    return name, motions[turn % len(motions)]


def is_readme(population: str, number: int) -> bool:
    """Whether a null that is asked without a flag is the README's scenario: every second one."""
    return population == "nulls_undeclared" and number % 2 == 0
