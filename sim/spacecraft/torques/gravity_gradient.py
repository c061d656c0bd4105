"""Gravity gradient: the near side of a body is pulled harder."""

from __future__ import annotations

from math import sqrt
from typing import Self

import numpy as np
from pydantic import model_validator

from fluxtwin.sim.base.section_types import ZERO33, Matrix3
from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.earth.constants import GM_EARTH_KM3_S2
from fluxtwin.sim.spacecraft.dynamics.layout import POSITION, ROTATION, TORQUE
from fluxtwin.sim.spacecraft.torques.base import Torque

GM_M3_S2 = GM_EARTH_KM3_S2 * 1e9


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
        a = stage[ROTATION] * x + stage[ROTATION + 1] * y + stage[ROTATION + 2] * z
        b = stage[ROTATION + 3] * x + stage[ROTATION + 4] * y + stage[ROTATION + 5] * z
        c = stage[ROTATION + 6] * x + stage[ROTATION + 7] * y + stage[ROTATION + 8] * z
        ja = packed[at] * a + packed[at + 3] * b + packed[at + 4] * c
        jb = packed[at + 3] * a + packed[at + 1] * b + packed[at + 5] * c
        jc = packed[at + 4] * a + packed[at + 5] * b + packed[at + 2] * c
        stage[TORQUE] += size * (b * jc - c * jb)
        stage[TORQUE + 1] += size * (c * ja - a * jc)
        stage[TORQUE + 2] += size * (a * jb - b * ja)

    def packed(self, inertia_kg_m2: FloatArray) -> list[float]:
        """xx, yy, zz, xy, xz, yz of the tensor [kg m2]."""
        J = np.asarray(inertia_kg_m2) + np.asarray(self.inertia_error_kg_m2)
        return [J[0, 0], J[1, 1], J[2, 2], J[0, 1], J[0, 2], J[1, 2]]
