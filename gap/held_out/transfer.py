"""For which other designs the parameters of a closed scenario are good enough.

An effect *transfers* to a design if a later diagnosis there, of a record as long as this one, with the effect applied
as it is and everything modelled re-estimated, would mistake its error for a gap at most once in twenty times. The
error is that of the parameters (their covariance, carried through the noise-free chain of that design) and that of
the name: what might as well have caused this gap may look different there.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2, ncx2

from fluxtwin.gap.held_out.held_out import floor_rms_nT
from fluxtwin.gap.held_out.targets import Target, targets
from fluxtwin.gap.hypotheses.candidates import settings_of
from fluxtwin.gap.linear.leftover import orthonormal
from fluxtwin.gap.noise.whitening import Whitener, make_whitener
from fluxtwin.gap.problem.row_axes import turn_images
from fluxtwin.gap.records.diagnosis import Closure, FoundEffect, Transfer
from fluxtwin.gap.selection.detectable import GATE, noncentrality, visible_part
from fluxtwin.gap.selection.refit import Readings, refit
from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.effects.base import SignalEffect
from fluxtwin.sim.effects.chain import Active, Chain, jacobians

MOST_CHANCE = 0.05
"""Of a false gap on the other design: more, and the parameters do not transfer."""
_DRAWS = 20_000
_SEEN = 1e-9
_UNLIKELY = 1e-3
_MOST_TRIALS = 8


@dataclass(frozen=True, eq=False)
class Other:
    """What might stand in the place of a named effect, as refitted there."""

    weight: float
    label: str
    effect: SignalEffect
    theta: FloatArray


@dataclass(frozen=True, eq=False)
class Learnt:
    """A named effect with what the data leave open about it."""

    effect: SignalEffect
    theta: FloatArray
    directions: FloatArray
    """(p, k) one sigma along each independent direction of its parameters."""
    unseen: tuple[str, ...]
    """Parameters that these data did not excite."""
    others: tuple[Other, ...]
    """What might stand in its place; its own weight is the rest to one."""


def transfers(closure: Closure, effects: Sequence[tuple[SignalEffect, FloatArray, FloatArray]]) -> list[Transfer]:
    """For each named effect (as pinned, parameters (p,), covariance (p, p)) and each target, whether it transfers."""
    designs = [_Design(closure, target, [(e, theta) for e, theta, _ in effects]) for target in targets(closure.problem)]
    learnt = [_learnt(closure, number, *effect) for number, effect in enumerate(effects)]
    rows = [_one(closure, design, one) for one in learnt for design in designs]
    return rows + [_known(one, design.target) for one in closure.stochastic for design in designs]


class _Design:
    """A target with its chain, whitening, and what is re-estimated there."""

    def __init__(self, closure: Closure, target: Target, chosen: Sequence[Active]) -> None:
        self.target, self.chain = target, Chain(target.setting)
        self.base = [*closure.problem.frozen, *closure.modelled]
        self.chosen = list(chosen)
        field = self.chain.signal([*self.base, *chosen]).field_B_nT
        noise = closure.whitener.noise
        self.whitener: Whitener = make_whitener(
            turn_images(field, closure.problem.sensor_image), target.setting.seconds, target.segment, noise
        )
        self.nuisance = jacobians(self.chain, closure.modelled, [*closure.problem.frozen, *chosen])
        self.nuisance_white = self.whitener.apply(self.nuisance) if closure.modelled else self.nuisance
        self.basis = orthonormal(self.nuisance_white)
        self.floor_nT = floor_rms_nT(field, float(np.sqrt(np.mean(noise.white_nT**2))), noise.theta_rad)

    def reading(self, old: SignalEffect, new: Sequence[Active]) -> FloatArray:
        """(N, 3) noise-free reading with `new` in place of the effect `old`."""
        others = [pair for pair in self.chosen if pair[0] is not old]
        return self.chain.reading_nT([*self.base, *others, *new])

    def left(self, signals: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Signals (N, 3, k) beside what is re-estimated: in nT (N, 3, k), and whitened and projected (3N, k)."""
        white = self.whitener.apply(signals)
        flat = white.reshape(-1, white.shape[2])
        flat = flat - self.basis @ (self.basis.T @ flat)
        return visible_part(signals, white, self.nuisance, self.nuisance_white), flat


def _one(closure: Closure, design: _Design, learnt: Learnt) -> Transfer:
    effect, name = learnt.effect, design.target.name
    why = closure.incomplete or effect.bound
    lost = effect.untestable(design.target.setting)
    if why is None and learnt.unseen:
        why = f"these data did not excite {', '.join(learnt.unseen)}"
    if why is not None:
        return Transfer(effect.name, name, False, None, None, design.floor_nT, None, why)
    if lost is not None:
        return Transfer(effect.name, name, True, 0.0, 0.0, design.floor_nT, None, f"it does not act there: {lost}")
    raw, white = design.left(_errors(design, learnt))
    spread: FloatArray = np.asarray(np.linalg.eigvalsh(white.T @ white), dtype=np.float64)
    rank = max(int((spread > _SEEN).sum()), 1)
    unsure_nT = float(np.sqrt(np.sum(raw**2) / raw[:, :, 0].size))
    bar = float(chi2.isf(GATE / closure.tested, rank))
    chance = _seen_by_chance(spread[spread > _SEEN], bar)
    whole, wrong_name = float(spread.sum()), ""
    share = 1.0 - sum(other.weight for other in learnt.others)
    total = share * chance
    mine = design.reading(effect, [(effect, learnt.theta)])
    for other in learnt.others:
        raw, white = design.left((design.reading(effect, [(other.effect, other.theta)]) - mine)[:, :, None])
        size = float(np.sum(white**2))
        seen = float(ncx2.sf(bar, rank, max(size, 1e-12)))
        total += other.weight * seen
        unsure_nT = float(np.hypot(unsure_nT, np.sqrt(other.weight * np.mean(raw**2))))
        whole += other.weight * size
        if other.weight * seen > MOST_CHANCE / 2 and not wrong_name:
            wrong_name = other.label
    detectable = unsure_nT * float(np.sqrt(noncentrality(rank, closure.tested) / whole)) if whole > _SEEN else None
    good = total <= MOST_CHANCE
    return Transfer(
        effect.name, name, good, total, unsure_nT, design.floor_nT, detectable, "" if good else _reason(wrong_name)
    )


