"""What closing the loop needs of a diagnosis: the effects, what was re-estimated beside them, and where it was learnt."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from fluxtwin.gap.noise.whitening import Whitener
from fluxtwin.gap.problem.problem import Problem
from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.effects.base import Effect, SignalEffect
from fluxtwin.sim.effects.chain import Active


@dataclass(frozen=True, eq=False)
class Stochastic:
    """A named effect that is known by its distribution or its own shape, not by a fit of the search."""

    effect: Effect
    theta: FloatArray
    """(p,)."""
    sigma: FloatArray
    """(p,) of each parameter; NaN where it is not known."""


@dataclass(frozen=True, eq=False)
class Closure:
    """The named effects and the design that they were learnt on; not part of the JSON."""

    problem: Problem
    whitener: Whitener
    modelled: tuple[Active, ...]
    """What is re-estimated, as refitted beside the named effects."""
    chosen: tuple[Active, ...]
    """Named effects of the search, with the parameters that the data give."""
    alternatives: tuple[tuple[SignalEffect, ...], ...]
    """For each of them: what might stand in its place (members of its group, rivals, other settings)."""
    stochastic: tuple[Stochastic, ...]
    variance: float
    """Of whitened rows: 1 when the noise model is right."""
    tested: int
    """Alternatives tested: the price of the search."""
    incomplete: str | None
    """Why the named effects are not the whole gap, in words; None when they are."""

    @property
    def empty(self) -> bool:
        """Whether nothing was named."""
        return not self.chosen and not self.stochastic

    def theta_of(self, name: str) -> FloatArray | None:
        """Parameters of a modelled effect, None if it is not modelled."""
        return next((theta for effect, theta in self.modelled if effect.name == name), None)


def names_of(effects: Sequence[Effect]) -> list[str]:
    """Names without repeats, in order."""
    return list(dict.fromkeys(effect.name for effect in effects))
