"""What only the full rate shows: fast lines, single wrong readings, and the noise from one reading to the next.

A long record is diagnosed on evenly spaced rows: what is slow is all there. One contiguous stretch at the full rate
then shows the rest, given the fit that was found. Its noise is chosen anew, with only that fit as design: slow
structure counts as noise there.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from fluxtwin.gap.detectors.lines import Line, strongest_line
from fluxtwin.gap.linear.projection import ProjectedResidual, projected
from fluxtwin.gap.noise.choice import RobustRows, Whitener, noise_of, whitener_of
from fluxtwin.gap.problem.problem import Problem, pose, realigned
from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.effects.chain import Active
from fluxtwin.sim.telemetry.record import Telemetry

MOST_ROWS = 60_000
"""Of the stretch: its Jacobians, their whitened and orthonormal copies take about a third of a gigabyte."""


@dataclass(frozen=True, eq=False)
class FullRate:
    """The stretch, given the fit; n rows."""

    problem: Problem
    robust: RobustRows
    whitener: Whitener
    residual_nT: FloatArray
    """(n, 3) less everything that was fitted on the evenly spaced rows."""
    fitted_nT: FloatArray
    """(n, 3, q) its Jacobian."""
    left: ProjectedResidual
    line: Line
    slow_Hz: float
    """Highest frequency that the evenly spaced rows show as it is."""


def full_rate(
    whole: Telemetry, problem: Problem, modelled: Sequence[Active], chosen: Sequence[Active]
) -> FullRate | None:
    """Look at the middle of a record at its full rate; None where what was found holds for the thinned rows only.

    problem: that of the thinned rows; modelled, chosen: what was fitted there.
    """
    if any(hasattr(effect, "sequence") and effect.sequence for effect, _ in chosen):
        return None
    setting = problem.setting
    near = _stretch(whole, problem, modelled, chosen)
    residual = near.residual_of([*modelled, *chosen])
    fitted = near.derivatives([*modelled, *chosen])
    noise, robust = noise_of(near, residual, [fitted])
    whitener = whitener_of(near, noise, robust.weights)
    left = projected(whitener, residual, fitted)
    line = strongest_line(near.setting.seconds, left)
    slow_Hz = 0.5 / float(np.median(np.diff(setting.seconds)))
    return FullRate(near, robust, whitener, residual, fitted, left, line, slow_Hz)


def _stretch(whole: Telemetry, problem: Problem, modelled: Sequence[Active], chosen: Sequence[Active]) -> Problem:
    """The same problem on the middle rows of a record, about the same parameters."""
    first = max((len(whole) - MOST_ROWS) // 2, 0)
    near = pose(
        whole.select(slice(first, first + MOST_ROWS)),
        problem.setting.model,
        modelled=[effect.name for effect in problem.modelled],
        budget=problem.budget,
        instrument=problem.setting.instrument,
        frozen=problem.frozen,
    )
    thetas = {effect.name: theta for effect, theta in modelled}
    about = tuple(thetas[effect.name] for effect in problem.modelled)
    near = replace(near, modelled=problem.modelled, modelled_theta=about)
    return realigned(near, beside=[*modelled, *chosen])
