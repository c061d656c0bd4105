"""The noise of a problem: budget, model, outliers, whitening. The front door of the modules around it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fluxtwin.gap.linear.span import Span, sketch, span_of
from fluxtwin.gap.noise.budget import NoisePrior, complete_budget, prior_of
from fluxtwin.gap.noise.reml import Choice, Likelihood, best_noise, least_share, noise_words, span_of_design
from fluxtwin.gap.noise.robust_rows import RobustRows, combine, first_weights, spike_weights, standing_out, weights_of
from fluxtwin.gap.noise.rows import LONGEST_MEAN_S, condensed, stretches
from fluxtwin.gap.noise.whitening import NoiseModel, Whitener, make_whitener
from fluxtwin.gap.problem.problem import Problem
from fluxtwin.sim.base.types import BoolArray, FloatArray

__all__ = [
    "NoiseChoice",
    "NoiseModel",
    "RobustRows",
    "Whitener",
    "choose_noise",
    "complete_budget",
    "make_whitener",
    "noise_choice",
    "select_noise",
    "whitener_of",
]

SEARCH_ROWS = 2_000
REFINE_ROWS = 3_000
_MOST_REFINE_ROWS = 8_000
_AFFORDED = 3e9  # rows times columns squared: where columns are few, more rows are taken
_ROUNDS = 4
_SKETCH = 3  # halves: rows of a sketch over columns
_ENOUGH = 4  # components a column: then single wrong ones stand out of the fit of all columns
_UNEVEN = 1.25  # axes whose white noise differs by more get a factor each


@dataclass(frozen=True, eq=False)
class NoiseChoice:
    """The noise model of a problem, and the readings that no model explains."""

    noise: NoiseModel
    robust: RobustRows


def choose_noise(problem: Problem, *columns: FloatArray) -> tuple[NoiseModel, RobustRows]:
    """The noise model of a problem, and the readings that no model explains; see `noise_choice`."""
    found = noise_choice(problem, *columns)
    return found.noise, found.robust


def noise_choice(problem: Problem, *columns: FloatArray, residual_nT: FloatArray | None = None) -> NoiseChoice:
    """The noise model of a problem.

    columns: of the signal beside the problem's nuisance, (N, 3, P) each; residual_nT: (N, 3) about which they are linear, by
    default that of the problem. Restricted maximum likelihood with the budget as prior, in turn with the search for spikes.
    """
    return _chosen(
        problem.judged(problem.residual_nT if residual_nT is None else residual_nT),
        [problem.judged(problem.nuisance), *(problem.judged(each) for each in columns)],
        problem.noise_image_nT,
        problem.setting.seconds,
        problem.segment,
        prior_of(complete_budget(problem)),
        None if problem.axes is None else problem.measured,
    )


def whitener_of(problem: Problem, noise: NoiseModel, weights: FloatArray | None) -> Whitener:
    """The whitening of a noise model on a problem's rows; takes columns in body axes."""
    seconds, segment = problem.setting.seconds, problem.segment
    return make_whitener(problem.noise_image_nT, seconds, segment, noise, weights, problem.axes)


def select_noise(
    residual_nT: FloatArray,
    designs: Sequence[FloatArray],
    image_nT: FloatArray,
    seconds: FloatArray,
    segment: FloatArray,
    prior: NoisePrior,
    measured: BoolArray | None = None,
) -> tuple[NoiseModel, RobustRows]:
    """`choose_noise` on arrays: residual (N, 3), images of a turn (N, 3, 3),
    designs (N, 3, P) each (the first is the least that is fitted
    where there are too few rows for all), seconds, segment (N,); measured (N, 3): components that there are, default
    all."""
    found = _chosen(residual_nT, designs, image_nT, seconds, segment, prior, measured)
    return found.noise, found.robust


