"""Torques of the magnetic field: of what the spacecraft carries, commands, and what its shell induces."""

from __future__ import annotations

from typing import Any, Literal, Self

import numpy as np
from pydantic import model_validator

from fluxtwin.sim.base.section_types import Matrix3, NonNegative, Positive, Vector3
from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.spacecraft.dynamics.layout import DIPOLE, FIELD, RATE, TORQUE
from fluxtwin.sim.spacecraft.torques.base import Torque

_DRIVES = ("linear", "saturated", "on_off")


class ResidualDipole(Torque):
    """A dipole fixed in the body."""

    name = "residual_dipole"
    needs_field = True

    dipole_Am2: Vector3

    @staticmethod
    def add(packed: FloatArray, at: int, stage: FloatArray) -> None:
        """m x B (Wertz, Spacecraft Attitude Determination and Control, 1978, section 17.2.4)."""
        mx, my, mz = packed[at], packed[at + 1], packed[at + 2]
        bx, by, bz = stage[FIELD], stage[FIELD + 1], stage[FIELD + 2]
        stage[TORQUE] += my * bz - mz * by
        stage[TORQUE + 1] += mz * bx - mx * bz
        stage[TORQUE + 2] += mx * by - my * bx

    def packed(self, inertia_kg_m2: FloatArray) -> list[float]:
        """The dipole [A m2]."""
        return list(self.dipole_Am2)


def drive(packed: FloatArray, at: int, command: FloatArray) -> None:
    """Turn the command (3,) [A m2] into the dipole that the torquers make of it, in place."""
    kind, limit, threshold = packed[at], packed[at + 1], packed[at + 2]
    for axis in range(3):
        wanted = command[axis]
        if kind == 1.0:
            wanted = min(max(wanted, -limit), limit)
        elif kind == 2.0:
            wanted = 0.0 if abs(wanted) <= threshold else (limit if wanted > 0.0 else -limit)
        command[axis] = wanted


class Torquers(Torque):
    """Three torquers along x, y, z. The dipole is held from tick to tick."""

    name = "torquers"
    needs_field = True

    dipole_Am2: Positive
    """What one torquer can do; a linear one is not limited by it."""
    drive: Literal["linear", "saturated", "on_off"] = "saturated"
    threshold_Am2: NonNegative = 0.0
    """on_off: off while the command is no larger than this."""
    gain: Vector3 = (1.0, 1.0, 1.0)
    """True dipole over the one that telemetry says, each axis."""

    @staticmethod
    def add(packed: FloatArray, at: int, stage: FloatArray) -> None:
        """m x B of the dipole that is on, each component times its gain (Wertz 1978, section 17.2.4)."""
        mx, my, mz = stage[DIPOLE], stage[DIPOLE + 1], stage[DIPOLE + 2]
        mx, my, mz = mx * packed[at + 3], my * packed[at + 4], mz * packed[at + 5]
        bx, by, bz = stage[FIELD], stage[FIELD + 1], stage[FIELD + 2]
        stage[TORQUE] += my * bz - mz * by
        stage[TORQUE + 1] += mz * bx - mx * bz
        stage[TORQUE + 2] += mx * by - my * bx

    def packed(self, inertia_kg_m2: FloatArray) -> list[float]:
        """Kind of drive, limit, threshold [A m2], gains."""
        return [float(_DRIVES.index(self.drive)), self.dipole_Am2, self.threshold_Am2, *self.gain]


class EddyCurrents(Torque):
    """Eddy currents in the shell of a spinner."""

    name = "eddy_currents"
    needs_field = True

    K_Am2_s_per_T: Matrix3
    """Symmetric, no negative eigenvalue; a thin spherical shell of radius r, thickness d, conductivity s has
    (2 pi / 3) r^4 s d times identity."""

    @model_validator(mode="after")
    def _brakes(self) -> Self:
        K: Any = np.array(self.K_Am2_s_per_T)
        if np.abs(K - K.T).max() > 1e-9 * np.abs(K).max() or np.linalg.eigvalsh(K).min() < -1e-9 * np.abs(K).max():
            raise ValueError("K is not symmetric, or would speed the body up: it wants eigenvalues of 0 or more")
        return self

    @staticmethod
    def add(packed: FloatArray, at: int, stage: FloatArray) -> None:
        """(K (w x B)) x B: the induced dipole -K dB/dt, of the field's change by the rotation, in the field itself.

        For K = k times identity this is k (w x B) x B (Wertz 1978, section 17.2.4). The orbit's own change
        of the field is left out: in low orbit two hundredths of it at 1 rpm.
        """
        wx, wy, wz = stage[RATE], stage[RATE + 1], stage[RATE + 2]
        bx, by, bz = stage[FIELD], stage[FIELD + 1], stage[FIELD + 2]
        ex, ey, ez = wy * bz - wz * by, wz * bx - wx * bz, wx * by - wy * bx
        mx = packed[at] * ex + packed[at + 3] * ey + packed[at + 4] * ez
        my = packed[at + 3] * ex + packed[at + 1] * ey + packed[at + 5] * ez
        mz = packed[at + 4] * ex + packed[at + 5] * ey + packed[at + 2] * ez
        stage[TORQUE] += my * bz - mz * by
        stage[TORQUE + 1] += mz * bx - mx * bz
        stage[TORQUE + 2] += mx * by - my * bx

    def packed(self, inertia_kg_m2: FloatArray) -> list[float]:
        """xx, yy, zz, xy, xz, yz."""
        K = self.K_Am2_s_per_T
        return [K[0][0], K[1][1], K[2][2], K[0][1], K[0][2], K[1][2]]
