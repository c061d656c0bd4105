"""What a search for causes hands on: the named effects, and everything later steps need of the fit."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from fluxtwin.gap.hypotheses.candidates import Candidate, settings_of
from fluxtwin.gap.records.diagnosis import EffectParameter, FoundEffect, Ranked, Score
from fluxtwin.gap.selection.detectable import Smallest
from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.effects.base import Effect
from fluxtwin.sim.effects.chain import Active
from fluxtwin.sim.effects.signal import Setting

OWN_AXIS = 0.8
"""Share of the energy from which on an effect is of one axis: a judgement, for words alone."""


class Support(NamedTuple):
    """Of one named effect."""

    p_value: float
    """Corrected for the number of tests."""
    probability: float
    """That it, or a member of its group, is present, given that one of the catalogue is."""
    group: tuple[str, ...]
    """Its own name first."""
    rivals: tuple[tuple[str, float], ...] = ()


def found_effect(
    effect: Effect,
    theta: FloatArray,
    sigma: FloatArray,
    setting: Setting,
    backing: Support,
    axis: str | None,
    visible_nT: float = 0.0,
    covariance: FloatArray | None = None,
) -> FoundEffect:
    """A cause on a design, with its parameters (p,); a sigma that is not finite is not known."""
    return FoundEffect(
        name=effect.name,
        group=backing.group,
        rivals=backing.rivals,
        probability=backing.probability,
        parameters=parameters_of(effect, theta, sigma),
        settings=settings_of(effect),
        stage=effect.stage,
        axis=axis,
        frame=effect.frame,
        condition=effect.condition_on(setting),
        significance=backing.p_value,
        visible_nT=visible_nT,
        effect=effect,
        covariance=covariance,
    )


def parameters_of(effect: Effect, theta: FloatArray, sigma: FloatArray) -> dict[str, EffectParameter]:
    """By name: values and sigmas (p,) with their units; a sigma that is not finite is not known."""
    return {
        one.name: EffectParameter(float(value), float(spread) if np.isfinite(spread) else None, one.unit)
        for one, value, spread in zip(effect.parameters, theta, sigma, strict=True)
    }


def axis_of(energy: FloatArray) -> str | None:
    """The axis that has most of an energy (3,), "all" where none has; None where the data do not separate the axes."""
    if not np.isfinite(energy).all():
        return None
    axis = int(np.argmax(energy))
    return "xyz"[axis] if energy[axis] >= OWN_AXIS * max(float(energy.sum()), 1e-300) else "all"


@dataclass(frozen=True, eq=False)
class SearchResult:
    """The outcome of a search; M rows, those of the problem."""

    named: tuple[FoundEffect, ...]
    """Jointly present, best supported first; empty: no gap that the catalogue explains."""
    ranking: tuple[Ranked, ...]
    """Every effect alone, best alternative, most significant first."""
    untestable: Mapping[str, str]
    isolability: Mapping[str, Mapping[str, float]]
    """Shares of 0.5 and more: {a: {b: share of a that b can imitate}}."""
    smallest: Mapping[str, Smallest]
    """By effect that shows: the smallest size under the noise model of the search."""
    candidates: Sequence[Candidate]
    """With their Jacobians at the fit without any named effect."""
    modelled: tuple[Active, ...]
    """What is re-estimated, refitted together with the named effects."""
    modelled_alone: tuple[Active, ...]
    """What is re-estimated, refitted without any named effect."""
    residual_nT: FloatArray
    """(N, 3) reading less prediction with everything at its refitted value, all rows of the problem."""
    residual_alone_nT: FloatArray
    """(N, 3) the same without any named effect."""
    residual_white: FloatArray
    """(M, 3) whitened."""
    jacobian_white: FloatArray
    """(M, 3, c + p) whitened, what is modelled, then the named effects in the order of `chosen`."""
    variance: float
    """Of whitened rows about the saturated fit: 1 when the noise model is right."""
    scores: tuple[tuple[Score, ...], tuple[Score, ...]]
    """What the record says of every candidate, and what it says of the others beside the named effects."""
    tested: int
    """Alternatives tested, for which every p-value is corrected."""

    @property
    def chosen(self) -> tuple[Active, ...]:
        """Effects and parameters of `named`, same order."""
        return tuple((one.effect, one.theta) for one in self.named if one.effect is not None)

    @property
    def resembles(self) -> tuple[str, ...]:
        """Names that would do, where more than three cannot be distinguished; else none."""
        return tuple(dict.fromkeys(name for one in self.named if one.too_many_alike for name in one.group))
