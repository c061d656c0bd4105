"""The one criterion by which explanations of a gap are compared, whatever kind they are.

With unit noise after whitening, D the drop of chi-square that p parameters give at their refit, n samples in time and
n_h settings that were tried,

    2 log(Bayes factor against nothing) = D - p min(log n, 1 + log max(D / p, 1)) - 2 log n_h.

The first penalty of a parameter is Schwarz's (1978, Annals of Statistics 6, 461), that of parameters which are seen well;
the second integrates p alike parameters over their unknown common size at its likeliest value (empirical Bayes: George &
Foster 2000, Biometrika 87, 731). Nature's form is not the catalogue's: what named causes that
explain a drop D leave has, beside the noise, a variance of `SHAPE` D in each direction that anything else could explain.
A further cause, or an unknown one, must stand out of that too.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import expit, logit

from fluxtwin.sim.base.types import FloatArray

SHAPE_ERROR = 0.15
"""Of its amplitude, rms: how far the image of a hypothesis is from what nature does where the hypothesis is right. Of 34
truths of other shapes (docs/design/shape_error.py, 60 records) it is below 0.10 in three quarters, 0.17 in nine tenths."""
SHAPE = SHAPE_ERROR**2 / 15.0
"""Share of the energy of named causes that their shape error has in one direction, spread over fifteen directions (columns
of some three to five blocks). Of the same truths the worst direction has less than 0.0020 in three quarters, 0.0053 in nine
tenths."""
LOG_FURTHER = 6.0
"""Minus twice the log of the prior odds of one more cause beside a named one, and of one outside the catalogue: one in
twenty."""
THRESHOLD = 6.0
"""The least worth of a finding. On noise alone the largest worth of a whole search exceeds it in about 0.2 % of records."""
MOST_SURE = 0.98
"""Most that is ever stated of a name: of some 160 names on tuning seeds (2001, 2002, 2003, 2010 of
benchmarks/withheld.py) of which the posterior was all but sure, two or three were wrong; by Laplace's rule
(1 + 160) / (2 + 163) = 0.976."""


def penalty(rank: ArrayLike, drop: ArrayLike, samples: float) -> FloatArray:
    """Of `rank` parameters that lower chi-square (unit variance) by `drop` together."""
    ranks = np.maximum(np.asarray(rank, dtype=np.float64), 0.0)
    each = np.asarray(drop, dtype=np.float64) / np.maximum(ranks, 1.0)
    return np.asarray(ranks * np.minimum(np.log(samples), 1.0 + np.log(np.maximum(each, 1.0))))


def worth(drop: float, rank: int, samples: float, log_tried: float) -> float:
    """Twice the log of the Bayes factor against nothing. log_tried: of the number of settings searched."""
    return float(drop - penalty(rank, drop, samples)) - 2.0 * log_tried


def still_known(known: float, log_ratio: float) -> float:
    """The probability that named effects are all there is, after held-out samples. known: before, by what is left in the
    fit; log_ratio: of the Bayes factor that held-out samples give. What looks like an effect of the catalogue may be none
    of it even where the fit leaves nothing."""
    return float(expit(min(logit(known), 0.5 * LOG_FURTHER) + log_ratio))
