"""Noise models that the data do not rule out: a finding must hold with each of them.

On a short record a slow attitude error and a fast one can be told apart only roughly, and what looks like structure
to one is noise to the other. The p-value that holds whatever the nuisance is, is the largest over its confidence set
(Berger & Boos 1994, doi 10.1080/01621459.1994.10476836); the set is taken from the profile of the restricted
likelihood along the time constant.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from fluxtwin.gap.noise import NoiseChoice, NoiseModel, complete_budget
from fluxtwin.gap.problem import Problem
from fluxtwin.gap.reml import RIDGE, Choice, Likelihood, Ridge, likeliest_ratio, noise_words
from fluxtwin.sim.base.types import FloatArray

WITHIN = 5.4
"""Log likelihood below the best: half the 1 % point of chi-square with one degree of freedom."""
_TAUS_S = (30.0, 80.0, 200.0, 500.0, 1200.0)
_SHORTEST_S = 10.0  # below this a memory changes little
_BESIDE = 0.3  # in log time constant: so far beyond known ones a parabola is trusted
_TRIES = 4


def plausible_noise(problem: Problem, chosen: NoiseChoice) -> tuple[NoiseModel, ...]:
    """Other noise models within the confidence set, at most three, that with the most slow noise first.

    At each time constant the likeliest attitude error and the largest that is still inside.
    """
    if not problem.noise_image_nT.any():
        return ()  # no attitude error reaches these rows
    budget, noise, likelihood = complete_budget(problem), chosen.noise, chosen.likelihood
    start = max(noise.theta_rad, 0.2 * (budget.attitude_sigma_rad or 0.0)) * likelihood.field_nT / noise.sigma_nT
    ridge = likelihood.latest or likelihood.ridge(start if start > 0 else 0.3, max(noise.tau_s, _SHORTEST_S))
    found = _profiles(ridge, _taus_s(budget.attitude_tau_s, problem.setting.seconds))
    top = max([_posterior(one) for one in found] + [_posterior(one) for one in ridge.known.values()])
    # The most slow noise explains most of what looks like structure; then the likeliest, then one between.
    inside = sorted((p for p in found if p.log_posterior > top - WITHIN), key=_slow_power, reverse=True)
    likeliest = max(ridge.known.values(), key=_posterior)
    picked = [_first_inside(likelihood, inside, top), likeliest]
    picked.append(_first_inside(likelihood, inside[len(inside) // 2 :], top))
    known = (noise.theta_rad / noise.sigma_nT, noise.tau_s)
    distinct = [
        one
        for one in dict.fromkeys(picked)
        if one is not None and not np.allclose((one.noise.theta_rad / one.noise.sigma_nT, one.noise.tau_s), known)
    ]
    return tuple(
        replace(one.noise, words=noise_words(one.noise), sigma_prior_nT=noise.sigma_prior_nT) for one in distinct
    )


@dataclass(frozen=True)
class _Point:
    """A noise model with its log posterior as a parabola has it."""

    ratio: float
    tau_s: float
    log_posterior: float


def _profiles(ridge: Ridge, taus_s: list[float]) -> list[_Point]:
    """At each time constant the likeliest attitude error, and the largest that is half of `WITHIN` less likely."""
    likelihood, found = ridge.likelihood, []
    for tau_s in taus_s:
        second = ridge.second
        if tau_s > 0:
            log_tau = float(np.log(tau_s))
            if not min(ridge.known) - _BESIDE < log_tau < max(ridge.known) + _BESIDE:
                ridge.at(log_tau)
            log_ratio, posterior = ridge.between(log_tau)
        else:
            nearest = ridge.known[min(ridge.known)]
            guess = likelihood.point(nearest.noise)[0] * (_SHORTEST_S / max(nearest.noise.tau_s, _SHORTEST_S)) ** RIDGE
            if _posterior(likelihood.at(guess, 0.0)) < _posterior(nearest) - 3.0 * WITHIN:
                continue
            best, second = likeliest_ratio(likelihood, guess, 0.0)
            log_ratio, posterior = float(np.log(likelihood.point(best.noise)[0])), _posterior(best)
        farther = float(np.sqrt(WITHIN / max(-second, 0.5)))
        found.append(_Point(float(np.exp(log_ratio)), tau_s, posterior))
        found.append(_Point(float(np.exp(log_ratio + farther)), tau_s, posterior - 0.5 * WITHIN))
    return found


def _first_inside(likelihood: Likelihood, ordered: list[_Point], top: float) -> Choice | None:
    """The first of these that the likelihood itself has inside."""
    for one in ordered[:_TRIES]:
        there = likelihood.at(one.ratio, one.tau_s)
        if there.log_posterior > top - WITHIN:
            return there
    return None


def _posterior(one: Choice | _Point) -> float:
    return one.log_posterior


def _slow_power(one: _Point) -> float:
    """Of the attitude error's spectrum at zero frequency, but for a constant (rows a second apart, if white)."""
    return one.ratio**2 * max(one.tau_s, 1.0)


def _taus_s(declared_s: float | None, seconds: FloatArray) -> list[float]:
    if declared_s is not None:
        return [declared_s * factor for factor in (0.5, 1.0, 2.0)] if declared_s > 0 else [0.0]
    spacing = float(np.median(np.diff(seconds))) if seconds.size > 1 else 1.0
    return [0.0, *(tau for tau in _TAUS_S if tau > 0.5 * spacing)]
