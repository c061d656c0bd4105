"""Alignment of each sensor on an attitude history, and of the magnetometer relative to the sun sensor.

For a sensor with unit vectors m_k, references v_k and weights w_k: the R that maximises tr(R sum w m (A v)') (Wahba's
problem, by the singular-value decomposition), so that m = R A v; information F = sum w (1 - r r'), r = R A v.

The trap: a slit sees the sun at nearly one direction of the body, and its own turn about that line is unknown.
R_sun' R_TAM would carry it into the magnetometer. A prior on the sun sensor's alignment (what was measured before
launch) keeps it out; dropping R_sun instead would let the azimuth of the body drift from pass to pass, for an
axisymmetric body has none of its own: the sun sensor defines it (the gauge).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fluxtwin.calib.spin.motion import turn, turn_vector
from fluxtwin.sim.base.types import FloatArray

_STEPS = 30
_SMALL_RAD = 1e-12


class Alignment(NamedTuple):
    """One sensor: m = R A v."""

    R: FloatArray
    """(3, 3) body to sensor axes, both nominally the same."""
    information: FloatArray
    """(3, 3) of the rotation vector [rad^-2]; a weak eigenvalue is a direction that the sensor hardly determines."""

    def weakest(self) -> tuple[float, FloatArray]:
        """1 sigma [rad] about the direction known least, and that direction (3,)."""
        values, vectors = np.linalg.eigh(self.information)
        return float(1.0 / np.sqrt(max(values[0], 1e-300))), vectors[:, 0]


def align(seen: FloatArray, reference_B: FloatArray, weight: FloatArray) -> Alignment:
    """One sensor. seen (n, 3), any length; reference_B (n, 3) = A v, any length; weight (n,) 1/rad^2."""
    m = seen / np.linalg.norm(seen, axis=1)[:, None]
    v = reference_B / np.linalg.norm(reference_B, axis=1)[:, None]
    U, _, Vt = np.linalg.svd((m * weight[:, None]).T @ v)
    R = U @ np.diag([1.0, 1.0, np.linalg.det(U) * np.linalg.det(Vt)]) @ Vt
    r = v @ R.T
    return Alignment(R, float(weight.sum()) * np.eye(3) - (r * weight[:, None]).T @ r)


def align_with_prior(seen: FloatArray, reference_B: FloatArray, weight: FloatArray, sigma_rad: float) -> Alignment:
    """As `align`, with no turn at all known beforehand to sigma_rad an axis; the information holds the prior.

    Sought from no turn onward: Wahba's own answer may lie half a turn off about a line that the sensor hardly determines.
    """
    m = seen / np.linalg.norm(seen, axis=1)[:, None]
    v = reference_B / np.linalg.norm(reference_B, axis=1)[:, None]
    prior = np.eye(3) / sigma_rad**2
    total = float(weight.sum()) * np.eye(3)
    R, whole = np.eye(3), total
    for _ in range(_STEPS):
        r = v @ R.T
        whole = total - (r * weight[:, None]).T @ r + prior
        step = np.linalg.solve(whole, weight @ np.cross(r, m) - prior @ turn_vector(R))
        R = turn(np.asarray(step, dtype=np.float64)) @ R
        if float(np.linalg.norm(step)) < _SMALL_RAD:
            break
    return Alignment(R, whole)


def relative(magnetometer: Alignment, sun: Alignment) -> tuple[FloatArray, FloatArray]:
    """R_rel = R_sun' R_TAM (3, 3) and the covariance (3, 3) of its rotation vector [rad^2]; sun: with its prior."""
    R = sun.R.T @ magnetometer.R
    turned = sun.R.T @ (np.linalg.inv(magnetometer.information) + np.linalg.inv(sun.information)) @ sun.R
    return np.asarray(R), np.asarray(turned)
