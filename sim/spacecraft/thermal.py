"""Temperature of one node: a first-order lag behind sun and shadow, with a heater on a thermostat."""

from __future__ import annotations

from dataclasses import dataclass
from math import exp, log

import numpy as np

from fluxtwin.sim.base.errors import BadInput
from fluxtwin.sim.base.types import FloatArray, TimeArray
from fluxtwin.sim.earth import epoch as clock

_LEAST_HYSTERESIS_K = 0.01
"""A heater that switches thousands of times a second is a mistake, and would take for ever to follow."""


def equilibrium_degC(illumination: FloatArray, sunlit_degC: float, eclipse_degC: float) -> FloatArray:
    """The temperature (N,) that the node would settle at: one value in shadow, one in full sun."""
    return eclipse_degC + (sunlit_degC - eclipse_degC) * np.asarray(illumination, dtype=np.float64)


@dataclass(frozen=True)
class Thermostat:
    """A heater that goes on below one temperature and off above a higher one.

    `rise_K` is how far the heater, left on, lifts the equilibrium.
    """

    on_below_degC: float
    off_above_degC: float
    rise_K: float

    def __post_init__(self) -> None:
        if not self.off_above_degC - self.on_below_degC >= _LEAST_HYSTERESIS_K or not self.rise_K >= 0:
            raise BadInput(
                f"on below {self.on_below_degC:g}, off above {self.off_above_degC:g}, rise {self.rise_K:g} K",
                where="thermostat",
                wanted=f"on_below at least {_LEAST_HYSTERESIS_K:g} K under off_above, and a rise >= 0",
            )


def temperature_history(
    time: TimeArray,
    equilibrium_degC: FloatArray,
    time_constant_s: float,
    *,
    thermostat: Thermostat | None = None,
    initial_degC: float | None = None,
) -> tuple[FloatArray, FloatArray]:
    """Temperature [degC] and heater state [0 or 1], each (N,).

    The equilibrium (N,) is held from each stamp to the next, and within a step everything is exact: the lag
    is an exponential, and the heater switches at the instant the threshold is crossed, as often as it is. It starts at
    the mean equilibrium unless stated otherwise, heater off unless that is below its threshold.
    """
    stamps = clock.as_times(time)
    goal = np.broadcast_to(np.asarray(equilibrium_degC, dtype=np.float64), stamps.shape)
    start = float(goal.mean()) if initial_degC is None else initial_degC
    start_on = thermostat is not None and start <= thermostat.on_below_degC
    steps = np.diff(clock.seconds_since(stamps, stamps[0])).tolist()
    temperature, heater = [start], [start_on]
    for held, step in zip(goal.tolist(), steps, strict=False):
        degC, on = _advance(temperature[-1], heater[-1], held, step, time_constant_s, thermostat)
        temperature.append(degC)
        heater.append(on)
    return np.array(temperature), np.array(heater, dtype=np.float64)


def _advance(
    temperature: float, on: bool, passive: float, seconds: float, tau_s: float, thermostat: Thermostat | None
) -> tuple[float, bool]:
    """Temperature and heater state after `seconds` at a held passive equilibrium."""
    if thermostat is None:
        return passive + (temperature - passive) * exp(-seconds / tau_s), False
    left = seconds
    while True:
        goal = passive + (thermostat.rise_K if on else 0.0)
        threshold = thermostat.off_above_degC if on else thermostat.on_below_degC
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
