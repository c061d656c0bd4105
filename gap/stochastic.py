"""Effects known by their distribution, in the order in which they explain each other away."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from fluxtwin.gap.blocks import Block
from fluxtwin.gap.evidence import fit_all, leftover
from fluxtwin.gap.flexible import (
    FlexibleFinding,
    coarse_steps,
    confirmed,
    flipped_bits,
    noise_level,
    stuck_bit,
    wheel_line,
)
from fluxtwin.gap.left import Left
from fluxtwin.gap.noise import NoiseModel, RobustRows, Whitener
from fluxtwin.gap.problem import Problem
from fluxtwin.gap.tones import strongest_tone
from fluxtwin.gap.two_state import heater_sequence
from fluxtwin.gap.wandering import random_walk
from fluxtwin.sim.types import FloatArray


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
    shape: FlexibleFinding | None = None,
) -> tuple[FlexibleFinding, ...]:
    """The confirmed ones, `shape` with them. residual_nT (N, 3), fitted_nT (N, 3, q): beside the named effects."""
    reading = np.asarray(problem.telemetry.mag_B_nT)
    lsb = problem.budget.lsb_nT
    step = coarser.parameters["lsb"][0] if coarser is not None and coarser.confirmed else lsb
    findings: list[FlexibleFinding | None] = [shape, coarser]
    stuck: FlexibleFinding | None = None
    if lsb is not None and lsb > 0 and step is not None:
        stuck = stuck_bit(reading, reading - residual_nT, lsb, step)
        findings.append(stuck)
        if stuck is None:
            difference = residual_nT if robust.difference_nT is None else robust.difference_nT
            findings.append(flipped_bits(reading, difference, robust.cut, lsb))
    explained = (stuck is not None and stuck.confirmed) or shape is not None
    if noise.sigma_prior_nT > 0 and not explained:
        rest = leftover(whitener, residual_nT, fitted_nT)
        findings.append(noise_level(problem.setting, rest, noise.white_nT, noise.sigma_prior_nT, structured))
    return confirmed(findings)


def shape_of(
    problem: Problem,
    whitener: Whitener,
    noise: NoiseModel,
    residual_nT: FloatArray,
    fitted_nT: FloatArray,
    left: Left,
    dictionary: Sequence[Block],
) -> FlexibleFinding | None:
    """The first of a line, a thermostat and a walk whose own shape the structure in a residual (N, 3) has, or None."""
    setting = problem.setting
    rest = leftover(whitener, residual_nT, fitted_nT)
    tone = strongest_tone(setting.seconds, rest)
    found: FlexibleFinding | None = None
    if left.kind == "tone":
        found = wheel_line(setting, rest, tone)
    if (found is None or not found.confirmed) and setting.column("heater_on") is None:
        found = heater_sequence(setting, whitener, residual_nT, fitted_nT, fit_all(dictionary, rest), tone)
    if found is None or not found.confirmed:
        found = random_walk(setting.seconds, rest, dictionary, noise.sigma_nT)
    return found if found is not None and found.confirmed else None


def stochastic_nT(findings: Sequence[FlexibleFinding], noise: NoiseModel, declared_lsb_nT: float | None) -> float:
    """What the named stochastic effects add to the white noise that the whitening works with, rms per component [nT]."""
    extra = 0.0
    for one in findings:
        if one.effect == "coarse_quantization":
            extra += max(one.parameters["lsb"][0] ** 2 - (declared_lsb_nT or 0.0) ** 2, 0.0) / 12.0
        elif one.effect == "excess_noise":
            extra += max(white_rms_nT(noise) ** 2 - noise.sigma_prior_nT**2, 0.0)
    return float(np.sqrt(min(extra, white_rms_nT(noise) ** 2)))


def white_rms_nT(noise: NoiseModel) -> float:
    """White noise, rms over the axes [nT]."""
    return float(np.sqrt(np.mean(noise.white_nT**2)))
