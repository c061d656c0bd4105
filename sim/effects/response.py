"""How the magnetometer answers a field: curved, late, with a memory, or not beyond full scale."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache, partial, reduce
from itertools import combinations_with_replacement
from typing import ClassVar, Literal, get_args

import numpy as np
from scipy.spatial.transform import Rotation

from fluxtwin.sim.base.errors import BadInput
from fluxtwin.sim.base.late import low_pass, restarts
from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.earth import epoch
from fluxtwin.sim.earth.field import field_N_nT
from fluxtwin.sim.effects.base import Parameter, SignalEffect, in_reading, mapped, vector_parameters
from fluxtwin.sim.effects.history import field_history, play
from fluxtwin.sim.effects.signal import Setting, Signal

STANDARD_FIELD_NT = 50_000.0
"""Where coefficients of nonlinearities are given."""
LARGEST_NT = 5_000.0
"""No magnetometer is off a straight line by more than a tenth of the field: what is called so is something else."""
_WAYS = {"o": 1.0, "r": -1.0, "n": 0.0}
_PARTS = 5
"""Of 0.3 rad of a turn: between 0.06 rad a field is within 5e-4 of itself of its turning point."""
_WIDTHS_NT = (1000.0, 4000.0, 16000.0)
_DEPTHS_NT = (500.0, 1000.0, 2000.0, 4000.0, 8000.0)
"""Further apart, a fit may begin where no reading is clipped, and stay there."""


@cache
def monomials(degree: int) -> tuple[str, ...]:
    """Names of the products of `degree` components: xx xy xz yy yz zz, or xxx xxy ... zzz."""
    return tuple("".join(letters) for letters in combinations_with_replacement("xyz", degree))


def products(reading_B_nT: FloatArray, degree: int) -> FloatArray:
    """(N, M) products of the components (N, 3), in units of the standard field, in the order of `monomials`."""
    unit = dict(zip("xyz", np.ascontiguousarray(reading_B_nT.T) / STANDARD_FIELD_NT, strict=True))
    columns = [reduce(np.multiply, [unit[letter] for letter in name]) for name in monomials(degree)]
    return np.stack(columns).T  # each product in one piece of memory: `mapped` then takes a third of the time


def slopes(reading_B_nT: FloatArray, degree: int) -> FloatArray:
    """(N, M, 3) derivatives of the `products` by the components, 1/nT."""
    found = np.zeros((len(reading_B_nT), len(monomials(degree)), 3))
    lower = products(reading_B_nT, degree - 1).T / STANDARD_FIELD_NT
    for name, rest in zip(monomials(degree - 1), lower, strict=True):
        for axis, letter in enumerate("xyz"):
            whole = "".join(sorted(name + letter))
            found[:, monomials(degree).index(whole), axis] = whole.count(letter) * rest
    return found


@dataclass(frozen=True)
class Nonlinearity(SignalEffect):
    """Base of the curved responses: each axis gains a combination of products of `degree` components of the reading."""

    stage = "sensor"
    follows = "field_strength"
    settled_by = "a slow tumble of 0.25 deg/s"
    degree: ClassVar[int]

    def apply(self, signal: Signal, theta: FloatArray) -> Signal:
        terms = signal.products(self.degree, products)
        return signal.with_reading(signal.reading + mapped(theta.reshape(3, -1), terms))

    def images(self, signal: Signal, theta: FloatArray) -> FloatArray:
        terms = signal.products(self.degree, products)
        return np.asarray(np.einsum("nm,ac->nacm", terms, np.eye(3)).reshape(signal.rows, 3, -1))

    def carried(self, signal: Signal, theta: FloatArray, images: FloatArray) -> FloatArray:
        gain = np.einsum("am,nmc->nac", theta.reshape(3, -1), slopes(signal.reading, self.degree))
        return np.asarray(images + gain @ images)


def nonlinear_parameters(prefix: str, degree: int) -> tuple[Parameter, ...]:
    """One an axis and product: prefix_x_xx, prefix_x_xy, ..."""
    places = [f"{axis}_{name}" for axis in "xyz" for name in monomials(degree)]
    return vector_parameters(prefix, "nT", 50.0, -LARGEST_NT, LARGEST_NT, axes=places)


@dataclass(frozen=True)
class QuadraticNonlinearity(Nonlinearity):
    """The reading gains second-order terms."""

    name = "quadratic_nonlinearity"
    about = (
        "products of two components, in nT at 50,000 nT each; positive raises the reading (the 6 x 3"
        " terms of CryoSat-2: Olsen et al. 2020, doi 10.1186/s40623-020-01171-9)"
    )
    degree = 2
    parameters = nonlinear_parameters("q", 2)


@dataclass(frozen=True)
class CubicNonlinearity(Nonlinearity):
    """The reading gains third-order terms."""

    name = "cubic_nonlinearity"
    about = (
        "products of three components, in nT at 50,000 nT each; positive raises the reading (the 10 "
        "x 3 terms of CryoSat-2: Olsen et al. 2020, doi 10.1186/s40623-020-01171-9)"
    )
    degree = 3
    parameters = nonlinear_parameters("c", 3)


@dataclass(frozen=True)
class Hysteresis(SignalEffect):
    """The reading lags behind the field.

    It is `a` too low where it rises, `a` too high where it falls.

    A core whose magnetisation follows the play operator y = play_w(x) of the field x along each axis, w half
    the loop's width, has a part in proportion to x, which is a scale error, and the rest, a (y - x) / w, which
    is this effect. It lies between -a and a; the loop of y against x is `width_nT` = 2 w wide. Before the first row the
    field is taken to have come the way it goes on, so that the core has followed it, unless `start` says otherwise. Between
    stamps the ambient field is followed where the body turns far in a step, a field of the spacecraft as straight lines.
    """

    name = "hysteresis"
    stage = "sensor"
    follows = "field_strength"
    settled_by = "a slow tumble of 0.25 deg/s"
    equivalent_stages = ("spacecraft",)
    about = (
        "remanence that follows the field's history: + reads low on a rising field and high on a falling one "
        "(play operator: Visintin 1994, Differential Models of Hysteresis)"
    )
    width_nT: float = 4000.0
    """Full width of the loop: how far the field must go back before the reading has followed."""
    start: str = "ooo"
    """How each axis came to the first row: o as it goes on from there, r reversed, the other way; n neutral."""

    adds = True
    parameters = vector_parameters("a", "nT", 50.0)

    def alternatives(self, setting: Setting) -> tuple[Hysteresis, ...]:
        if self != Hysteresis():
            return (self,)
        return tuple(replace(self, width_nT=width_nT) for width_nT in _WIDTHS_NT)

    def between(self, setting: Setting, ratio: float) -> Hysteresis | None:
        return replace(self, width_nT=ratio * self.width_nT)

    def variants(self, setting: Setting) -> tuple[Hysteresis, ...]:
        moved = [(axis, way) for axis in range(3) for way in _WAYS if way != self.start[axis]]
        return tuple(replace(self, start=self.start[:axis] + way + self.start[axis + 1 :]) for axis, way in moved)

    def apply(self, signal: Signal, theta: FloatArray) -> Signal:
        if len(self.start) != 3 or not set(self.start) <= set(_WAYS):
            raise BadInput(f"{self.start!r}", where=f"{self.name} start", wanted="three letters of o, r and n")
        if not self.width_nT > 0:
            raise BadInput(f"{self.width_nT:g} nT", where=f"{self.name} width_nT", wanted="more than 0 nT")
        stray = None if signal.stray_B_nT is None else signal.stray_B_nT.tobytes()
        behind = signal.of_ambient((self, stray), partial(self._behind, signal))
        shift = in_reading(signal.setting, behind * theta)
        return signal.with_reading(signal.reading + shift)

    def _behind(self, signal: Signal) -> FloatArray:
        """(N, 3) (y - x) / w."""
        # A field of the spacecraft that is varied changes only what is added to this.
        seconds, field, stamps = signal.of_ambient("closely", lambda: field_history(signal).closely(_PARTS))
        if signal.stray_B_nT is not None:
            stray = [np.interp(seconds, seconds[stamps], axis) for axis in signal.stray_B_nT.T]
            field = field + np.stack(stray, axis=1)
        half = 0.5 * self.width_nT
        onward = np.sign(field[min(stamps[0] + 1, len(field) - 1)] - field[0])
        came = onward * np.array([_WAYS[way] for way in self.start])
        return ((play(field, half, field[0] - half * came) - field) / half)[stamps]


@dataclass(frozen=True)
class SensorLag(SignalEffect):
    """The reading is smoothed and late.

    Between stamps the ambient field's part is followed by its value and its rate of change, at moments between two
    stamps too where the body turns far in a step, so a lag far below the sampling interval comes out right; the rest
    of the reading (torquers, stray fields) as straight lines. After a gap the filter starts anew, as if the body had
    turned at that rate before.
    """

    name = "sensor_lag"
    stage = "sensor"
    frame = None
    settled_by = "a spin of 2 rpm, or torquer edges sampled fast"
    equivalent_stages = ("time",)
    about = (
        "first-order low-pass, lag dy/dt + y = x: the reading, or that of one axis, is late by the lag and smoothed "
        "(RC low-pass: Oppenheim & Willsky, Signals and Systems, section 3.10)"
    )
    axis: Literal["all", "x", "y", "z"] = "all"
    """Whose filter it is."""

    parameters = (Parameter("lag", "s", 0.5, 0.0, 600.0),)

    def alternatives(self, setting: Setting) -> tuple[SensorLag, ...]:
        return (self, *map(SensorLag, get_args(Literal["x", "y", "z"]))) if self == SensorLag() else (self,)

    def apply(self, signal: Signal, theta: FloatArray) -> Signal:
        setting, lag_s = signal.setting, float(theta[0])
        if setting.seconds.size < 2:
            return signal
        shift = signal.of_ambient((self.name, lag_s), partial(_shifted_by_lag, signal, lag_s))
        rest = signal.reading - in_reading(setting, signal.field_B_nT)
        late_rest = low_pass(setting.seconds, rest, lag_s, restarts(setting.seconds)) - rest
        change = shift + late_rest
        if self.axis != "all":
            change = change * (np.arange(3) == "xyz".index(self.axis))
        return signal.with_reading(signal.reading + change)

    def carried(self, signal: Signal, theta: FloatArray, images: FloatArray) -> FloatArray:
        seconds, found = signal.setting.seconds, images.copy()
        late = [self.axis in ("all", axis) for axis in "xyz"]
        wide = images[:, late].reshape(signal.rows, -1)
        found[:, late] = low_pass(seconds, wide, float(theta[0]), restarts(seconds)).reshape(signal.rows, sum(late), -1)
        return found


def _shifted_by_lag(signal: Signal, lag_s: float) -> FloatArray:
    """(N, 3) by how much a lag changes the ambient field's part of the reading."""
    field = field_history(signal)
    start = field.steady_B_nT(lag_s)
    late = low_pass(field.time_s, field.along_B_nT, lag_s, field.restart, field.slope_B_nT_s, start)
    late = late - field.along_B_nT
    return in_reading(signal.setting, signal.with_own_turn(late[field.stamps]))


