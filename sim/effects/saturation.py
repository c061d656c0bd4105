"""Readings that stop short of full scale."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.effects.base import Parameter, SignalEffect
from fluxtwin.sim.effects.signal import Setting, Signal

_DEPTHS_NT = (500.0, 2000.0, 8000.0)


@dataclass(frozen=True)
class Saturation(SignalEffect):
    """Each axis is clipped near full scale.

    Each axis is clipped at full scale less the depth.

    Full scale is `full_scale_nT`, else the setting's, else the largest reading without noise.
    """

    name: ClassVar[str] = "saturation"
    stage: ClassVar[str] = "sensor"
    frame: ClassVar[str | None] = "body"
    follows: ClassVar[str | None] = "field_strength"
    settled_by: ClassVar[str] = (
        "turning the axis concerned along the strongest field, near the poles (a level axis by 90 deg)"
    )
    after_noise: ClassVar[bool] = True
    about: ClassVar[str] = (
        "each axis clipped at +-(full scale - depth), full scale as declared or else the largest reading; + clips more "
        "(the limiter of every converter)"
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
