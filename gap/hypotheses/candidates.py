"""The causes to be tested: every effect of the catalogue that is not re-estimated, with its image in the readings.

The image is the Jacobian of the noise-free chain at the best present fit. Columns that move nothing (a panel never
lit, a torquer axis never fired) are dropped one by one; an effect with no column left is untestable, not absent.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from fluxtwin.gap.hypotheses.perturbed_design import MOST_CHANGED, PerturbedDesign
from fluxtwin.gap.problem.problem import Problem
from fluxtwin.sim.base.types import BoolArray, FloatArray
from fluxtwin.sim.effects.base import Effect, SignalEffect
from fluxtwin.sim.effects.catalogue import CATALOGUE
from fluxtwin.sim.effects.chain import Active, Chain, jacobian
from fluxtwin.sim.effects.digits import BitErrors

OF_ERRORS = (
    "what the calibration cannot imitate of its signature comes mostly from errors of the reference attitude: the body "
    "would have to turn further"
)
_DEAD_NT = 1e-6  # a parameter of its typical size that moves the readings by less is not there


@dataclass(frozen=True, eq=False)
class Candidate:
    """One alternative: an effect with its discrete settings."""

    effect: SignalEffect
    jacobian: FloatArray
    """(M, 3, p) derivative of the reading by its parameters, nT per unit."""
    live: BoolArray
    """(p,) columns that move anything."""
    change: float = 0.0
    """Share of its image, beside what is modelled, that another attitude error would change."""

    @property
    def name(self) -> str:
        return self.effect.name

    @cached_property
    def label(self) -> str:
        """The name with its settings."""
        settings = settings_of(self.effect)
        inside = ", ".join(f"{key}={value}" for key, value in settings.items())
        return f"{self.name}({inside})" if inside else self.name

    @cached_property
    def scale(self) -> FloatArray:
        """(p,) typical sizes of its parameters."""
        return np.array([parameter.scale for parameter in self.effect.parameters])


def candidates(problem: Problem, perturbed: PerturbedDesign | None = None) -> tuple[list[Candidate], dict[str, str]]:
    """All alternatives of all signal effects that are not modelled, and why others cannot be tested: {name: reason}.

    perturbed: the design with one more attitude error, if at hand.
    """
    taken = {effect.name for effect in problem.modelled}
    on = [*problem.frozen, *problem.modelled_active]
    perturbed = perturbed or PerturbedDesign(problem)
    found: list[Candidate] = []
    untestable: dict[str, str] = {}
    for effect in (one for kind in CATALOGUE for one in kind.instances(problem.setting)):
        if effect.name in taken:
            continue
        reason, possible = _not_reported(effect, problem), []
        if reason is None and isinstance(effect, SignalEffect):
            possible = [one for one in effect.alternatives(problem.setting) if isinstance(one, SignalEffect)]
        if possible:
            reasons = [one.untestable(problem.setting) for one in possible]
            reason = None if None in reasons else reasons[0]
        if reason is not None:
            untestable[effect.name] = reason
        if reason is not None or not possible:
            continue
        seen: dict[Effect, FloatArray] = {}
        every = (_candidate(problem.design, alternative, on, perturbed, seen) for alternative in possible)
        testable = [candidate for candidate in every if candidate.live.any()]
        if not testable:
            untestable[effect.name] = (
                "nothing in these data excites it: at its typical size it would not change any reading"
            )
        firm = [candidate for candidate in testable if candidate.change <= MOST_CHANGED]
        if testable and not firm:
            untestable[effect.name] = OF_ERRORS
        found += firm
    return found, untestable


def candidate_of(problem: Problem, effect: SignalEffect, *, modelled: Sequence[Active]) -> Candidate:
    """One alternative that `candidates` does not try, linearised beside what is modelled."""
    return made(effect, jacobian(problem.design, effect, [*problem.frozen, *modelled]), _DEAD_NT)


def made(effect: SignalEffect, image: FloatArray, least: float) -> Candidate:
    """An alternative with its image (M, 3, p). least: rms by which a parameter of its typical size moves something."""
    scale = np.array([parameter.scale for parameter in effect.parameters])
    return Candidate(effect, image, np.sqrt(np.mean(image**2, axis=(0, 1))) * scale > least)


def _not_reported(effect: Effect, problem: Problem) -> str | None:
    """Why an effect is not to be tested: another measurement rules it out, or no attitude was reported."""
    if effect.name in problem.ruled_out:
        return f"another measurement rules it out: {problem.ruled_out[effect.name]}"
    if problem.axes is None or problem.axes.known.any():
        return None
    if isinstance(effect, BitErrors):
        return "no row has a reference attitude, so the axis and the bit of a spike are not known"
    return "no row has a reference attitude" if effect.stage == "attitude" else None


def settings_of(effect: Effect) -> dict[str, object]:
    """Discrete settings of an effect that can be written in a word: numbers, words, flags, the edges of a region."""
    fields = {item.name: getattr(effect, item.name) for item in dataclasses.fields(effect) if item.compare}
    return {
        key: list(value) if isinstance(value, tuple) else value
        for key, value in fields.items()
        if isinstance(value, int | float | str) or (key == "region_deg" and value is not None)
    }


def _candidate(
    chain: Chain,
    effect: SignalEffect,
    on: Sequence[Active],
    perturbed: PerturbedDesign,
    seen: dict[Effect, FloatArray],
) -> Candidate:
    """seen: images of effects that others modulate, made so far; more are added."""
    whole, share = effect.modulates(chain.setting) or (effect, np.ones((1, 1)))
    if whole not in seen:
        assert isinstance(whole, SignalEffect)
        seen[whole] = jacobian(chain, whole, on)
    one = made(effect, seen[whole] * share[:, None, :], _DEAD_NT)
    return dataclasses.replace(one, change=perturbed.change(effect, one.jacobian, on)) if one.live.any() else one