@dataclass(frozen=True)
class AxisSkew(SignalEffect):
    """The axes are read one after another.

    y and z are read `dt_y` and `dt_z` after x: each component is that of the ambient field, and of the attitude, at its own
    moment. What the spacecraft adds is taken to stay as it is for so long.
    """

    name = "axis_skew"
    stage = "sensor"
    follows = "rate"
    settled_by = "a spin of 2 rpm about each axis in turn"
    equivalent_stages = ("time",)
    about = (
        "component i is sampled dt_i later than the stamp, which is that of x, because one converter samples the axes "
        "in turn (PNI RM3100: three axes at 147 Hz, so 2 ms apart; tenths of a second where a slow bus polls them)"
    )
    parameters = vector_parameters("dt", "s", 0.1, -30.0, 30.0, axes="yz")

    def apply(self, signal: Signal, theta: FloatArray) -> Signal:
        change = np.zeros((signal.rows, 3))
        for axis, later_s in zip((1, 2), theta, strict=True):
            if later_s:
                later = signal.of_ambient((self.name, float(later_s)), partial(_later, signal, float(later_s)))
                change[:, axis] = later[:, axis]
        return signal.with_reading(signal.reading + change)

    def carried(self, signal: Signal, theta: FloatArray, images: FloatArray) -> FloatArray:
        return images


