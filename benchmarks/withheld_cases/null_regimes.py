"""Perfect flights in regimes of their own: what a right diagnosis calls no gap.

Nothing is wrong in any of them but what every record has: noise, steps, an attitude error, and S and b, which are
re-estimated. Each flight of a regime is asked twice, with its noise declared (even numbers) and without a flag (odd).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np

from fluxtwin.sim.base.types import FloatArray, TimeArray
from fluxtwin.sim.earth import epoch
from withheld_cases.draft import direction
from withheld_cases.worlds import Budget, World, between, draw_motion, draw_world

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


REGIMES: dict[str, Callable[[np.random.Generator, str], World]] = {
    maker.__name__: maker for maker in (passes_only, short, coarse)
}


def is_readme(population: str, number: int) -> bool:
    """Whether a null that is asked without a flag is the README's scenario: every second one."""
    return population == "nulls_undeclared" and number % 2 == 0
