"""Whether what is left is what the budget gives: its size, its outliers, and what was assumed where nothing was declared."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.stats import norm, poisson

from fluxtwin.gap.detectors.flexible import FlexibleFinding
from fluxtwin.gap.held_out.held_out import floor_rms_nT
from fluxtwin.gap.noise.budget import DECLARED, complete_budget
from fluxtwin.gap.noise.choice import NoiseModel, RobustRows
from fluxtwin.gap.noise.robust_rows import CUT_SIGMA
from fluxtwin.gap.problem.problem import Budget, Problem
from fluxtwin.sim.earth import epoch

if TYPE_CHECKING:
    from fluxtwin.gap.report.work import Work

_ATTITUDE_TRUST = 1.5
"""Factor to which a declared attitude error is believed; `noise_budget` has the same as a prior."""
_NOISE_TRUST = 1.2  # two standard deviations of the prior of declared noise
_LEAST_SPREAD = 0.05  # of the logarithm of the rms that is left, however many rows
_RARE = 1e-3  # probability of so many outliers by chance from which on they are a finding
_FLAGS = {
    "noise_nT": "--noise-nT",
    "lsb_nT": "--lsb-nT",
    "attitude_sigma_deg": "--attitude-sigma-deg",
    "attitude_tau_s": "--attitude-tau-s",
}


@dataclass(frozen=True)
class Excess:
    """More than the budget gives."""

    stage: str
    words: str


def left_in_fit_nT(work: Work) -> float:
    """rms per component of what the fit leaves, over the readings that are not cut [nT]."""
    problem = work.problem
    rest = problem.judged(work.found.residual_nT)[problem.measured & ~work.robust.cut]
    return float(np.sqrt(np.mean(rest**2))) if rest.size else 0.0


def beyond_budget(work: Work) -> Excess | None:
    """More left in the fit than the declared noise and attitude error give, as far as they are trusted, or None.

    Held-out figures are no measure of this: right answers may be at 1.6 of what is expected there.
    """
    declared, noise, problem = work.problem.budget, work.noise, work.problem
    left_nT = left_in_fit_nT(work)
    theta_rad = declared.attitude_sigma_rad
    if theta_rad is not None and declared.noise_nT is not None and not _has_own_shape(work):
        white_nT = _NOISE_TRUST * noise.sigma_prior_nT
        kept = ~np.any(work.robust.cut, axis=1)
        field, measured = problem.noise_field_nT[kept], problem.measured[kept]
        most_nT = floor_rms_nT(field, white_nT, _ATTITUDE_TRUST * theta_rad, measured)
        spread = np.hypot(_LEAST_SPREAD, noise.theta_log_sd if np.isfinite(noise.theta_log_sd) else 0.0)
        if left_nT > most_nT * np.exp(3.0 * spread):
            return _too_much(work, left_nT, floor_rms_nT(field, noise.sigma_prior_nT, theta_rad, measured))
    return None if work.loud is None else Excess("sensor", work.loud)


def _has_own_shape(work: Work) -> bool:
    """Whether a cause is named that stays in the residual: noise, steps, a walk, a line."""
    return bool(work.flexible)


def _too_much(work: Work, left_nT: float, expected_nT: float) -> Excess:
    noise, declared_rad = work.noise, work.problem.budget.attitude_sigma_rad or 0.0
    tail = f"{left_nT:.1f} nT rms are left in the fit where {expected_nT:.1f} nT were expected"
    if noise.theta_rad > declared_rad:
        memory = "white" if noise.tau_s <= 0.0 else f"with a memory of {float(f'{noise.tau_s:.2g}'):g} s"
        errs = f"the reported attitude errs by {np.degrees(noise.theta_rad):.2g} deg per axis, {memory}, where "
        return Excess("attitude", f"{errs}{np.degrees(declared_rad):.2g} deg was declared: {tail}")
    return Excess("sensor", tail)


def outliers(problem: Problem, robust: RobustRows, explained: bool) -> Excess | None:
    """Readings that were set aside, where noise does not give as many, or None; explained: as bit errors."""
    count = robust.components_cut
    by_chance = 2.0 * float(norm.sf(CUT_SIGMA)) * float(problem.measured.sum())
    if explained or count == 0 or poisson.sf(count - 1, by_chance) > _RARE:
        return None
    return Excess("telemetry", outlier_words(problem, robust))


def outlier_words(problem: Problem, robust: RobustRows) -> str:
    """How many readings were set aside, when, and whether in runs."""
    rows = np.flatnonzero(robust.cut.any(axis=1))
    runs = 1 + int((np.diff(rows) > 1).sum())
    times = [epoch.iso(problem.time[row]) for row in (rows[0], rows[-1])]
    when = f"at {times[0]}" if rows.size == 1 else f"from {times[0]} to {times[1]}"
    together = f" in {runs} runs" if rows.size > 1.5 * runs else ""
    are = "row has an outlier" if rows.size == 1 else f"rows have outliers{together}"
    return f"{rows.size} {are} of more than six sigma, {when}, and {'is' if rows.size == 1 else 'are'} set aside"


def assumed(budget: Budget, problem: Problem, noise: NoiseModel) -> dict[str, dict[str, Any]]:
    """The noise that the answer rests on, by name: value, source (`declared`, `scenario` or `found`) and its flag.

    budget: as given; noise: as found. Without the attitude's where no row has one.
    """
    complete = complete_budget(problem)
    found = {
        "noise_nT": complete.noise_nT,
        "lsb_nT": complete.lsb_nT,
        "attitude_sigma_deg": float(np.degrees(noise.theta_rad)),
        "attitude_tau_s": noise.tau_s,
    }
    given = {
        "noise_nT": budget.noise_nT,
        "lsb_nT": budget.lsb_nT,
        "attitude_sigma_deg": None
        if budget.attitude_sigma_rad is None
        else float(np.degrees(budget.attitude_sigma_rad)),
        "attitude_tau_s": budget.attitude_tau_s,
    }
    sources = budget.sources or {}
    return {
        name: {
            "value": found[name] if value is None else value,
            "source": "found" if value is None else "scenario" if sources.get(name) == "scenario" else DECLARED,
            "flag": _FLAGS[name],
        }
        for name, value in given.items()
        if not name.startswith("attitude") or problem.noise_image_nT.any()
    }


def assumed_words(values: Mapping[str, Mapping[str, Any]]) -> str:
    """What was not declared, what was taken in its place, and the flags that would settle it; empty where all was declared.

    The time constant of the attitude error is left to the data even where its size is declared.
    """
    missing = {name for name, one in values.items() if one["source"] == "found" and name != "attitude_tau_s"}
    if not missing:
        return ""
    parts = []
    if "noise_nT" in missing:
        parts.append(f"noise {values['noise_nT']['value']:.3g} nT")
    if "lsb_nT" in missing:
        step = values["lsb_nT"]["value"]
        parts.append("no rounding" if not step else f"a step of {step:.3g} nT")
    if "attitude_sigma_deg" in missing:
        size, tau = values["attitude_sigma_deg"]["value"], values["attitude_tau_s"]["value"]
        memory = f" over {float(f'{tau:.2g}'):g} s" if tau else ", white"
        parts.append(f"an attitude error of {size:.2g} deg{memory if size else ''}")
    listed = parts[0] if len(parts) == 1 else f"{', '.join(parts[:-1])} and {parts[-1]}"
    flags = ", ".join(values[name]["flag"] for name in values if name in missing)
    return f"Not declared, so found in these data: {listed} ({flags})."


def confirmed_bits(findings: tuple[FlexibleFinding, ...]) -> bool:
    """Whether outliers are named as bit errors."""
    return any(one.confirmed and one.effect == "bit_errors" for one in findings)
