"""Solar array and battery: currents and state of charge."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fluxtwin.sim.base.errors import BadInput
from fluxtwin.sim.base.types import FloatArray, TimeArray
from fluxtwin.sim.earth import epoch as clock

Direction = tuple[float, float, float]
"""Components of a direction in body axes, of any length but zero."""


@dataclass(frozen=True)
class Panel:
    """A panel fixed to the body, or an array that turns so that its normal follows the sun."""

    direction_B: Direction
    """Outward normal of a fixed panel; the axis of an array, to which its normal stays across."""
    full_sun_current_A: float
    """At normal incidence."""
    tracks: bool = False


def incidence_cosine(sun_B: FloatArray, panel: Panel) -> FloatArray:
    """Cosine of the angle between the panel's normal and the sun, 0 where the sun is behind it. Shape (N,).

    sun_B: (N, 3) unit vectors. A tracking array's best normal leaves only the angle out of its plane: the
    cosine is the sine of the angle between sun and axis.
    """
    sun = np.atleast_2d(np.asarray(sun_B, dtype=np.float64))
    if panel.tracks:
        across = np.cross(sun, _unit(panel.direction_B, "array axis"))
        return np.asarray(np.linalg.norm(across, axis=1))
    return np.clip(sun @ _unit(panel.direction_B, "panel normal"), 0.0, None)


def array_current_A(sun_B: FloatArray, illumination: FloatArray, panel: Panel) -> FloatArray:
    """Current of a panel, (N,) A: full-sun current x cosine of incidence x illumination.

    sun_B (N, 3) unit vectors, illumination (N,) share of the sun's disc. Self-shadowing, temperature and the
    sun's distance (3.4 % in irradiance) are left out.
    """
    return panel.full_sun_current_A * incidence_cosine(sun_B, panel) * np.asarray(illumination, dtype=np.float64)


@dataclass(frozen=True)
class Battery:
    """A battery that takes what the array leaves over, up to a charging limit that tapers at full charge."""

    capacity_Ah: float
    efficiency: float = 0.9
    """Share of the charge put in that can be taken out again (coulombic)."""
    taper_above: float = 0.9
    """State of charge from which the charging limit falls linearly, to zero at full charge."""

    @property
    def limit_A(self) -> float:
        """Largest charging current below the taper: half the capacity per hour."""
        return 0.5 * self.capacity_Ah

    def accepted_A(self, state_of_charge: float, surplus_A: float) -> float:
        """Battery current for a surplus (array less load), positive when charging; the rest is shunted.

        An empty battery gives nothing: what the load then lacks is not followed.
        """
        if surplus_A <= 0.0:
            return surplus_A if state_of_charge > 0.0 else 0.0
        room = min(1.0, (1.0 - state_of_charge) / (1.0 - self.taper_above))
        return min(surplus_A, self.limit_A * room)

    def after(self, state_of_charge: float, surplus_A: float, seconds: float) -> float:
        """State of charge after `seconds` at a constant surplus; exact, whatever the step."""
        hours = seconds / 3600.0
        if surplus_A <= 0.0:
            return max(0.0, state_of_charge + surplus_A * hours / self.capacity_Ah)
        rate = self.efficiency / self.capacity_Ah  # state of charge per ampere hour
        constant = min(surplus_A, self.limit_A)
        # Constant current up to where the falling limit meets it, exponential approach to full beyond.
        bend = 1.0 - (1.0 - self.taper_above) * constant / self.limit_A
        if state_of_charge < bend:
            to_bend = (bend - state_of_charge) / (rate * constant)
            if hours <= to_bend:
                return state_of_charge + rate * constant * hours
            state_of_charge, hours = bend, hours - to_bend
        return 1.0 - (1.0 - state_of_charge) * float(np.exp(-rate * self.limit_A / (1.0 - self.taper_above) * hours))


def battery_history(
    time: TimeArray,
    array_current_A: FloatArray,
    load_A: FloatArray | float,
    battery: Battery,
    *,
    initial_state_of_charge: float = 1.0,
) -> tuple[FloatArray, FloatArray]:
    """Battery current [A], positive when charging, and state of charge [0, 1], each (N,).

    Array current and load are held from each stamp to the next.
    """
    stamps = clock.as_times(time)
    surplus = (np.broadcast_to(array_current_A, stamps.shape) - load_A).tolist()
    steps = np.diff(clock.seconds_since(stamps, stamps[0])).tolist()
    charge = [initial_state_of_charge]
    for held, step in zip(surplus, steps, strict=False):
        charge.append(battery.after(charge[-1], held, step))
    current = [battery.accepted_A(*pair) for pair in zip(charge, surplus, strict=True)]
    return np.array(current), np.array(charge)


def _unit(vector: Direction, name: str) -> FloatArray:
    array = np.asarray(vector, dtype=np.float64)
    size = float(np.linalg.norm(array))
    if array.shape != (3,) or not size > 0:
        raise BadInput(f"{vector}", where=name, wanted="three numbers, not all zero")
    return np.asarray(array / size)
