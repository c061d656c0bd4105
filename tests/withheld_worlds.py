"""Small worlds for the tests of the withheld benchmark."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
from withheld_cases.chain import Truth
from withheld_cases.worlds import OPTIONAL, World, draw_motion, draw_world

from fluxtwin.sim.earth import epoch


def small_world(regime: str = "nadir", step_s: float = 30.0, rows: int = 240, seed: int = 3) -> World:
    """A sun-synchronous flight with eclipses, every column recorded, no row without attitude."""
    world = draw_world(np.random.default_rng(seed), regime)
    start = np.datetime64("2012-03-20T10:00:00", "ns")
    time = epoch.add_seconds(start, step_s * np.arange(rows))
    orbit = dataclasses.replace(
        world.orbit,
        epoch_utc=start,
        altitude_km=650.0,
        eccentricity=0.001,
        inclination_rad=np.radians(97.8),
        raan_rad=0.4,
    )
    return dataclasses.replace(
        world,
        orbit=orbit,
        time=time,
        motion=draw_motion(np.random.default_rng(seed), regime, time),
        recorded=frozenset(OPTIONAL),
        missing=np.zeros(rows, dtype=bool),
    )


def drawn(maker: Any, world: World, size: float, seed: int = 11) -> tuple[World, Truth]:
    """A truth of that size in the world as the maker wants it."""
    draft = maker(world, np.random.default_rng(seed))
    assert draft is not None, maker.__name__
    return draft.world, draft.at(size)
