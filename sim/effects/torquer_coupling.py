"""The torquers' field at the magnetometer that no calibration has taken out."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.effects.base import Parameter, SignalEffect, known_column
from fluxtwin.sim.effects.instrument import mapped
from fluxtwin.sim.effects.signal import Setting, Signal


@dataclass(frozen=True)
class TorquerCoupling(SignalEffect):
    """Field of the torquers at the sensor.

    Field C m at the sensor from the torquers' dipole m. C row by row; eq. 1's T is -C.
    """

    name: ClassVar[str] = "torquer_coupling"
    stage: ClassVar[str] = "spacecraft"
    frame: ClassVar[str | None] = "body"
    follows: ClassVar[str | None] = "torquer"
    settled_by: ClassVar[str] = "firing each torquer alone, on and off at full dipole, with the dipole in the telemetry"
    about: ClassVar[str] = (
        "field C m of the torquers at the sensor (T = -C of Lerner & Shuster 1981, eq. 1; Seasat 1.7 nT/(A m2) at 6 m)"
    )

    parameters = tuple(Parameter(f"C_{to}{of}", "nT/(A m2)", 2.0) for to in "xyz" for of in "xyz")

    def untestable(self, setting: Setting) -> str | None:
        dipole = known_column(setting, "dipole_B_Am2")
        if dipole is None:
            return "the telemetry has no torquer dipole"
        return None if (dipole != 0.0).any() else "the torquers never fired"

    def apply(self, signal: Signal, theta: FloatArray) -> Signal:
        dipole = known_column(signal.setting, "dipole_B_Am2")
        return signal if dipole is None else signal.with_stray(mapped(theta.reshape(3, 3), dipole))
