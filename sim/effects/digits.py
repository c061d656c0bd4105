"""Single readings: their noise, their step, their bits."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from fluxtwin.sim.base.errors import BadInput
from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.effects.base import DistributionEffect, Parameter
from fluxtwin.sim.effects.signal import Signal

_DEFAULT_LSB_NT = 1.0


@dataclass(frozen=True)
class ExcessNoise(DistributionEffect):
    """More white noise than was declared."""

    name = "excess_noise"
    stage = "sensor"
    settled_by = "a quiet stretch with torquers and payload off"
    about = (
        "added in variance to the declared noise (magnetoresistors 10 to 100 nT rms; "
        "200 nT in ST5's simulation, Sedlak)"
    )
    axis: Literal["x", "y", "z", "all"] = "all"

    parameters = (Parameter("rms", "nT", 50.0, 0.0),)

    def draw(self, signal: Signal, theta: FloatArray, rng: np.random.Generator) -> Signal:
        noisy = np.ones(3) if self.axis == "all" else np.array([float(self.axis == axis) for axis in "xyz"])
        return signal.with_reading(signal.reading + theta[0] * noisy * rng.standard_normal((signal.rows, 3)))


@dataclass(frozen=True)
class CoarseQuantization(DistributionEffect):
    """The readings' step is coarser than declared.

    Steps finer than the declared change nothing.
    """

    name = "coarse_quantization"
    stage = "sensor"
    settled_by = "slower motion, so that single steps of the reading show"
    equivalent_stages = ("telemetry",)
    after_rounding = True
    about = (
        "readings are rounded to a step larger than declared, with an error of lsb/sqrt(12) rms (Widrow & "
        "Kollar 2008, Quantization Noise; Seasat 440 nT, HCMM 470 nT)"
    )
    parameters = (Parameter("lsb", "nT", 400.0, 0.0),)

    def draw(self, signal: Signal, theta: FloatArray, rng: np.random.Generator) -> Signal:
        lsb = float(theta[0])
        if lsb <= signal.setting.instrument.lsb_nT:
            return signal
        return signal.with_reading(lsb * np.rint(signal.reading / lsb))


@dataclass(frozen=True)
class BitErrors(DistributionEffect):
    """Single readings have a flipped or stuck bit.

    A reading's code is reading / LSB, a two's complement word just long enough for the record's largest, plus
    its sign bit. Only whole codes change, by a power of two, so a reading that was not rounded keeps its rest.
    """

    name = "bit_errors"
    stage = "telemetry"
    settled_by = "the raw counts"
    after_rounding = True
    about = (
        "the parameter is the share of affected components "
        "(undetected bit errors of Seasat's telemetry: Lerner & Shuster 1981)"
    )
    bit: int | None = None
    """Number of the bit, 0 for the LSB's; None: any of the word, the sign's included, with equal chance."""
    kind: Literal["flip", "stuck_0", "stuck_1"] = "flip"
    lsb_nT: float | None = None
    """Step of the code; None: the instrument's, or 1 nT if that does not round."""
    axis: Literal["x", "y", "z", "all"] = "all"

    parameters = (Parameter("rate", "1", 0.01, 0.0, 1.0),)

    def step_nT(self, signal: Signal) -> float:
        return self.lsb_nT or signal.setting.instrument.lsb_nT or _DEFAULT_LSB_NT

    def draw(self, signal: Signal, theta: FloatArray, rng: np.random.Generator) -> Signal:
        lsb = self.step_nT(signal)
        whole = np.rint(signal.reading / lsb)
        code = np.where(np.isfinite(whole), whole, 0.0).astype(np.int64)
        word = int(np.abs(code).max()).bit_length() + 1
        if self.bit is not None and not 0 <= self.bit < 62:
            raise BadInput(f"bit {self.bit}", where=self.name, wanted="0 to 61, or none for any")
        reached = np.array([self.axis in ("all", axis) for axis in "xyz"])
        hit = (rng.random(code.shape) < theta[0]) & reached
        chosen = rng.integers(0, word, code.shape)
        mask = np.left_shift(np.int64(1), chosen if self.bit is None else np.full(code.shape, self.bit))
        wrong = {"flip": code ^ mask, "stuck_0": code & ~mask, "stuck_1": code | mask}[self.kind]
        sign = 1 << (word if self.bit is None else max(word, self.bit + 1)) - 1
        wrong = ((wrong & 2 * sign - 1) ^ sign) - sign  # as a two's complement word of that many bits says it
        return signal.with_reading(signal.reading + np.where(hit, lsb * (wrong - code), 0.0))
