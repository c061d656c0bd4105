"""How far: the gap before and after the named effects, on samples that the parameters have not seen.

Five contiguous blocks; what is modelled, and the effects' parameters, are estimated on four with a guard of the
smaller of 300 s and 2 % of the span, and predict the fifth. Estimation is linear about the refitted parameters, from
Gram matrices of whitened rows, so a block costs one small solve. Where the others do not determine what a block needs,
so that the prediction is less sure than the noise is large, there is no prediction; where that is so of half of the
record, the figures are those of the fit itself, and say so. A random walk is predicted one row ahead instead.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.special import logsumexp
from scipy.stats import halfnorm, norm

from fluxtwin.gap.hypotheses.candidates import SLOW_S
from fluxtwin.gap.linear.projection import Whitens
from fluxtwin.gap.problem.problem import ALIKE, Problem, Roll
from fluxtwin.gap.problem.row_axes import RowAxes, turn_images
from fluxtwin.gap.records.diagnosis import GapSeries, Shrinkage
from fluxtwin.gap.selection.criterion import SHAPE_ERROR
from fluxtwin.sim.base.types import BoolArray, FloatArray, TimeArray

BLOCKS = 5
"""The usual number of folds: a compromise between bias and variance (Hastie et al. 2009, section 7.10.1)."""
DRAWS = 400
"""Of the bootstrap: its 5 % points are good to a tenth of the spread."""
_DIFFUSE = 1e6
"""Variance of a level of which nothing is known yet, over that of a reading."""
_Fit = tuple[FloatArray, FloatArray]
"""A residual (N, 3), and what is fitted (N, 3, P), both in body axes [nT]."""


@dataclass(frozen=True, eq=False)
class Prediction:
    """Held-out residuals, N rows, in body axes or, where rows have no attitude, in their own axes."""

    before_nT: FloatArray
    """(N, 3) with what is modelled re-estimated on the other blocks."""
    after_nT: FloatArray
    """(N, 3) with the named effects re-estimated too."""
    counted: BoolArray
    """(N,) rows that are not cut, and were predicted."""
    floor_nT: float
    """What the budget makes expect, with the error of the prediction, rms per component."""
    floor_with_effects_nT: float
    """The same with the named noise."""
    of: str = "blocks"
    """`blocks` held out, `one_step` ahead, or the `fit` itself."""
    axes: RowAxes | None = None
    """Where rows have no attitude: what is seen along the field counts for each body axis by its share in it."""
    floor_log_sd: float = 0.0
    """Standard deviation of the logarithm of what is expected."""
    unsure_nT: tuple[float, float] = (0.0, 0.0)
    """rms per component of the errors of the predictions, which stand in these residuals beside the noise."""

    @property
    def log_ratio(self) -> float:
        """Log of the Bayes factor of what is left of held-out samples: the named effects with their shape error, against
        something else in their likeness.

        Of the energy of the gap the first leave eps^2, eps half-normal of scale `SHAPE_ERROR`; the second leave any share.
        Minus infinity where the effects predict samples that have a gap worse than nothing does.
        """
        before2, after2 = self._draws(self.after_nT)
        if self._has_gap(before2) and self._mean_square(self.after_nT) >= self._mean_square(self.before_nT):
            return -np.inf
        signal = max(self._mean_square(self.before_nT) - self.floor_nT**2, 0.0)
        left = min(self._mean_square(self.after_nT) - self.floor_with_effects_nT**2, signal)
        floor_sd = 2.0 * self.floor_log_sd * self.floor_with_effects_nT**2
        count = 200  # quantiles of a prior, in place of an integral over it
        sd = max(float(np.hypot(after2.std(), floor_sd)), signal / count, 1e-300)
        middle = (np.arange(count) + 0.5) / count
        shares = (halfnorm.ppf(middle, scale=SHAPE_ERROR) ** 2, middle)
        named, other = (logsumexp(norm.logpdf(left, signal * share, sd)) for share in shares)
        return float(named - other)

    def without_known_noise(self, named: bool) -> Prediction:
        """Where the scenario has the noise already it belongs to the floor; if nothing else is named there is no before."""
        lifted = replace(self, floor_nT=self.floor_with_effects_nT)
        return lifted if named else replace(lifted, before_nT=self.after_nT)

    def series(self, time: TimeArray, named: bool) -> GapSeries:
        """For figures, in body axes; NaN where there is no prediction. Without a named effect, after is before."""
        parts = [self.before_nT, self.after_nT if named else self.before_nT]
        if self.axes is not None:
            parts = [self.axes.in_body(part) for part in parts]
        return GapSeries(time, *(np.where(self.counted[:, None], part, np.nan) for part in parts))

    def shrinkage(self, named: bool, shape_incomplete: bool = False, left_nT: float = 0.0) -> Shrinkage:
        """The figures of the contract, over what is measured. Without a named effect, after is before."""
        after_nT = self.after_nT if named else self.before_nT
        floor_with_nT = self.floor_with_effects_nT if named else self.floor_nT
        before2, after2 = self._draws(after_nT)
        rms = [float(np.sqrt(self._mean_square(part))) for part in (self.before_nT, after_nT)]
        closed: float | None = None
        interval: tuple[float, float] | None = None
        if named and self._has_gap(before2):
            closed, interval = closed_share(rms[0], rms[1], self.floor_nT, floor_with_nT, before2, after2)
        sizes = zip("xyz", self._by_axis(self.before_nT), self._by_axis(after_nT), strict=True)
        return Shrinkage(
            before_nT=rms[0],
            after_nT=rms[1],
            floor_nT=self.floor_nT,
            floor_with_effects_nT=floor_with_nT,
            closed=closed,
            interval=interval,
            prediction=self.of,
            shape_incomplete=shape_incomplete,
            per_axis={axis: {"before_nT": before, "after_nT": after} for axis, before, after in sizes},
            left_nT=left_nT,
        )

    def _has_gap(self, before2: FloatArray) -> bool:
        """Whether held-out samples show the gap beyond chance; before2: as from `_draws`."""
        return self._mean_square(self.before_nT) - self.floor_nT**2 > 2.0 * float(before2.std())

    @property
    def _count(self) -> FloatArray:
        """(n,) components of each counted row."""
        rows = int(self.counted.sum())
        return np.full(rows, 3) if self.axes is None else self.axes.measured[self.counted].sum(axis=1)

    def _mean_square(self, residual_nT: FloatArray) -> float:
        """Of the counted rows of residuals (N, 3), per component [nT^2]."""
        return float(np.sum(residual_nT[self.counted] ** 2) / self._count.sum())

    def _draws(self, after_nT: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Mean squares before and after, (draws,) each, as other noise would have made them: a bootstrap of stretches.

        What the effects explain, s = before - after, belongs to the design and stays as it is (a clip acts in a few
        stretches only, and is measured none the less); before^2 = s^2 + (2 before after - after^2), and the bracket is
        drawn anew.
        """
        before, after, count = self.before_nT[self.counted], after_nT[self.counted], self._count
        groups = np.array_split(np.arange(len(before)), min(40, len(before)))
        parts = (2.0 * before * after - after**2, after**2)
        sums = np.array([[*(np.sum(part[g]) for part in parts), np.sum(count[g])] for g in groups])
        rng = np.random.default_rng(len(self.before_nT))
        drawn = sums[rng.integers(0, len(sums), size=(DRAWS, len(sums)))].sum(axis=1)
        explained = float(np.sum((before - after) ** 2) / count.sum())
        return explained + drawn[:, 0] / drawn[:, 2], drawn[:, 1] / drawn[:, 2]

    def _by_axis(self, residual_nT: FloatArray) -> list[float]:
        """rms along each body axis of residuals (N, 3)."""
        counted = residual_nT[self.counted]
        if self.axes is None:
            return [float(np.sqrt(np.mean(component**2))) for component in counted.T]
        share = self.axes.turn[self.counted] ** 2 * self.axes.measured[self.counted][:, :, None]
        energy = np.einsum("nki,nk->i", share, counted**2)
        return [float(value) for value in np.sqrt(energy / np.maximum(share.sum(axis=(0, 1)), 1e-300))]


