"""Remanence that follows the field's history."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from fluxtwin.sim.base.errors import BadInput
from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.effects.base import SignalEffect, vector_parameters
from fluxtwin.sim.effects.history import play
from fluxtwin.sim.effects.instrument import in_reading
from fluxtwin.sim.effects.signal import Setting, Signal

_WAYS = {"o": 1.0, "r": -1.0, "n": 0.0}
_WIDTHS_NT = (1000.0, 4000.0, 16000.0)


@dataclass(frozen=True)
class Hysteresis(SignalEffect):
    """The reading lags behind the field.

    The reading lags behind the field: `a` too low where it rises, `a` too high where it falls.

    A core whose magnetisation follows the play operator y = play_w(x) of the field x along each axis, w half
    the loop's width, has a part in proportion to x, which is a scale error, and the rest, a (y - x) / w, which
    is this effect. It lies between -a and a; the loop of y against x is `width_nT` = 2 w wide. Before the first row the
    field is taken to have come the way it goes on, so that the core has followed it, unless `start` says otherwise; what
    the field did between rows is not seen.
    """

    name: ClassVar[str] = "hysteresis"
    stage: ClassVar[str] = "sensor"
    frame: ClassVar[str | None] = "body"
    follows: ClassVar[str | None] = "field_strength"
    settled_by: ClassVar[str] = "a slow tumble of 0.25 deg/s"
    equivalent_stages: ClassVar[tuple[str, ...]] = ("spacecraft",)
    about: ClassVar[str] = (
        "remanence that follows the field's history: + reads low on a rising field and high on a falling one "
        "(play operator: Visintin 1994, Differential Models of Hysteresis)"
    )
    width_nT: float = 4000.0
    """Full width of the loop: how far the field must go back before the reading has followed."""

    start: str = "ooo"
    """How each axis came to the first row: o as it goes on from there, r reversed, the other way; n neutral."""

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
        field = signal.R_track_BN.apply(signal.ambient_N_nT)
        field = field if signal.stray_B_nT is None else field + signal.stray_B_nT
        half = 0.5 * self.width_nT
        onward = np.sign(field[min(1, len(field) - 1)] - field[0])
        came = onward * np.array([_WAYS[way] for way in self.start])
        behind = (play(field, half, field[0] - half * came) - field) / half
        shift = in_reading(signal.setting, behind * theta)
        return signal.with_reading(signal.reading + shift)
