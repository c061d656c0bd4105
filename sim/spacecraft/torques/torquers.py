"""Magnetic torquers: linear, saturated or on-off, and the torque of what they do."""

from __future__ import annotations

from typing import ClassVar, Literal

from fluxtwin.sim.base.section_types import NonNegative, Positive, Vector3
from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.spacecraft.dynamics.layout import DIPOLE, FIELD, TORQUE
from fluxtwin.sim.spacecraft.torques.base import Torque

_DRIVES = ("linear", "saturated", "on_off")


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


def add(packed: FloatArray, at: int, stage: FloatArray) -> None:
    """m x B of the dipole that is on, each component times its gain (Wertz 1978, section 17.2.4)."""
    mx, my, mz = stage[DIPOLE], stage[DIPOLE + 1], stage[DIPOLE + 2]
    mx, my, mz = mx * packed[at + 3], my * packed[at + 4], mz * packed[at + 5]
    bx, by, bz = stage[FIELD], stage[FIELD + 1], stage[FIELD + 2]
    stage[TORQUE] += my * bz - mz * by
    stage[TORQUE + 1] += mz * bx - mx * bz
    stage[TORQUE + 2] += mx * by - my * bx


class Torquers(Torque):
    """Three torquers along x, y, z. The dipole is held from tick to tick."""

    name: ClassVar[str] = "torquers"
    add = staticmethod(add)
    needs_field: ClassVar[bool] = True

    dipole_Am2: Positive
    """What one torquer can do; a linear one is not limited by it."""
    drive: Literal["linear", "saturated", "on_off"] = "saturated"
    threshold_Am2: NonNegative = 0.0
    """on_off: off while the command is no larger than this."""
    gain: Vector3 = (1.0, 1.0, 1.0)
    """True dipole over the one that telemetry says, each axis."""

    def packed(self, inertia_kg_m2: FloatArray) -> list[float]:
        """Kind of drive, limit, threshold [A m2], gains."""
        return [float(_DRIVES.index(self.drive)), self.dipole_Am2, self.threshold_Am2, *self.gain]
