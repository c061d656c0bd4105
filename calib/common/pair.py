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
from fluxtwin.sim.base.errors import NoAnswer, amount
from fluxtwin.sim.base.types import FloatArray

_FEWEST = 20
_GROUPS = 20
"""Pieces of the record that are left out in turn: each holds a row at least, and errors last shorter than one."""


@dataclass(frozen=True)
class Pair:
    """Residuals of two calibrated magnetometers at common instants; rms of a component, None where it is not to be
    distinguished from zero: within two sigma of its square."""

    samples: int
    shared_nT: float | None
    """Of both: field model, reference attitude."""
    own_nT: tuple[float | None, float | None]
    """Of each alone."""
    most_nT: tuple[float, float, float]
    """What both share, and what each has alone, are less than these: two sigma above the estimate of the square."""

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON; its keys are the fields."""
        return asdict(self)


def compare(first: Fit, second: Fit) -> Pair:
    """What two fits of one record share. Raises NoAnswer for fits by |B|, and with fewer than 20 common instants."""
    if first.residuals_nT.shape[1] != 3 or second.residuals_nT.shape[1] != 3:
        raise NoAnswer("two magnetometers are compared by vectors: a method with attitude is needed")
    common, i, j = np.intersect1d(first.time, second.time, return_indices=True)
    if common.size < _FEWEST:
        have = amount(common.size, "reading|readings")
        raise NoAnswer(f"the two magnetometers have {have} at the same instants; {_FEWEST} are needed")
    one, two = first.residuals_nT[i], second.residuals_nT[j]
    kept = ~(find_outliers(one) | find_outliers(two))
    one, two = one[kept] - one[kept].mean(axis=0), two[kept] - two[kept].mean(axis=0)
    products = np.mean([one * two, one * (one - two), two * (two - one)], axis=2)
    squares, sigma = products.mean(axis=1), _sigma_of_mean(products)
    sizes = [
        float(np.sqrt(square)) if square > 2.0 * wide else None for square, wide in zip(squares, sigma, strict=True)
    ]
    most = [float(np.sqrt(max(square, 0.0) + 2.0 * wide)) for square, wide in zip(squares, sigma, strict=True)]
    return Pair(int(kept.sum()), sizes[0], (sizes[1], sizes[2]), (most[0], most[1], most[2]))


def _sigma_of_mean(values: FloatArray) -> FloatArray:
    """(k,) sigma of the means of rows (k, n) in the order of time, by leaving out a group of neighbours at a time.

    Source: the jackknife of blocks, Kuensch 1989, Annals of Statistics 17, 1217.
    """
    groups = np.array_split(values, _GROUPS, axis=1)
    whole = values.sum(axis=1)
    without = np.array([(whole - part.sum(axis=1)) / (values.shape[1] - part.shape[1]) for part in groups])
    squares = np.sum((without - without.mean(axis=0)) ** 2, axis=0)
    return np.asarray(np.sqrt(squares * (_GROUPS - 1) / _GROUPS), dtype=np.float64)
