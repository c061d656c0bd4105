"""A spinner steered by magnets: its axis, its rate and its nutation. The spin axis is body z."""

from __future__ import annotations

import numpy as np

from fluxtwin.sim.base.section_types import NonNegative
from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.spacecraft.control.base import Control
from fluxtwin.sim.spacecraft.dynamics.layout import AXIS, COMMAND_DIPOLE, PERIOD, SEEN_FIELD, SEEN_RATE, TICK


class Spin(Control):
    """Spin about body z at a wanted rate, the axis along `control.axis`."""

    name = "spin"
    needs_torquers = True

    rate_rpm: float
    axis_gain_Am2_per_T: NonNegative = 0.0
    rate_gain_Am2_s_per_T: NonNegative = 0.0
    nutation_gain_Am2_s_per_T: NonNegative = 0.0

    @staticmethod
    def decide(packed: FloatArray, at: int, reading: FloatArray, memory: FloatArray, command: FloatArray) -> None:
        """Dipoles of a coil along the spin axis and two across it:

        axis      m_z = k_a (z x B) . a              a the wanted direction: the torque m x B then points towards it
        rate      m = k_s (W - w_z) (B_y, -B_x, 0)   torque about z of k_s (W - w_z) times the field across z, squared
        nutation  m_z = -k_n dB_z/dt                 a steady spin leaves B_z alone
        """
        bx, by, bz = reading[SEEN_FIELD], reading[SEEN_FIELD + 1], reading[SEEN_FIELD + 2]
        command[COMMAND_DIPOLE + 2] += packed[at + 1] * (bx * reading[AXIS + 1] - by * reading[AXIS])
        lack = packed[at] - reading[SEEN_RATE + 2]
        command[COMMAND_DIPOLE] += packed[at + 2] * lack * by
        command[COMMAND_DIPOLE + 1] -= packed[at + 2] * lack * bx
        if reading[TICK] > 0.0:
            command[COMMAND_DIPOLE + 2] -= packed[at + 3] * (bz - memory[0]) / reading[PERIOD]
        memory[0] = bz

    def packed(self, inertia_kg_m2: FloatArray) -> list[float]:
        """Rate [rad/s] and the three gains."""
        return [
            self.rate_rpm * 2.0 * float(np.pi) / 60.0,
            self.axis_gain_Am2_per_T,
            self.rate_gain_Am2_s_per_T,
            self.nutation_gain_Am2_s_per_T,
        ]
