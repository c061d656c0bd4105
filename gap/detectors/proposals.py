"""All detectors, in the order in which what they find explains each other away."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from fluxtwin.gap.detectors.codes import flipped_bits, noise_level, stuck_bit
from fluxtwin.gap.detectors.finding import Finding
from fluxtwin.gap.detectors.lines import companion, strongest_line, wheel_line
from fluxtwin.gap.detectors.residual_structure import Structure
from fluxtwin.gap.detectors.switched_region import switched_region
from fluxtwin.gap.detectors.two_state import heater_sequence
from fluxtwin.gap.hypotheses.evidence import Dictionary
from fluxtwin.gap.linear.projection import projected
from fluxtwin.gap.noise.choice import RobustRows, Whitener, complete_budget
from fluxtwin.gap.problem.problem import Problem
from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.effects.base import DistributionEffect, Effect
from fluxtwin.sim.effects.chain import Active

_ALIKE = 0.25


def structured(
    problem: Problem,
    whitener: Whitener,
    residual_nT: FloatArray,
    fitted_nT: FloatArray,
    left: Structure,
    dictionary: Dictionary,
    chosen: Sequence[Effect] = (),
) -> Finding | None:
    """The first of a line, a region in the dark and a thermostat whose waveform a residual (N, 3) has, or None.

    chosen: named effects; a companion of a named wheel's line is that wheel once more.
    """

    def proposed() -> Iterator[Finding | None]:
        if left.kind == "tone" and not any(companion(setting, rest, line, one) for one in chosen):
            yield wheel_line(setting, rest, line, fits)
        yield switched_region(problem, rest, fits)
        if setting.column("heater_on") is None:
            white = whitener.apply(np.ascontiguousarray(fitted_nT)).reshape(rest.residual.size, -1)
            size = np.linalg.lstsq(white, whitener.apply(residual_nT).reshape(-1), rcond=1e-10)[0]
            yield heater_sequence(setting, rest, residual_nT - fitted_nT @ size, fits, line)

    setting = problem.setting
    rest = projected(whitener, residual_nT, fitted_nT)
    line, fits = strongest_line(setting.seconds, rest), dictionary.fits(rest)
    return next((one for one in proposed() if one is not None and one.confirmed), None)


def in_the_readings(
    problem: Problem,
    whitener: Whitener,
    robust: RobustRows,
    residual_nT: FloatArray,
    fitted_nT: FloatArray,
    shape_nT: float | None,
    found: Sequence[Finding],
) -> tuple[Finding, ...]:
    """Those found before, then what the codes and the level of the noise say, confirmed or not.

    residual_nT (N, 3), fitted_nT (N, 3, q): given the named effects. shape_nT: what these may leave besides noise; None
    where something unknown is left. found: a coarser step and structured causes.
    """
    reading, lsb = np.asarray(problem.telemetry.mag_B_nT), complete_budget(problem).lsb_nT
    noise = whitener.noise
    step = next((float(one.theta[0]) for one in found if one.name == "coarse_quantization"), lsb)
    stuck: Finding | None = None
    findings: list[Finding | None] = [*found]
    whole = problem.measured.all(axis=1)  # elsewhere the axis of a spike is not known
    if lsb is not None and lsb > 0 and step is not None and whole.any():
        stuck = stuck_bit(reading[whole], (reading - residual_nT)[whole], lsb, step)
        findings.append(stuck)
        if stuck is None:
            difference = residual_nT if robust.difference_nT is None else robust.difference_nT
            findings.append(flipped_bits(reading[whole], difference[whole], robust.cut[whole], lsb))
    walks = any(one.name == "bias_random_walk" for one in found)
    if noise.sigma_prior_nT > 0 and not walks and not (stuck is not None and stuck.confirmed):
        rest = projected(whitener, residual_nT, fitted_nT)
        measured = None if problem.axes is None else problem.measured
        findings.append(noise_level(rest, noise.white_nT, noise.sigma_prior_nT, shape_nT, measured))
    return tuple(finding for finding in findings if finding is not None)


def expected(finding: Finding, frozen: Sequence[Active]) -> bool:
    """Whether the scenario has this stochastic effect already, in this size (to a quarter, or three sigma)."""
    for effect, theta in frozen:
        if effect.name == finding.name and isinstance(effect, DistributionEffect):
            bar = max(3.0 * float(finding.sigma[0]) * float(np.sqrt(2.0)), _ALIKE * float(theta[0]))
            if abs(float(finding.theta[0]) - float(theta[0])) <= bar:
                return True
    return False
