"""What a detector proposes: a cause with a waveform or a distribution of its own."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fluxtwin.gap.selection.criterion import stands_out
from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.effects.base import Effect, SignalEffect


@dataclass(frozen=True, eq=False)
class Finding:
    """An effect that a detector found, its worth, and what in the data the effect would not make."""

    effect: Effect
    """With its discrete settings."""
    theta: FloatArray
    """(p,) its parameters."""
    sigma: FloatArray
    worth: float = 0.0
    """Twice the log of the Bayes factor against nothing, by the criterion."""
    what: str = ""
    """What was found, in words."""
    faults: tuple[str, ...] = ()

    @property
    def name(self) -> str:
        return self.effect.name

    @property
    def is_signal(self) -> bool:
        """Whether it has a course that a fit can have; else it is known by its distribution."""
        return isinstance(self.effect, SignalEffect)

    @property
    def is_noise(self) -> bool:
        """Whether it is new in every row, and so stands beside something unknown, which a signal or a walk would be."""
        return not self.is_signal and self.effect.follows is None

    @property
    def confirmed(self) -> bool:
        return bool(stands_out(self.p_value, self.worth)) and not self.faults

    @property
    def words(self) -> str:
        """What was found, and what speaks against the effect."""
        return f"{self.what}; but {', '.join(self.faults)}" if self.faults else self.what

    @property
    def p_value(self) -> float:
        """A Bayes factor of k against nothing comes by chance at most once in k times (Markov's inequality)."""
        return float(np.exp(-0.5 * max(self.worth, 0.0)))

    @property
    def probability(self) -> float:
        """That this effect is present: 1 - p, at least 0.5."""
        return max(0.5, 1.0 - self.p_value)
