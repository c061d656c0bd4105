"""B-dot: a dipole against the change of the field in the body, which takes away the rate."""

from __future__ import annotations

from fluxtwin.sim.base.section_types import Positive
from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.spacecraft.control.base import Control
from fluxtwin.sim.spacecraft.dynamics.layout import COMMAND_DIPOLE, PERIOD, SEEN_FIELD, TICK


class BDot(Control):
    """B-dot on all three axes; the torquers' drive makes it linear, saturated or on-off."""

    name = "b_dot"
    needs_torquers = True

    gain_Am2_s_per_T: Positive

    @staticmethod
    def decide(packed: FloatArray, at: int, reading: FloatArray, memory: FloatArray, command: FloatArray) -> None:
        """m = -k dB/dt from the difference of two readings (Stickler & Alfriend 1976, J. Spacecraft 13, 282)."""
        for axis in range(3):
            field = reading[SEEN_FIELD + axis]
            if reading[TICK] > 0.0:
                command[COMMAND_DIPOLE + axis] -= packed[at] * (field - memory[axis]) / reading[PERIOD]
            memory[axis] = field

    def packed(self, inertia_kg_m2: FloatArray) -> list[float]:
        """The gain [A m2 s/T]."""
        return [self.gain_Am2_s_per_T]
