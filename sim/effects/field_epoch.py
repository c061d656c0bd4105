"""The model of the field is out of date."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from fluxtwin.sim.base.types import FloatArray, TimeArray
from fluxtwin.sim.earth.field import field_E_nT
from fluxtwin.sim.earth.field_models import FieldModel
from fluxtwin.sim.effects.base import Parameter, SignalEffect
from fluxtwin.sim.effects.signal import Signal

_YEAR = np.timedelta64(round(365.25 * 86400e9), "ns")


@dataclass(frozen=True)
class FieldEpoch(SignalEffect):
    """The field is that of another date.

    The field of another epoch at the same place over the ground.
    """

    name: ClassVar[str] = "field_epoch"
    stage: ClassVar[str] = "field"
    frame: ClassVar[str | None] = "earth"
    follows: ClassVar[str | None] = None
    settled_by: ClassVar[str] = "a slow tumble of 0.25 deg/s"
    about: ClassVar[str] = (
        "the real field is that of the model so many years (of 365.25 days) after the stamp: a model evaluated at a "
        "fixed old epoch, or secular variation forecast wrongly; beyond the model's last knot its last year's change "
        "goes on (IGRF-14: up to about 100 nT a year)"
    )

    parameters = (Parameter("ahead", "yr", 1.0, -20.0, 20.0),)

    def apply(self, signal: Signal, theta: FloatArray) -> Signal:
        r_E_km = signal.R_EN.apply(signal.r_N_km)
        time = signal.sampled_time
        later = time + np.timedelta64(round(float(theta[0]) * float(_YEAR.astype("int64"))), "ns")
        model = signal.setting.model
        change_E = field_beyond_E_nT(model, later, r_E_km) - field_E_nT(model, time, r_E_km)
        return signal.with_ambient(signal.R_EN.inv().apply(change_E))


def field_beyond_E_nT(model: FieldModel, time: TimeArray, r_E_km: FloatArray) -> FloatArray:
    """`field_E_nT`, and outside the model's validity the change of its outermost year carried on; (N, 3).

    For a model that is linear between knots, such as IGRF, that is the straight line of the outermost interval.
    """
    first, last = model.valid_from, model.valid_to
    field_nT = field_E_nT(model, np.clip(time, first, last), r_E_km)
    for outside, edge, inner in (
        (time > last, last, max(last - _YEAR, first)),
        (time < first, first, min(first + _YEAR, last)),
    ):
        if outside.any():
            there = r_E_km[outside]
            change = field_E_nT(model, edge, there) - field_E_nT(model, inner, there)
            share = (time[outside] - edge) / (edge - inner)
            field_nT[outside] += share[:, None] * change
    return field_nT
