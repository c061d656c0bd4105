"""What the real field has and the model has not, or the other way round."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.earth import epoch
from fluxtwin.sim.earth.constants import FIELD_RADIUS_KM
from fluxtwin.sim.earth.field import field_beyond_E_nT, field_E_nT, field_N_nT
from fluxtwin.sim.earth.field_models import FieldModel, load_field
from fluxtwin.sim.effects.base import Effect, Parameter, SignalEffect
from fluxtwin.sim.effects.signal import Setting, Signal

_RICHEST = 13
_POOREST = 4
INDUCED_SHARE = 0.27
RECOVERY_H = (7.7, 24.0)
"""Decay times of a storm's recovery: early (Burton et al. 1975) and late, when the slow ions are left."""
_LEAST_SPAN = 0.1  # of the decay time: over less, decaying and constant are the same


@dataclass(frozen=True)
class FieldEpoch(SignalEffect):
    """The field is that of another date."""

    name = "field_epoch"
    stage = "field"
    frame = "earth"
    settled_by = "a slow tumble of 0.25 deg/s"
    about = (
        "the real field is that of the model this many years (of 365.25 days) after the stamp, because the model was "
        "evaluated at a fixed old epoch or its secular variation is a wrong forecast. Beyond its last epoch the model's "
        "last yearly change continues (IGRF-14: up to about 100 nT per year)"
    )
    parameters = (Parameter("ahead", "yr", 1.0, -20.0, 20.0),)

    def apply(self, signal: Signal, theta: FloatArray) -> Signal:
        r_E_km = signal.R_EN.apply(signal.r_N_km)
        time = signal.sampled_time
        later = time + epoch.years(float(theta[0]))
        model = signal.setting.model
        change_E = field_beyond_E_nT(model, later, r_E_km) - field_E_nT(model, time, r_E_km)
        return signal.with_ambient(signal.R_EN.inv().apply(change_E))


@dataclass(frozen=True)
class FieldTruncation(SignalEffect):
    """Reality or the model ends at a lower degree."""

    degree: int = 8
    """The highest degree that both have."""
    truth: Literal["poorer", "richer"] = "poorer"
    """poorer: the real field lacks the model's degrees above `degree`; richer: it has those of IGRF-14 above `degree`,
    to 13, and the model has not."""

    name = "field_truncation"
    stage = "field"
    frame = "earth"
    settled_by = "a whole day, so that all longitudes are covered"
    about = (
        "real field and model differ by this share (1: wholly) of the degrees above N. With truth = poorer the real "
        "field lacks those degrees of the model; with truth = richer it has those of IGRF-14 up to 13, which the model "
        "lacks"
    )
    parameters = (Parameter("share", "1", 1.0, -2.0, 2.0),)

    def alternatives(self, setting: Setting) -> tuple[Effect, ...]:
        """Degrees from 4 to 12 below the model's own, and what a truncated model leaves out."""
        top = min(setting.model.degree - 1, _RICHEST)
        poorer = [FieldTruncation(degree, "poorer") for degree in range(_POOREST, top + 1)]
        richer = FieldTruncation(setting.model.degree, "richer")
        return (*poorer, richer) if richer._nothing(setting) is None else tuple(poorer)

    def untestable(self, setting: Setting) -> str | None:
        """Nothing, as long as one of the alternatives is possible."""
        return None if self.alternatives(setting) else self._nothing(setting)

    def _nothing(self, setting: Setting) -> str | None:
        """Why the two fields cannot differ in this way."""
        model = setting.model
        if self.truth == "poorer":
            return None if self.degree < model.degree else f"the field model ends at degree {model.degree}"
        if self.degree >= _RICHEST or model.degree >= _RICHEST:
            return f"the field model, of degree {model.degree}, has all that IGRF-14 could add above {self.degree}"
        source = load_field("igrf14")
        if setting.time[0] < source.valid_from or setting.time[-1] > source.valid_to:
            return "the record is outside IGRF-14, from which the higher degrees would come"
        return None

    def apply(self, signal: Signal, theta: FloatArray) -> Signal:
        model, share = signal.setting.model, float(theta[0])
        if self.truth == "poorer":
            return signal.with_ambient(-share * _above(model, self.degree, signal))
        extra = _above(load_field("igrf14"), self.degree, signal) - _above(model, self.degree, signal)
        return signal.with_ambient(share * extra)


