"""What every effect is: a small frozen object with a name, a stage and parameters, for which zero is absent.

The same object switches the effect on in the simulation (`apply`) and gives the diagnosis its Jacobian (the
difference of the noise-free chain), so what can be diagnosed can by construction be simulated.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from fluxtwin.sim.base.types import BoolArray, FloatArray
from fluxtwin.sim.earth import epoch
from fluxtwin.sim.effects.signal import Setting, Signal

if TYPE_CHECKING:
    from fluxtwin.sim.spacecraft.dynamics.vehicle import Vehicle

STAGES = ("dynamics", "time", "orbit", "field", "attitude", "spacecraft", "sensor", "telemetry")
"""In the order in which nature applies them."""
MATRIX = tuple(row + column for row in "xyz" for column in "xyz")
"""Places of a matrix, row by row: xx, xy, ... zz."""


@dataclass(frozen=True)
class Parameter:
    """One number that says how large an effect is."""

    name: str
    unit: str
    scale: float
    """A typical size: the step of the Jacobian."""
    low: float = -np.inf
    high: float = np.inf
    """Physical range."""


@dataclass(frozen=True)
class Effect(ABC):
    """Base of all effects. Fields of a subclass are its discrete settings (a degree, a head, a condition)."""

    name: ClassVar[str]
    stage: ClassVar[str]
    about: ClassVar[str]
    """What reality does, what + means, and the source of the model."""
    frame: ClassVar[str | None] = "body"
    """The frame in which it is coherent: body, orbital or earth; None: in none of them."""
    follows: ClassVar[str | None] = None
    """The condition of a diagnosis that it follows; None: none of them."""
    settled_by: ClassVar[str]
    """The manoeuvre, or the data, that would show it best. From a study of confusions over five designs: nadir pointing for
    one and for six orbits, inertial hold, a tumble of 0.25 deg/s, a spin of 2 rpm; the tumble gains three to ten times on
    what nadir geometry hides in bias and matrix."""
    equivalent_stages: ClassVar[tuple[str, ...]] = ()
    by_definition: ClassVar[bool] = False
    """Whether its form is a definition and no model of nature: it has no shape error, so that a law that explains more
    takes its place."""
    keyed_by: ClassVar[str | None] = None
    """The setting (a text) that tells effects of this class apart and is part of their names, as in `driver.payload`."""

    def __init_subclass__(cls) -> None:
        """Raise TypeError for an effect that leaves out one of the above that have no default."""
        super().__init_subclass__()
        missing = [attribute for attribute in ("stage", "about", "settled_by") if not hasattr(cls, attribute)]
        if hasattr(cls, "name") and missing:
            raise TypeError(f"the effect {cls.name} does not say its {', '.join(missing)}")

    def __post_init__(self) -> None:
        """One of several of its kind has a name of its own."""
        key = "" if self.keyed_by is None else getattr(self, self.keyed_by)
        if key:
            object.__setattr__(self, "name", f"{self.family}.{key}")

    @property
    def family(self) -> str:
        """The name that all effects of this class share, and the catalogue has."""
        return type(self).name

    @property
    def title(self) -> str:
        """What it is, in a few words for a person."""
        return (type(self).__doc__ or "").split("\n")[0].rstrip(".")

    @property
    @abstractmethod
    def parameters(self) -> tuple[Parameter, ...]:
        """Its parameters, in the order of `theta`."""

    def instances(self, setting: Setting) -> tuple[Effect, ...]:
        """The effects of this kind that a design may have, each with a name of its own; just itself for most."""
        return (self,)

    def alternatives(self, setting: Setting) -> tuple[Effect, ...]:
        """The discrete settings worth trying on this design; just itself for most."""
        return (self,)

    def modulates(self, setting: Setting) -> tuple[Effect, FloatArray] | None:
        """An effect with as many parameters, or with one, and numbers (N, 1), or (N, p): its image times these, row by row,
        is that of this one, but for what remembers earlier rows. None: this one's image is its own."""
        return None

    @property
    def forms(self) -> tuple[Effect, ...]:
        """One for each set of parameters that a setting gives it; just itself for most."""
        return (self,)

    def condition_on(self, setting: Setting) -> str | None:
        """The condition that it follows on this design, with these settings."""
        return self.follows

    def stands_in(self, setting: Setting) -> str:
        """Of what its parameters are the field, in words, where something that is assumed stands in for a current that was
        not recorded; else empty."""
        return ""

    def parameters_on(self, setting: Setting) -> tuple[Parameter, ...]:
        """Its parameters in their units on this design: nothing is per ampere of a current that nobody recorded."""
        if not self.stands_in(setting):
            return self.parameters
        return tuple(replace(one, unit=one.unit.removesuffix("/A")) for one in self.parameters)

    def untestable(self, setting: Setting) -> str | None:
        """Why this design cannot show the effect at all, in words; None when it can."""
        return None

    def invented(self, setting: Setting) -> BoolArray:
        """(N,) rows in which a recorded column that it follows is missing, so that what it does is invented."""
        return np.zeros(setting.time.size, dtype=np.bool_)

    def pinned(self, setting: Setting, reading_B_nT: FloatArray) -> Effect:
        """The same effect with whatever it takes from this record written down, so that another record changes nothing.

        reading_B_nT: (N, 3) noise-free readings of the record without this effect.
        """
        return self

    def between(self, setting: Setting, ratio: float) -> Effect | None:
        """The effect with a setting moved by a ratio that `alternatives` tries at a few values only; None: it has none."""
        return None

    def variants(self, setting: Setting) -> tuple[Effect, ...]:
        """The effect with one more setting of which `alternatives` tries one value only."""
        return ()

    def suggested(self, setting: Setting, theta: FloatArray) -> tuple[SignalEffect, ...]:
        """Effects with fewer parameters that may be what was found with these, or other names for it."""
        return ()

    @property
    def bound(self) -> str | None:
        """Why its parameters say nothing of another record, in words; None when they do."""
        return None


