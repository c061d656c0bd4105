"""A bias that wanders, as noise: the whitening of readings that have a random walk in them.

A walk is known by its rate alone, so it belongs to the covariance and not to the parameters (a random effect of a
linear mixed model: Harville 1977, J. Am. Stat. Assoc. 72, 320). Causes that are sought under this whitening are those
that a walk of that rate does not make, and the likelihoods of "these causes" and of "a walk, and those causes" are on
one scale.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.optimize import minimize_scalar

from fluxtwin.calib.common.criterion import THRESHOLD, samples_of, worth
from fluxtwin.gap.linear.projection import span_of
from fluxtwin.gap.noise.whitening import Whitener, with_walk
from fluxtwin.sim.base.types import FloatArray

RMS = (0.003, 100.0)
"""Of the walk at the end of the record, over the noise of a reading: its prior is even in the logarithm between these."""
_CLOSE = 0.02
"""In the logarithm of the rate: a fifth of its standard deviation where 50 modes of the walk show."""


def likeliest_rate(whitener: Whitener, residual_nT: FloatArray, fitted_nT: FloatArray) -> float | None:
    """The likeliest rate [nT/sqrt(s)] of a walk in a residual (N, 3) beside fitted columns (N, 3, q); None where a walk is
    hardly more likely than none."""
    fit = _fits(whitener, residual_nT, fitted_nT)
    degrees = max(whitener.measured - fitted_nT.shape[2], 1)
    energy, log_det = fit(0.0)

    def lost(log_rate: float) -> float:
        chi2, wider = fit(float(np.exp(log_rate)))
        # The noise level is profiled out: one that was declared wrong is no walk.
        return -float(log_det - wider - degrees * np.log(chi2 / energy))

    unit = whitener.noise.sigma_nT / np.sqrt(float(whitener.seconds[-1] - whitener.seconds[0]))
    found = minimize_scalar(lost, bounds=np.log(unit * np.array(RMS)), options={"xatol": _CLOSE})
    found_worth = worth(-float(found.fun), 1, samples_of(whitener.measured), 0.0)
    return float(np.exp(found.x)) if found_worth > THRESHOLD else None


def gain(whitener: Whitener, residual_nT: FloatArray, fitted_nT: FloatArray, rate: float) -> float:
    """Twice the log likelihood that a walk of that rate wins on a residual, for noise of unit variance."""
    fit = _fits(whitener, residual_nT, fitted_nT)
    (before, log_det), (now, wider) = fit(0.0), fit(rate)
    return before - now + log_det - wider


def _fits(whitener: Whitener, residual_nT: FloatArray, fitted_nT: FloatArray) -> Callable[[float], tuple[float, float]]:
    """Of a rate: chi-square beside the fitted columns, and the log determinant of the restricted likelihood."""
    flat = whitener.apply(fitted_nT).reshape(residual_nT.size, -1)
    columns = np.concatenate([fitted_nT[:, :, span_of(flat).number], residual_nT[:, :, None]], axis=2)

    def fit(rate: float) -> tuple[float, float]:
        walking = with_walk(whitener, rate)
        R = np.linalg.qr(walking.apply(columns).reshape(residual_nT.size, -1), mode="r")
        size = np.abs(np.diag(R))
        return float(size[-1] ** 2), walking.log_det + 2.0 * float(np.log(size[:-1]).sum())

    return fit
