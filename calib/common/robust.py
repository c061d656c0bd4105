"""The outliers of a fit.

Iteratively reweighted least squares on the size of the residual vector, in the *forward* form B = G A H + o +
C D: a bit error sits in the reading B, so there it can move the left side only and has no leverage. Huber weights
lead from a start that no outlier reaches (G = I, o the median) to the neighbourhood, and Tukey's biweight to a fit that
gross errors do not move. What it gives no weight is set aside, in either direction; least squares takes the rest. Weights
between nought and one would make the sigmas of clean data wrong: they bend large residuals, and an attitude error makes
large ones across the field alone.

Scale: median of |r|, each axis on its own, which up to half of the samples may be bad. Sources: Maronna,
Martin & Yohai (2006), Robust Statistics, ch. 2, 4; Rousseeuw & Leroy (1987), Robust Regression, ch. 5 (least squares after
rejection).
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.optimize import brentq

from fluxtwin.sim.base.errors import NoAnswer, amount
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


def rows_to_keep(start_nT: FloatArray, refit: Callable[[FloatArray], FloatArray], kind: str) -> BoolArray:
    """(N,) rows that are no outliers, by `tukey`; `none`: all.

    start_nT: (N, 3) residuals that no outlier has pulled, up to a constant; (N, 1) where only |B| is fitted. refit:
    residuals like it of the fit with the weights (N,) it is given. Raises NoAnswer where no row is left.
    """
    r = start_nT - np.median(start_nT, axis=0)
    weights = np.ones(len(r))
    if kind == "none":
        return weights > 0.0
    for weigh in (_huber, _tukey):
        for _ in range(_ROUNDS):
            new = weigh(robust_distance(r))
            r = refit(new)
            moved = float(np.abs(new - weights).max())
            weights = new
            if moved < 1e-3:
                break
    return robust_distance(r) < TUKEY_AT


def within_attitude_errors(residuals_nT: FloatArray, field_nT: FloatArray) -> BoolArray:
    """(N,) rows that an error of the attitude, beside the noise, explains: rows below six robust sigma where sigma follows
    the field.

    residuals_nT, field_nT: (N, 3) in one set of axes. An error theta leaves theta x B: nothing along the field, more where
    the field is strong, so a slow one makes runs of rows that are far off by the scale of all rows. The noise is that along
    the field; the square of what is across has the median 2 ln 2 in units of noise and attitude error together.
    """
    size = np.linalg.norm(field_nT, axis=1)
    along = np.einsum("ij,ij->i", residuals_nT, field_nT) / size
    across2 = np.maximum((residuals_nT**2).sum(axis=1) - along**2, 0.0)
    along -= np.median(along)
    noise2 = (MAD_TO_SIGMA * float(np.median(np.abs(along)))) ** 2
    if noise2 == 0.0:
        return np.zeros(size.size, dtype=np.bool_)

    def beyond(theta2: float) -> float:
        return float(np.median(across2 / (noise2 + theta2 * size**2)) - 2.0 * np.log(2.0))

    largest = float((across2 / size**2).max())
    theta2 = brentq(beyond, 0.0, largest) if beyond(0.0) > 0.0 else 0.0
    return np.asarray(along**2 / noise2 + across2 / (noise2 + theta2 * size**2) < TUKEY_AT**2)


def outlier_words(kept: BoolArray) -> str:
    """How many rows are left out."""
    return f"{amount(int((~kept).sum()), 'outlier|outliers')} of more than {TUKEY_AT:g} robust sigma left out"


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


def _huber(distance: FloatArray) -> FloatArray:
    return np.asarray(_HUBER_AT / np.maximum(distance, _HUBER_AT))


def _tukey(distance: FloatArray) -> FloatArray:
    u = np.minimum(distance / TUKEY_AT, 1.0)
    if not (u < 1.0).any():
        raise NoAnswer(f"each of the {len(u)} rows lies far from all others: --robust none, or more rows")
    return np.asarray((1.0 - u**2) ** 2)
