"""What is fitted and what came out: the rows at work and the solution of one linear calibration."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from fluxtwin.calib.common.design import Design
from fluxtwin.calib.common.noise import ReadingNoise
from fluxtwin.calib.common.options import LinearOptions
from fluxtwin.calib.common.records import Calibration
from fluxtwin.calib.common.regression import Regression
from fluxtwin.sim.base.types import BoolArray, FloatArray


@dataclass(frozen=True)
class LinearProblem:
    """The rows at work."""

    design: Design
    options: LinearOptions
    fired: np.ndarray
    """Torquer axes that are fitted."""
    weights: FloatArray
    """(N,) a_k of journal eq. 4, sum 1; outliers have none."""
    kept: BoolArray
    """(N,) rows that are no outliers."""
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

    @cached_property
    def driver_rms(self) -> FloatArray:
        """(J,) rms of each column that a field follows."""
        return np.array([float(np.sqrt((values**2).mean())) for values in self.design.columns.values()])

    @cached_property
    def drivers(self) -> list[FloatArray]:
        """These columns, each over its rms, in a list of one, or of none."""
        values = list(self.design.columns.values())
        return [np.stack(values, axis=1) / self.driver_rms] if values else []

    @property
    def fits_S(self) -> bool:
        """Whether the field is a regressor."""
        return self.options.parameters != "b"

    @property
    def linear(self) -> bool:
        """The reading stands on the right side, beside a slope that is fitted."""
        return self.options.method == "linear" and self.fits_S

    @property
    def forward(self) -> bool:
        """The reference field does."""
        return self.options.method == "forward" and self.fits_S

    @property
    def sides(self) -> tuple[FloatArray, list[FloatArray]]:
        """(N, 3) what is fitted, and the m regressors: none for b alone, without drivers."""
        B, H = self.design.B_nT, self.design.H_nT
        if not self.fits_S:
            return H - B, self.drivers
        return (H, [B, *self.dipole, *self.drivers]) if self.linear else (B, [H, *self.dipole, *self.drivers])

    @property
    def noise_xx(self) -> FloatArray:
        """(m, m) Sigma_x of the regressors [B; D; drivers]; zero where it is not corrected for."""
        field = float(self.options.corrects) * self.noise.variance_nT2 if self.fits_S else np.zeros(0)
        others = self.fired.size * self.fits_S + len(self.design.columns)
        return np.diag(np.concatenate([field, np.zeros(others)]))


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
