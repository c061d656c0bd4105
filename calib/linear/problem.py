"""What is fitted and what came out: the rows at work and the solution of one linear calibration."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fluxtwin.calib.common.design import Design
from fluxtwin.calib.common.noise import ReadingNoise
from fluxtwin.calib.common.records import Calibration
from fluxtwin.calib.common.regression import Regression
from fluxtwin.calib.common.robust import RobustWeights
from fluxtwin.calib.linear.method import LinearOptions
from fluxtwin.sim.base.types import FloatArray


@dataclass(frozen=True)
class LinearProblem:
    """The rows at work."""

    design: Design
    options: LinearOptions
    fired: np.ndarray
    """Torquer axes that are fitted."""
    weights: FloatArray
    """(N,) a_k of journal eq. 4, sum 1; the robust weights are in them."""
    robust: RobustWeights
    noise: ReadingNoise

    @property
    def effective(self) -> float:
        """Effective number of rows, 1 / sum a_k^2."""
        return 1.0 / float((self.weights**2).sum())

    def mean_square(self, r: FloatArray, power: int = 1) -> FloatArray:
        """(3, 3) mean of r r' with weights a_k^power, divided by sum a_k^power."""
        w = self.weights**power
        return np.asarray((r * w[:, None]).T @ r / w.sum())

    @property
    def dipole(self) -> list[FloatArray]:
        """The columns of the dipole that are fitted, in a list of one, or of none."""
        D = self.design.D_Am2
        return [] if D is None or not self.fired.size else [D[:, self.fired]]

    @property
    def linear(self) -> bool:
        """The reading stands on the right side, beside a slope that is fitted."""
        return self.options.method == "linear" and self.options.parameters != "b"

    @property
    def forward(self) -> bool:
        """The reference field does."""
        return self.options.method == "forward" and self.options.parameters != "b"

    @property
    def sides(self) -> tuple[FloatArray, list[FloatArray]]:
        """(N, 3) what is fitted, and the m regressors: none for b alone."""
        B, H = self.design.B_nT, self.design.H_nT
        if self.options.parameters == "b":
            return H - B, []
        return (H, [B, *self.dipole]) if self.linear else (B, [H, *self.dipole])

    @property
    def noise_xx(self) -> FloatArray:
        """(m, m) Sigma_x of the regressors [B; D]; zero where it is not corrected for."""
        if self.options.parameters == "b":
            return np.zeros((0, 0))
        corrects = float(self.options.corrects)
        return np.diag(np.concatenate([corrects * self.noise.variance_nT2, np.zeros(self.fired.size)]))


@dataclass(frozen=True)
class Solution:
    """Slopes, calibration and residuals."""

    fit: Regression
    M: FloatArray  # (3, m) slopes in the fitted direction
    c: FloatArray
    calibration: Calibration
    residual_nT: FloatArray  # true-field side
    own_residual_nT: FloatArray  # side of the fitted direction
    eiv_shift: FloatArray
