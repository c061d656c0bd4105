"""Torque of sunlight on a body whose surface is not known: a push that acts beside the centre of mass."""

from __future__ import annotations

from typing import ClassVar

from fluxtwin.sim.base.section_types import Vector3
from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.earth.constants import SOLAR_CONSTANT_W_M2, SPEED_OF_LIGHT_M_S
from fluxtwin.sim.spacecraft.dynamics.layout import ROTATION, SUN, SUNLIGHT, TORQUE
from fluxtwin.sim.spacecraft.torques.base import Torque

PUSH_N_M2 = SOLAR_CONSTANT_W_M2 / SPEED_OF_LIGHT_M_S


def add(packed: FloatArray, at: int, stage: FloatArray) -> None:
    """-p (M x s), s to the sun, M = C_R A c (Wertz 1978, section 17.2.2), p with distance and shadow.

    c is the centre of pressure from the centre of mass; area and c are the same for every direction of the sun.
    """
    pressure = -PUSH_N_M2 * min(max(stage[SUNLIGHT], 0.0), 1.1)
    x, y, z = stage[SUN], stage[SUN + 1], stage[SUN + 2]
    sx = pressure * (stage[ROTATION] * x + stage[ROTATION + 1] * y + stage[ROTATION + 2] * z)
    sy = pressure * (stage[ROTATION + 3] * x + stage[ROTATION + 4] * y + stage[ROTATION + 5] * z)
    sz = pressure * (stage[ROTATION + 6] * x + stage[ROTATION + 7] * y + stage[ROTATION + 8] * z)
    mx, my, mz = packed[at], packed[at + 1], packed[at + 2]
    stage[TORQUE] += my * sz - mz * sy
    stage[TORQUE + 1] += mz * sx - mx * sz
    stage[TORQUE + 2] += mx * sy - my * sx


class SunlightMoment(Torque):
    """Sunlight at a centre of pressure."""

    name: ClassVar[str] = "sunlight_moment"
    add = staticmethod(add)
    needs_sun: ClassVar[bool] = True

    moment_m3: Vector3
    """C_R A c: 1 for a black and 2 for a mirroring surface, area, and the centre of pressure from that of mass."""

    def packed(self, inertia_kg_m2: FloatArray) -> list[float]:
        """The moment [m3]."""
        return list(self.moment_m3)
