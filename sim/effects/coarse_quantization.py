"""Readings in coarser steps than declared."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.effects.base import DistributionEffect, Parameter
from fluxtwin.sim.effects.signal import Signal


@dataclass(frozen=True)
class CoarseQuantization(DistributionEffect):
    """The readings' step is coarser than declared.

    The true step is `lsb`, not the declared one. Steps finer than the declared change nothing.
    """

    name: ClassVar[str] = "coarse_quantization"
    stage: ClassVar[str] = "sensor"
    frame: ClassVar[str | None] = "body"
    follows: ClassVar[str | None] = None
    settled_by: ClassVar[str] = "slower motion, so that single steps of the reading show"
    equivalent_stages: ClassVar[tuple[str, ...]] = ("telemetry",)
    after_rounding: ClassVar[bool] = True
    about: ClassVar[str] = (
        "readings rounded to a step larger than declared, error lsb/sqrt(12) rms (Widrow & Kollar 2008, Quantization "
        "Noise; Seasat 440 nT, HCMM 470 nT)"
    )

    parameters = (Parameter("lsb", "nT", 400.0, 0.0),)

    def draw(self, signal: Signal, theta: FloatArray, rng: np.random.Generator) -> Signal:
        lsb = float(theta[0])
        if lsb <= signal.setting.instrument.lsb_nT:
            return signal
        return signal.with_reading(lsb * np.rint(signal.reading / lsb))
