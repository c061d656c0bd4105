"""The one criterion by which explanations of a gap are compared, whatever kind they are: `calib.common.criterion`.

Nature's form is not the catalogue's. What named causes that explain a drop D of chi-square leave has, beside the noise, a
variance of `SHAPE` D in each direction that anything else could explain. A further cause, or an unknown one, must stand out
of that too.
"""

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import expit, logit

from fluxtwin.calib.common.criterion import THRESHOLD as THRESHOLD
from fluxtwin.calib.common.criterion import penalty as penalty
from fluxtwin.calib.common.criterion import samples_of as samples_of
from fluxtwin.calib.common.criterion import worth as worth
from fluxtwin.sim.base.types import BoolArray, FloatArray

FEWEST = 30
"""Measurements that say anything by themselves: a variance is then known to a quarter, sqrt(2 / 30)."""
GATE = 0.002
"""Probability that a perfect simulation gets any name."""
SHAPE_ERROR = 0.15
"""Of its amplitude, rms: how far the image of a hypothesis is from what nature does where the hypothesis is right. Of 34
truths of other shapes (docs/design/shape_error.py, 60 records) it is below 0.10 in three quarters, 0.17 in nine tenths."""
SHAPE_DIRECTIONS = 15
SHAPE = SHAPE_ERROR**2 / SHAPE_DIRECTIONS
"""Share of the energy of named causes that their shape error has in one direction, spread over fifteen directions (columns
of some three to five blocks). Of the same truths the worst direction has less than 0.0020 in three quarters, 0.0053 in nine
tenths."""
IN_GROUP = 0.05
"""Probability of a rival, one in twenty, from which on it is not distinguished."""
LOG_FURTHER = -2.0 * float(np.log(IN_GROUP))
"""The same in twice the log; and minus that of the prior odds of one more cause beside a named one, and of one outside the
catalogue: as much."""


def stands_out(p_value: ArrayLike, worth: ArrayLike) -> BoolArray:
    """Whether a first cause is named. p_value: the least of all that was tested, times their number; worth: the largest."""
    return np.asarray((np.asarray(p_value) <= GATE) & (np.asarray(worth) > THRESHOLD), dtype=np.bool_)


def weight_of(worse: ArrayLike) -> FloatArray:
    """Posterior weight, against 1, of what costs so much more in twice the log; within what a number holds."""
    return np.asarray(np.exp(-0.5 * np.clip(worse, -100.0, 1400.0)))


def of_shape(explained: float, directions: int) -> float:
    """Variance of the shape error of causes that explain so much, in each of so many directions: in more than
    `SHAPE_DIRECTIONS` there is no more of it."""
    return SHAPE * explained * min(1.0, SHAPE_DIRECTIONS / directions)


def worth_of_shape(drop: float, explained: float, directions: int) -> float:
    """Twice the log of the Bayes factor that what causes leave is their shape error, against noise.

    drop: of chi-square, by what the causes leave, in so many directions; explained: by the causes. An error of the shape has
    a variance in all of `SHAPE_DIRECTIONS`, and would have been seen in those that hold nothing too: where they are known to
    be empty they count. The variance is the likeliest.
    """
    variance = float(np.clip(drop / directions - 1.0, 0.0, of_shape(explained, directions)))
    return float(drop * variance / (1.0 + variance) - directions * np.log1p(variance))


def still_known(known: float, log_ratio: float) -> float:
    """The probability that named effects are all there is, after held-out samples. known: before, by what is left in the
    fit; log_ratio: of the Bayes factor that held-out samples give. What looks like an effect of the catalogue may be none
    of it even where the fit leaves nothing."""
    return float(expit(min(logit(known), 0.5 * LOG_FURTHER) + log_ratio))
