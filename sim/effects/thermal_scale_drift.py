"""Scale factors that follow the temperature."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.effects.base import Parameter, SignalEffect, known_column
from fluxtwin.sim.effects.drivers import TIME_CONSTANTS_S, temperature_K
from fluxtwin.sim.effects.instrument import mapped
from fluxtwin.sim.effects.signal import Setting, Signal
from fluxtwin.sim.effects.thermal_bias_drift import thermally_untestable, warmer_K


@dataclass(frozen=True)
class ThermalScaleDrift(SignalEffect):
    """The scale error grows with temperature.

    The diagonal of eq. 1's S grows with temperature, from zero at `reference_degC`; see thermal_bias_drift.
    """

    name: ClassVar[str] = "thermal_scale_drift"
    stage: ClassVar[str] = "sensor"
    frame: ClassVar[str | None] = "body"
    follows: ClassVar[str | None] = "temperature"
    settled_by: ClassVar[str] = "a slow tumble of 0.25 deg/s, at several temperatures"
    about: ClassVar[str] = (
        "diagonal of eq. 1's S per K of temperature; + lowers the reading when warm (Swarm, about 1e-6 1/K: "
        "Toffner-Clausen et al. 2016; fluxgates 1e-5 to 5e-5, magnetoresistors up to 3e-3)"
    )
    time_constant_s: float = 900.0
    reference_degC: float | None = None
    """Temperature without effect; None: the record's mean."""

    parameters = tuple(Parameter(f"S_{axis}{axis}", "1/K", 1e-4, -0.01, 0.01) for axis in "xyz")

    def alternatives(self, setting: Setting) -> tuple[ThermalScaleDrift, ...]:
        if known_column(setting, "temperature_degC") is not None:
            return (self,)
        return tuple(replace(self, time_constant_s=tau_s) for tau_s in TIME_CONSTANTS_S)

    def untestable(self, setting: Setting) -> str | None:
        return thermally_untestable(setting, self.time_constant_s)

    def between(self, setting: Setting, ratio: float) -> ThermalScaleDrift | None:
        if known_column(setting, "temperature_degC") is not None:
            return None
        return replace(self, time_constant_s=ratio * self.time_constant_s)

    def pinned(self, setting: Setting, reading_B_nT: FloatArray) -> ThermalScaleDrift:
        mean_degC = float(temperature_K(setting, self.time_constant_s).mean())
        return self if self.reference_degC is not None else replace(self, reference_degC=mean_degC)

    def apply(self, signal: Signal, theta: FloatArray) -> Signal:
        warmer = warmer_K(signal.setting, self.time_constant_s, self.reference_degC)
        nominal = np.eye(3) + signal.setting.instrument.S
        warm = nominal + warmer[:, None, None] * np.diag(theta)
        changed = np.linalg.solve(warm, mapped(nominal, signal.reading)[:, :, None])[:, :, 0]
        return signal.with_reading(np.asarray(changed, dtype=np.float64))