def _above(model: FieldModel, degree: int, signal: Signal) -> FloatArray:
    """(N, 3) GCRS field of the model's degrees above `degree`."""
    if degree >= model.degree:
        return np.zeros((signal.rows, 3))
    kept = degree * (degree + 2)
    polynomial, static = model.polynomial_nT.copy(), model.static_nT.copy()
    polynomial[:, :, :kept], static[:kept] = 0.0, 0.0
    high = replace(model, polynomial_nT=polynomial, static_nT=static)
    return field_N_nT(high, signal.sampled_time, signal.r_N_km, signal.R_EN)


@dataclass(frozen=True)
class RingCurrent(SignalEffect):
    """Field of the ring current in a magnetic storm."""

    decay_h: float = 0.0
    """0: constant; else it decays by e in so many hours from the first stamp."""

    name = "ring_current"
    stage = "field"
    frame = "earth"
    settled_by = "a slow tumble of 0.25 deg/s, or days of different Dst"
    about = (
        "external field along the geomagnetic dipole axis, northward at the dipole equator, so negative in a storm as "
        "Dst is. It is constant, or decays from the first stamp on (Burton et al. 1975: 7.7 h). 0.27 of it enters again "
        "as an internal dipole field (Langel & Estes 1985), so that Dst on the ground is 1.27 times the parameter"
    )
    parameters = (Parameter("external", "nT", 50.0, -2000.0, 2000.0),)
    bound = "the ring current changes from hour to hour: take the Dst of the day"

    def alternatives(self, setting: Setting) -> tuple[Effect, ...]:
        """Constant, and the two decays where the record is long enough to show one."""
        span_h = float(setting.seconds[-1]) / 3600.0
        return (RingCurrent(), *(RingCurrent(hours) for hours in RECOVERY_H if span_h > _LEAST_SPAN * hours))

    def between(self, setting: Setting, ratio: float) -> RingCurrent | None:
        return RingCurrent(ratio * self.decay_h) if self.decay_h > 0 else None

    def apply(self, signal: Signal, theta: FloatArray) -> Signal:
        size_nT = np.full(signal.rows, float(theta[0]))
        if self.decay_h > 0:
            since_s = signal.setting.seconds + signal.sample_offset_s
            size_nT = size_nT * np.exp(-since_s / (3600.0 * self.decay_h))
        shape_E = unit_storm_E(
            dipole_axis_E(signal.setting.model, signal.setting.time[0]), signal.R_EN.apply(signal.r_N_km)
        )
        return signal.with_ambient(signal.R_EN.inv().apply(size_nT[:, None] * shape_E))


def dipole_axis_E(model: FieldModel, time: np.datetime64) -> FloatArray:
    """(3,) unit vector to the northern pole of the dipole part of a field, Earth-fixed."""
    g10, g11, h11 = model.coefficients_nT(epoch.as_times(time))[0, :3]
    axis = -np.array([g11, h11, g10])
    return np.asarray(axis / np.linalg.norm(axis))


def unit_storm_E(axis_E: FloatArray, r_E_km: FloatArray, induced_share: float = INDUCED_SHARE) -> FloatArray:
    """(N, 3) field for 1 nT of external field along the axis (3,), at positions (N, 3)."""
    radius = np.linalg.norm(r_E_km, axis=1)[:, None]
    up = r_E_km / radius
    dipole = axis_E - 3.0 * (up @ axis_E)[:, None] * up
    return np.asarray(axis_E + induced_share * (FIELD_RADIUS_KM / radius) ** 3 * dipole)
