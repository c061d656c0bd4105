"""Temperature of one node: a first-order lag behind sun and shadow, with a heater on a thermostat."""

from __future__ import annotations

from math import exp, log
from typing import Self

import numpy as np
from pydantic import model_validator

from fluxtwin.sim.base.section_types import NonNegative, Positive, Section
from fluxtwin.sim.base.types import FloatArray, TimeArray
from fluxtwin.sim.earth import epoch as clock

_LEAST_HYSTERESIS_K = 0.01
"""A heater that switches thousands of times a second is a mistake, and would take for ever to follow."""


class ThermalSection(Section):
    """A first-order lag between two equilibria, sunlit and eclipse, with an optional thermostat. A section of a scenario."""

    sunlit_degC: float
    eclipse_degC: float
    time_constant_min: Positive
    heater_on_below_degC: float | None = None
    heater_off_above_degC: float | None = None
    heater_rise_degC: NonNegative = 0.0
    """How far the heater, left on, lifts the equilibrium."""

    @model_validator(mode="after")
    def _thermostat(self) -> Self:
        on, off = self.heater_on_below_degC, self.heater_off_above_degC
        if (on is None) != (off is None):
            raise ValueError("a heater needs both heater_on_below_degC and heater_off_above_degC")
        if on is not None and off is not None and not off - on >= _LEAST_HYSTERESIS_K:
            raise ValueError(
                f"heater_on_below_degC is to be at least {_LEAST_HYSTERESIS_K:g} K under heater_off_above_degC"
            )
        return self

    def history(
        self, time: TimeArray, illumination: FloatArray, initial_degC: float | None = None
    ) -> tuple[FloatArray, FloatArray]:
        """Temperature [degC] and heater state [0 or 1], each (N,). illumination (N,): share of the sun's disc.

        The equilibrium is held from each stamp to the next, and within a step everything is exact: the lag is an
        exponential, and the heater switches at the instant the threshold is crossed, as often as it is. It starts at
        the mean equilibrium unless stated otherwise, heater off unless that is below its threshold.
        """
        stamps = clock.as_times(time)
        goal = self.eclipse_degC + (self.sunlit_degC - self.eclipse_degC) * np.asarray(illumination, dtype=np.float64)
        degC = float(goal.mean()) if initial_degC is None else initial_degC
        on = self.heater_on_below_degC is not None and degC <= self.heater_on_below_degC
        states = [(degC, on)]
        for held, step in zip(goal.tolist(), np.diff(clock.seconds_since(stamps, stamps[0])).tolist(), strict=False):
            states.append(self._advance(*states[-1], held, step))
        temperature, heater = np.array(states, dtype=np.float64).T
        return temperature, heater

    def _advance(self, temperature: float, on: bool, passive: float, seconds: float) -> tuple[float, bool]:
        """Temperature and heater state after `seconds` at a held passive equilibrium."""
        tau_s = 60.0 * self.time_constant_min
        if self.heater_on_below_degC is None or self.heater_off_above_degC is None:
            return passive + (temperature - passive) * exp(-seconds / tau_s), False
        left = seconds
        while True:
            goal = passive + (self.heater_rise_degC if on else 0.0)
            threshold = self.heater_off_above_degC if on else self.heater_on_below_degC
            until = _time_to(threshold, temperature, goal, tau_s, rising=on)
            if until >= left:
                return goal + (temperature - goal) * exp(-left / tau_s), on
            temperature = threshold if until > 0.0 else temperature
            left, on = left - until, not on


def _time_to(threshold: float, temperature: float, goal: float, tau_s: float, *, rising: bool) -> float:
    """Seconds until the threshold is crossed; 0 if it is passed already, infinite if it is never reached."""
    sense = 1.0 if rising else -1.0
    if sense * (temperature - threshold) >= 0.0:
        return 0.0
    if sense * (goal - threshold) <= 0.0:
        return float("inf")
    return tau_s * log((goal - temperature) / (goal - threshold))
