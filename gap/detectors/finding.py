"""What a detector proposes: a cause with a waveform or a distribution of its own."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from fluxtwin.gap.selection.criterion import MOST_SURE, THRESHOLD
from fluxtwin.sim.effects.base import Effect

_SEARCHED = ("wheel_field", "heater_switching", "bias_random_walk", "switched_field")
_MOST_SEARCHED = 0.9
"""Most that is stated of a waveform that was searched for: by Laplace's rule for none wrong in eight. A judgement: on tuning
records such names are too rare for a calibration of their own."""


@dataclass(frozen=True)
class Finding:
    """An effect that a detector found, its worth, and what in the data the effect would not make."""

    effect: str
    parameters: dict[str, tuple[float, float, str]] = field(default_factory=dict)
    """Value, sigma and unit by name."""
    worth: float = 0.0
    """Twice the log of the Bayes factor against nothing, by the criterion."""
    what: str = ""
    """What was found, in words."""
    faults: tuple[str, ...] = ()
    instance: Effect | None = None
    """The effect with its discrete settings, ready for a scenario."""

    @property
    def confirmed(self) -> bool:
        return self.worth > THRESHOLD and not self.faults

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
        """That this effect is present: 1 - p, within 0.5 and the most that is stated of such a name."""
        return float(np.clip(1.0 - self.p_value, 0.5, _MOST_SEARCHED if self.effect in _SEARCHED else MOST_SURE))
