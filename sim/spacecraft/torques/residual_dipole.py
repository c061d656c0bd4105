"""Residual magnetic dipole: the magnetism that the spacecraft carries whatever it does."""

from __future__ import annotations

from typing import ClassVar

from fluxtwin.sim.base.section_types import Vector3
from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.spacecraft.dynamics.layout import FIELD, TORQUE
from fluxtwin.sim.spacecraft.torques.base import Torque


def add(packed: FloatArray, at: int, stage: FloatArray) -> None:
    """m x B (Wertz, Spacecraft Attitude Determination and Control, 1978, section 17.2.4)."""
    mx, my, mz = packed[at], packed[at + 1], packed[at + 2]
    bx, by, bz = stage[FIELD], stage[FIELD + 1], stage[FIELD + 2]
    stage[TORQUE] += my * bz - mz * by
    stage[TORQUE + 1] += mz * bx - mx * bz
    stage[TORQUE + 2] += mx * by - my * bx


class ResidualDipole(Torque):
    """A dipole fixed in the body."""

    name: ClassVar[str] = "residual_dipole"
    add = staticmethod(add)
    needs_field: ClassVar[bool] = True

    dipole_Am2: Vector3

    def packed(self, inertia_kg_m2: FloatArray) -> list[float]:
        """The dipole [A m2]."""
        return list(self.dipole_Am2)