def _chosen(
    residual_nT: FloatArray,
    designs: Sequence[FloatArray],
    image_nT: FloatArray,
    seconds: FloatArray,
    segment: FloatArray,
    prior: NoisePrior,
    measured: BoolArray | None,
) -> NoiseChoice:
    rows = seconds.size
    designs = _affordable(designs, rows, 3 * rows if measured is None else int(measured.sum()))
    designs = _independent(designs, stretches(rows, REFINE_ROWS), measured, least_share(prior))
    columns = sum(design.shape[2] for design in designs)
    limit = int(np.clip(_AFFORDED / max(columns, 1) ** 2, REFINE_ROWS, _MOST_REFINE_ROWS))
    basis = _Basis(designs, rows, measured, limit, least_share(prior))
    weights = basis.first_weights(residual_nT)
    whole = np.ones(rows, dtype=np.bool_) if measured is None else np.asarray(measured.all(axis=1), dtype=np.bool_)
    if not image_nT.any():
        prior = replace(prior, theta_rad=0.0)  # nothing that an attitude error could act on
    factor = (1.0, 1.0, 1.0)
    choice: Choice | None = None
    difference = residual_nT
    for _ in range(_ROUNDS):
        design = (residual_nT, designs, image_nT, seconds, segment, weights)
        if choice is None and rows > limit and 2.0 * np.median(np.diff(seconds)) <= LONGEST_MEAN_S:
            # How long a mean may be depends on the attitude error's memory.
            few = condensed(*design, SEARCH_ROWS, measured=measured)
            choice = best_noise(Likelihood(few, prior, factor))
        few = condensed(*design, limit, _longest_mean_s(choice), measured)
        likelihood = Likelihood(few, prior, factor, basis.of(weights) if rows <= limit else None)
        choice = best_noise(likelihood, None if choice is None else choice.noise)
        left = basis.left(residual_nT, weights, likelihood.coefficients(choice))
        again, difference = spike_weights(left, image_nT, seconds, segment, choice.noise, weights, measured)
        uneven = _axis_factor(make_whitener(image_nT, seconds, segment, choice.noise, again), left, factor, whole)
        settled = np.array_equal(again <= 0, weights <= 0) and uneven == factor
        weights, factor = again, uneven
        if settled:
            break
    assert choice is not None
    noise = replace(choice.noise, words=noise_words(choice.noise))
    robust = RobustRows(weights, difference, measured=measured)
    return NoiseChoice(noise, replace(robust, words=_spike_words(robust)))


class _Basis:
    """The orthonormal basis of a design on the components that are not cut, recomputed only when the cut changes."""

    def __init__(
        self, designs: Sequence[FloatArray], rows: int, measured: BoolArray | None, limit: int, share: float
    ) -> None:
        """limit: rows that the likelihood gets at most."""
        self.designs, self.rows, self.measured, self.limit, self.share = designs, rows, measured, limit, share
        self._cut: BoolArray | None = None
        self._known: tuple[Span, FloatArray] | None = None

    def of(self, weights: FloatArray) -> tuple[Span, FloatArray]:
        """Span and basis (N, 3, r) of all rows under weights (N, 3)."""
        if self._known is None or self._cut is None or not np.array_equal(self._cut, weights <= 0):
            self._cut = weights <= 0
            whole = np.concatenate(list(self.designs), axis=2)
            self._known = span_of_design(whole, weights > 0, self.designs[0].shape[2], self.share)
        return self._known

    def left(self, residual_nT: FloatArray, weights: FloatArray, coefficients: FloatArray) -> FloatArray:
        """(N, 3) what the design leaves: with the likelihood's coefficients, or, where it had fewer rows, by least
        squares on all of them (columns that some rows hardly show must not be carried to others)."""
        if self.rows <= self.limit:
            return residual_nT - combine(self.designs, coefficients)
        return self._plainly_left(residual_nT, weights)

    def _plainly_left(self, residual_nT: FloatArray, weights: FloatArray) -> FloatArray:
        span, basis = self.of(weights)
        y = np.where(weights > 0, residual_nT, 0.0).reshape(-1)
        along = basis.reshape(y.size, span.rank).T @ y
        if (weights > 0).all():
            return residual_nT - basis @ along
        columns = sum(design.shape[2] for design in self.designs)
        return residual_nT - combine(self.designs, span.coefficients(along, columns))

    def first_weights(self, residual_nT: FloatArray) -> FloatArray:
        """As `robust_rows.first_weights`; where least squares leaves nothing that stands out, at no further cost."""
        there = np.ones(residual_nT.shape, dtype=np.bool_) if self.measured is None else self.measured
        if self.measured is not None and there.sum() < _ENOUGH * sum(design.shape[2] for design in self.designs):
            # So many columns on one component a row would follow every spike.
            return first_weights(residual_nT, self.designs[:1], stretches(self.rows, REFINE_ROWS), self.measured)
        left = self._plainly_left(residual_nT, there.astype(float))
        weights = weights_of(standing_out(left, measured=self.measured), self.measured)
        if (weights > 0)[there].all():
            return there.astype(float)
        return first_weights(residual_nT, self.designs, stretches(self.rows, REFINE_ROWS), self.measured)


