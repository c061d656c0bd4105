"""The level of the white noise: whether it is above its budget, and what named causes do to it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from fluxtwin.gap.detectors.finding import Finding
from fluxtwin.gap.detectors.waveforms import gaussian
from fluxtwin.gap.linear.projection import ProjectedResidual
from fluxtwin.gap.noise.budget import NOISE_LOG_SD
from fluxtwin.gap.noise.choice import NoiseModel
from fluxtwin.gap.problem.problem import Budget
from fluxtwin.gap.selection.criterion import THRESHOLD, worth
from fluxtwin.sim.base.types import BoolArray, FloatArray
from fluxtwin.sim.effects.chain import Active
from fluxtwin.sim.effects.digits import BitErrors, CoarseQuantization, ExcessNoise


def noise_level(
    left: ProjectedResidual,
    fitted_nT: FloatArray | float,
    declared_nT: float,
    shape_nT: float | None,
    measured: BoolArray | None = None,
) -> Finding | None:
    """Is the white noise above its budget, and is it noise?

    fitted_nT: the level that the whitening used, one number or (3,); declared_nT: noise and rounding of the budget
    together (with the true step where that is coarser). shape_nT: what named causes may leave because nature's form is not
    theirs; None where something unknown is left. Confirmed beyond both where nothing unknown is left and the values are
    Gaussian. measured (N, 3): components that there are, where rows have no attitude; no single axis is named then.
    """
    series = left.residual.reshape(-1, 3)
    there = np.ones(series.shape, dtype=np.bool_) if measured is None else measured
    share = there.mean(axis=0) / there.mean()
    axis_energy = np.sum(series**2, axis=0) / left.degrees * 3.0 / np.where(share > 0, share, 1.0)
    level = np.maximum(np.asarray(fitted_nT) * np.sqrt(axis_energy), 1e-12)
    expected_nT = float(np.hypot(declared_nT, shape_nT or 0.0))
    noisy = np.log(level / expected_nT) > 2 * NOISE_LOG_SD
    alone = measured is None and int(noisy.sum()) == 1
    level_nT = float(level[noisy][0]) if alone else float(np.sqrt(np.sum(share * level**2) / 3.0))
    degrees = left.degrees / 3 if alone else left.degrees
    beyond = float(np.log(level_nT / expected_nT) / np.hypot(NOISE_LOG_SD, np.sqrt(0.5 / degrees)))
    value = worth(max(beyond, 0.0) ** 2, 1, left.degrees / 3.0, float(np.log(3.0)) if alone else 0.0)
    if value <= THRESHOLD:
        return None
    rms = float(np.sqrt(level_nT**2 - declared_nT**2))
    sigma = float(np.hypot(NOISE_LOG_SD * declared_nT**2, level_nT**2 * np.sqrt(0.5 / degrees)) / rms)
    values = (series / np.sqrt(np.where(share > 0, axis_energy, 1.0)))[there & np.any(series != 0, axis=1)[:, None]]
    faults = ["structure remains"] if shape_nT is None else []
    if not gaussian(values):
        faults.append("it is not Gaussian")
    effect = ExcessNoise(("x", "y", "z")[int(np.argmax(noisy))]) if alone else ExcessNoise()
    where = f" on axis {effect.axis}" if alone else ""
    what = f"white noise is {level_nT:.4g} nT{where}, where {declared_nT:.4g} nT were expected"
    return Finding(effect, np.array([rms]), np.array([sigma]), value, what, tuple(faults))


def with_frozen_noise(
    frozen: Sequence[Active], noise_nT: float | None, lsb_nT: float | None
) -> tuple[float | None, float | None]:
    """White noise and step of the readings with what a scenario's effects add to those declared."""
    for effect, theta in frozen:
        if isinstance(effect, ExcessNoise) and effect.axis == "all" and noise_nT is not None:
            noise_nT = float(np.hypot(noise_nT, theta[0]))
        if isinstance(effect, CoarseQuantization):
            lsb_nT = max(lsb_nT or 0.0, float(theta[0]))
    return noise_nT, lsb_nT


def stochastic_nT(findings: Sequence[Finding], noise: NoiseModel, declared_lsb_nT: float | None) -> float:
    """What the named stochastic effects add to the white noise that the whitening works with, rms per component [nT]."""
    extra = 0.0
    for one in findings:
        if one.name == "coarse_quantization":
            extra += max(float(one.theta[0]) ** 2 - (declared_lsb_nT or 0.0) ** 2, 0.0) / 12.0
        elif one.name == "excess_noise":
            extra += max(noise.white_rms_nT**2 - noise.sigma_prior_nT**2, 0.0)
    stuck = sum(size_nT**2 for size_nT in _stuck_nT(findings))
    return float(np.sqrt(min(extra + stuck, stuck or noise.white_rms_nT**2)))


def _stuck_nT(findings: Sequence[Finding]) -> list[float]:
    """rms per component of each bit that never changes: wrong by its whole size half of the time, b taking the mean."""
    found = []
    for bits in (one.effect for one in findings):
        if isinstance(bits, BitErrors) and bits.kind != "flip":
            assert bits.bit is not None
            size_nT = 0.5 * 2.0**bits.bit * (bits.lsb_nT or 0.0)
            found.append(size_nT if bits.axis == "all" else size_nT / float(np.sqrt(3.0)))
    return found


def floor_noise(findings: Sequence[Finding], noise: NoiseModel, budget: Budget) -> tuple[float, float]:
    """White noise [nT] and attitude error [rad] of what is expected with the named effects.

    As declared, unless a named cause makes the readings noisier; what was not declared is what the whitening works with.
    """
    white, theta = noise.white_rms_nT, noise.theta_rad
    stuck = _stuck_nT(findings)
    louder = any(one.name in ("excess_noise", "coarse_quantization") for one in findings)
    if stuck:
        white = float(np.hypot(noise.sigma_prior_nT, max(stuck)))
    elif budget.noise_nT is not None and not louder:
        white = noise.sigma_prior_nT
    if budget.attitude_sigma_rad is not None:
        theta = budget.attitude_sigma_rad
    return white, theta
