"""Aerodynamic torque of a body whose surface is not known: a drag that acts beside the centre of mass."""

from __future__ import annotations

from math import sqrt
from typing import ClassVar

from fluxtwin.sim.base.section_types import Vector3
from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.earth.constants import EARTH_RATE_RAD_S
from fluxtwin.sim.spacecraft.dynamics.layout import DENSITY, POSITION, ROTATION, TORQUE, VELOCITY
from fluxtwin.sim.spacecraft.torques.base import Torque


def add(packed: FloatArray, at: int, stage: FloatArray) -> None:
    """-rho V^2 / 2 (M x u), u along the motion through the air, M = C_D A c (Wertz 1978, section 17.2.3).

    c is the centre of pressure from the centre of mass; area and c are the same for every wind. The air turns with the
    Earth, about z of N.
    """
    vx = stage[VELOCITY] + EARTH_RATE_RAD_S * stage[POSITION + 1]
    vy = stage[VELOCITY + 1] - EARTH_RATE_RAD_S * stage[POSITION]
    vz = stage[VELOCITY + 2]
    size = -0.5 * stage[DENSITY] * sqrt(vx * vx + vy * vy + vz * vz)
    ux = size * (stage[ROTATION] * vx + stage[ROTATION + 1] * vy + stage[ROTATION + 2] * vz)
    uy = size * (stage[ROTATION + 3] * vx + stage[ROTATION + 4] * vy + stage[ROTATION + 5] * vz)
    uz = size * (stage[ROTATION + 6] * vx + stage[ROTATION + 7] * vy + stage[ROTATION + 8] * vz)
    mx, my, mz = packed[at], packed[at + 1], packed[at + 2]
    stage[TORQUE] += my * uz - mz * uy
    stage[TORQUE + 1] += mz * ux - mx * uz
    stage[TORQUE + 2] += mx * uy - my * ux


class DragMoment(Torque):
    """Drag at a centre of pressure, in air of the table of `atmosphere`."""

    name: ClassVar[str] = "drag_moment"
    add = staticmethod(add)
    needs_air: ClassVar[bool] = True

    moment_m3: Vector3
    """C_D A c: drag coefficient, area, and the centre of pressure from the centre of mass."""

    def packed(self, inertia_kg_m2: FloatArray) -> list[float]:
        """The moment [m3]."""
        return list(self.moment_m3)
