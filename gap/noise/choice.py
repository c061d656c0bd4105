"""The noise of a problem: budget, model, outliers, whitening. The front door of the modules around it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from fluxtwin.gap.noise.budget import NoisePrior, prior_of
from fluxtwin.gap.noise.budget import complete_budget as complete_budget
from fluxtwin.gap.noise.reml import Choice, Data, Likelihood, best_noise
from fluxtwin.gap.noise.reml import Likely as Likely
from fluxtwin.gap.noise.reml import likely_noises as _likely_noises
from fluxtwin.gap.noise.robust_rows import RobustRows as RobustRows
from fluxtwin.gap.noise.robust_rows import first_weights, spike_weights
from fluxtwin.gap.noise.whitening import NoiseModel as NoiseModel
from fluxtwin.gap.noise.whitening import Whitener as Whitener
from fluxtwin.gap.noise.whitening import make_whitener
from fluxtwin.gap.problem.problem import Problem
from fluxtwin.gap.problem.row_axes import RowAxes
from fluxtwin.sim.base.types import BoolArray, FloatArray
from fluxtwin.sim.effects.chain import Active

_ROUNDS = 4  # of noise and spikes in turn; two settle all but records with many bit errors
_UNEVEN = 1.25  # axes whose white noise differs by more get a factor each: less costs at most 5 % (Kantorovich's bound)


class NoiseChoice(NamedTuple):
    """The noise model of a problem, and the readings that no model explains."""

    noise: NoiseModel
    robust: RobustRows


def choose_noise(
    problem: Problem, *columns: FloatArray, residual_nT: FloatArray | None = None, walk: float = 0.0
) -> NoiseChoice:
    """The noise model of a problem.

    columns: of the signal beside the problem's nuisance, (N, 3, P) each; residual_nT: (N, 3) about which they are linear, by
    default that of the problem; walk: rate of a bias that walks, over the white noise [1/sqrt(s)]. Restricted maximum
    likelihood with the budget as prior, in turn with the search for spikes.
    """
    residual_nT = problem.residual_nT if residual_nT is None else residual_nT
    return noise_of(problem, residual_nT, [problem.nuisance, *columns], walk)


def noise_of(
    problem: Problem, residual_nT: FloatArray, designs: Sequence[FloatArray], walk: float = 0.0
) -> NoiseChoice:
    """The noise model of a residual (N, 3) with these designs (N, 3, P) fitted, as in `select_noise`; in body axes."""
    where = (problem.noise_image_nT, problem.setting.seconds, problem.segment)
    prior, columns = prior_of(complete_budget(problem)), [problem.in_row_axes(design) for design in designs]
    return select_noise(problem.in_row_axes(residual_nT), columns, *where, prior, problem.axes, walk)


def noise_beside(problem: Problem, active: Sequence[Active]) -> NoiseChoice:
    """The noise model with these effects on, linear about them; the modelled ones, as refitted, are among them."""
    return choose_noise(problem, problem.derivatives(active), residual_nT=problem.residual_of(active))


def likely_noises(
    problem: Problem,
    whitener: Whitener,
    residual_nT: FloatArray,
    columns: FloatArray,
    walk: float = 0.0,
) -> list[Likely]:
    """Noise models all over what a residual (N, 3) with these columns (N, 3, C) fitted and the budget allow.

    whitener: with the noise model that was chosen; walk: as for `choose_noise`.
    """
    noise, prior = whitener.noise, prior_of(complete_budget(problem))
    where = (problem.noise_image_nT, problem.setting.seconds, problem.segment)
    weights = whitener.weights * np.square(noise.axis_factor)
    design = _affordable([problem.in_row_axes(columns)], int((weights > 0).sum()))
    data = Data(problem.in_row_axes(residual_nT), design, *where, weights, problem.axes)
    return _likely_noises(Likelihood(data, prior, noise.axis_factor, walk), noise)


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
    axes: RowAxes | None = None,
    walk: float = 0.0,
) -> NoiseChoice:
    """`choose_noise` on arrays: residual (N, 3), images of a turn (N, 3, 3), designs (N, 3, P) each (the first is the least
    that is fitted where there are too few rows for all), seconds, segment (N,); axes: those that all this is in,
    if not the body axes."""
    there = np.ones(residual_nT.shape, dtype=np.bool_) if axes is None else axes.measured
    design = _affordable(designs, int(there.sum()))
    if not image_nT.any():
        prior = replace(prior, theta_rad=0.0)  # nothing that an attitude error could act on
    weights = first_weights(residual_nT, design, there)
    factor = (1.0, 1.0, 1.0)
    choice: Choice | None = None
    difference = residual_nT
    for _ in range(_ROUNDS):
        data = Data(residual_nT, design, image_nT, seconds, segment, weights, axes)
        likelihood = Likelihood(data, prior, factor, walk)
        choice = best_noise(likelihood, None if choice is None else choice.noise)
        left = likelihood.left_nT(choice)
        again, difference = spike_weights(left, likelihood.whitener(choice.noise, weights, covariance=True), there)
        whitener = likelihood.whitener(choice.noise, again)
        uneven = _axis_factor(whitener, left, factor, np.asarray(there.all(axis=1), dtype=np.bool_))
        settled = np.array_equal(again <= 0, weights <= 0) and uneven == factor
        weights, factor = again, uneven
        if settled:
            break
    assert choice is not None
    return NoiseChoice(choice.noise, RobustRows(weights, difference, None if axes is None else there))


def _affordable(designs: Sequence[FloatArray], components: int) -> FloatArray:
    """All designs, or the first alone, or none, so that degrees of freedom are left."""
    for used in (designs, designs[:1]):
        if components >= 1.5 * sum(d.shape[2] for d in used) + 6:
            return np.concatenate(list(used), axis=2)
    return designs[0][:, :, :0]


def _axis_factor(
    whitener: Whitener, left_nT: FloatArray, now: tuple[float, float, float], whole: BoolArray
) -> tuple[float, float, float]:
    """White noise of each axis over the mean, from differences of neighbouring innovations: slow structure is none
    of its business. whole: rows in body axes. Unchanged where the axes agree, within a quarter or within chance."""
    white, weights = whitener.apply_in_row_axes(left_nT)[whole], whitener.weights[whole]
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