def _later(signal: Signal, later_s: float) -> FloatArray:
    """(N, 3) by how much the reading changes in this time, along the orbit and by the body's turning."""
    setting, then = signal.setting, signal.sampled_later(later_s)
    before_N_nT, from_given = signal.of_ambient("as given", partial(_as_given, signal))  # however much later
    after_N_nT = _modelled_N_nT(setting, then.sample_offset_s, then.r_N_km)
    own = signal.R_BN.apply(signal.ambient_N_nT + after_N_nT - before_N_nT)
    return in_reading(setting, np.asarray(then.R_BN.apply(from_given.apply(own))) - signal.field_B_nT)


def _as_given(signal: Signal) -> tuple[FloatArray, Rotation]:
    """The field of the model at the position given for the moment of sampling (N, 3), and R_NB of the attitude given."""
    r_N_km, _, R_BN = signal.setting.motion.at(signal.sample_offset_s)
    return _modelled_N_nT(signal.setting, signal.sample_offset_s, r_N_km), R_BN.inv()


def _modelled_N_nT(setting: Setting, offset_s: float | FloatArray, r_N_km: FloatArray) -> FloatArray:
    return field_N_nT(setting.model, epoch.add_seconds(setting.time[0], setting.seconds + offset_s), r_N_km)


@dataclass(frozen=True)
class Saturation(SignalEffect):
    """Each axis is clipped near full scale.

    It is clipped at full scale less the depth. Full scale is `full_scale_nT`, else the setting\'s, else the largest
    reading without noise.
    """

    name = "saturation"
    stage = "sensor"
    follows = "field_strength"
    settled_by = "turning the axis concerned along the strongest field, near the poles (a level axis by 90 deg)"
    after_noise = True
    about = (
        "the limits are +-(full scale - depth), with full scale as declared or else the largest "
        "reading; positive clips more (the limiter of every converter)"
    )
    typical_nT: float = 2000.0
    """Depth at which the effect is linearised; not part of what reality does."""
    full_scale_nT: float | None = None

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        return (Parameter("depth", "nT", self.typical_nT, 0.0),)

    def alternatives(self, setting: Setting) -> tuple[Saturation, ...]:
        """The effect linearised at several depths, because a clip is anything but linear."""
        return tuple(replace(self, typical_nT=depth_nT) for depth_nT in _DEPTHS_NT)

    def pinned(self, setting: Setting, reading_B_nT: FloatArray) -> Saturation:
        declared = setting.full_scale_nT
        largest_nT = float(np.abs(reading_B_nT).max()) if declared is None else declared
        return self if self.full_scale_nT is not None else replace(self, full_scale_nT=largest_nT)

    def apply(self, signal: Signal, theta: FloatArray) -> Signal:
        declared = signal.setting.full_scale_nT if self.full_scale_nT is None else self.full_scale_nT
        clean = signal.reading if signal.ideal_B_nT is None else signal.ideal_B_nT
        full_scale_nT = float(np.abs(clean).max()) if declared is None else declared
        limit = max(full_scale_nT - float(theta[0]), 0.0)
        return signal.with_reading(np.clip(signal.reading, -limit, limit))
