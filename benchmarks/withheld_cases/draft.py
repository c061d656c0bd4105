"""A truth before its size is known, and small tools that the forward models share."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from fluxtwin.sim.base.types import FloatArray
from withheld_cases.chain import Truth
from withheld_cases.worlds import World


@dataclass(frozen=True)
class Draft:
    """A truth with everything drawn but its size."""

    world: World
    """The world, with what the truth needs of it (a column, a noise level)."""
    at: Callable[[float], Truth]
    low: float
    high: float
    """Physical range of the size."""
    start: float
    measure: Callable[[World, Truth], float] | None = None
    """Visible size of a truth that is no signal; None: `visible`."""
    as_drawn: bool = False
    """Its size is `start`, however visible that is."""


Maker = Callable[[World, np.random.Generator], Draft | None]
"""World and generator to a draft; None where this world cannot show the effect."""


def direction(rng: np.random.Generator, count: int = 3) -> FloatArray:
    """A random vector of rms 1 per element."""
    vector = rng.standard_normal(count)
    unit: FloatArray = vector / np.sqrt(np.mean(vector**2))
    return unit


def sign(rng: np.random.Generator) -> float:
    """Plus or minus one."""
    return float(rng.choice([-1.0, 1.0]))


def recording(world: World, *names: str) -> World:
    """The world with these columns in the record."""
    return dataclasses.replace(world, recorded=world.recorded | frozenset(names))


def followed(world: World) -> World:
    """The world with a gyro in the record where the body turns more than a radian from row to row.

    Attitudes so far apart do not say which way and how often the body has turned in between, and a cause that acts on
    what happens between the stamps cannot be known from the record at all.
    """
    turn = 2.0 * np.pi * world.step_s / world.turn_period_s()
    return recording(world, "rate_B_rad_s") if turn > 1.0 else world


def share(mask: FloatArray) -> float:
    """Share of rows where it is not zero."""
    return float(np.mean(np.asarray(mask) != 0))


def changes(state: FloatArray) -> int:
    """How often it changes from row to row."""
    return int(np.count_nonzero(np.diff(state)))


def listed(values: FloatArray) -> list[float]:
    """Numbers for the answer file."""
    return [float(f"{value:.8g}") for value in np.ravel(values)]
