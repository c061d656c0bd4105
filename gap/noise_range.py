"""Noise models that the data do not rule out: a finding must hold with each of them.

On a short record a slow attitude error and a fast one can be told apart only roughly, and what looks like structure
to one is noise to the other. The p-value that holds whatever the nuisance is, is the largest over its confidence set
(Berger & Boos 1994, doi 10.1080/01621459.1994.10476836); the set is taken from the profile of the restricted
likelihood along the time constant.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from fluxtwin.gap.noise import SEARCH_ROWS, NoiseModel, RobustRows, complete_budget
from fluxtwin.gap.noise_budget import prior_of
from fluxtwin.gap.noise_rows import condensed
from fluxtwin.gap.problem import Problem
from fluxtwin.gap.reml import Choice, Likelihood, noise_words
from fluxtwin.sim.types import FloatArray

WITHIN = 3.3
"""Log likelihood below the best: half the 1 % point of chi-square with one degree of freedom."""
_TAUS_S = (30.0, 80.0, 200.0, 500.0, 1200.0)
_STEP = 1.25
_MOST_STEPS = 8


def plausible_noise(
    problem: Problem, saturated: FloatArray, noise: NoiseModel, robust: RobustRows
) -> tuple[NoiseModel, ...]:
    """Other noise models within the confidence set, at most three, that with the most slow noise first.

    saturated (N, 3, P): every column that may be in the signal, as for `choose_noise`. At each time constant the
    likeliest attitude error and the largest that is still inside.
    """
    budget = complete_budget(problem)
    design = (
        problem.residual_nT, [problem.nuisance, saturated], problem.field_B_nT, problem.setting.seconds,
        problem.segment, robust.weights,
    )  # fmt: skip
    likelihood = Likelihood(condensed(*design, SEARCH_ROWS), prior_of(budget), noise.axis_factor)
    start = max(noise.theta_rad, 0.2 * (budget.attitude_sigma_rad or 0.0)) * likelihood.field_nT / noise.sigma_nT
    start = start if start > 0 else 0.3
    best = likelihood.at(start, noise.tau_s)
    found = [best]
    for tau_s in _taus_s(budget.attitude_tau_s, problem.setting.seconds):
        found += _profile(likelihood, start, tau_s)
    top = max(one.log_posterior for one in found)
    inside = sorted((one for one in found if one.log_posterior > top - WITHIN), key=_slow_power, reverse=True)
    # The most slow noise explains most of what looks like structure; then the likeliest, then one between.
    likeliest = max(inside, key=lambda one: one.log_posterior)
    picked = list(dict.fromkeys([inside[0], likeliest, inside[len(inside) // 2]]))
    return tuple(
        replace(one.noise, words=noise_words(one.noise), sigma_prior_nT=noise.sigma_prior_nT) for one in picked
    )


def _slow_power(one: Choice) -> float:
    """Of the attitude error's spectrum at zero frequency, but for a constant (rows a second apart, if white)."""
    return one.noise.theta_rad**2 * max(one.noise.tau_s, 1.0)


def _taus_s(declared_s: float | None, seconds: FloatArray) -> list[float]:
    if declared_s is not None:
        return [declared_s * factor for factor in (0.5, 1.0, 2.0)] if declared_s > 0 else [0.0]
    spacing = float(np.median(np.diff(seconds))) if seconds.size > 1 else 1.0
    return [0.0, *(tau for tau in _TAUS_S if tau > 0.5 * spacing)]


def _profile(likelihood: Likelihood, start: float, tau_s: float) -> list[Choice]:
    """The likeliest at a time constant, and the largest attitude error that is not much less likely."""
    best, ratio = likelihood.at(start, tau_s), start
    for factor in (_STEP, 1.0 / _STEP):
        moved = False
        for _ in range(_MOST_STEPS):
            there = likelihood.at(ratio * factor, tau_s)
            if there.log_posterior <= best.log_posterior:
                break
            best, ratio, moved = there, ratio * factor, True
        if moved:
            break
    largest = best
    for _ in range(_MOST_STEPS):
        ratio *= _STEP
        there = likelihood.at(ratio, tau_s)
        if there.log_posterior < best.log_posterior - 0.5 * WITHIN:
            break
        largest = there
    return [best] if largest is best else [best, largest]
