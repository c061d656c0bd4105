"""Everything that a diagnosis found on the way to its words."""

from __future__ import annotations

from dataclasses import dataclass

from fluxtwin.gap.channels.momentum import Momentum
from fluxtwin.gap.detectors.flexible import FlexibleFinding
from fluxtwin.gap.detectors.residual_structure import Left
from fluxtwin.gap.noise.choice import NoiseModel, RobustRows, Whitener
from fluxtwin.gap.posterior.where import Where
from fluxtwin.gap.problem.problem import Problem
from fluxtwin.gap.records.diagnosis import GapSeries, Shrinkage
from fluxtwin.gap.selection.named import SearchResult
from fluxtwin.sim.base.types import FloatArray


@dataclass(frozen=True, eq=False)
class Work:
    """Everything that was found on the way; N rows."""

    problem: Problem
    noise: NoiseModel
    robust: RobustRows
    whitener: Whitener
    found: SearchResult
    nuisance_nT: FloatArray
    """(N, 3, C) Jacobian of what is modelled, without named effects."""
    fitted_nT: FloatArray
    """(N, 3, C + P) Jacobian of what is modelled and of the named effects, at the refit."""
    known: float
    """Probability that nothing, or what is named, is all there is."""
    left: Left
    flexible: tuple[FlexibleFinding, ...]
    """Those that are confirmed."""
    loud: str | None
    """Words for white noise above its budget that is not like noise."""
    where: Where
    shrinkage: Shrinkage
    series: GapSeries
    momentum: Momentum
    """The balance of the momentum."""
    attitude_would_do_rad: float | None = None
    """Size of an attitude error, 1 sigma per axis, that makes all the structure that is left; None where none does."""
