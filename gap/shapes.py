"""All flexible effects in one go, in the order in which they explain each other away."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from fluxtwin.gap.blocks import Block, blocks
from fluxtwin.gap.evidence import fit_all, leftover
from fluxtwin.gap.flexible import (
    FlexibleFinding,
    coarse_steps,
    flipped_bits,
    noise_level,
    stuck_bit,
    wheel_line,
)
from fluxtwin.gap.left import judge
from fluxtwin.gap.noise import Whitener
from fluxtwin.gap.problem import Problem
from fluxtwin.gap.tones import strongest_tone
from fluxtwin.gap.two_state import heater_sequence
from fluxtwin.gap.wandering import random_walk
from fluxtwin.sim.types import FloatArray


def flexible_findings(
    problem: Problem,
    whitener: Whitener,
    residual_nT: FloatArray,
    fitted: FloatArray,
    *,
    found: Sequence[Block] | None = None,
) -> tuple[FlexibleFinding, ...]:
    """Test every flexible effect on a residual.

    residual_nT (N, 3): reading less the best prediction; fitted (N, 3, q): Jacobian of all that was fitted; both in
    nT. The components that the whitener passes over are the spikes. Each finding says whether its shape is
    confirmed; the others tell what was looked at. found: blocks made before.
    """
    reading = problem.telemetry.mag_B_nT
    findings = [*_codes(problem, whitener, residual_nT, reading)]
    step = _step(problem, findings)
    known = blocks(problem) if found is None else found
    left = leftover(whitener, residual_nT, fitted)
    fits = fit_all(known, left)
    verdict = judge(problem, left, fits)
    noise = whitener.noise
    if problem.budget.noise_nT is not None:
        declared = float(np.hypot(problem.budget.noise_nT, step / np.sqrt(12)))
        if declared > 0:
            findings.append(noise_level(problem.setting, left, noise.white_nT, declared, verdict.structured))
    if verdict.structured:
        tone = strongest_tone(problem.setting.seconds, left)
        findings.append(wheel_line(problem.setting, left, tone))
        if not _any_confirmed(findings[-1:]):
            findings.append(heater_sequence(problem.setting, whitener, residual_nT, fitted, fits, tone))
        if not _any_confirmed(findings[-2:]):
            findings.append(random_walk(problem.setting.seconds, left, known, noise.sigma_nT))
    return tuple(one for one in findings if one is not None)


def _codes(
    problem: Problem, whitener: Whitener, residual_nT: FloatArray, reading_nT: FloatArray
) -> list[FlexibleFinding | None]:
    declared = problem.budget.lsb_nT
    coarse = coarse_steps(reading_nT, declared)
    if not declared:
        return [coarse]
    step = declared if coarse is None else coarse.parameters["lsb"][0]
    stuck = stuck_bit(reading_nT, reading_nT - residual_nT, declared, step)
    flipped = None
    if stuck is None or not stuck.confirmed:
        flipped = flipped_bits(reading_nT, residual_nT, np.asarray(whitener.weights <= 0), declared)
    return [coarse, stuck, flipped]


def _step(problem: Problem, findings: Sequence[FlexibleFinding | None]) -> float:
    for one in findings:
        if one is not None and one.effect == "coarse_quantization" and one.confirmed:
            return one.parameters["lsb"][0]
    return problem.budget.lsb_nT or 0.0


def _any_confirmed(findings: Sequence[FlexibleFinding | None]) -> bool:
    return any(one is not None and one.confirmed for one in findings)
