"""Two magnetometers of one spacecraft, calibrated each by itself: what their residuals share, and what is their own.

Field model and reference attitude err alike for both, so what the residuals have in common, row by row, is theirs; noise,
interference and a wrong calibration are each sensor's own. (A common fit would not change either calibration: both regress
on readings of one field, and seemingly unrelated regressions on equal regressors are ordinary ones, Zellner 1962.)
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from fluxtwin.calib.common.fit import Fit
from fluxtwin.calib.common.robust import find_outliers
from fluxtwin.sim.base.errors import NoAnswer

_FEWEST = 20


@dataclass(frozen=True)
class Pair:
    """Residuals of two calibrated magnetometers at common instants; rms of a component."""

    samples: int
    shared_nT: float
    """Of both: field model, reference attitude."""
    own_nT: tuple[float, float]
    """Of each alone."""

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON; its keys are the fields."""
        return asdict(self)


def compare(first: Fit, second: Fit) -> Pair:
    """What two fits of one record share. Raises NoAnswer for fits by |B|, and with fewer than 20 common instants."""
    if first.residuals_nT.shape[1] != 3 or second.residuals_nT.shape[1] != 3:
        raise NoAnswer("two magnetometers are compared by vectors: a method with attitude is needed")
    common, i, j = np.intersect1d(first.time, second.time, return_indices=True)
    if common.size < _FEWEST:
        raise NoAnswer(f"the two magnetometers have {common.size} readings at the same instants; {_FEWEST} are needed")
    one, two = first.residuals_nT[i], second.residuals_nT[j]
    kept = ~(find_outliers(one) | find_outliers(two))
    one, two = one[kept] - one[kept].mean(axis=0), two[kept] - two[kept].mean(axis=0)
    shared = float(np.mean(one * two))
    own = [float(np.sqrt(max(float(np.mean(x**2)) - max(shared, 0.0), 0.0))) for x in (one, two)]
    return Pair(int(kept.sum()), float(np.sqrt(max(shared, 0.0))), (own[0], own[1]))
