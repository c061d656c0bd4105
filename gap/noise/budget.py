"""What is known of the noise before the fit: declared, or estimated from the readings themselves."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fluxtwin.calib.common.robust import MAD_TO_SIGMA
from fluxtwin.gap.problem.problem import Budget, Problem
from fluxtwin.sim.base.types import FloatArray

DECLARED = "declared"
FROM_SPACING = "estimated from the spacing of the readings"
FROM_DIFFERENCES = "estimated from short differences"
NOT_KNOWN = "not known"

NOISE_LOG_SD = 0.1
"""The declared noise is trusted to 10 %: data sheets give two digits."""
ATTITUDE_LOG_SD = 0.4
"""The declared attitude error is trusted to a factor 1.5: requirements are round numbers, and met with margin."""
TAU_LOG_SD = 0.5
"""A declared time constant is one number for a spectrum."""
USUAL_TAU_S, _USUAL_TAU_LOG_SD = 100.0, 1.5
"""Undeclared: from a sensor's own noise, some seconds, to ten minutes of an attitude filter, at 1.3 standard deviations."""
_WIDE_LOG_SD = 0.7
"""Noise that was estimated from differences: a factor two either way, as it takes all fast errors for noise."""
_LEAST_NOISE_nT = 1e-3
"""What a noise-free, unrounded simulation is held to have: the last decimal of a written reading."""


@dataclass(frozen=True)
class NoisePrior:
    """Normal priors of the logarithms; None where nothing is known."""

    sigma_nT: float
    """White noise of a reading with rounding, 1 sigma per axis."""
    sigma_log_sd: float
    theta_rad: float | None = None
    theta_log_sd: float = ATTITUDE_LOG_SD
    tau_s: float | None = None
    """Declared time constant; None leaves it to the data, white included."""

    def log_density(self, sigma_nT: float, theta_rad: float, tau_s: float) -> float:
        """Log of the prior at a point, without its constant; a theta or tau of zero has the peak's."""
        total = (np.log(sigma_nT / self.sigma_nT) / self.sigma_log_sd) ** 2
        if self.theta_rad and theta_rad > 0:
            total += (np.log(theta_rad / self.theta_rad) / self.theta_log_sd) ** 2
        usual_s, log_sd = (USUAL_TAU_S, _USUAL_TAU_LOG_SD) if self.tau_s is None else (self.tau_s, TAU_LOG_SD)
        if tau_s > 0 and usual_s:
            total += (np.log(tau_s / usual_s) / log_sd) ** 2
        return -0.5 * float(total)


def complete_budget(problem: Problem) -> Budget:
    """The budget of a problem with what was not declared filled in from the readings; `sources` says which.

    The LSB comes from the spacing of the readings, the noise from short differences of the residual along the
    field, where the attitude error does not reach. The attitude error stays None if it was not declared.
    """
    given = problem.budget
    sources = dict(given.sources or {})
    lsb = given.lsb_nT
    if lsb is None:
        lsb = reading_spacing(np.asarray(problem.telemetry.mag_B_nT))
        sources["lsb_nT"] = FROM_SPACING if lsb is not None else NOT_KNOWN
    else:
        sources.setdefault("lsb_nT", DECLARED)
    noise = given.noise_nT
    if noise is None:
        total = short_difference_sigma(problem.residual_nT, problem.field_B_nT, problem.segment)
        noise = float(np.sqrt(max(total**2 - (lsb or 0.0) ** 2 / 12.0, 0.0)))
        sources["noise_nT"] = FROM_DIFFERENCES
    else:
        sources.setdefault("noise_nT", DECLARED)
    for name in ("attitude_sigma_rad", "attitude_tau_s"):
        sources.setdefault(name, NOT_KNOWN if getattr(given, name) is None else DECLARED)
    return Budget(noise, lsb, given.attitude_sigma_rad, given.attitude_tau_s, sources)


def prior_of(budget: Budget) -> NoisePrior:
    """The prior that a complete budget stands for."""
    sources = budget.sources or {}
    white = float(np.hypot(budget.noise_nT or 0.0, (budget.lsb_nT or 0.0) / np.sqrt(12.0)))
    guessed = budget.noise_nT is None or sources.get("noise_nT") == FROM_DIFFERENCES
    return NoisePrior(
        sigma_nT=max(white, _LEAST_NOISE_nT),
        sigma_log_sd=_WIDE_LOG_SD if guessed else NOISE_LOG_SD,
        theta_rad=budget.attitude_sigma_rad,
        tau_s=budget.attitude_tau_s,
    )


def reading_spacing(mag_B_nT: FloatArray) -> float | None:
    """LSB of readings (N, 3): the step whose multiples they are; None where they are on no grid.

    Readings written with few decimals are on a grid too, but one so fine that it does not matter. A few bit errors
    stay on the grid.
    """
    spacings = [s for axis in np.asarray(mag_B_nT).T if (s := _axis_spacing(axis)) is not None]
    return float(np.median(spacings)) if len(spacings) >= 2 else None


def _axis_spacing(values: FloatArray) -> float | None:
    distinct = np.unique(values[np.isfinite(values)])
    if distinct.size < 4:
        return None
    gaps = np.diff(distinct)
    span = float(distinct[-1] - distinct[0])
    gaps = np.sort(gaps[gaps > 1e-9 * span])
    if gaps.size < 3:
        return None
    step = float(np.median(gaps[gaps < 1.5 * gaps[0]]))
    # Longer and longer lever arms: each refines the step enough to count over the next.
    for reach in (4.5, 20.5, 100.5):
        near = gaps[gaps < reach * step]
        counts = np.rint(near / step)
        step = float((near @ counts) / (counts @ counts))
    off = np.abs(gaps / step - np.rint(gaps / step))
    # On a random axis the fraction is spread over 0 to 0.5; on a grid it is the rounding of the file.
    return step if float(np.mean(off < 0.05)) > 0.97 and float(np.mean(np.rint(gaps / step) > 0)) == 1.0 else None


def short_difference_sigma(residual_nT: FloatArray, field_B_nT: FloatArray, segment: FloatArray) -> float:
    """White noise per axis [nT] from second differences of neighbouring rows, robust against spikes.

    The component along the field is used: an attitude error turns the field and cannot lengthen it.
    """
    along = np.einsum("ti,ti->t", residual_nT, field_B_nT) / np.maximum(np.linalg.norm(field_B_nT, axis=1), 1e-9)
    if along.size < 3:
        return float(np.std(residual_nT)) if residual_nT.size else _LEAST_NOISE_nT
    same = (segment[2:] == segment[:-2]) & np.isfinite(along[2:] + along[:-2])
    second = (along[2:] - 2.0 * along[1:-1] + along[:-2])[same if same.any() else slice(None)] / np.sqrt(6.0)
    middle = MAD_TO_SIGMA * float(np.median(np.abs(second)))
    if middle > 0:
        return middle
    return float(np.sqrt(np.mean(np.square(second)))) or _LEAST_NOISE_nT
