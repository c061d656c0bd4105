"""What is fitted and what came out: the options, the rows at work and the solution of one linear calibration."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fluxtwin.calib.common.design import Design
from fluxtwin.calib.common.moments import second_moment
from fluxtwin.calib.common.noise import ReadingNoise
from fluxtwin.calib.common.records import Calibration
from fluxtwin.calib.common.regression import Regression
from fluxtwin.calib.common.robust import RobustWeights
from fluxtwin.sim.base.errors import BadInput, NoAnswer
from fluxtwin.sim.base.types import FloatArray

PARAMETERS = ("b", "b,S", "b,S,T")
DIRECTIONS = ("linear", "forward")


LEAST_BLOCK_S = 1e-3


def require_block(block_s: float | None) -> None:
    """Raises BadInput for a length that no block can have."""
    if block_s is not None and not LEAST_BLOCK_S <= block_s < np.inf:
        raise BadInput(f"{block_s!r}", where="block_s", wanted=f"seconds, at least {LEAST_BLOCK_S:g}")


@dataclass(frozen=True)
class Options:
    """How the regression is done; see `calibrate_linear`."""

    parameters: str = "b,S"
    direction: str = "linear"
    errors_in_variables: bool | None = None
    noise_nT: float | FloatArray | None = None
    lsb_nT: float | FloatArray | None = None
    robust: str | None = None
    """`huber`, `tukey`; None: all rows alike."""
    covariance: str = "blocks"
    block_s: float | None = None
    field_error_nT: float | None = None
    attitude_sigma_deg: float | None = None
    attitude_tau_s: float | None = None

    def __post_init__(self) -> None:
        _one_of(self.parameters, PARAMETERS, "parameters")
        _one_of(self.direction, DIRECTIONS, "direction")
        _one_of(self.covariance, ("white", "blocks"), "covariance")
        if self.errors_in_variables and self.direction == "forward":
            raise BadInput(
                "the correction for noise in the reading has no place in the forward direction",
                where="errors_in_variables",
                wanted="direction linear, or the correction off",
            )
        require_block(self.block_s)
        for name, low in (("attitude_sigma_deg", 1e-6), ("attitude_tau_s", 0.0)):
            value = getattr(self, name)
            if value is not None and not low <= value < 1e9:
                raise BadInput(f"{value!r}", where=name, wanted="degrees, positive" if low else "seconds, not negative")
        if self.attitude_sigma_deg is not None and not self.attitude_sigma_deg < 90.0:
            raise BadInput(f"{self.attitude_sigma_deg!r}", where="attitude_sigma_deg", wanted="degrees, below 90")
        if self.field_error_nT is not None and not 0 <= self.field_error_nT < np.inf:
            raise BadInput(f"{self.field_error_nT!r}", where="field_error_nT", wanted="nT, not negative")

    @property
    def corrects(self) -> bool:
        """Whether the errors-in-variables correction is made."""
        wanted = self.direction == "linear" if self.errors_in_variables is None else self.errors_in_variables
        return wanted and self.parameters != "b"


@dataclass(frozen=True)
class Job:
    """The rows at work."""

    design: Design
    options: Options
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
        return [self.design.B_nT if self.options.direction == "linear" else self.design.H_nT, *self.dipole]

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


def _one_of(value: str, allowed: tuple[str, ...], name: str) -> None:
    if value not in allowed:
        raise BadInput(f"{value!r}", where=name, wanted=" or ".join(repr(v) for v in allowed))
