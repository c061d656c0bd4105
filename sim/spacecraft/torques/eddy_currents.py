"""Eddy currents: a conductor that turns in the field is braked by it."""

from __future__ import annotations

from typing import Any, ClassVar, Self

import numpy as np
from pydantic import model_validator

from fluxtwin.sim.base.section_types import Matrix3
from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.spacecraft.dynamics.layout import FIELD, RATE, TORQUE
from fluxtwin.sim.spacecraft.torques.base import Torque


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


class EddyCurrents(Torque):
    """Eddy currents in the shell of a spinner."""

    name: ClassVar[str] = "eddy_currents"
    add = staticmethod(add)
    needs_field: ClassVar[bool] = True

    K_Am2_s_per_T: Matrix3
    """Symmetric, no negative eigenvalue; a thin spherical shell of radius r, thickness d, conductivity s has
    (2 pi / 3) r^4 s d times identity."""

    @model_validator(mode="after")
    def _brakes(self) -> Self:
        K: Any = np.array(self.K_Am2_s_per_T)
        if np.abs(K - K.T).max() > 1e-9 * np.abs(K).max() or np.linalg.eigvalsh(K).min() < -1e-9 * np.abs(K).max():
            raise ValueError("K is not symmetric, or would speed the body up: it wants eigenvalues of 0 or more")
        return self

    def packed(self, inertia_kg_m2: FloatArray) -> list[float]:
        """xx, yy, zz, xy, xz, yz."""
        K = self.K_Am2_s_per_T
        return [K[0][0], K[1][1], K[2][2], K[0][1], K[0][2], K[1][2]]