def _reason(wrong_name: str) -> str:
    if wrong_name:
        return f"it may as well be {wrong_name} in these data, which differs there"
    return "the error of its parameters would show there"


def _label(effect: SignalEffect, other: SignalEffect) -> str:
    """The other name, or the settings in which it differs."""
    if other.name != effect.name:
        return other.name
    changed = {key: value for key, value in settings_of(other).items() if settings_of(effect).get(key) != value}
    words = [f"{key} {value:.3g}" if isinstance(value, float) else f"{key} {value}" for key, value in changed.items()]
    return f"{other.name} with {', '.join(words)}" if words else other.name


def _errors(design: _Design, learnt: Learnt) -> FloatArray:
    """(N, 3, k) what one sigma along each direction of the parameters changes in the reading."""
    low = np.array([parameter.low for parameter in learnt.effect.parameters])
    high = np.array([parameter.high for parameter in learnt.effect.parameters])
    columns = []
    for step in learnt.directions.T:
        up, down = (np.clip(learnt.theta + sign * step, low, high) for sign in (1.0, -1.0))
        both = [design.reading(learnt.effect, [(learnt.effect, theta)]) for theta in (up, down)]
        columns.append((both[0] - both[1]) / 2.0)
    return np.stack(columns, axis=-1)


def _seen_by_chance(spread: FloatArray, bar: float) -> float:
    """P(sum (1 + l_i) z_i^2 > bar), z standard normal: the score of an error with covariance l over noise."""
    if not spread.size:
        return 0.0
    z2 = np.random.default_rng(0).chisquare(1.0, size=(_DRAWS, spread.size))
    return float(np.mean(z2 @ (1.0 + spread) > bar))


def _learnt(closure: Closure, number: int, effect: SignalEffect, theta: FloatArray, covariance: FloatArray) -> Learnt:
    known = np.isfinite(np.diag(covariance))
    unseen = tuple(p.name for p, seen in zip(effect.parameters, known, strict=True) if not seen)
    directions = np.zeros((theta.size, 1))
    if known.any():
        values, vectors = np.linalg.eigh(covariance[np.ix_(known, known)])
        directions = np.zeros((theta.size, int(known.sum())))
        directions[known] = vectors * np.sqrt(np.maximum(values, 0.0))
    others = () if effect.bound or closure.incomplete else _others(closure, number)
    return Learnt(effect, theta, directions, unseen, others)


def _others(closure: Closure, number: int) -> tuple[Other, ...]:
    """What might stand in the place of a named effect, refitted, with posterior weights exp(-BIC / 2)."""
    problem, effect = closure.problem, closure.chosen[number][0]
    own = refit(Readings(problem, closure.whitener), closure.chosen, modelled=closure.modelled)
    samples = max(closure.whitener.measured / 3.0, 2.0)
    found: list[Other] = []
    for other in closure.alternatives[number][:_MOST_TRIALS]:
        trial = list(closure.chosen)
        trial[number] = (other, np.zeros(len(other.parameters)))
        fit = refit(Readings(problem, closure.whitener), trial, modelled=closure.modelled)
        worse = (fit.chi2 - own.chi2) / closure.variance + (fit.rank_chosen - own.rank_chosen) * np.log(samples)
        weight = float(np.exp(-0.5 * np.clip(worse, -100.0, 1400.0)))
        if weight > _UNLIKELY:
            rest = [pair for place, pair in enumerate(fit.chosen) if place != number]
            reading = problem.chain.reading_nT([*problem.frozen, *fit.modelled, *rest])
            pinned = other.pinned(problem.setting, reading)
            assert isinstance(pinned, SignalEffect) and isinstance(effect, SignalEffect)
            found.append(Other(weight, _label(effect, other), pinned, fit.chosen[number][1]))
    total = 1.0 + sum(one.weight for one in found)
    return tuple(dataclasses.replace(one, weight=one.weight / total) for one in found)


def _known(one: FoundEffect, target: Target) -> Transfer:
    """An effect that is known by its distribution: a property of the instrument, or a path that never comes again."""
    bound = None if one.effect is None else one.effect.bound
    owner = "body" if one.stage == "dynamics" else "readings"
    why = bound or f"a property of the {owner}, not of the orbit: its size is carried over"
    return Transfer(one.name, target.name, bound is None, None, None, None, None, why)
