"""Whether the residual is what the budget gives: its size, its outliers, and what was assumed where nothing was declared."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.stats import norm, poisson

from fluxtwin.gap.held_out.held_out import floor_rms_nT
from fluxtwin.gap.noise.budget import DECLARED, complete_budget, prior_of
from fluxtwin.gap.noise.choice import NoiseModel, RobustRows
from fluxtwin.gap.noise.robust_rows import CUT_SIGMA
from fluxtwin.gap.posterior.explanations import Answer, signals_of
from fluxtwin.gap.problem.problem import Budget, Problem
from fluxtwin.gap.report import words
from fluxtwin.gap.selection.criterion import GATE, SHAPE_ERROR

_LEAST_SPREAD = 0.05
"""Standard deviation of the logarithm of the rms, however many rows: structure that nobody looks for is in any record."""


@dataclass(frozen=True)
class Excess:
    """More than the budget gives."""

    stage: str
    words: str


def residual_rms_nT(problem: Problem, answer: Answer) -> float:
    """rms per component of the residual of the fit, over the readings that are not cut [nT]."""
    rest = problem.in_row_axes(answer.result.residual_nT)[problem.measured & ~answer.robust.cut]
    return float(np.sqrt(np.mean(rest**2))) if rest.size else 0.0


def shape_nT(problem: Problem, answer: Answer) -> float | None:
    """What named causes may leave because nature's form is not theirs, rms per component [nT]; None where what is left is
    something unknown."""
    result = answer.result
    if answer.left.structured and (not result.named or answer.known < 0.5):
        return None
    if not answer.left.structured and not answer.shapes:
        return 0.0
    rest_nT = problem.residual_of([*result.modelled, *result.chosen, *signals_of(answer.shapes)])
    signal_nT = problem.in_row_axes(result.residual_alone_nT - rest_nT)[problem.measured]
    return SHAPE_ERROR * float(np.sqrt(np.mean(signal_nT**2)))


def beyond_budget(problem: Problem, answer: Answer) -> Excess | None:
    """A residual larger than the declared noise and attitude error give, or None: by three standard deviations beyond
    what they are at the most, two standard deviations of the prior of the noise, one of the attitude error's.

    Held-out figures are no measure of this: right answers may be at 1.6 of what is expected there.
    """
    declared, noise = problem.budget, answer.noise
    if declared.attitude_sigma_rad is None or declared.noise_nT is None:
        return None
    kept = ~answer.robust.cut.any(axis=1)
    field_nT, measured = problem.noise_field_nT[kept], problem.measured[kept]

    def expected_nT(noise_trust: float, attitude_trust: float) -> float:
        theta_rad = attitude_trust * (declared.attitude_sigma_rad or 0.0)
        return floor_rms_nT(field_nT, noise_trust * noise.sigma_prior_nT, theta_rad, measured)

    prior = prior_of(complete_budget(problem))
    most_nT = expected_nT(float(np.exp(2.0 * prior.sigma_log_sd)), float(np.exp(prior.theta_log_sd)))
    found_nT = residual_rms_nT(problem, answer)
    spread = np.hypot(_LEAST_SPREAD, noise.theta_log_sd if np.isfinite(noise.theta_log_sd) else 0.0)
    if found_nT <= most_nT * np.exp(3.0 * spread):
        return None
    said = f"the residual of the fit is {found_nT:.1f} nT rms, where {expected_nT(1.0, 1.0):.1f} nT were expected"
    whiter = noise.white_rms_nT**2 - noise.sigma_prior_nT**2
    turned = [floor_rms_nT(field_nT, 0.0, rad, measured) ** 2 for rad in (noise.theta_rad, declared.attitude_sigma_rad)]
    if turned[0] - turned[1] <= whiter:
        return Excess("sensor", said)
    return Excess("attitude", f"{words.attitude_error(noise, declared.attitude_sigma_rad)}: {said}")


def outliers(problem: Problem, robust: RobustRows) -> Excess | None:
    """Readings that were set aside, where noise does not give as many, or None."""
    count = robust.components_cut
    by_chance = 2.0 * float(norm.sf(CUT_SIGMA)) * float(problem.measured.sum())
    if count == 0 or poisson.sf(count - 1, by_chance) > GATE:
        return None
    return Excess("telemetry", words.outliers(problem.time, robust.cut))


def assumed(budget: Budget, problem: Problem, noise: NoiseModel) -> dict[str, dict[str, Any]]:
    """The noise that the answer rests on, by name: value, source (`declared`, `scenario` or `found`) and its flag.

    budget: as given; noise: as found. Without the attitude's where no row has one.
    """
    complete, sources = complete_budget(problem), budget.sources or {}
    declared_deg = None if budget.attitude_sigma_rad is None else float(np.degrees(budget.attitude_sigma_rad))
    rounding_nT = (complete.lsb_nT or 0.0) / np.sqrt(12.0)
    pairs = {  # as given, and as found
        "noise_nT": (budget.noise_nT, float(np.sqrt(max(noise.sigma_nT**2 - rounding_nT**2, 0.0)))),
        "lsb_nT": (budget.lsb_nT, complete.lsb_nT),
        "attitude_sigma_deg": (declared_deg, float(np.degrees(noise.theta_rad))),
        "attitude_tau_s": (budget.attitude_tau_s, noise.tau_s),
    }
    return {
        name: {
            "value": found if given is None else given,
            "source": "found" if given is None else "scenario" if sources.get(name) == "scenario" else DECLARED,
            "flag": f"--{name.replace('_', '-')}",
        }
        for name, (given, found) in pairs.items()
        if not name.startswith("attitude") or problem.noise_image_nT.any()
    }
