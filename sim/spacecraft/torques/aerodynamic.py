"""Aerodynamic torque on flat plates in free-molecular flow."""

from __future__ import annotations

from math import sqrt
from typing import Annotated, ClassVar

from pydantic import Field

from fluxtwin.sim.base.section_types import Positive
from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.earth.constants import EARTH_RATE_RAD_S
from fluxtwin.sim.spacecraft.dynamics.layout import DENSITY, POSITION, ROTATION, TORQUE, VELOCITY
from fluxtwin.sim.spacecraft.torques.base import Torque
from fluxtwin.sim.spacecraft.torques.plates import PLATE_SIZE, Plates, rows_of


def add(packed: FloatArray, at: int, stage: FloatArray) -> None:
    """Sum over the plates of centre x force; each force, with u along the motion through the air, n outward, c = n.u > 0,

        F = -rho V^2 A c { sigma_t u + [(2 - sigma_n - sigma_t) c + sigma_n V_b / V] n }

    (Hughes, Spacecraft Attitude Dynamics, 1986, chapter 8, for a fast body: thermal speeds are nothing to V).
    The air turns with the Earth, about z of N.
    """
    vx = stage[VELOCITY] + EARTH_RATE_RAD_S * stage[POSITION + 1]
    vy = stage[VELOCITY + 1] - EARTH_RATE_RAD_S * stage[POSITION]
    vz = stage[VELOCITY + 2]
    speed = sqrt(vx * vx + vy * vy + vz * vz)
    if speed == 0.0:
        return
    ux = (stage[ROTATION] * vx + stage[ROTATION + 1] * vy + stage[ROTATION + 2] * vz) / speed
    uy = (stage[ROTATION + 3] * vx + stage[ROTATION + 4] * vy + stage[ROTATION + 5] * vz) / speed
    uz = (stage[ROTATION + 6] * vx + stage[ROTATION + 7] * vy + stage[ROTATION + 8] * vz) / speed
    pressure = packed[at + 1] * stage[DENSITY] * speed * speed
    tangential, specular, thermal = packed[at + 2], packed[at + 3], packed[at + 4]
    for plate in range(int(packed[at])):
        k = at + 5 + PLATE_SIZE * plate
        nx, ny, nz = packed[k + 1], packed[k + 2], packed[k + 3]
        cosine = nx * ux + ny * uy + nz * uz
        if cosine > 0.0:
            size = -pressure * packed[k] * cosine
            normal = specular * cosine + thermal
            fx = size * (tangential * ux + normal * nx)
            fy = size * (tangential * uy + normal * ny)
            fz = size * (tangential * uz + normal * nz)
            cx, cy, cz = packed[k + 4], packed[k + 5], packed[k + 6]
            stage[TORQUE] += cy * fz - cz * fy
            stage[TORQUE + 1] += cz * fx - cx * fz
            stage[TORQUE + 2] += cx * fy - cy * fx


Share = Annotated[float, Field(ge=0, le=1)]


class Aerodynamic(Torque):
    """Free-molecular flow on plates, in air of the table of `atmosphere`."""

    name: ClassVar[str] = "aerodynamic"
    add = staticmethod(add)
    needs_air: ClassVar[bool] = True

    plates: Plates
    density_factor: Positive = 1.0
    """True density over that of the table: 0.1 to 10 between the quietest and the most active sun."""
    accommodation_normal: Share = 0.9
    """sigma_n: share of the normal momentum that the molecules give up."""
    accommodation_tangential: Share = 0.9
    reemission_ratio: Share = 0.05
    """V_b / V: speed at which molecules leave the warm wall, over that of the spacecraft."""

    def packed(self, inertia_kg_m2: FloatArray) -> list[float]:
        """Number of plates, factor, sigma_t, 2 - sigma_n - sigma_t, sigma_n V_b / V, and the plates."""
        n, t = self.accommodation_normal, self.accommodation_tangential
        return [
            float(len(self.plates)),
            self.density_factor,
            t,
            2.0 - n - t,
            n * self.reemission_ratio,
            *rows_of(self.plates),
        ]
