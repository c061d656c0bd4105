"""Torques of what presses on the outer surface: air and sunlight, on flat plates or on a surface that is not known."""

from __future__ import annotations

from itertools import chain
from math import sqrt
from typing import Annotated, Self

import numpy as np
from pydantic import BeforeValidator, Field, model_validator

from fluxtwin.sim.base.section_types import Positive, Section, Vector3, as_tuple
from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.earth.constants import EARTH_RATE_RAD_S, SOLAR_CONSTANT_W_M2, SPEED_OF_LIGHT_M_S
from fluxtwin.sim.spacecraft.dynamics.layout import DENSITY, POSITION, ROTATION, SUN, SUNLIGHT, TORQUE, VELOCITY
from fluxtwin.sim.spacecraft.torques.base import Torque

PLATE_SIZE = 7
Share = Annotated[float, Field(ge=0, le=1)]
PRESSURE_N_M2 = SOLAR_CONSTANT_W_M2 / SPEED_OF_LIGHT_M_S
"""On a black surface that faces the sun at 1 au."""


class Plate(Section):
    """One side of a flat plate. A panel that is seen from both sides is two plates; none shades another."""

    area_m2: Positive
    normal_B: Vector3
    """Outward."""
    centre_m: Vector3
    """From the centre of mass, body axes."""

    @model_validator(mode="after")
    def _has_a_normal(self) -> Self:
        if not any(self.normal_B):
            raise ValueError("normal_B is zero: no such direction")
        return self

    def row(self) -> list[float]:
        """Area, unit normal, centre: PLATE_SIZE numbers."""
        normal = np.array(self.normal_B) / np.linalg.norm(self.normal_B)
        return [self.area_m2, *normal.tolist(), *self.centre_m]


Plates = Annotated[tuple[Plate, ...], BeforeValidator(as_tuple), Field(min_length=1)]


class Aerodynamic(Torque):
    """Free-molecular flow on plates, in air of the table of `atmosphere`."""

    name = "aerodynamic"
    needs_air = True

    plates: Plates
    density_factor: Positive = 1.0
    """True density over that of the table: 0.1 to 10 between the quietest and the most active sun."""
    accommodation_normal: Share = 0.9
    """sigma_n: share of the normal momentum that the molecules give up."""
    accommodation_tangential: Share = 0.9
    reemission_ratio: Share = 0.05
    """V_b / V: speed at which molecules leave the warm wall, over that of the spacecraft."""

    @staticmethod
    def add(packed: FloatArray, at: int, stage: FloatArray) -> None:
        """Sum over the plates of centre x force; each force, with u along the motion through the air, n outward and
        c = n.u > 0,

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

    def packed(self, inertia_kg_m2: FloatArray) -> list[float]:
        """Number of plates, factor, sigma_t, 2 - sigma_n - sigma_t, sigma_n V_b / V, and the plates."""
        n, t = self.accommodation_normal, self.accommodation_tangential
        wall = [t, 2.0 - n - t, n * self.reemission_ratio]
        return [float(len(self.plates)), self.density_factor, *wall, *chain.from_iterable(p.row() for p in self.plates)]


class SolarPressure(Torque):
    """Sunlight on plates that all reflect alike. Light from the Earth (a third of it, at most) is left out."""

    name = "solar_pressure"
    needs_sun = True

    plates: Plates
    specular: Share = 0.2
    diffuse: Share = 0.2

    @model_validator(mode="after")
    def _no_more_than_all(self) -> Self:
        if self.specular + self.diffuse > 1.0:
            raise ValueError("specular and diffuse reflection together are more than the light")
        return self

    @staticmethod
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

    def packed(self, inertia_kg_m2: FloatArray) -> list[float]:
        """Number of plates, C_s, C_d, and the plates."""
        rows = chain.from_iterable(plate.row() for plate in self.plates)
        return [float(len(self.plates)), self.specular, self.diffuse, *rows]


class DragMoment(Torque):
    """Drag at a centre of pressure, in air of the table of `atmosphere`."""

    name = "drag_moment"
    needs_air = True

    moment_m3: Vector3
    """C_D A c: drag coefficient, area, and the centre of pressure from the centre of mass."""

    @staticmethod
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

    def packed(self, inertia_kg_m2: FloatArray) -> list[float]:
        """The moment [m3]."""
        return list(self.moment_m3)


class SunlightMoment(Torque):
    """Sunlight at a centre of pressure."""

    name = "sunlight_moment"
    needs_sun = True

    moment_m3: Vector3
    """C_R A c: 1 for a black and 2 for a mirroring surface, area, and the centre of pressure from that of mass."""

    @staticmethod
    def add(packed: FloatArray, at: int, stage: FloatArray) -> None:
        """-p (M x s), s to the sun, M = C_R A c (Wertz 1978, section 17.2.2), p with distance and shadow.

        c is the centre of pressure from the centre of mass; area and c are the same for every direction of the sun.
        """
        pressure = -PRESSURE_N_M2 * min(max(stage[SUNLIGHT], 0.0), 1.1)
        x, y, z = stage[SUN], stage[SUN + 1], stage[SUN + 2]
        sx = pressure * (stage[ROTATION] * x + stage[ROTATION + 1] * y + stage[ROTATION + 2] * z)
        sy = pressure * (stage[ROTATION + 3] * x + stage[ROTATION + 4] * y + stage[ROTATION + 5] * z)
        sz = pressure * (stage[ROTATION + 6] * x + stage[ROTATION + 7] * y + stage[ROTATION + 8] * z)
        mx, my, mz = packed[at], packed[at + 1], packed[at + 2]
        stage[TORQUE] += my * sz - mz * sy
        stage[TORQUE + 1] += mz * sx - mx * sz
        stage[TORQUE + 2] += mx * sy - my * sx

    def packed(self, inertia_kg_m2: FloatArray) -> list[float]:
        """The moment [m3]."""
        return list(self.moment_m3)
