"""The one criterion by which explanations of a gap are compared, whatever kind they are.

With unit noise after whitening, D the drop of chi-square that p parameters give at their refit, n samples in time and
n_h settings that were tried,

    2 log(Bayes factor against nothing) = D - p min(log n, 1 + log max(D / p, 1)) - 2 log n_h.

The first penalty of a parameter is Schwarz's (1978, Annals of Statistics 6, 461), that of parameters which are seen well;
the second integrates p alike parameters over their unknown common size at its likeliest value (empirical Bayes: George &
Foster 2000, Biometrika 87, 731). Nature's form is not the catalogue's: what a named cause leaves is its own shape, up to a
share eps^2 of what it explains, eps half-normal of scale `SHAPE_SD`; beyond that something else is there.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from fluxtwin.sim.base.types import FloatArray

SHAPE_SD = 0.15
"""Of the amplitude of a cause: how far its form in nature is off the catalogue's."""
LOG_UNKNOWN = 6.0
"""Minus twice the log of the prior odds of a cause outside the catalogue: one in twenty."""
THRESHOLD = 6.0
"""The least worth of a finding. On noise alone the largest worth of a whole search exceeds it in about 0.2 % of records."""


def penalty(rank: ArrayLike, drop: ArrayLike, samples: float) -> FloatArray:
    """Of `rank` parameters that lower chi-square (unit variance) by `drop` together."""
    ranks = np.maximum(np.asarray(rank, dtype=np.float64), 0.0)
    each = np.asarray(drop, dtype=np.float64) / np.maximum(ranks, 1.0)
    return np.asarray(ranks * np.minimum(np.log(samples), 1.0 + np.log(np.maximum(each, 1.0))))


def worth(drop: float, rank: int, samples: float, log_tried: float) -> float:
    """Twice the log of the Bayes factor against nothing. log_tried: of the number of settings searched."""
    return float(drop - penalty(rank, drop, samples)) - 2.0 * log_tried


def misfit(left: float, explained: float) -> float:
    """What it costs to take a drop `left`, of structure, for the shape error of causes that explain a drop `explained`."""
    return left / max(explained, 1e-300) / SHAPE_SD**2


@dataclass(frozen=True)
class Weights:
    """Probabilities of explanations, from twice the logs of their Bayes factors."""

    logs: FloatArray

    @property
    def shares(self) -> FloatArray:
        """They sum to one."""
        half = 0.5 * (self.logs - self.logs.max())
        weight = np.exp(half)
        return np.asarray(weight / weight.sum())
