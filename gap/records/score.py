"""What one record says of one effect: of many records these add up."""

from __future__ import annotations

from dataclasses import dataclass

from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.effects.base import Effect


@dataclass(frozen=True, eq=False)
class Score:
    """What one record says of one effect, with unit noise."""

    label: str
    """The name with its settings."""
    effect: Effect
    score: FloatArray
    """(p,) derivative of the log likelihood by each parameter, at none of the effect."""
    information: FloatArray
    """(p, p) beside the nuisance; zero for parameters that move nothing."""
    of_errors: float = 0.0
    """What of the information of a single parameter is none, as its image is made of an attitude with errors."""
