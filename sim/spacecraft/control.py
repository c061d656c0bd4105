"""Attitude control laws: sections of a scenario with their gains, and functions that a kernel can run."""

from __future__ import annotations

from math import sqrt
from typing import ClassVar, Literal

import numpy as np

from fluxtwin.sim.base.section_types import ZERO3, NonNegative, Positive, Section, Vector3
from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.spacecraft.dynamics.layout import (
    AXIS,
    COMMAND_DIPOLE,
    COMMAND_TORQUE,
    ERROR,
    PERIOD,
    RATE_ERROR,
    SEEN_FIELD,
    SEEN_RATE,
    TICK,
    WHEEL_MOMENTUM,
    symmetric,
)

MAX_INTEGRAL_RAD = 0.05
"""The integral stands for no larger error than this, so that it is soon forgotten after an acquisition."""


class Control(Section):
    """Base of all control laws: a frozen record, checked as a section [control.NAME] of a scenario."""

    name: ClassVar[str]
    needs_torquers: ClassVar[bool] = False
    needs_wheels: ClassVar[bool] = False
    """Without them the law could do nothing of what it is for."""

    @staticmethod
    def decide(packed: FloatArray, at: int, reading: FloatArray, memory: FloatArray, command: FloatArray) -> None:
        """Add to `command` what the law wants at this tick.

        packed[at ...] holds the gains; reading, memory and command are as in `dynamics.layout`. Compiled like the
        torques, so under the same restrictions.
        """
        raise NotImplementedError

    def packed(self, inertia_kg_m2: FloatArray) -> list[float]:
        """The numbers that `decide` finds at packed[at ...]; inertia_kg_m2 is that of the whole body, (3, 3) in B."""
        raise NotImplementedError


class BDot(Control):
    """A dipole against the change of the field in the body, which takes away the rate: B-dot on all three axes.

    The torquers' drive makes it linear, saturated or on-off.
    """

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
        return [self.gain_Am2_s_per_T]


class MomentumBias(Control):
    """Momentum bias held by magnets: nutation damping, precession and momentum, from a scanner and the field's sign.

    A wheel turns about the pitch axis (body y), so that the momentum lies along the orbit normal, -y of O, and an infrared
    scanner sees roll and pitch; yaw is never measured. A quarter of an orbit turns a yaw error into a roll error, so what
    takes away roll all along the orbit takes away yaw as well. The torquers' drive makes the dipoles proportional, limited,
    or full on and off.
    """

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


class ThreeAxis(Control):
    """Three axes: wheels point, magnets unload. Wheels that do not span three axes leave the rest to the other torques."""

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
        tx, ty, tz = symmetric(packed, at, ax, ay, az)
        hx, hy, hz = symmetric(packed, at, wx, wy, wz)
        hx, hy, hz = hx + reading[h], hy + reading[h + 1], hz + reading[h + 2]
        command[COMMAND_TORQUE] += tx + wy * hz - wz * hy
        command[COMMAND_TORQUE + 1] += ty + wz * hx - wx * hz
        command[COMMAND_TORQUE + 2] += tz + wx * hy - wy * hx
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


class Spin(Control):
    """A spinner steered by magnets: spin about body z at a wanted rate, the axis along `control.axis`."""

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


CONTROLS: tuple[type[Control], ...] = (BDot, MomentumBias, ThreeAxis, Spin)
"""Their order is that of the packed gains."""
