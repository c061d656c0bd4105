"""A boom that bends with its temperature and turns the sensor at its tip."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
from scipy.spatial.transform import Rotation

from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.effects.base import Parameter, SignalEffect, known_column
from fluxtwin.sim.effects.drivers import temperature_K
from fluxtwin.sim.effects.signal import Setting, Signal
from fluxtwin.sim.effects.thermal_bias_drift import thermally_untestable, warmer_K

TIME_CONSTANTS_S = (60.0, 300.0, 900.0, 2700.0)
"""Time constants tried where no temperature was recorded: a bare strip of metal to a root inside the body."""


@dataclass(frozen=True)
class BoomBending(SignalEffect):
    """The sensor turns as its boom warms up.

    The sensor is turned by a vector that grows with temperature, from zero at `reference_degC`.

    + turns the sensor's axes right-handed about the body axis, so the field in them turns the other way. The whole
    field at the sensor turns, that of the spacecraft too. Without the column `temperature_degC` the temperature is a
    first-order lag, `time_constant_s`, behind sun and shadow, as for thermal_bias_drift: deg per K of a swing of 20.
    """

    name: ClassVar[str] = "boom_bending"
    stage: ClassVar[str] = "spacecraft"
    frame: ClassVar[str | None] = "body"
    follows: ClassVar[str | None] = "temperature"
    settled_by: ClassVar[str] = (
        "a slow tumble of 0.25 deg/s through sun and shadow, with the boom's temperature in the telemetry"
    )
    equivalent_stages: ClassVar[tuple[str, ...]] = ("attitude", "sensor")
    about: ClassVar[str] = (
        "turn of the sensor per K of temperature, + right-handed about the body axis (thermal bending of a boom: "
        "Boley & Weiner 1960, Theory of Thermal Stresses, chapter 10; Magsat's attitude transfer system was built "
        "for excursions of 0.05 deg in bending and 0.08 deg in twist, NTRS 19810055192)"
    )
    time_constant_s: float = 300.0
    reference_degC: float | None = None
    """Temperature at which the boom is straight; None: the record's mean."""

    parameters = tuple(Parameter(f"turn_{axis}", "deg/K", 0.005, -1.0, 1.0) for axis in "xyz")

    def alternatives(self, setting: Setting) -> tuple[BoomBending, ...]:
        if known_column(setting, "temperature_degC") is not None:
            return (self,)
        return tuple(replace(self, time_constant_s=tau_s) for tau_s in TIME_CONSTANTS_S)

    def untestable(self, setting: Setting) -> str | None:
        return thermally_untestable(setting, self.time_constant_s)

    def between(self, setting: Setting, ratio: float) -> BoomBending | None:
        if known_column(setting, "temperature_degC") is not None:
            return None
        return replace(self, time_constant_s=ratio * self.time_constant_s)

    def pinned(self, setting: Setting, reading_B_nT: FloatArray) -> BoomBending:
        mean_degC = float(temperature_K(setting, self.time_constant_s).mean())
        return self if self.reference_degC is not None else replace(self, reference_degC=mean_degC)

    def apply(self, signal: Signal, theta: FloatArray) -> Signal:
        warmer = warmer_K(signal.setting, self.time_constant_s, self.reference_degC)
        at_sensor = signal.field_B_nT if signal.stray_B_nT is None else signal.field_B_nT + signal.stray_B_nT
        seen = Rotation.from_rotvec(-np.radians(np.outer(warmer, theta))).apply(at_sensor)
        return signal.with_stray(seen - at_sensor, here_alone=True)
