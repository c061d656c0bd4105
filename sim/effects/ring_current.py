"""The ring current of a magnetic storm, which models of the main field leave out."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.earth.constants import FIELD_RADIUS_KM
from fluxtwin.sim.effects.base import Effect, Parameter, SignalEffect
from fluxtwin.sim.effects.signal import Setting, Signal

INDUCED_SHARE = 0.27
RECOVERY_H = (7.7, 24.0)
"""Decay times of a storm's recovery: early (Burton et al. 1975) and late, when the slow ions are left."""
_LEAST_SPAN = 0.1  # of the decay time: over less, decaying and constant are the same


@dataclass(frozen=True)
class RingCurrent(SignalEffect):
    """Field of the ring current in a magnetic storm.

    Uniform along the dipole axis, with the dipole it induces in the Earth.
    """

    decay_h: float = 0.0
    """0: constant; else it decays by e in so many hours from the first stamp."""

    name: ClassVar[str] = "ring_current"
    stage: ClassVar[str] = "field"
    frame: ClassVar[str | None] = "earth"
    follows: ClassVar[str | None] = None
    settled_by: ClassVar[str] = "a slow tumble of 0.25 deg/s, or days of different Dst"
    about: ClassVar[str] = (
        "external field along the geomagnetic dipole axis, northward at the dipole equator, so negative in a storm as "
        "Dst is; 0.27 of it enters again as an internal dipole field (Langel & Estes 1985), so that Dst on the ground "
        "is 1.27 times the parameter; constant, or decaying from the first stamp (Burton et al. 1975: 7.7 h)"
    )

    parameters = (Parameter("external", "nT", 50.0, -2000.0, 2000.0),)

    def alternatives(self, setting: Setting) -> tuple[Effect, ...]:
        """Constant, and the two decays where the record is long enough to show one."""
        span_h = float(setting.seconds[-1]) / 3600.0
        return (RingCurrent(), *(RingCurrent(hours) for hours in RECOVERY_H if span_h > _LEAST_SPAN * hours))

    def between(self, setting: Setting, ratio: float) -> RingCurrent | None:
        return RingCurrent(ratio * self.decay_h) if self.decay_h > 0 else None

    @property
    def bound(self) -> str:
        return "the ring current of these hours is not that of others: take the Dst of the day"

    def apply(self, signal: Signal, theta: FloatArray) -> Signal:
        size_nT = np.full(signal.rows, float(theta[0]))
        if self.decay_h > 0:
            since_s = signal.setting.seconds + signal.sample_offset_s
            size_nT = size_nT * np.exp(-since_s / (3600.0 * self.decay_h))
        shape_E = unit_storm_E(dipole_axis_E(signal.setting), signal.R_EN.apply(signal.r_N_km))
        return signal.with_ambient(signal.R_EN.inv().apply(size_nT[:, None] * shape_E))


def dipole_axis_E(setting: Setting) -> FloatArray:
    """(3,) unit vector to the northern dipole pole, Earth-fixed, at the first stamp."""
    g10, g11, h11 = setting.model.coefficients_nT(setting.time[:1])[0, :3]
    axis = -np.array([g11, h11, g10])
    return np.asarray(axis / np.linalg.norm(axis))


def unit_storm_E(axis_E: FloatArray, r_E_km: FloatArray) -> FloatArray:
    """(N, 3) field for 1 nT of external field along the axis (3,), at positions (N, 3)."""
    radius = np.linalg.norm(r_E_km, axis=1)[:, None]
    up = r_E_km / radius
    dipole = axis_E - 3.0 * (up @ axis_E)[:, None] * up
    field: FloatArray = axis_E + INDUCED_SHARE * (FIELD_RADIUS_KM / radius) ** 3 * dipole
    return field