def _independent(
    designs: Sequence[FloatArray], rows: NDArray[np.intp], measured: BoolArray | None, share: float
) -> list[FloatArray]:
    """The first design, and of the others the columns that nothing else makes up on these rows."""
    first, columns = designs[0].shape[2], sum(design.shape[2] for design in designs)
    few = np.concatenate([_sketched(design, rows, measured, _SKETCH * columns // 2) for design in designs], axis=1)
    number = span_of(few, first, share).number
    picked, start = [], first
    for design in designs[1:]:
        here = number[(number >= start) & (number < start + design.shape[2])] - start
        picked.append(np.take(design.reshape(3 * design.shape[0], design.shape[2]), np.sort(here), axis=1))
        start += design.shape[2]
    if not picked:
        return [designs[0]]
    rest = np.concatenate(picked, axis=1)
    return [designs[0], rest.reshape(*designs[0].shape[:2], rest.shape[1])]


def _sketched(design: FloatArray, rows: NDArray[np.intp], measured: BoolArray | None, count: int) -> FloatArray:
    """(about `count`, P) random combinations of a design's measured rows, the same ones for every design."""
    there = design if rows.size == design.shape[0] else design[rows]
    if measured is not None:
        there = there * measured[rows][:, :, None]
    return sketch(there.reshape(3 * rows.size, design.shape[2]), count)


def _longest_mean_s(choice: Choice | None) -> float:
    """Means must be short beside the attitude error's memory, or so long that none is left: white is exact."""
    if choice is None or choice.noise.tau_s <= 0:
        return LONGEST_MEAN_S
    return min(choice.noise.tau_s / 5.0, LONGEST_MEAN_S)


def _affordable(designs: Sequence[FloatArray], rows: int, components: int) -> list[FloatArray]:
    """All designs, or the first alone, or none, so that degrees of freedom are left."""
    for used in (list(designs), list(designs[:1])):
        if components >= 1.5 * sum(d.shape[2] for d in used) + 6:
            return used
    return [np.zeros((rows, 3, 0))]


def _axis_factor(
    whitener: Whitener, left_nT: FloatArray, now: tuple[float, float, float], whole: BoolArray
) -> tuple[float, float, float]:
    """White noise of each axis over the mean, from differences of neighbouring innovations: slow structure is none
    of its business. whole: rows in body axes. Unchanged where the axes agree, within a quarter or within chance."""
    white, weights = whitener.apply(left_nT)[whole], whitener.weights[whole]
    step = np.where((weights[1:] > 0) & (weights[:-1] > 0), np.diff(white, axis=0), np.nan)
    count = np.isfinite(step).sum(axis=0)
    if count.min() < 20:
        return now
    size = np.sqrt(np.nanmean(np.square(step), axis=0))
    bar = max(_UNEVEN, 1.0 + 4.0 * np.sqrt(1.5 / count.min()))
    if size.max() <= bar * size.min():
        return now
    factor = np.asarray(now) * size
    factor = factor / np.exp(np.mean(np.log(factor)))
    return (float(factor[0]), float(factor[1]), float(factor[2]))


def _spike_words(robust: RobustRows) -> str:
    cut = robust.cut
    if not cut.any():
        return "no spikes"
    rows = int(cut.any(axis=1).sum())
    return f"{int(cut.sum())} components of {rows} rows stand more than six sigma out and are passed over"
