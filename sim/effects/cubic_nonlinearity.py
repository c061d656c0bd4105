"""A magnetometer whose response is curved alike on both sides of zero."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.effects.base import Parameter, SignalEffect
from fluxtwin.sim.effects.instrument import mapped
from fluxtwin.sim.effects.polynomial import LARGEST_NT, monomials, products
from fluxtwin.sim.effects.signal import Signal


@dataclass(frozen=True)
class CubicNonlinearity(SignalEffect):
    """The reading gains third-order terms.

    Each axis gains a combination of the ten products of three components of the linear reading.
    """

    name: ClassVar[str] = "cubic_nonlinearity"
    stage: ClassVar[str] = "sensor"
    frame: ClassVar[str | None] = "body"
    follows: ClassVar[str | None] = "field_strength"
    settled_by: ClassVar[str] = "a slow tumble of 0.25 deg/s"
    about: ClassVar[str] = (
        "reading gains products of three components, nT at 50,000 nT each, + raises it (the 10 x 3 terms of CryoSat-2: "
        "Olsen et al. 2020, doi 10.1186/s40623-020-01171-9)"
    )

    parameters = tuple(
        Parameter(f"c_{axis}_{name}", "nT", 50.0, -LARGEST_NT, LARGEST_NT) for axis in "xyz" for name in monomials(3)
    )

    def apply(self, signal: Signal, theta: FloatArray) -> Signal:
        return signal.with_reading(signal.reading + mapped(theta.reshape(3, 10), products(signal.reading, 3)))
