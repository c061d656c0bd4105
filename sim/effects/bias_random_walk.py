"""A bias that wanders."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.effects.base import DistributionEffect, Parameter
from fluxtwin.sim.effects.instrument import in_reading
from fluxtwin.sim.effects.signal import Signal


@dataclass(frozen=True)
class BiasRandomWalk(DistributionEffect):
    """The bias does a random walk on each axis.

    b of equation 1 does a random walk on each axis, from zero at the first row.
    """

    name: ClassVar[str] = "bias_random_walk"
    stage: ClassVar[str] = "sensor"
    frame: ClassVar[str | None] = "body"
    follows: ClassVar[str | None] = "time"
    settled_by: ClassVar[str] = "a slow tumble of 0.25 deg/s"
    equivalent_stages: ClassVar[tuple[str, ...]] = ("spacecraft",)
    about: ClassVar[str] = (
        "b of eq. 1 wanders, its variance growing by rate^2 a second (rate random walk of IEEE Std 952)"
    )

    parameters = (Parameter("rate", "nT/sqrt(s)", 1.0, 0.0),)

    @property
    def bound(self) -> str:
        return "a walk takes another path each time: only its rate is carried over"

    def draw(self, signal: Signal, theta: FloatArray, rng: np.random.Generator) -> Signal:
        steps = rng.standard_normal((signal.rows, 3))
        size = theta[0] * np.sqrt(np.diff(signal.setting.seconds, prepend=0.0))
        walk = np.cumsum(size[:, None] * steps, axis=0)
        return signal.with_reading(signal.reading - in_reading(signal.setting, walk))
