"""The noise of a problem: budget, model, spoilt readings, whitening. The front door of the modules around it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from fluxtwin.gap.noise_budget import NoisePrior, complete_budget, prior_of
from fluxtwin.gap.noise_rows import LONGEST_MEAN_S, condensed, stretches
from fluxtwin.gap.problem import Problem
from fluxtwin.gap.reml import Choice, Likelihood, best_noise, noise_words
from fluxtwin.gap.robust_rows import RobustRows, combine, first_weights, spike_weights
from fluxtwin.gap.whitening import NoiseModel, Whitener, make_whitener
from fluxtwin.sim.types import FloatArray

__all__ = ["NoiseModel", "RobustRows", "Whitener", "choose_noise", "complete_budget", "make_whitener", "select_noise"]

SEARCH_ROWS = 2_000
REFINE_ROWS = 8_000
_ROUNDS = 4
_UNEVEN = 1.25  # axes whose white noise differs by more get a factor each


def choose_noise(problem: Problem, saturated: FloatArray) -> tuple[NoiseModel, RobustRows]:
    """The noise model of a problem, and the readings that no model explains.

    saturated (N, 3, P): every column that may be in the signal; the problem's nuisance is added. Restricted maximum
    likelihood with the budget as prior, in turn with the search for spikes.
    """
    return select_noise(
        problem.residual_nT,
        [problem.nuisance, saturated],
        problem.field_B_nT,
        problem.setting.seconds,
        problem.segment,
        prior_of(complete_budget(problem)),
    )


def select_noise(
    residual_nT: FloatArray,
    designs: Sequence[FloatArray],
    field_B_nT: FloatArray,
    seconds: FloatArray,
    segment: FloatArray,
    prior: NoisePrior,
) -> tuple[NoiseModel, RobustRows]:
    """`choose_noise` on arrays: residual, field (N, 3), designs (N, 3, P) each (the first is the least that is fitted
    where there are too few rows for all), seconds, segment (N,)."""
    rows = seconds.size
    designs = _affordable(designs, rows)
    weights = first_weights(residual_nT, designs, stretches(rows, REFINE_ROWS))
    factor = (1.0, 1.0, 1.0)
    choice: Choice | None = None
    difference = residual_nT
    for _ in range(_ROUNDS):
        design = (residual_nT, designs, field_B_nT, seconds, segment, weights)
        if choice is None and rows > SEARCH_ROWS:
            choice = best_noise(Likelihood(condensed(*design, SEARCH_ROWS), prior, factor))
        likelihood = Likelihood(condensed(*design, REFINE_ROWS, _longest_mean_s(choice)), prior, factor)
        choice = best_noise(likelihood, None if choice is None else choice.noise)
        left = residual_nT - combine(designs, choice.coefficients)
        again, difference = spike_weights(left, field_B_nT, seconds, segment, choice.noise, weights)
        uneven = _axis_factor(make_whitener(field_B_nT, seconds, segment, choice.noise, again), left, factor)
        settled = np.array_equal(again <= 0, weights <= 0) and uneven == factor
        weights, factor = again, uneven
        if settled:
            break
    assert choice is not None
    noise = replace(choice.noise, words=noise_words(choice.noise))
    return noise, RobustRows(weights, difference, _spike_words(weights))


def _longest_mean_s(choice: Choice | None) -> float:
    """Means must be short beside the attitude error's memory, or so long that none is left: white is exact."""
    if choice is None or choice.noise.tau_s <= 0:
        return LONGEST_MEAN_S
    return min(choice.noise.tau_s / 5.0, LONGEST_MEAN_S)


def _affordable(designs: Sequence[FloatArray], rows: int) -> list[FloatArray]:
    """All designs, or the first alone, or none, so that degrees of freedom are left."""
    for used in (list(designs), list(designs[:1])):
        if 3 * rows >= 1.5 * sum(d.shape[2] for d in used) + 6:
            return used
    return [np.zeros((rows, 3, 0))]


def _axis_factor(
    whitener: Whitener, left_nT: FloatArray, now: tuple[float, float, float]
) -> tuple[float, float, float]:
    """White noise of each axis over the mean, from differences of neighbouring innovations: slow structure is none
    of its business. Unchanged where the axes agree, within a quarter or within chance."""
    white = whitener.apply(left_nT)
    step = np.where((whitener.weights[1:] > 0) & (whitener.weights[:-1] > 0), np.diff(white, axis=0), np.nan)
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


def _spike_words(weights: FloatArray) -> str:
    cut = weights <= 0
    if not cut.any():
        return "no spikes"
    rows = int(cut.any(axis=1).sum())
    return f"{int(cut.sum())} components of {rows} rows stand more than six sigma out and are passed over"
