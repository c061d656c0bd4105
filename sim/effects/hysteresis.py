"""Remanence that follows the field's history."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from fluxtwin.sim.effects.base import Parameter, SignalEffect, vector_parameters
from fluxtwin.sim.effects.history import play
from fluxtwin.sim.effects.instrument import in_reading
from fluxtwin.sim.errors import BadInput
from fluxtwin.sim.signal import Setting, Signal
from fluxtwin.sim.types import FloatArray

_WIDTHS_NT = (1000.0, 4000.0, 16000.0)


@dataclass(frozen=True)
class Hysteresis(SignalEffect):
    """The reading lags behind the field: `a` too low where it rises, `a` too high where it falls.

    A core whose magnetisation follows the play operator y = play_w(x) of the field x along each axis, w half
    the loop's width, has a part in proportion to x, which is a scale error, and the rest, a (y - x) / w, which
    is this effect. It lies between -a and a; the loop of y against x is `width_nT` = 2 w wide. Before the first row the
    field is taken to have come the way it goes on, so that the core has followed it; what the field did between rows is
    not seen.
    """

    name: ClassVar[str] = "hysteresis"
    stage: ClassVar[str] = "sensor"
    equivalent_stages: ClassVar[tuple[str, ...]] = ("spacecraft",)
    about: ClassVar[str] = (
        "remanence that follows the field's history: + reads low on a rising field and high on a falling one "
        "(play operator: Visintin 1994, Differential Models of Hysteresis)"
    )
    width_nT: float = 4000.0
    """Full width of the loop: how far the field must go back before the reading has followed."""

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        return vector_parameters("a", "nT", 50.0)

    def alternatives(self, setting: Setting) -> tuple[Hysteresis, ...]:
        if self.width_nT != Hysteresis.width_nT:
            return (self,)
        return tuple(replace(self, width_nT=width_nT) for width_nT in _WIDTHS_NT)

    def between(self, setting: Setting, ratio: float) -> Hysteresis | None:
        return replace(self, width_nT=ratio * self.width_nT)

    def apply(self, signal: Signal, theta: FloatArray) -> Signal:
        if not self.width_nT > 0:
            raise BadInput(f"{self.width_nT:g} nT", where=f"{self.name} width_nT", wanted="more than 0 nT")
        field = signal.R_track_BN.apply(signal.ambient_N_nT)
        field = field if signal.stray_B_nT is None else field + signal.stray_B_nT
        half = 0.5 * self.width_nT
        onward = np.sign(field[min(1, len(field) - 1)] - field[0])
        behind = (play(field, half, field[0] - half * onward) - field) / half
        shift = in_reading(signal.setting, behind * theta)
        return signal.with_reading(signal.reading + shift)
