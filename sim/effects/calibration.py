"""What a calibration does not know of the magnetometer, constant or not: S and b of equation 1."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar, Literal, Self

import numpy as np
from scipy.spatial.transform import Rotation

from fluxtwin.sim.base.late import stretches
from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.earth import epoch
from fluxtwin.sim.effects.base import (
    GOES_ON,
    MATRIX,
    DistributionEffect,
    Effect,
    Parameter,
    SignalEffect,
    elapsed_s,
    in_reading,
    mapped,
    vector_parameters,
)
from fluxtwin.sim.effects.signal import Setting, Signal


@dataclass(frozen=True)
class Bias(SignalEffect):
    """A constant error of the reading."""

    name = "bias"
    stage = "sensor"
    settled_by = "a slow tumble of 0.25 deg/s"
    equivalent_stages = ("spacecraft",)
    adds = True
    about = "the bias b of A B0 = (I+S) B + b + T D (Lerner & Shuster 1981, eq. 1); + lowers the reading"
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
    follows = "field_strength"
    settled_by = "a slow tumble of 0.25 deg/s"
    equivalent_stages = ("attitude",)
    about = (
        "S of A B0 = (I+S) B + b + T D (Lerner & Shuster 1981, eq. 1), row by row; + on the diagonal lowers the reading"
    )
    parameters = vector_parameters("S", "1", 0.01, -0.5, 0.5, axes=MATRIX)

    def apply(self, signal: Signal, theta: FloatArray) -> Signal:
        return signal.with_reading(mapped(self._change(signal.setting, theta), signal.reading))

    def images(self, signal: Signal, theta: FloatArray) -> FloatArray:
        inverse = np.linalg.inv(np.eye(3) + signal.setting.instrument.S + theta.reshape(3, 3))
        images = np.einsum("ai,nj->naij", -inverse, self.apply(signal, theta).reading)
        return np.asarray(images.reshape(signal.rows, 3, 9))

    def carried(self, signal: Signal, theta: FloatArray, images: FloatArray) -> FloatArray:
        return np.asarray(self._change(signal.setting, theta) @ images)

    def _change(self, setting: Setting, theta: FloatArray) -> FloatArray:
        """(3, 3) by which the reading is multiplied."""
        nominal = np.eye(3) + setting.instrument.S
        return np.asarray(np.linalg.solve(nominal + theta.reshape(3, 3), nominal), dtype=np.float64)


@dataclass(frozen=True)
class Step(SignalEffect):
    """Base of what happens at a moment and stays: nothing before `at`, all of it from then on."""

    follows = "after_time"
    grid: ClassVar[int]
    """Moments that are tried, spread evenly over the rows."""
    becomes: ClassVar[str]
    """What it is once it has happened."""
    at: str | None = None
    """ISO 8601 UTC; None: the middle row."""

    def alternatives(self, setting: Setting) -> tuple[Self, ...]:
        """Moments spread evenly over the rows, at a row each, or where the rows go on after a gap near it: most of the time
        may lie in gaps, and what happened there is one moment. The given one alone where there is one."""
        rows = setting.time.size
        if self.at is not None or rows < 3:
            return (self,)
        number = np.linspace(0, rows, self.grid + 2)[1:-1].round().astype(int)
        again = np.flatnonzero(np.diff(stretches(setting.seconds))) + 1
        if again.size:
            nearest = again[np.abs(again - number[:, None]).argmin(axis=1)]
            number = np.where(2 * np.abs(nearest - number) * (self.grid + 1) <= rows, nearest, number)
        return tuple(
            replace(self, at=epoch.iso(setting.time[row], "ms")) for row in np.unique(number) if 0 < row < rows
        )

    def variants(self, setting: Setting) -> tuple[Self, ...]:
        """The moment moved to either side by half the distance between those that are tried, by half of that, and so on to
        one row: a moment that is off leaves the whole step in the rows between."""
        if self.at is None:
            return ()
        rows = setting.time.size
        row = int(np.searchsorted(setting.time, epoch.parse_time(self.at, where=self.name)))
        moves = 2 ** np.arange(int(np.log2(max(rows / (self.grid + 1), 1.0))), -1, -1)
        moved = np.clip(row + np.column_stack([moves, -moves]).ravel(), 1, rows - 1)
        return tuple(replace(self, at=epoch.iso(setting.time[to], "ms")) for to in moved)

    def after(self, setting: Setting) -> FloatArray:
        """(N,) 0 before the moment, 1 from it on."""
        moment = setting.time[setting.time.size // 2] if self.at is None else epoch.parse_time(self.at, where=self.name)
        return (setting.time >= moment).astype(np.float64)

    def modulates(self, setting: Setting) -> tuple[Effect, FloatArray]:
        return replace(self, at=epoch.iso(setting.time[0], "ms")), self.after(setting)[:, None]

    def untestable(self, setting: Setting) -> str | None:
        after = self.after(setting)
        return None if 0.0 < after.mean() < 1.0 else "the moment lies outside the record"

    @property
    def bound(self) -> str:
        moment = "once" if self.at is None else f"once, at {self.at}"
        return f"it happened {moment}: later it is a constant {self.becomes}, and whether it happens again is not known"

    def pinned(self, setting: Setting, reading_B_nT: FloatArray) -> Self:
        middle = epoch.iso(setting.time[setting.time.size // 2], "ms")
        return self if self.at is not None else replace(self, at=middle)


@dataclass(frozen=True)
class BiasStep(Step):
    """The bias jumps at a moment and stays there."""

    name = "bias_step"
    stage = "sensor"
    settled_by = "data from well before and well after the jump"
    equivalent_stages = ("spacecraft",)
    about = (
        "the bias is b of eq. 1; + lowers the reading from then on "
        "(additive jump: Willsky & Jones 1976, doi 10.1109/TAC.1976.1101146)"
    )
    adds = True
    grid, becomes = 31, "part of b"
    parameters = vector_parameters("b", "nT", 100.0)

    def apply(self, signal: Signal, theta: FloatArray) -> Signal:
        shift = in_reading(signal.setting, theta)
        return signal.with_reading(signal.reading - self.after(signal.setting)[:, None] * shift)


class TurningStep(Step):
    """Base of the steps that turn something."""

    grid, becomes = 7, "turn"
    # Mounting errors before alignment in flight: Wertz 1978, section 7.1.
    parameters = vector_parameters("turn", "deg", 0.5, -180.0, 180.0)

    def turns_rad(self, setting: Setting, theta: FloatArray) -> FloatArray:
        """(N, 3) rotation vectors, body axes."""
        return np.asarray(np.outer(self.after(setting), np.radians(theta)))


@dataclass(frozen=True)
class MountingStep(TurningStep):
    """The sensor rotates on its mount at a moment.

    + turns the sensor's axes right-handed about the body axis, so the field in them turns the other way: the ambient one and
    the spacecraft's. To a magnetometer alone it is `attitude_step`, but for the spacecraft's field.
    """

    name = "mounting_step"
    stage = "sensor"
    settled_by = "another attitude sensor or a second magnetometer, which show whether they were rotated as well"
    equivalent_stages = ("attitude", "spacecraft")
    about = (
        "the sensor's axes are rotated from a moment on by this rotation vector, body axes (a hinge that slips, a boom "
        "that latches; mounting errors before alignment in flight are tenths of a degree: Wertz 1978, section 7.1)"
    )

    def apply(self, signal: Signal, theta: FloatArray) -> Signal:
        at_sensor = signal.at_sensor_B_nT
        turned = Rotation.from_rotvec(-self.turns_rad(signal.setting, theta)).apply(at_sensor)
        return signal.with_reading(signal.reading + in_reading(signal.setting, turned - at_sensor))

    def carried(self, signal: Signal, theta: FloatArray, images: FloatArray) -> FloatArray:
        return images


@dataclass(frozen=True)
class LinearDrift(SignalEffect):
    """The bias or the scale drifts with time."""

    name = "linear_drift"
    stage = "sensor"
    follows = "time"
    settled_by = "a longer record, in a slow tumble of 0.25 deg/s"
    equivalent_stages = ("spacecraft",)
    about = (
        "the bias b of eq. 1 (of = bias), or the diagonal of its S (of = scale), grows in proportion to time;"
        " + lowers the reading (ageing: THEMIS's fluxgates were to keep within 0.2 nT in 12 h, Auster et al. "
        "2008, doi 10.1007/s11214-008-9365-9; the typical size is that of a sensor a hundred times worse)"
    )
    of: Literal["bias", "scale"] = "bias"
    since: str | None = None
    """ISO 8601 UTC of no drift; None: the first row."""

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        if self.of == "bias":
            return vector_parameters("b", "nT/day", 40.0)
        return vector_parameters("S", "1/day", 1e-3, -0.5, 0.5, axes=("xx", "yy", "zz"))

    @property
    def forms(self) -> tuple[LinearDrift, ...]:
        return (replace(self, of="bias"), replace(self, of="scale"))

    def alternatives(self, setting: Setting) -> tuple[LinearDrift, ...]:
        return self.forms if self == LinearDrift() else (self,)

    bound = GOES_ON

    def untestable(self, setting: Setting) -> str | None:
        return "one row alone shows no drift" if setting.time.size < 2 else None

    def pinned(self, setting: Setting, reading_B_nT: FloatArray) -> LinearDrift:
        return self if self.since is not None else replace(self, since=epoch.iso(setting.time[0], "ms"))

    def apply(self, signal: Signal, theta: FloatArray) -> Signal:
        days = elapsed_s(signal.setting, self.since) / 86400.0
        if self.of == "bias":
            return signal.with_reading(signal.reading - np.outer(days, in_reading(signal.setting, theta)))
        return signal.with_reading(rescaled(signal.setting, signal.reading, np.outer(days, theta)))

    def carried(self, signal: Signal, theta: FloatArray, images: FloatArray) -> FloatArray:
        if self.of == "bias":
            return images
        days = elapsed_s(signal.setting, self.since) / 86400.0
        return rescaled(signal.setting, images, np.outer(days, theta))


def rescaled(setting: Setting, columns: FloatArray, change: FloatArray) -> FloatArray:
    """Readings (N, 3), or changes of them (N, 3, p), with the diagonal of S larger by `change` (N, 3):
    (I + S + diag)^-1 (I + S) times them."""
    nominal = np.eye(3) + setting.instrument.S
    changed = nominal + change[:, :, None] * np.eye(3)
    wide = columns if columns.ndim == 3 else columns[:, :, None]
    return np.asarray(np.linalg.solve(changed, nominal @ wide).reshape(columns.shape))


@dataclass(frozen=True)
class BiasRandomWalk(DistributionEffect):
    """The bias does a random walk on each axis.

    b of equation 1 starts from zero at the first row.
    """

    name = "bias_random_walk"
    stage = "sensor"
    follows = "time"
    settled_by = "a slow tumble of 0.25 deg/s"
    equivalent_stages = ("spacecraft",)
    about = "the bias b of eq. 1 wanders, its variance growing by rate^2 a second (rate random walk of IEEE Std 952)"
    parameters = (Parameter("rate", "nT/sqrt(s)", 1.0, 0.0),)
    bound = "a walk takes another path each time: only its rate is carried over"

    def draw(self, signal: Signal, theta: FloatArray, rng: np.random.Generator) -> Signal:
        steps = rng.standard_normal((signal.rows, 3))
        size = theta[0] * np.sqrt(np.diff(signal.setting.seconds, prepend=0.0))
        walk = np.cumsum(size[:, None] * steps, axis=0)
        return signal.with_reading(signal.reading - in_reading(signal.setting, walk))
