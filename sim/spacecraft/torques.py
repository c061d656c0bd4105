"""The torques on a spacecraft: sections of a scenario with their parameters, and functions that a kernel can run."""

from __future__ import annotations

from itertools import chain
from math import sqrt
from typing import Annotated, Any, ClassVar, Literal, Self

import numpy as np
from pydantic import BeforeValidator, Field, model_validator

from fluxtwin.sim.base.section_types import ZERO33, Matrix3, NonNegative, Positive, Section, Vector3, as_tuple
from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.earth.constants import EARTH_RATE_RAD_S, GM_EARTH_KM3_S2, SOLAR_CONSTANT_W_M2, SPEED_OF_LIGHT_M_S
from fluxtwin.sim.spacecraft.dynamics.layout import (
    DENSITY,
    DIPOLE,
    FIELD,
    POSITION,
    RATE,
    SUN,
    SUNLIGHT,
    TORQUE,
    VELOCITY,
    add_cross,
    symmetric,
    to_body,
)

GM_M3_S2 = GM_EARTH_KM3_S2 * 1e9
_DRIVES = ("linear", "saturated", "on_off")
PLATE_SIZE = 7
Share = Annotated[float, Field(ge=0, le=1)]
PRESSURE_N_M2 = SOLAR_CONSTANT_W_M2 / SPEED_OF_LIGHT_M_S
"""On a black surface that faces the sun at 1 au."""


class Torque(Section):
    """Base of all torques: a frozen record, checked as a section [torques.NAME] of a scenario."""

    name: ClassVar[str]
    # Without one of these the middle of a step has a new position, attitude and rate, and nothing else.
    needs_field: ClassVar[bool] = False
    needs_sun: ClassVar[bool] = False
    needs_air: ClassVar[bool] = False

    @staticmethod
    def add(packed: FloatArray, at: int, stage: FloatArray) -> None:
        """Add the torque to stage[TORQUE ...], with the parameters at packed[at ...].

        It is compiled, so it uses numbers, `math`, `dynamics.layout` and functions like itself alone. Uncompiled it runs as
        well: that is what the reference path and the tests do.
        """
        raise NotImplementedError

    def packed(self, inertia_kg_m2: FloatArray) -> list[float]:
        """The numbers that `add` finds at packed[at ...]; inertia_kg_m2 is that of the whole body, (3, 3) in B."""
        raise NotImplementedError


class GravityGradient(Torque):
    """Gravity gradient of a point-mass Earth on the body's inertia tensor, J2 (0.3 % of it) left out."""

    name = "gravity_gradient"

    inertia_error_kg_m2: Matrix3 = ZERO33
    """Added to the inertia tensor in this torque alone: what a wrong tensor would do. Symmetric."""

    @model_validator(mode="after")
    def _symmetric(self) -> Self:
        error = np.asarray(self.inertia_error_kg_m2)
        if np.abs(error - error.T).max() > 1e-9 * np.abs(error).max():
            raise ValueError("inertia_error_kg_m2 is not symmetric, as the change of a tensor is")
        return self

    @staticmethod
    def add(packed: FloatArray, at: int, stage: FloatArray) -> None:
        """3 GM / r^3 (r^ x J r^), for a point mass (Wertz 1978, section 17.2.1)."""
        x, y, z = stage[POSITION], stage[POSITION + 1], stage[POSITION + 2]
        squared = x * x + y * y + z * z
        size = 3.0 * GM_M3_S2 / (squared * squared * sqrt(squared))
        a, b, c = to_body(stage, x, y, z)
        ja, jb, jc = symmetric(packed, at, a, b, c)
        stage[TORQUE] += size * (b * jc - c * jb)
        stage[TORQUE + 1] += size * (c * ja - a * jc)
        stage[TORQUE + 2] += size * (a * jb - b * ja)

    def packed(self, inertia_kg_m2: FloatArray) -> list[float]:
        """xx, yy, zz, xy, xz, yz of the tensor [kg m2]."""
        J = np.asarray(inertia_kg_m2) + np.asarray(self.inertia_error_kg_m2)
        return [J[0, 0], J[1, 1], J[2, 2], J[0, 1], J[0, 2], J[1, 2]]


