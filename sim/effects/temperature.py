"""What follows the temperature: bias, scale factors, and a boom that bends."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar, Self

import numpy as np
from scipy.spatial.transform import Rotation

from fluxtwin.sim.base.late import varies
from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.effects.base import Parameter, SignalEffect, in_reading, known_column, vector_parameters
from fluxtwin.sim.effects.calibration import rescaled
from fluxtwin.sim.effects.drivers import STANDARD_SWING_K, TIME_CONSTANTS_S, temperature_K
from fluxtwin.sim.effects.signal import Setting, Signal


@dataclass(frozen=True)
class ThermalEffect(SignalEffect):
    """Base of the effects that grow with temperature, from zero at `reference_degC`.

    Without the column `temperature_degC` the temperature is a first-order lag, `time_constant_s`, behind sun
    and shadow, whose equilibrium swings from 0 to 20: a parameter is then per K of that swing.
    """

    follows = "temperature"
    tried_s: ClassVar[tuple[float, ...]] = TIME_CONSTANTS_S
    """Time constants tried where no temperature was recorded."""
    time_constant_s: float = 900.0
    reference_degC: float | None = None
    """Temperature without effect; None: the record's mean."""

    def alternatives(self, setting: Setting) -> tuple[Self, ...]:
        if known_column(setting, "temperature_degC") is not None:
            return (self,)
        return tuple(replace(self, time_constant_s=tau_s) for tau_s in self.tried_s)

    def untestable(self, setting: Setting) -> str | None:
        # A hundredth of a kelvin is no change.
        if varies(temperature_K(setting, self.time_constant_s), least=0.01 / STANDARD_SWING_K):
            return None
        if known_column(setting, "temperature_degC") is not None:
            return "the temperature never changes"
        return "no temperature was recorded, and the sunlight never changes"

    def between(self, setting: Setting, ratio: float) -> Self | None:
        if known_column(setting, "temperature_degC") is not None:
            return None
        return replace(self, time_constant_s=ratio * self.time_constant_s)

    def pinned(self, setting: Setting, reading_B_nT: FloatArray) -> Self:
        mean_degC = float(temperature_K(setting, self.time_constant_s).mean())
        return self if self.reference_degC is not None else replace(self, reference_degC=mean_degC)

    def warmer_K(self, setting: Setting) -> FloatArray:
        """(N,) temperature above the reference, or above the record's mean."""
        temperature = temperature_K(setting, self.time_constant_s)
        reference_degC = float(temperature.mean()) if self.reference_degC is None else self.reference_degC
        return np.asarray(temperature - reference_degC)


@dataclass(frozen=True)
class ThermalBiasDrift(ThermalEffect):
    """The bias grows with temperature."""

    name = "thermal_bias_drift"
    stage = "sensor"
    settled_by = "warming and cooling through a full range, over several sun angles"
    about = (
        "change of the bias b of eq. 1 per K of temperature; + lowers the reading when warm (offset "
        "temperature coefficients: CryoSat-2, Olsen et al. 2020, doi 10.1186/s40623-020-01171-9; 0.1-10 nT/K "
        "fluxgates, more for magnetoresistors)"
    )
    adds = True
    parameters = vector_parameters("b", "nT/K", 5.0)

    def apply(self, signal: Signal, theta: FloatArray) -> Signal:
        shift = in_reading(signal.setting, theta)
        return signal.with_reading(signal.reading - self.warmer_K(signal.setting)[:, None] * shift)


@dataclass(frozen=True)
class ThermalScaleDrift(ThermalEffect):
    """The scale error grows with temperature."""

    name = "thermal_scale_drift"
    stage = "sensor"
    settled_by = "a slow tumble of 0.25 deg/s, at several temperatures"
    about = (
        "change of the diagonal of S in eq. 1 per K of temperature; + lowers the reading when warm (Swarm, about 1e-6 1/K: "
        "Toffner-Clausen et al. 2016; fluxgates 1e-5 to 5e-5, magnetoresistors up to 3e-3)"
    )
    parameters = vector_parameters("S", "1/K", 1e-4, -0.01, 0.01, axes=("xx", "yy", "zz"))

    def apply(self, signal: Signal, theta: FloatArray) -> Signal:
        return signal.with_reading(self.carried(signal, theta, signal.reading))

    def carried(self, signal: Signal, theta: FloatArray, images: FloatArray) -> FloatArray:
        return rescaled(signal.setting, images, np.outer(self.warmer_K(signal.setting), theta))


@dataclass(frozen=True)
class CommonGainDrift(ThermalEffect):
    """The common gain follows the temperature.

    The whole reading is multiplied: the spacecraft's own field and the bias as well as the ambient field.
    """

    name = "common_gain_drift"
    stage = "sensor"
    settled_by = "warming and cooling through a full range, the temperature of the sensor in the telemetry"
    about = (
        "the reading is multiplied by 1 + gain per K of temperature, all axes alike; + raises it when warm (one supply "
        "drives all bridges: Honeywell HMC1001/1002, -3e-3 1/K at constant voltage, -6e-4 1/K at constant current)"
    )
    tried_s = (600.0, 1500.0, 3600.0)
    time_constant_s: float = 1500.0

    parameters = (Parameter("gain", "1/K", 1e-3, -0.02, 0.02),)

    def apply(self, signal: Signal, theta: FloatArray) -> Signal:
        return signal.with_reading(self._gain(signal.setting, theta)[:, None] * signal.reading)

    def images(self, signal: Signal, theta: FloatArray) -> FloatArray:
        return (self.warmer_K(signal.setting)[:, None] * signal.reading)[:, :, None]

    def carried(self, signal: Signal, theta: FloatArray, images: FloatArray) -> FloatArray:
        return self._gain(signal.setting, theta)[:, None, None] * images

    def _gain(self, setting: Setting, theta: FloatArray) -> FloatArray:
        """(N,)."""
        return 1.0 + float(theta[0]) * self.warmer_K(setting)


@dataclass(frozen=True)
class BoomBending(ThermalEffect):
    """The sensor rotates as its boom warms up.

    + turns the sensor's axes right-handed about the body axis, so the field in them turns the other way. The whole
    field at the sensor turns, that of the spacecraft too. The boom is straight at `reference_degC`.
    """

    name = "boom_bending"
    stage = "spacecraft"
    settled_by = "a slow tumble of 0.25 deg/s through sun and shadow, with the boom's temperature in the telemetry"
    equivalent_stages = ("attitude", "sensor")
    about = (
        "rotation of the sensor per K of temperature, positive right-handed about the body axis (thermal bending of a boom: "
        "Boley & Weiner 1960, Theory of Thermal Stresses, chapter 10; Magsat's attitude transfer system was built "
        "for excursions of 0.05 deg in bending and 0.08 deg in twist, NTRS 19810055192)"
    )
    tried_s = (60.0, 300.0, 900.0, 2700.0)  # a bare strip of metal to a root inside the body
    time_constant_s: float = 300.0

    parameters = vector_parameters("turn", "deg/K", 0.005, -1.0, 1.0)

    def apply(self, signal: Signal, theta: FloatArray) -> Signal:
        at_sensor = signal.at_sensor_B_nT
        turn = -np.radians(np.outer(self.warmer_K(signal.setting), theta))
        return signal.with_stray(Rotation.from_rotvec(turn).apply(at_sensor) - at_sensor, here_alone=True)
