"""Momentum bias held by magnets: nutation damping, precession and momentum, from a scanner and the field's sign.

A wheel turns about the pitch axis (body y), so that the momentum lies along the orbit normal, -y of O, and an infrared
scanner sees roll and pitch; yaw is never measured. A quarter of an orbit turns a yaw error into a roll error, so what
takes away roll all along the orbit takes away yaw as well.
"""

from __future__ import annotations

from math import sqrt
from typing import Literal

from fluxtwin.sim.base.section_types import NonNegative, Positive
from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.spacecraft.control.base import Control
from fluxtwin.sim.spacecraft.dynamics.layout import (
    COMMAND_DIPOLE,
    COMMAND_TORQUE,
    ERROR,
    PERIOD,
    RATE_ERROR,
    SEEN_FIELD,
    TICK,
    WHEEL_MOMENTUM,
)

MAX_INTEGRAL_RAD = 0.05
"""The integral stands for no larger error than this, so that it is soon forgotten after an acquisition."""


class MomentumBias(Control):
    """Momentum-bias control. The torquers' drive makes the dipoles proportional, limited, or full on and off."""

    name = "momentum_bias"
    needs_wheels = True

    momentum_Nms: Positive
    """Of the wheel, along -y of the body."""
    nutation_gain_Am2_s_per_T: NonNegative
    precession_gain_Am2_per_rad: NonNegative
    momentum_gain_per_T: NonNegative
    """A m2 for each N m s of excess, which is 1/(T s) times s."""
    pitch_frequency_rad_s: Positive = 0.05
    """Natural frequency of the pitch loop."""
    pitch_damping: Positive = 0.7
    roll_smoothing_s: NonNegative = 60.0
    """First-order filter of the roll that the precession acts on: it must not see the nutation, which it would feed."""
    pitch_integral_s: NonNegative = 100.0
    """Time in which the integral makes up for a standing error, as friction leaves; 0 is no integral."""
    field_use: Literal["sign", "proportional"] = "sign"

    @staticmethod
    def decide(packed: FloatArray, at: int, reading: FloatArray, memory: FloatArray, command: FloatArray) -> None:
        """Three dipoles and the pitch loop (after Alfriend 1975, AIAA Journal 13, 817, reference 1 of the papers):

            nutation    m_y = -k_n dB_y/dt               B-dot about the pitch axis
            precession  m_y = -k_p roll sign(B_x)        torque about z, which turns the momentum in roll
            momentum    m_x = k_h dH sign(B_z), m_z = -k_h dH sign(B_x)     torque about y against dH

        dH is the wheel's momentum about +y less the wanted one, -h. Precession and momentum use only the sign of the
        field, so a crude magnetometer will do; only its change counts for the nutation. (With `proportional`, B_x / B and
        B_z / B stand for the signs, as in Alfriend's linear law.) The wheel keeps pitch with proportional, integral and
        rate gain.

        Roll is smoothed first, because the precession law feeds a nutation. The dipole that turns roll also turns yaw, by
        m_y B_z; over an orbit that cancels only while roll changes little in a quarter of it. So the precession must be
        slow, k_p B / (h n) about 1 at most with n the orbital rate: signs with torquers full on or off hold small errors,
        but may not catch some that are ten times their dead zone.
        """
        bx, by, bz = reading[SEEN_FIELD], reading[SEEN_FIELD + 1], reading[SEEN_FIELD + 2]
        sign_x, sign_z = (1.0 if bx >= 0.0 else -1.0), (1.0 if bz >= 0.0 else -1.0)
        if packed[at + 6] > 0.0:
            size = sqrt(bx * bx + by * by + bz * bz)
            sign_x, sign_z = bx / size, bz / size
        if reading[TICK] > 0.0:
            command[COMMAND_DIPOLE + 1] -= packed[at + 1] * (by - memory[0]) / reading[PERIOD]
        memory[0] = by
        keep = packed[at + 8] / (packed[at + 8] + reading[PERIOD])
        memory[2] = keep * memory[2] + (1.0 - keep) * reading[ERROR]
        command[COMMAND_DIPOLE + 1] -= packed[at + 2] * memory[2] * sign_x
        excess = reading[WHEEL_MOMENTUM + 1] + packed[at]
        command[COMMAND_DIPOLE] += packed[at + 3] * excess * sign_z
        command[COMMAND_DIPOLE + 2] -= packed[at + 3] * excess * sign_x
        if packed[at + 7] > 0.0:
            memory[1] += reading[ERROR + 1] * reading[PERIOD] / packed[at + 7]
            memory[1] = min(max(memory[1], -MAX_INTEGRAL_RAD), MAX_INTEGRAL_RAD)
        stiffness, damping = packed[at + 4], packed[at + 5]
        command[COMMAND_TORQUE + 1] -= stiffness * (reading[ERROR + 1] + memory[1]) + damping * reading[RATE_ERROR + 1]

    def packed(self, inertia_kg_m2: FloatArray) -> list[float]:
        """Momentum, magnetic gains, pitch gains [N m/rad] and [N m s/rad], use of the field, times."""
        pitch = float(inertia_kg_m2[1][1]) * self.pitch_frequency_rad_s
        return [
            self.momentum_Nms,
            self.nutation_gain_Am2_s_per_T,
            self.precession_gain_Am2_per_rad,
            self.momentum_gain_per_T,
            pitch * self.pitch_frequency_rad_s,
            2.0 * self.pitch_damping * pitch,
            float(self.field_use == "proportional"),
            self.pitch_integral_s,
            self.roll_smoothing_s,
        ]
