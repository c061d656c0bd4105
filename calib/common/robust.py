"""Weights that bit errors do not move, and the outliers of a fit.

Iteratively reweighted least squares on the size of the residual vector, in the *forward* form B = G A H + o +
C D: a bit error sits in the reading B, so there it can move the left side only and has no leverage. The
weights then serve either direction. Huber weights lead from a start that no outlier reaches (G = I, o the
median) to the neighbourhood; Tukey's biweight then gives gross errors the weight zero. Huber alone only
bounds them: what it leaves of a wrong reading still attenuates S in the linear direction.

Scale: median of |r|, each axis on its own, which up to half of the samples may be bad. Source: Maronna,
Martin & Yohai (2006), Robust Statistics, ch. 2, 4.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from fluxtwin.sim.base.errors import NoAnswer
from fluxtwin.sim.base.types import BoolArray, FloatArray

MAD_TO_SIGMA = 1.482602218505602
"""Standard deviation of a normal distribution over its median absolute deviation."""
_HUBER_AT = 2.0
"""In sigma of the three-component distance: 74 % of a Gaussian lies inside, efficiency 96 %."""
TUKEY_AT = 6.0
"""Efficiency for three Gaussian components 95 %; weight zero beyond six sigma."""
_OUTLIER_SIGMA = 8.0
"""Robust sigmas: of Gaussian rows none, of correlated errors next to none."""
_ROUNDS = 50


@dataclass(frozen=True)
class RobustWeights:
    """Weights of the rows, and what the covariance must know about them."""

    weights: FloatArray
    """(N,) between 0 and 1."""
    sharpness: float
    """Mean derivative of the influence over the mean weight: slopes are 1/sharpness as uncertain."""

    @property
    def kept(self) -> BoolArray:
        """(N,) rows that are not set aside."""
        return np.asarray(self.weights >= 0.01)

    @property
    def rejected(self) -> int:
        """How many are."""
        return int((~self.kept).sum())


def robust_weights(start_nT: FloatArray, refit: Callable[[FloatArray], FloatArray], kind: str) -> RobustWeights:
    """Weights of rows by `huber` or `tukey`; `none`: one each.

    start_nT: (N, 3) residuals that no outlier has pulled, up to a constant; (N, 1) where only |B| is fitted. refit:
    residuals like it of the fit with the weights (N,) it is given.
    """
    r = start_nT - np.median(start_nT, axis=0)
    weights = np.ones(len(r))
    if kind == "none":
        return RobustWeights(weights, 1.0)
    for stage in ("huber", "tukey") if kind == "tukey" else ("huber",):
        for _ in range(_ROUNDS):
            new, _ = _weigh(robust_distance(r), stage)
            r = refit(new)
            moved = float(np.abs(new - weights).max())
            weights = new
            if moved < 1e-3:
                break
    distance = robust_distance(r)
    weights, slope = _weigh(distance, kind)
    # E[psi'] of a radial influence w(d) r in n dimensions is w + w'(d) d / n
    sharpness = float((weights + slope * distance / r.shape[1]).mean() / weights.mean())
    return RobustWeights(weights, sharpness)


def find_outliers(residuals: FloatArray) -> np.ndarray:
    """(N,) rows of (N, k) residuals that lie far from the others, by a scale that half of them may be wrong in."""
    r = residuals - np.median(residuals, axis=0)
    scale = MAD_TO_SIGMA * np.median(np.abs(r))
    return np.asarray((np.linalg.norm(r, axis=1) > _OUTLIER_SIGMA * scale) & (scale > 0))


def robust_distance(r: FloatArray) -> FloatArray:
    """(N,) size of the residual vector in units of each axis's own robust sigma."""
    sigma = MAD_TO_SIGMA * np.median(np.abs(r - np.median(r, axis=0)), axis=0)
    floor = max(1e-6 * float(np.abs(r).max()), 1e-12)  # more than half of an axis may sit on one LSB
    spread = np.maximum(sigma, floor)
    return np.asarray(np.sqrt(((r / spread) ** 2).sum(axis=1)))


def _weigh(distance: FloatArray, kind: str) -> tuple[FloatArray, FloatArray]:
    """Weight w(d) and its derivative. Raises NoAnswer where no row has any."""
    if kind == "huber":
        outside = distance > _HUBER_AT
        safe = np.where(outside, distance, _HUBER_AT)
        return np.where(outside, _HUBER_AT / safe, 1.0), np.where(outside, -_HUBER_AT / safe**2, 0.0)
    u = np.minimum(distance / TUKEY_AT, 1.0)
    if not (u < 1.0).any():
        raise NoAnswer(f"each of the {len(u)} rows lies far from all others: --robust none, or more rows", evidence={})
    return (1.0 - u**2) ** 2, -4.0 * u * (1.0 - u**2) / TUKEY_AT
