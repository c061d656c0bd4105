"""Solar radiation pressure on flat plates, with the Earth's shadow."""

from __future__ import annotations

from typing import Annotated, ClassVar, Self

from pydantic import Field, model_validator

from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.earth.constants import SOLAR_CONSTANT_W_M2, SPEED_OF_LIGHT_M_S
from fluxtwin.sim.spacecraft.dynamics.layout import ROTATION, SUN, SUNLIGHT, TORQUE
from fluxtwin.sim.spacecraft.torques.base import Torque
from fluxtwin.sim.spacecraft.torques.plates import PLATE_SIZE, Plates, rows_of

PRESSURE_N_M2 = SOLAR_CONSTANT_W_M2 / SPEED_OF_LIGHT_M_S
"""On a black surface that faces the sun at 1 au."""


def add(packed: FloatArray, at: int, stage: FloatArray) -> None:
    """Sum over the plates of centre x force; each force, with s to the sun, n outward and c = n.s > 0,

        F = -p A c { (1 - C_s) s + 2 (C_s c + C_d / 3) n }

    (Wertz 1978, section 17.2.2), p falling with the square of the distance and with the share of the sun in view.
    """
    pressure = PRESSURE_N_M2 * min(max(stage[SUNLIGHT], 0.0), 1.1)  # the cubic overshoots at the shadow's edge
    if pressure == 0.0:
        return
    x, y, z = stage[SUN], stage[SUN + 1], stage[SUN + 2]
    sx = stage[ROTATION] * x + stage[ROTATION + 1] * y + stage[ROTATION + 2] * z
    sy = stage[ROTATION + 3] * x + stage[ROTATION + 4] * y + stage[ROTATION + 5] * z
    sz = stage[ROTATION + 6] * x + stage[ROTATION + 7] * y + stage[ROTATION + 8] * z
    specular, diffuse = packed[at + 1], packed[at + 2]
    for plate in range(int(packed[at])):
        k = at + 3 + PLATE_SIZE * plate
        nx, ny, nz = packed[k + 1], packed[k + 2], packed[k + 3]
        cosine = nx * sx + ny * sy + nz * sz
        if cosine > 0.0:
            size = -pressure * packed[k] * cosine
            along, normal = 1.0 - specular, 2.0 * (specular * cosine + diffuse / 3.0)
            fx = size * (along * sx + normal * nx)
            fy = size * (along * sy + normal * ny)
            fz = size * (along * sz + normal * nz)
            cx, cy, cz = packed[k + 4], packed[k + 5], packed[k + 6]
            stage[TORQUE] += cy * fz - cz * fy
            stage[TORQUE + 1] += cz * fx - cx * fz
            stage[TORQUE + 2] += cx * fy - cy * fx


class SolarPressure(Torque):
    """Sunlight on plates that all reflect alike. Light from the Earth (a third of it, at most) is left out."""

    name: ClassVar[str] = "solar_pressure"
    add = staticmethod(add)
    needs_sun: ClassVar[bool] = True

    plates: Plates
    specular: Annotated[float, Field(ge=0, le=1)] = 0.2
    diffuse: Annotated[float, Field(ge=0, le=1)] = 0.2

    @model_validator(mode="after")
    def _no_more_than_all(self) -> Self:
        if self.specular + self.diffuse > 1.0:
            raise ValueError("specular and diffuse reflection together are more than the light")
        return self

    def packed(self, inertia_kg_m2: FloatArray) -> list[float]:
        """Number of plates, C_s, C_d, and the plates."""
        return [float(len(self.plates)), self.specular, self.diffuse, *rows_of(self.plates)]
