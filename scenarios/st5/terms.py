"""The abstract's own terms: raw = R A H + b, R = exp(-[v x]) the passive turn of the misalignment v."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fluxtwin.calib.common.conventions import Correction, forward_from_correction, polar_split
from fluxtwin.calib.common.records import Calibration
from fluxtwin.calib.spin.motion import turn_vector
from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.earth.constants import NT_PER_MG

_STEP = 1e-6


class Terms(NamedTuple):
    """b and v with their covariance (6, 6), mG and deg."""

    b_mG: FloatArray
    misalignment_deg: FloatArray
    covariance: FloatArray

    @property
    def sigma(self) -> FloatArray:
        """(6,) 1 sigma of b [mG] and v [deg]."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def values(self) -> FloatArray:
        """(6,) b [mG] and v [deg]."""
        return np.concatenate([self.b_mG, self.misalignment_deg])

    def to_dict(self) -> dict[str, list[float]]:
        """As it stands in `summary.json`."""
        return {
            "b_mG": self.b_mG.tolist(),
            "sigma_b_mG": self.sigma[:3].tolist(),
            "misalignment_deg": self.misalignment_deg.tolist(),
            "sigma_misalignment_deg": self.sigma[3:].tolist(),
        }


def terms_of(calibration: Calibration) -> Terms:
    """From S, b of equation 1. R is the rotation in (I+S)^-1; scale and non-orthogonality stay out of it."""
    x = calibration.values[:12]
    scale = np.where(np.arange(12) < 9, _STEP, _STEP * 1e5)
    slope = np.stack([(_terms(x + h) - _terms(x - h)) / (2.0 * h.max()) for h in np.diag(scale)], axis=1)
    values = _terms(x)
    return Terms(values[:3], values[3:], slope @ calibration.covariance[:12, :12] @ slope.T)


def _terms(x: FloatArray) -> FloatArray:
    forward = forward_from_correction(Correction(x[:9].reshape(3, 3), x[9:]))
    R, _ = polar_split(forward.G)
    return np.concatenate([forward.o_nT / NT_PER_MG, np.degrees(-turn_vector(R))])