@dataclass(frozen=True)
class SignalEffect(Effect):
    """An effect that changes the signal in a way that repeats."""

    after_noise: ClassVar[bool] = False
    """Whether it acts on readings that have their noise already, after everything else in its stage."""
    adds: ClassVar[bool] = False
    """Whether all it does is to add something to the reading, in proportion to its parameters, whatever the reading is."""

    @abstractmethod
    def apply(self, signal: Signal, theta: FloatArray) -> Signal:
        """The signal with the effect in it; theta = 0 is identity."""

    def images(self, signal: Signal, theta: FloatArray) -> FloatArray | None:
        """(N, 3, p) derivative by its parameters, at theta, of the reading that it makes of a signal; None: only differences
        tell."""
        if not self.adds:
            return None
        units = np.eye(len(self.parameters))
        return np.stack([self.apply(signal, unit).reading - signal.reading for unit in units], axis=-1)

    def carried(self, signal: Signal, theta: FloatArray, images: FloatArray) -> FloatArray | None:
        """What it makes, at theta, of small changes (N, 3, p) of a signal's reading; None: only differences tell."""
        return images if self.adds else None


@dataclass(frozen=True)
class SpacecraftField(SignalEffect):
    """Base of the fields of the spacecraft itself, most of them in proportion to a series."""

    stage = "spacecraft"

    def values(self, setting: Setting) -> FloatArray | None:
        """(N,) what the field follows, (N, 3) where its parameters are a matrix; None when nothing tells."""
        raise NotImplementedError

    def apply(self, signal: Signal, theta: FloatArray) -> Signal:
        setting = signal.setting
        values = setting.once(self, lambda: self.values(setting))  # a fit asks for the same one thousands of times
        if values is None:
            return signal
        field = values[:, None] * theta if values.ndim == 1 else mapped(theta.reshape(3, 3), values)
        return signal.with_stray(field)


@dataclass(frozen=True)
class DistributionEffect(Effect):
    """An effect that is known by its distribution only."""

    after_rounding: ClassVar[bool] = False
    """Whether it acts on readings that have their noise and are saturated and rounded already."""

    @abstractmethod
    def draw(self, signal: Signal, theta: FloatArray, rng: np.random.Generator) -> Signal:
        """The signal with one draw of the effect in it; theta = 0 is identity."""


@dataclass(frozen=True)
class DynamicsEffect(Effect):
    """An effect that turns the body: it moves the attitude itself, not what is reported of it.

    It acts in attitude mode dynamics; a diagnosis sees it in the balance of the momentum.
    """

    stage = "dynamics"

    @abstractmethod
    def on(self, vehicle: Vehicle, theta: FloatArray) -> Vehicle:
        """The vehicle with the effect in it; theta = 0 is identity."""

    def step(self, vehicle: Vehicle) -> FloatArray:
        """(p,) sizes that change this vehicle's motion a little: steps of derivatives."""
        return np.array([parameter.scale for parameter in self.parameters])

    def idle(self, vehicle: Vehicle) -> str | None:
        """Why it has nothing to act on in this vehicle, in words; None when it has."""
        return None


def vector_parameters(
    prefix: str,
    unit: str,
    scale: float,
    low: float = -np.inf,
    high: float = np.inf,
    axes: Iterable[str] = "xyz",
) -> tuple[Parameter, ...]:
    """One parameter an axis, or a place of a matrix, alike but for the name: prefix_x, prefix_y, prefix_z."""
    return tuple(Parameter(f"{prefix}_{axis}", unit, scale, low, high) for axis in axes)


def elapsed_s(setting: Setting, since: str | None) -> FloatArray:
    """(N,) seconds since a moment (ISO 8601 UTC), or since the first row."""
    start = setting.time[0] if since is None else epoch.parse_time(since, where="since")
    return epoch.seconds_since(setting.time, start)


GOES_ON = "the drift was found in this record: whether it continues at this rate is not known"
"""Why a rate says nothing of another record."""


def known_column(setting: Setting, name: str) -> FloatArray | None:
    """A recorded column with gaps filled by their neighbours (held), or None when absent or wholly missing."""
    column = setting.column(name)
    return None if column is None else held(column)


def held(column: FloatArray) -> FloatArray | None:
    """A column (N,) or (N, k) with gaps filled by the value before (at the start: after), or None if all are gaps."""
    finite = np.isfinite(column) if column.ndim == 1 else np.isfinite(column).all(axis=1)
    if not finite.any():
        return None
    latest = np.maximum.accumulate(np.where(finite, np.arange(finite.size), 0))
    latest[: int(np.argmax(finite))] = int(np.argmax(finite))
    return np.asarray(column[latest])


def in_reading(setting: Setting, field_B_nT: FloatArray) -> FloatArray:
    """(I + S)^-1 times a field (3,) or (N, 3): what equation 1 makes of it in the reading."""
    field = np.asarray(field_B_nT)
    if not setting.instrument.S.any():
        return np.array(field, dtype=np.float64)
    inverse = np.asarray(np.linalg.inv(np.eye(3) + setting.instrument.S), dtype=np.float64)
    return inverse @ field if field.ndim == 1 else mapped(inverse, field)


def mapped(matrix: FloatArray, vectors: FloatArray) -> FloatArray:
    """(N, m) matrix (m, k) times each row of vectors (N, k), on one core: a threaded product of such a shape is slow."""
    return np.asarray(np.einsum("nk,mk->nm", vectors, matrix))
