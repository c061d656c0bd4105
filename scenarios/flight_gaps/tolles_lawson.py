"""The coefficients behind a published Tolles-Lawson compensation, recovered exactly.

With the fluxgate's reading f and its direction u the compensation is u . (p + S f + K df/dt): permanent, induced (S
symmetric) and eddy-current terms (Tolles & Lawson 1950; Leliak 1961, doi 10.1109/TANE3.1961.4201799). df/dt is the
central difference that the source took, so the 18 coefficients repeat the published values to their last digit.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fluxtwin.scenarios.flight_field.residuals import rms
from fluxtwin.scenarios.flight_gaps.records import Compensation
from fluxtwin.sim.base.types import FloatArray


@dataclass(frozen=True)
class Coefficients:
    """Permanent, induced and eddy-current coefficients of a compensation."""

    permanent_nT: FloatArray
    """(3,)."""
    induced: FloatArray
    """(3, 3) symmetric."""
    eddy_s: FloatArray
    """(3, 3)."""
    worst_nT: float
    """Largest difference between the published compensation and the one of these coefficients."""
    parts_nT: tuple[float, float, float]
    """rms along the field of the three parts."""
    antisymmetric_nT: float
    """rms along the field of the eddy terms that are antisymmetric."""

    @property
    def symmetric_eddy_s(self) -> FloatArray:
        """(3, 3) symmetric part of the eddy terms, without its trace."""
        symmetric = 0.5 * (self.eddy_s + self.eddy_s.T)
        traceless: FloatArray = symmetric - np.eye(3) * np.trace(symmetric) / 3.0
        return traceless


def coefficients(given: Compensation, rate_Hz: float) -> Coefficients:
    """The 18 coefficients of a published compensation."""
    flux = given.fluxgate_B_nT
    u = flux / np.linalg.norm(flux, axis=1)[:, None]
    rows, columns = np.triu_indices(3)
    induced = u[:, rows] * flux[:, columns]
    eddy = np.einsum("ni,nj->nij", u, np.gradient(flux, 1.0 / rate_Hz, axis=0)).reshape(-1, 9)
    design = np.concatenate([u, induced, eddy], axis=1)
    length = np.linalg.norm(design, axis=0)
    found = np.linalg.lstsq(design / length, given.taken_nT, rcond=1e-13)[0] / length
    S = np.zeros((3, 3))
    S[rows, columns] = 0.5 * found[3:9]
    K = found[9:].reshape(3, 3)
    parts = (rms(u @ found[:3]), rms(induced @ found[3:9]), rms(eddy @ found[9:]))
    worst = float(np.abs(design @ found - given.taken_nT).max())
    return Coefficients(found[:3], S + S.T, K, worst, parts, rms(eddy @ (0.5 * (K - K.T)).reshape(-1)))