def predict_blocks(problem: Problem, whitener: Whitens, kept: BoolArray, noise_nT: float, *fits: _Fit) -> Prediction:
    """Each block predicted from the others, by the fit before and by that after; where one part of the record does not
    determine another, the residuals of the fits themselves.

    kept (N,): rows that are not cut. noise_nT: rms per component of noise and attitude error.
    """
    seconds, known = problem.setting.seconds, kept.copy()
    plain, white = ([tuple(map(turned, fit)) for fit in fits] for turned in (problem.in_row_axes, whitener.apply))
    predicted, variance = [residual_nT.copy() for residual_nT, _ in plain], np.zeros((2, len(seconds)))
    place = np.cumsum(kept) - 1
    block = np.clip(np.floor(place * BLOCKS / max(int(kept.sum()), 1)), 0, BLOCKS - 1)
    guard = min(SLOW_S, 0.02 * float(seconds[-1] - seconds[0]))
    for number in range(BLOCKS):
        held = block == number
        start, end = seconds[held].min() - guard, seconds[held].max() + guard
        train = kept & ~((seconds >= start) & (seconds <= end))
        for of, ((residual_nT, columns_nT), (residual, columns)) in enumerate(zip(plain, white, strict=True)):
            theta, root = _solve(residual[train], columns[train])
            predicted[of][held] = residual_nT[held] - columns_nT[held] @ theta
            variance[of, held] = np.sum((columns_nT[held] @ root) ** 2, axis=(1, 2))
        known[held] &= float(np.mean(variance[1, held]) / 3.0) < noise_nT**2
    about = (noise_nT, noise_nT)
    if 2 * known.sum() < kept.sum():
        # Fitted once more: a waveform with columns of its own still stands in the residual.
        sizes = [_solve(residual[kept], columns[kept])[0] for residual, columns in white]
        fitted = [rest_nT - columns_nT @ size for (rest_nT, columns_nT), size in zip(plain, sizes, strict=True)]
        return Prediction(fitted[0], fitted[1], kept, *about, "fit", problem.axes)
    unsure_nT = np.sqrt(variance[:, known].sum(axis=1) / problem.measured[known].sum())
    of_both = (float(unsure_nT[0]), float(unsure_nT[1]))
    return Prediction(predicted[0], predicted[1], known, *about, axes=problem.axes, unsure_nT=of_both)


