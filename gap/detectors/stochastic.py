"""Effects known by their distribution, in the order in which they explain each other away."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from fluxtwin.gap.detectors.flexible import (
    FlexibleFinding,
    coarse_steps,
    companion,
    flipped_bits,
    noise_level,
    stuck_bit,
    wheel_line,
)
from fluxtwin.gap.detectors.residual_structure import Left
from fluxtwin.gap.detectors.switched_region import switched_region
from fluxtwin.gap.detectors.tones import strongest_tone
from fluxtwin.gap.detectors.two_state import heater_sequence
from fluxtwin.gap.hypotheses.blocks import Block
from fluxtwin.gap.hypotheses.evidence import fit_all
from fluxtwin.gap.linear.leftover import leftover
from fluxtwin.gap.noise.choice import NoiseModel, RobustRows, Whitener, complete_budget
from fluxtwin.gap.problem.problem import Budget, Problem
from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.effects.base import DistributionEffect, Effect
from fluxtwin.sim.effects.chain import Active
from fluxtwin.sim.effects.digits import BitErrors, CoarseQuantization, ExcessNoise

_ALIKE = 0.25


def coarse(problem: Problem) -> FlexibleFinding | None:
    """Readings on a coarser grid than declared: looked for first, because the grid is part of the noise."""
    return coarse_steps(np.asarray(problem.telemetry.mag_B_nT), problem.budget.lsb_nT)


def flexible_findings(
    problem: Problem,
    whitener: Whitener,
    noise: NoiseModel,
    robust: RobustRows,
    residual_nT: FloatArray,
    fitted_nT: FloatArray,
    structured: bool,
    coarser: FlexibleFinding | None,
    shapes: Sequence[FlexibleFinding] = (),
) -> tuple[FlexibleFinding, ...]:
    """All that were found, `shapes` with them, confirmed or not. residual_nT (N, 3), fitted_nT (N, 3, q): beside the named
    effects."""
    reading = np.asarray(problem.telemetry.mag_B_nT)
    lsb = complete_budget(problem).lsb_nT
    step = coarser.parameters["lsb"][0] if coarser is not None and coarser.confirmed else lsb
    findings: list[FlexibleFinding | None] = [*shapes, coarser]
    stuck: FlexibleFinding | None = None
    whole = problem.measured.all(axis=1)  # elsewhere the axis of a spike is not known
    if lsb is not None and lsb > 0 and step is not None and whole.any():
        stuck = stuck_bit(reading[whole], (reading - residual_nT)[whole], lsb, step)
        findings.append(stuck)
        if stuck is None:
            difference = residual_nT if robust.difference_nT is None else robust.difference_nT
            findings.append(flipped_bits(reading[whole], difference[whole], robust.cut[whole], lsb))
    explained = (stuck is not None and stuck.confirmed) or bool(shapes)
    if noise.sigma_prior_nT > 0 and not explained:
        rest = leftover(whitener, residual_nT, fitted_nT)
        measured = None if problem.axes is None else problem.measured
        level = noise_level(problem.setting, rest, noise.white_nT, noise.sigma_prior_nT, structured, measured)
        findings.append(level)
    return tuple(finding for finding in findings if finding is not None)


def shape_of(
    problem: Problem,
    whitener: Whitener,
    residual_nT: FloatArray,
    fitted_nT: FloatArray,
    left: Left,
    dictionary: Sequence[Block],
    chosen: Sequence[Effect] = (),
) -> FlexibleFinding | None:
    """The first of a line, a region in the dark and a thermostat whose shape a residual (N, 3) has, or None.

    chosen: named effects; a companion of a named wheel's line is that wheel once more.
    """
    setting = problem.setting
    rest = leftover(whitener, residual_nT, fitted_nT)
    tone = strongest_tone(setting.seconds, rest)
    found: FlexibleFinding | None = None
    if left.kind == "tone" and not any(companion(setting, rest, tone, one) for one in chosen):
        found = wheel_line(setting, rest, tone)
    if found is None or not found.confirmed:
        found = switched_region(problem, rest, fit_all(dictionary, rest))
    if (found is None or not found.confirmed) and setting.column("heater_on") is None:
        found = heater_sequence(setting, whitener, residual_nT, fitted_nT, fit_all(dictionary, rest), tone)
    return found if found is not None and found.confirmed else None


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


def expected(finding: FlexibleFinding, frozen: Sequence[Active]) -> bool:
    """Whether the scenario has this stochastic effect already, in this size (to a quarter, or three sigma)."""
    for effect, theta in frozen:
        if effect.name != finding.effect or not isinstance(effect, DistributionEffect):
            continue
        value, sigma, _ = finding.parameters[effect.parameters[0].name]
        bar = max(3.0 * float(np.nan_to_num(sigma)) * float(np.sqrt(2.0)), _ALIKE * float(theta[0]))
        if abs(value - float(theta[0])) <= bar:
            return True
    return False


def stochastic_nT(findings: Sequence[FlexibleFinding], noise: NoiseModel, declared_lsb_nT: float | None) -> float:
    """What the named stochastic effects add to the white noise that the whitening works with, rms per component [nT]."""
    extra = 0.0
    for one in findings:
        if one.effect == "coarse_quantization":
            extra += max(one.parameters["lsb"][0] ** 2 - (declared_lsb_nT or 0.0) ** 2, 0.0) / 12.0
        elif one.effect == "excess_noise":
            extra += max(white_rms_nT(noise) ** 2 - noise.sigma_prior_nT**2, 0.0)
        elif _stuck(one):
            extra += _stuck_nT(one) ** 2
    most = sum(_stuck_nT(one) ** 2 for one in findings if _stuck(one)) or white_rms_nT(noise) ** 2
    return float(np.sqrt(min(extra, most)))


def _stuck(one: FlexibleFinding) -> bool:
    return isinstance(one.instance, BitErrors) and one.instance.kind != "flip"


def _stuck_nT(one: FlexibleFinding) -> float:
    """rms per component of a bit that never changes: wrong by its whole size half of the time, b taking the mean."""
    assert isinstance(one.instance, BitErrors) and one.instance.bit is not None
    size_nT = 0.5 * 2.0**one.instance.bit * (one.instance.lsb_nT or 0.0)
    return size_nT if one.instance.axis == "all" else size_nT / float(np.sqrt(3.0))


def floor_noise(findings: Sequence[FlexibleFinding], noise: NoiseModel, budget: Budget) -> tuple[float, float]:
    """White noise [nT] and attitude error [rad] of the floor with the named effects in it.

    As declared, unless a named cause makes the readings noisier; what was not declared is what the whitening works with.
    """
    white, theta = white_rms_nT(noise), noise.theta_rad
    stuck = [_stuck_nT(one) for one in findings if _stuck(one)]
    louder = any(one.effect in ("excess_noise", "coarse_quantization") for one in findings)
    if stuck:
        white = float(np.hypot(noise.sigma_prior_nT, max(stuck)))
    elif budget.noise_nT is not None and not louder:
        white = noise.sigma_prior_nT
    if budget.attitude_sigma_rad is not None:
        theta = budget.attitude_sigma_rad
    return white, theta


def white_rms_nT(noise: NoiseModel) -> float:
    """White noise, rms over the axes [nT]."""
    return float(np.sqrt(np.mean(noise.white_nT**2)))
