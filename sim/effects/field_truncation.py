"""The real field and the model do not have the same degrees."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar, Literal

import numpy as np

from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.earth.field import field_N_nT
from fluxtwin.sim.earth.field_models import FieldModel, load_field
from fluxtwin.sim.effects.base import Effect, Parameter, SignalEffect
from fluxtwin.sim.effects.signal import Setting, Signal

_RICHEST = 13
_POOREST = 4


@dataclass(frozen=True)
class FieldTruncation(SignalEffect):
    """Reality or the model ends at a lower degree.

    The degrees above `degree` are in one of real field and model, not in the other.
    """

    degree: int = 8
    """The highest degree that both have."""
    truth: Literal["poorer", "richer"] = "poorer"
    """poorer: the real field lacks the model's degrees above `degree`; richer: it has those of IGRF-14 above `degree`,
    to 13, and the model has not."""

    name: ClassVar[str] = "field_truncation"
    stage: ClassVar[str] = "field"
    frame: ClassVar[str | None] = "earth"
    follows: ClassVar[str | None] = None
    settled_by: ClassVar[str] = "a whole day, so that all longitudes are flown over"
    about: ClassVar[str] = (
        "real field and model differ by the share given (1: wholly) of the degrees above N; truth = poorer: the real "
        "field lacks the model's, truth = richer: it has IGRF-14's up to 13, the model has not"
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
