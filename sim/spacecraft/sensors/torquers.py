"""The field of magnetic torquers at the magnetometer, by the dipole law."""

from __future__ import annotations

import numpy as np

from fluxtwin.sim.base.errors import BadInput
from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.earth.constants import MU0_OVER_4PI_NT_M3_PER_AM2


def dipole_field_nT(m_B_Am2: FloatArray, r_B_m: FloatArray) -> FloatArray:
    """Field (N, 3) in nT of point dipoles m_B_Am2 at the point r_B_m from them; (3,) or (N, 3) each.

    mu0/(4 pi) (3 (m.u) u - m) / r^3 with u = r/|r| (Jackson, section 5.6). It is even in r: whether r points
    from the dipole to the sensor or back does not matter. Good where r is many times the torquer's length.
    Raises BadInput for a zero distance.
    """
    m, r = np.broadcast_arrays(np.atleast_2d(m_B_Am2).astype(float), np.atleast_2d(r_B_m).astype(float))
    distance = np.linalg.norm(r, axis=1)[:, None]
    if not (distance > 0).all():
        raise BadInput("a torquer sits in the magnetometer", where="torquer position", wanted="a distance > 0 m")
    u = r / distance
    along = np.sum(m * u, axis=1)[:, None]
    field: FloatArray = MU0_OVER_4PI_NT_M3_PER_AM2 * (3.0 * along * u - m) / distance**3
    return field


def coupling_nT_per_Am2(positions_B_m: FloatArray, axes_B: FloatArray | None = None) -> FloatArray:
    """Coupling C (3, 3): field at the magnetometer [nT] = C @ dipole [A m2]. Equation 1's T is -C.

    positions_B_m (3, 3): row k is where torquer k sits as seen from the magnetometer, body axes. axes_B
    (3, 3): row k is its direction; default torquer k along body axis k. Column k of C belongs to torquer k.
    """
    axes = np.eye(3) if axes_B is None else np.asarray(axes_B, dtype=np.float64)
    positions = np.asarray(positions_B_m, dtype=np.float64)
    if positions.shape != (3, 3) or axes.shape != (3, 3):
        raise BadInput(f"shapes {positions.shape} and {axes.shape}", where="torquers", wanted="three by three")
    return dipole_field_nT(axes, positions).T
