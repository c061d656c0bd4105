"""What a calibration does not know of the magnetometer, constant or not: S and b of equation 1."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.earth import epoch
from fluxtwin.sim.effects.base import (
    MATRIX,
    DistributionEffect,
    Parameter,
    SignalEffect,
    in_reading,
    mapped,
    vector_parameters,
)
from fluxtwin.sim.effects.signal import Setting, Signal

_GRID = 31


@dataclass(frozen=True)
class Bias(SignalEffect):
    """A constant error of the reading.

    b of equation 1: reading and true field differ by a constant.
    """

    name = "bias"
    stage = "sensor"
    frame = "body"
    follows = None
    settled_by = "a slow tumble of 0.25 deg/s"
    equivalent_stages = ("spacecraft",)
    about = "b of A B0 = (I+S) B + b + T D (Lerner & Shuster 1981, eq. 1); + lowers the reading"
    parameters = vector_parameters("b", "nT", 100.0)

    def apply(self, signal: Signal, theta: FloatArray) -> Signal:
        matrix = np.eye(3) + signal.setting.instrument.S
        return signal.with_reading(signal.reading - np.linalg.solve(matrix, theta))


@dataclass(frozen=True)
class ScaleMisalignment(SignalEffect):
    """Errors of scale, skewness and mounting.

    S of equation 1, beyond the baseline's: reading (I + S + dS)^-1 (I + S) B.
    """

    name = "scale_misalignment"
    stage = "sensor"
    frame = "body"
    follows = "field_strength"
    settled_by = "a slow tumble of 0.25 deg/s"
    equivalent_stages = ("attitude",)
    about = (
        "S of A B0 = (I+S) B + b + T D (Lerner & Shuster 1981, eq. 1), row by row; + on the diagonal lowers the reading"
    )
    parameters = vector_parameters("S", "1", 0.01, -0.5, 0.5, axes=MATRIX)

    def apply(self, signal: Signal, theta: FloatArray) -> Signal:
        nominal = np.eye(3) + signal.setting.instrument.S
        change = np.asarray(np.linalg.solve(nominal + theta.reshape(3, 3), nominal), dtype=np.float64)
        return signal.with_reading(mapped(change, signal.reading))


@dataclass(frozen=True)
class BiasStep(SignalEffect):
    """The bias jumps at a moment and stays there.

    b of equation 1 is larger from `at` on.
    """

    name = "bias_step"
    stage = "sensor"
    frame = "body"
    follows = "after_time"
    settled_by = "data from well before and well after the jump"
    equivalent_stages = ("spacecraft",)
    about = (
        "b of eq. 1 jumps at a moment and stays; + lowers the reading from then on "
        "(additive jump: Willsky & Jones 1976, doi 10.1109/TAC.1976.1101146)"
    )
    at: str | None = None
    """ISO 8601 UTC; None: the middle row."""

    parameters = vector_parameters("b", "nT", 100.0)

    def alternatives(self, setting: Setting) -> tuple[BiasStep, ...]:
        """Moments spread evenly over the rows, at a row each; the given one alone where there is one."""
        rows = setting.time.size
        if self.at is not None or rows < 3:
            return (self,)
        number = np.unique(np.linspace(0, rows, _GRID + 2)[1:-1].round().astype(int))
        return tuple(replace(self, at=epoch.iso(setting.time[row], "ms")) for row in number if 0 < row < rows)

    def after(self, setting: Setting) -> FloatArray:
        """(N,) 0 before the jump, 1 from it on."""
        moment = setting.time[setting.time.size // 2] if self.at is None else epoch.parse_time(self.at, where=self.name)
        return (setting.time >= moment).astype(np.float64)

    def untestable(self, setting: Setting) -> str | None:
        after = self.after(setting)
        return None if 0.0 < after.mean() < 1.0 else "the moment lies outside the record"

    def pinned(self, setting: Setting, reading_B_nT: FloatArray) -> BiasStep:
        middle = epoch.iso(setting.time[setting.time.size // 2], "ms")
        return self if self.at is not None else replace(self, at=middle)

    @property
    def bound(self) -> str:
        moment = "once" if self.at is None else f"once, at {self.at}"
        return f"it happened {moment}: later it is a constant part of b, and whether it happens again is not known"

    def apply(self, signal: Signal, theta: FloatArray) -> Signal:
        shift = in_reading(signal.setting, theta)
        return signal.with_reading(signal.reading - self.after(signal.setting)[:, None] * shift)


@dataclass(frozen=True)
class BiasRandomWalk(DistributionEffect):
    """The bias does a random walk on each axis.

    b of equation 1 starts from zero at the first row.
    """

    name = "bias_random_walk"
    stage = "sensor"
    frame = "body"
    follows = "time"
    settled_by = "a slow tumble of 0.25 deg/s"
    equivalent_stages = ("spacecraft",)
    about = "b of eq. 1 wanders, its variance growing by rate^2 a second (rate random walk of IEEE Std 952)"
    parameters = (Parameter("rate", "nT/sqrt(s)", 1.0, 0.0),)
    bound = "a walk takes another path each time: only its rate is carried over"

    def draw(self, signal: Signal, theta: FloatArray, rng: np.random.Generator) -> Signal:
        steps = rng.standard_normal((signal.rows, 3))
        size = theta[0] * np.sqrt(np.diff(signal.setting.seconds, prepend=0.0))
        walk = np.cumsum(size[:, None] * steps, axis=0)
        return signal.with_reading(signal.reading - in_reading(signal.setting, walk))
