"""How much a finding is worth: what it explains, less what its parameters and the trials would explain by chance.

With unit noise, D the drop of chi-square that p parameters give, n samples in time and n_h hypotheses that were tried,

    2 log(Bayes factor against nothing) = D - p min(log n, 1 + log max(D / p, 1)) - 2 log n_h.

The first penalty of a parameter is Schwarz's (1978, Annals of Statistics 6, 461), that of parameters which are seen well;
the second integrates p alike parameters over their unknown common size at its likeliest value (empirical Bayes: George &
Foster 2000, Biometrika 87, 731).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from fluxtwin.sim.base.types import FloatArray

THRESHOLD = 6.0
"""The least worth of a finding. On noise alone the largest worth of a whole search exceeds it in about 0.2 % of records."""


FALSE_ALARM = 0.01
"""Level of a test that no worth is given for, over all that it is made of."""


def samples_of(components: float) -> float:
    """Samples in time, of so many measured components: three each, and two at least, so that a parameter has a price."""
    return max(components / 3.0, 2.0)


def penalty(rank: ArrayLike, drop: ArrayLike, samples: float) -> FloatArray:
    """Of `rank` parameters that lower chi-square (unit variance) by `drop` together."""
    ranks = np.maximum(np.asarray(rank, dtype=np.float64), 0.0)
    each = np.asarray(drop, dtype=np.float64) / np.maximum(ranks, 1.0)
    return np.asarray(ranks * np.minimum(np.log(samples), 1.0 + np.log(np.maximum(each, 1.0))))


def worth(drop: float, rank: int, samples: float, log_tried: float) -> float:
    """Twice the log of the Bayes factor against nothing. log_tried: of the number of settings searched."""
    return float(drop - penalty(rank, drop, samples)) - 2.0 * log_tried
