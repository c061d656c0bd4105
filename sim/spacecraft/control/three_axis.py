"""Three axes held by reaction wheels, whose momentum magnets unload."""

from __future__ import annotations

import numpy as np

from fluxtwin.sim.base.section_types import ZERO3, NonNegative, Positive, Vector3
from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.spacecraft.control.base import Control
from fluxtwin.sim.spacecraft.dynamics.layout import (
    COMMAND_DIPOLE,
    COMMAND_TORQUE,
    ERROR,
    PERIOD,
    RATE_ERROR,
    SEEN_FIELD,
    SEEN_RATE,
    WHEEL_MOMENTUM,
)

MAX_INTEGRAL_RAD = 0.05
"""The integral stands for no larger error than this, so that it is soon forgotten after an acquisition."""


class ThreeAxis(Control):
    """Wheels point, magnets unload. Wheels that do not span three axes leave the rest to the other torques."""

    name = "three_axis"
    needs_wheels = True

    frequency_rad_s: Positive = 0.05
    """Natural frequency n of the loop, all axes."""
    damping: Positive = 0.7
    unloading_per_s: NonNegative = 0.0
    """k: excess momentum across the field decays at this rate."""
    integral_s: NonNegative = 0.0
    """T, in which the integral makes up for a standing error; 0 is no integral."""
    nominal_momentum_Nms: Vector3 = ZERO3
    """What the wheels keep, body axes: a momentum bias."""

    @staticmethod
    def decide(packed: FloatArray, at: int, reading: FloatArray, memory: FloatArray, command: FloatArray) -> None:
        """Torque of the wheels on the body, and the dipole that unloads them:

            -J (n^2 (e + int e dt / T) + 2 d n de/dt) + w x (J w + h)
            m = k (dh x B) / B^2, so that m x B = -k dh across the field

        (Wie, Weiss & Arapostathis 1989, J. Guidance 12, 375; Camillo & Markley 1980, J. Guidance 3, 563.) e is the turn
        from the target, dh the wheels' momentum less the nominal one.
        """
        e, r, w, h, b = ERROR, RATE_ERROR, SEEN_RATE, WHEEL_MOMENTUM, SEEN_FIELD
        p, d = packed[at + 6], packed[at + 7]
        if packed[at + 12] > 0.0:
            for axis in range(3):
                memory[axis] += reading[e + axis] * reading[PERIOD] / packed[at + 12]
                memory[axis] = min(max(memory[axis], -MAX_INTEGRAL_RAD), MAX_INTEGRAL_RAD)
        ax = -p * (reading[e] + memory[0]) - d * reading[r]
        ay = -p * (reading[e + 1] + memory[1]) - d * reading[r + 1]
        az = -p * (reading[e + 2] + memory[2]) - d * reading[r + 2]
        wx, wy, wz = reading[w], reading[w + 1], reading[w + 2]
        hx = packed[at] * wx + packed[at + 3] * wy + packed[at + 4] * wz + reading[h]
        hy = packed[at + 3] * wx + packed[at + 1] * wy + packed[at + 5] * wz + reading[h + 1]
        hz = packed[at + 4] * wx + packed[at + 5] * wy + packed[at + 2] * wz + reading[h + 2]
        command[COMMAND_TORQUE] += packed[at] * ax + packed[at + 3] * ay + packed[at + 4] * az + wy * hz - wz * hy
        command[COMMAND_TORQUE + 1] += (
            packed[at + 3] * ax + packed[at + 1] * ay + packed[at + 5] * az + wz * hx - wx * hz
        )
        command[COMMAND_TORQUE + 2] += (
            packed[at + 4] * ax + packed[at + 5] * ay + packed[at + 2] * az + wx * hy - wy * hx
        )
        bx, by, bz = reading[b], reading[b + 1], reading[b + 2]
        squared = bx * bx + by * by + bz * bz
        if squared > 0.0:
            k = packed[at + 8] / squared
            dx, dy, dz = reading[h] - packed[at + 9], reading[h + 1] - packed[at + 10], reading[h + 2] - packed[at + 11]
            command[COMMAND_DIPOLE] += k * (dy * bz - dz * by)
            command[COMMAND_DIPOLE + 1] += k * (dz * bx - dx * bz)
            command[COMMAND_DIPOLE + 2] += k * (dx * by - dy * bx)

    def packed(self, inertia_kg_m2: FloatArray) -> list[float]:
        """Inertia xx yy zz xy xz yz, n^2, 2 d n, k, nominal momentum, T."""
        J, n = np.asarray(inertia_kg_m2), self.frequency_rad_s
        tensor = [float(v) for v in (J[0, 0], J[1, 1], J[2, 2], J[0, 1], J[0, 2], J[1, 2])]
        gains = [n * n, 2.0 * self.damping * n, self.unloading_per_s]
        return [*tensor, *gains, *self.nominal_momentum_Nms, self.integral_s]
