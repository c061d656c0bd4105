"""What is fitted and what came out: the rows at work and the solution of one linear calibration."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fluxtwin.calib.common.design import Design
from fluxtwin.calib.common.moments import second_moment
from fluxtwin.calib.common.noise import ReadingNoise
from fluxtwin.calib.common.records import Calibration
from fluxtwin.calib.common.regression import Regression
from fluxtwin.calib.common.robust import RobustWeights
from fluxtwin.calib.linear.method import LinearOptions
from fluxtwin.sim.base.errors import NoAnswer
from fluxtwin.sim.base.types import FloatArray


@dataclass(frozen=True)
class LinearProblem:
    """The rows at work."""

    design: Design
    options: LinearOptions
    fired: np.ndarray
    dipole: list[np.ndarray]
    a: np.ndarray | None  # (N,) weights of sum 1, None for equal
    robust: RobustWeights | None
    noise: ReadingNoise

    @property
    def weights(self) -> FloatArray:
        """(N,) a_k of journal eq. 4."""
        return np.full(len(self.design), 1.0 / len(self.design)) if self.a is None else self.a

    @property
    def effective(self) -> float:
        """Effective number of rows, 1 / sum a_k^2."""
        return float(len(self.design)) if self.a is None else 1.0 / float((self.a**2).sum())

    def mean_square(self, r: FloatArray, power: int = 1) -> FloatArray:
        """(3, 3) mean of r r' with weights a_k^power, divided by sum a_k^power."""
        if self.a is None:
            return second_moment([r])[1]
        w = self.a**power
        return second_moment([r], w / w.sum())[1]

    @property
    def parts(self) -> list[FloatArray]:
        """Regressors of the fitted direction."""
        if self.options.parameters == "b":
            return []
        return [self.design.B_nT if self.options.method == "linear" else self.design.H_nT, *self.dipole]

    @property
    def noise_xx(self) -> FloatArray | None:
        """Sigma_x of the regressors [B; D] when the correction is on."""
        if not self.options.corrects:
            return None
        return np.diag(np.concatenate([self.noise.variance_nT2, np.zeros(self.fired.size)]))


@dataclass(frozen=True)
class Solution:
    """Slopes, calibration and residuals."""

    fit: Regression | None
    M: FloatArray  # (3, m) slopes in the fitted direction
    c: FloatArray
    calibration: Calibration
    residual_nT: FloatArray  # true-field side
    own_residual_nT: FloatArray  # side of the fitted direction
    eiv_shift: FloatArray


def corrected(
    xx: FloatArray, yx: FloatArray, mean_x: FloatArray, mean_y: FloatArray, noise_xx: FloatArray | None
) -> tuple[FloatArray, FloatArray]:
    """M = <y|x> (<x|x> - Sigma_x)^-1, c = <y> - M <x> (journal eqs. 5, 8; Fuller 1987)."""
    clean = xx if noise_xx is None else xx - noise_xx
    scale = np.sqrt(np.maximum(np.diag(clean), 1e-300))
    try:
        factor = np.linalg.cholesky(clean / np.outer(scale, scale))
    except np.linalg.LinAlgError:
        raise NoAnswer(
            "the field varies by less than the noise of the reading in some body direction: S is not determined",
            evidence={"field_covariance_nT2": xx[:3, :3].tolist()},
        ) from None
    half = np.linalg.solve(factor, (yx / scale).T)
    M = np.linalg.solve(factor.T, half).T / scale
    return M, mean_y - M @ mean_x
