"""A bias that follows the temperature."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.effects.base import SignalEffect, known_column, vector_parameters
from fluxtwin.sim.effects.drivers import STANDARD_SWING_K, TIME_CONSTANTS_S, temperature_K, varies
from fluxtwin.sim.effects.instrument import in_reading
from fluxtwin.sim.effects.signal import Setting, Signal


@dataclass(frozen=True)
class ThermalBiasDrift(SignalEffect):
    """The bias grows with temperature.

    b of equation 1 grows with temperature, from zero at `reference_degC`.

    Without the column `temperature_degC` the temperature is a first-order lag, `time_constant_s`, behind sun
    and shadow, whose equilibrium swings from 0 to 20: the parameter is then nT per K of that swing.
    """

    name: ClassVar[str] = "thermal_bias_drift"
    stage: ClassVar[str] = "sensor"
    frame: ClassVar[str | None] = "body"
    follows: ClassVar[str | None] = "temperature"
    settled_by: ClassVar[str] = "warming and cooling through a full range, over several sun angles"
    about: ClassVar[str] = (
        "b of eq. 1 per K of temperature; + lowers the reading when warm (offset temperature coefficients: CryoSat-2, "
        "Olsen et al. 2020, doi 10.1186/s40623-020-01171-9; 0.1-10 nT/K fluxgates, more for magnetoresistors)"
    )
    time_constant_s: float = 900.0
    reference_degC: float | None = None
    """Temperature without effect; None: the record's mean."""

    parameters = vector_parameters("b", "nT/K", 5.0)

    def alternatives(self, setting: Setting) -> tuple[ThermalBiasDrift, ...]:
        if known_column(setting, "temperature_degC") is not None:
            return (self,)
        return tuple(replace(self, time_constant_s=tau_s) for tau_s in TIME_CONSTANTS_S)

    def untestable(self, setting: Setting) -> str | None:
        return thermally_untestable(setting, self.time_constant_s)

    def between(self, setting: Setting, ratio: float) -> ThermalBiasDrift | None:
        if known_column(setting, "temperature_degC") is not None:
            return None
        return replace(self, time_constant_s=ratio * self.time_constant_s)

    def pinned(self, setting: Setting, reading_B_nT: FloatArray) -> ThermalBiasDrift:
        mean_degC = float(temperature_K(setting, self.time_constant_s).mean())
        return self if self.reference_degC is not None else replace(self, reference_degC=mean_degC)

    def apply(self, signal: Signal, theta: FloatArray) -> Signal:
        warmer = warmer_K(signal.setting, self.time_constant_s, self.reference_degC)
        shift = in_reading(signal.setting, theta)
        return signal.with_reading(signal.reading - warmer[:, None] * shift)


def warmer_K(setting: Setting, time_constant_s: float, reference_degC: float | None) -> FloatArray:
    """(N,) temperature above the reference, or above the record's mean."""
    temperature = temperature_K(setting, time_constant_s)
    above: FloatArray = temperature - (float(temperature.mean()) if reference_degC is None else reference_degC)
    return above


def thermally_untestable(setting: Setting, time_constant_s: float) -> str | None:
    """Why no temperature effect can show, or None. A hundredth of a kelvin is no change."""
    if varies(temperature_K(setting, time_constant_s), least=0.01 / STANDARD_SWING_K):
        return None
    if known_column(setting, "temperature_degC") is not None:
        return "the temperature never changes"
    return "no temperature was recorded, and the sunlight never changes"