def one_step(
    residual_nT: FloatArray,
    seconds: FloatArray,
    kept: BoolArray,
    rate: float,
    noise_nT: float,
    axes: RowAxes | None = None,
) -> tuple[FloatArray, float]:
    """Residual (N, 3) with each row's bias predicted from the rows before it, and how unsure the prediction is [nT].

    rate: of the walk, nT/sqrt(s); noise_nT: of a reading. The Kalman filter of a local level (Harvey 1989, section
    2.2), from an unknown level; its second row is the first that is predicted. axes: where some components only are
    measured, in the rows' own axes.
    """
    left, level, P = residual_nT.copy(), np.zeros(3), _DIFFUSE * noise_nT**2 * np.eye(3)
    unsure = []
    for row, since in enumerate(np.diff(seconds, prepend=seconds[0])):
        P = P + rate**2 * since * np.eye(3)
        measured = slice(None) if axes is None else axes.measured[row]
        H = np.eye(3) if axes is None else axes.turn[row][measured]
        left[row, measured] -= H @ level
        if not kept[row] or not len(H):
            continue
        spread = H @ P @ H.T
        mean = float(np.trace(spread)) / len(H)
        if mean < np.sqrt(_DIFFUSE) * noise_nT**2:
            unsure.append(mean)
        gain = np.linalg.solve(spread + noise_nT**2 * np.eye(len(H)), H @ P).T
        level = level + gain @ left[row, measured]
        P = P - gain @ H @ P
    return left, float(np.sqrt(np.mean(unsure))) if unsure else 0.0


def closed_share(
    before: float, after: float, floor: float, floor_with_effects: float, before2: FloatArray, after2: FloatArray
) -> tuple[float, tuple[float, float]]:
    """1 - max(after^2 - floor_with_effects^2, 0) / (before^2 - floor^2), within 0 and 1, and its 90 % interval.

    before, after: rms; before2, after2: (draws,) mean squares of a bootstrap.
    """
    below = np.append(before2, before**2) - floor**2
    beyond = np.maximum(np.append(after2, after**2) - floor_with_effects**2, 0.0)
    shares = np.where(below > 0.0, np.clip(1.0 - beyond / np.where(below > 0.0, below, 1.0), 0.0, 1.0), 0.0)
    closed = float(shares[-1])
    low, high = np.percentile(shares[:-1], [5.0, 95.0])
    return closed, (min(float(low), closed), max(float(high), closed))


def floor_rms_nT(
    field_nT: FloatArray, sigma_nT: float, theta_rad: float, measured: BoolArray | None = None, roll: Roll = ALIKE
) -> float:
    """rms per component that white noise and an attitude error theta per axis leave: theta x B has two components.

    field_nT (N, 3) that the error acts on; measured (N, 3), in the same axes: components that count, default all.
    roll: how the error differs from axis to axis.
    """
    reached = np.sum(field_nT**2, axis=1)[:, None] - field_nT**2
    if roll.factor != 1.0:
        reached = np.sum((turn_images(field_nT) @ roll.turns) ** 2, axis=2)
    mean = np.mean(reached if measured is None else reached[measured])
    return float(np.sqrt(sigma_nT**2 + theta_rad**2 * mean))


def _solve(y: FloatArray, x: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Least squares of y (n, 3) on x (n, 3, P), both of unit noise, by the scaled Gram matrix: estimate (P,) and a root
    (P, P) of its covariance. Directions that say nothing get zero, and a covariance that is as good as infinite."""
    if x.shape[2] == 0:
        return np.zeros(0), np.zeros((0, 0))
    flat = x.reshape(-1, x.shape[2])
    size = np.sqrt(np.mean(flat**2, axis=0))
    scale = np.where(size > 0, size, 1.0) * np.sqrt(len(flat))
    values, vectors = np.linalg.eigh((flat.T @ flat) / np.outer(scale, scale))
    least = 1e-12 * values[-1]  # rounding of the Gram matrix
    identifiable = values > least
    moment = vectors[:, identifiable].T @ ((flat.T @ y.reshape(-1)) / scale)
    root = vectors / np.sqrt(np.maximum(values, least)) / scale[:, None]
    return np.asarray((vectors[:, identifiable] @ (moment / values[identifiable])) / scale), np.asarray(root)