class ResidualDipole(Torque):
    """A dipole fixed in the body."""

    name = "residual_dipole"
    needs_field = True

    dipole_Am2: Vector3

    @staticmethod
    def add(packed: FloatArray, at: int, stage: FloatArray) -> None:
        """m x B (Wertz, Spacecraft Attitude Determination and Control, 1978, section 17.2.4)."""
        mx, my, mz = packed[at], packed[at + 1], packed[at + 2]
        add_cross(stage, mx, my, mz, stage[FIELD], stage[FIELD + 1], stage[FIELD + 2])

    def packed(self, inertia_kg_m2: FloatArray) -> list[float]:
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
        mx, my = stage[DIPOLE] * packed[at + 3], stage[DIPOLE + 1] * packed[at + 4]
        mz = stage[DIPOLE + 2] * packed[at + 5]
        add_cross(stage, mx, my, mz, stage[FIELD], stage[FIELD + 1], stage[FIELD + 2])

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
        mx, my, mz = symmetric(packed, at, wy * bz - wz * by, wz * bx - wx * bz, wx * by - wy * bx)
        add_cross(stage, mx, my, mz, bx, by, bz)

    def packed(self, inertia_kg_m2: FloatArray) -> list[float]:
        K = self.K_Am2_s_per_T
        return [K[0][0], K[1][1], K[2][2], K[0][1], K[0][2], K[1][2]]


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
        normal = np.array(self.normal_B) / np.linalg.norm(self.normal_B)
        return [self.area_m2, *normal.tolist(), *self.centre_m]


def press_plates(
    packed: FloatArray, first: int, count: int, towards: Any, pressure: float, law: Any, stage: FloatArray
) -> None:
    """Add the torque of a pressure on plates, packed from `first` on: the sum of centre x force, each force
    -p A c { along u + (slope c + level) n } with u in B, where what presses comes from, n outward and c = n.u > 0.

    towards: u. law: along, slope, level.
    """
    ux, uy, uz = towards
    along, slope, level = law
    for plate in range(count):
        k = first + PLATE_SIZE * plate
        nx, ny, nz = packed[k + 1], packed[k + 2], packed[k + 3]
        cosine = nx * ux + ny * uy + nz * uz
        if cosine > 0.0:
            size, normal = -pressure * packed[k] * cosine, slope * cosine + level
            fx = size * (along * ux + normal * nx)
            fy = size * (along * uy + normal * ny)
            fz = size * (along * uz + normal * nz)
            add_cross(stage, packed[k + 4], packed[k + 5], packed[k + 6], fx, fy, fz)


def through_air(stage: FloatArray) -> tuple[float, float, float, float]:
    """Speed through air that turns with the Earth, about z of N, and the velocity in B."""
    vx = stage[VELOCITY] + EARTH_RATE_RAD_S * stage[POSITION + 1]
    vy = stage[VELOCITY + 1] - EARTH_RATE_RAD_S * stage[POSITION]
    vz = stage[VELOCITY + 2]
    x, y, z = to_body(stage, vx, vy, vz)
    return sqrt(vx * vx + vy * vy + vz * vz), x, y, z


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
        """
        speed, x, y, z = through_air(stage)
        if speed == 0.0:
            return
        pressure = packed[at + 1] * stage[DENSITY] * speed * speed
        law = packed[at + 2], packed[at + 3], packed[at + 4]
        press_plates(packed, at + 5, int(packed[at]), (x / speed, y / speed, z / speed), pressure, law, stage)

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
        to_sun = to_body(stage, stage[SUN], stage[SUN + 1], stage[SUN + 2])
        specular, diffuse = packed[at + 1], packed[at + 2]
        law = 1.0 - specular, 2.0 * specular, 2.0 * diffuse / 3.0
        press_plates(packed, at + 3, int(packed[at]), to_sun, pressure, law, stage)

    def packed(self, inertia_kg_m2: FloatArray) -> list[float]:
        rows = chain.from_iterable(plate.row() for plate in self.plates)
        return [float(len(self.plates)), self.specular, self.diffuse, *rows]


class DragMoment(Torque):
    """Drag on a surface that is not known: at a centre of pressure, in air of the table of `atmosphere`."""

    name = "drag_moment"
    needs_air = True

    moment_m3: Vector3
    """C_D A c: drag coefficient, area, and the centre of pressure from the centre of mass."""

    @staticmethod
    def add(packed: FloatArray, at: int, stage: FloatArray) -> None:
        """-rho V^2 / 2 (M x u), u along the motion through the air, M = C_D A c (Wertz 1978, section 17.2.3).

        c is the centre of pressure from the centre of mass; area and c are the same for every wind.
        """
        speed, x, y, z = through_air(stage)
        size = -0.5 * stage[DENSITY] * speed
        add_cross(stage, packed[at], packed[at + 1], packed[at + 2], size * x, size * y, size * z)

    def packed(self, inertia_kg_m2: FloatArray) -> list[float]:
        return list(self.moment_m3)


class SunlightMoment(Torque):
    """Sunlight on a surface that is not known: at a centre of pressure."""

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
        x, y, z = to_body(stage, stage[SUN], stage[SUN + 1], stage[SUN + 2])
        add_cross(stage, packed[at], packed[at + 1], packed[at + 2], pressure * x, pressure * y, pressure * z)

    def packed(self, inertia_kg_m2: FloatArray) -> list[float]:
        return list(self.moment_m3)


TORQUES: tuple[type[Torque], ...] = (
    GravityGradient,
    ResidualDipole,
    Torquers,
    Aerodynamic,
    SolarPressure,
    EddyCurrents,
    DragMoment,
    SunlightMoment,
)
"""Their order is that of the packed parameters."""
