"""The field of eddy currents in the structure."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.effects.base import Parameter, SignalEffect
from fluxtwin.sim.effects.instrument import mapped
from fluxtwin.sim.effects.signal import Signal

_NAMES = ("K_xx", "K_yy", "K_xy", "K_xz", "K_yz")


def traceless(theta: FloatArray) -> FloatArray:
    """(3, 3) symmetric K without trace from K_xx, K_yy, K_xy, K_xz, K_yz."""
    xx, yy, xy, xz, yz = theta
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, -xx - yy]])


@dataclass(frozen=True)
class EddyCurrent(SignalEffect):
    """Field of currents that a changing field drives.

    Induced dipole's field -K dB_B/dt at the sensor, K symmetric, K_zz = -K_xx - K_yy.

    Good while the currents decay much faster than the field changes. The part of K that is a multiple of the
    identity is left out: it is a time tag (-K dB/dt is a delay by K).
    """

    name: ClassVar[str] = "eddy_current"
    stage: ClassVar[str] = "spacecraft"
    frame: ClassVar[str | None] = "body"
    follows: ClassVar[str | None] = "rate"
    settled_by: ClassVar[str] = "a spin of 2 rpm"
    about: ClassVar[str] = (
        "field -K dB/dt of the dipole that a changing field induces in a conductor, K_zz = -K_xx - K_yy "
        "(Landau & Lifshitz, Electrodynamics of Continuous Media, section 59)"
    )

    # A sphere of aluminium of half a metre: mu_0 sigma a^2 / pi^2 = 1.1 s (Landau & Lifshitz, section 59).
    parameters = tuple(Parameter(name, "s", 0.05, -1.0, 1.0) for name in _NAMES)

    def apply(self, signal: Signal, theta: FloatArray) -> Signal:
        return signal.with_stray(-mapped(traceless(theta), signal.field_rate_B_nT_s))
