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
from scipy.stats import ncx2

from fluxtwin.gap.held_out.held_out import floor_rms_nT
from fluxtwin.gap.held_out.targets import Target, targets
from fluxtwin.gap.hypotheses.candidates import settings_of
from fluxtwin.gap.linear.projection import orthonormal
from fluxtwin.gap.noise.whitening import Whitener, make_whitener
from fluxtwin.gap.problem.row_axes import turn_images
from fluxtwin.gap.records.diagnosis import Closure, FoundEffect, Transfer
from fluxtwin.gap.selection.criterion import samples_of
from fluxtwin.gap.selection.detectable import Rule, visible_part
from fluxtwin.gap.selection.refit import Readings, refit
from fluxtwin.gap.selection.search import WORTH_SAYING
from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.effects.base import SignalEffect
from fluxtwin.sim.effects.chain import Active, Chain, jacobians

MOST_CHANCE = 0.05
"""Of a false gap on the other design: more, and the parameters do not transfer."""
_DRAWS = 20_000
"""A chance of 0.05 is then good to 0.0015."""
_ABSORBED = 1e-9
"""Whitened energy of an error that what is re-estimated absorbs: rounding."""
_MOST_TRIALS = 8
"""Refits of what might be in the place of a named effect."""


@dataclass(frozen=True, eq=False)
class Other:
    """What might be in the place of a named effect, as refitted there."""

    weight: float
    label: str
    effect: SignalEffect
    theta: FloatArray


def transfers(closure: Closure, effects: Sequence[tuple[SignalEffect, FloatArray, FloatArray]]) -> list[Transfer]:
    """For each named effect (as pinned, parameters (p,), covariance (p, p)) and each target, whether it transfers."""
    designs = [_Design(closure, target, [(e, theta) for e, theta, _ in effects]) for target in targets(closure.problem)]
    rows = []
    for number, (effect, theta, covariance) in enumerate(effects):
        known = np.isfinite(np.diag(covariance))
        unseen = [p.name for p, seen in zip(effect.parameters, known, strict=True) if not seen]
        why = closure.incomplete or effect.bound
        if why is None and unseen:
            why = f"these data did not excite {', '.join(unseen)}"
        others = _others(closure, number) if why is None else ()
        for design in designs:
            name, lost = design.target.name, effect.untestable(design.target.setting)
            if why is not None:
                rows.append(Transfer(effect.name, name, False, None, None, design.floor_nT, None, why))
            elif lost is not None:
                lost = f"it has no effect there ({lost})"
                rows.append(Transfer(effect.name, name, True, 0.0, 0.0, design.floor_nT, None, lost))
            else:
                rows.append(_one(closure.tested, design, effect, theta, covariance, others))
    return rows + [_known(one, design.target) for one in closure.stochastic for design in designs]


class _Design:
    """A target with its chain, whitening, and what is re-estimated there."""

    def __init__(self, closure: Closure, target: Target, chosen: Sequence[Active]) -> None:
        self.target, self.chain = target, Chain(target.setting)
        self.base = [*closure.problem.frozen, *closure.modelled]
        self.chosen = list(chosen)
        field = self.chain.signal([*self.base, *chosen]).field_B_nT
        noise = closure.whitener.noise
        images = turn_images(field, closure.problem.sensor_image)
        self.whitener: Whitener = make_whitener(images, target.setting.seconds, target.segment, noise)
        self.nuisance = jacobians(self.chain, closure.modelled, [*closure.problem.frozen, *chosen])
        self.nuisance_white = self.whitener.apply(self.nuisance) if closure.modelled else self.nuisance
        self.basis = orthonormal(self.nuisance_white)
        self.floor_nT = floor_rms_nT(field, noise.white_rms_nT, noise.theta_rad)

    def reading(self, old: SignalEffect, new: SignalEffect, theta: FloatArray) -> FloatArray:
        """(N, 3) noise-free reading with the effect `new` in place of `old`."""
        others = [pair for pair in self.chosen if pair[0] is not old]
        return self.chain.reading_nT([*self.base, *others, (new, theta)])

    def projected(self, signals: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Signals (N, 3, k) after projecting out what is re-estimated: in nT (N, 3, k), and whitened (3N, k)."""
        white = self.whitener.apply(signals)
        flat = white.reshape(-1, white.shape[2])
        visible = visible_part(signals, white, self.nuisance, self.nuisance_white)
        return visible, flat - self.basis @ (self.basis.T @ flat)


def _one(
    tested: int,
    design: _Design,
    effect: SignalEffect,
    theta: FloatArray,
    covariance: FloatArray,
    others: Sequence[Other],
) -> Transfer:
    """By the errors of the parameters, and by what else the effect may be: both as a diagnosis there would see them."""
    raw, white = design.projected(_errors(design, effect, theta, covariance))
    spread: FloatArray = np.asarray(np.linalg.eigvalsh(white.T @ white), dtype=np.float64)
    seen = spread[spread > _ABSORBED]
    rank = max(seen.size, 1)
    rule = Rule(rank, tested, samples_of(design.whitener.measured))
    bar = rule.least_drop
    unsure2, energy = float(np.sum(raw**2) / raw[:, :, 0].size), float(spread.sum())
    chance = (1.0 - sum(other.weight for other in others)) * _seen_by_chance(seen, bar)
    reading = design.reading(effect, effect, theta)
    wrong_name = ""
    for other in others:
        raw, white = design.projected((design.reading(effect, other.effect, other.theta) - reading)[:, :, None])
        own = float(np.sum(white**2))
        added = other.weight * float(ncx2.sf(bar, rank, max(own, 1e-12)))
        chance += added
        unsure2 += other.weight * float(np.mean(raw**2))
        energy += other.weight * own
        wrong_name = wrong_name or (other.label if added > MOST_CHANCE / 2 else "")
    unsure_nT = float(np.sqrt(unsure2))
    detectable = unsure_nT * float(np.sqrt(rule.noncentrality / energy)) if energy > _ABSORBED else None
    why = f"it may as well be {wrong_name} in these data, and that would differ there"
    why = why if wrong_name else "the error of its parameters would show there"
    good = chance <= MOST_CHANCE
    sizes = (chance, unsure_nT, design.floor_nT, detectable)
    return Transfer(effect.name, design.target.name, good, *sizes, "" if good else why)


def _label(effect: SignalEffect, other: SignalEffect) -> str:
    """The other name, or the settings in which it differs."""
    if other.name != effect.name:
        return other.name
    changed = {key: value for key, value in settings_of(other).items() if settings_of(effect).get(key) != value}
    words = [f"{key} {value:.3g}" if isinstance(value, float) else f"{key} {value}" for key, value in changed.items()]
    return f"{other.name} with {', '.join(words)}" if words else other.name


def _errors(design: _Design, effect: SignalEffect, theta: FloatArray, covariance: FloatArray) -> FloatArray:
    """(N, 3, k) what one sigma along each principal direction of the parameters changes in the reading."""
    values, vectors = np.linalg.eigh(covariance)
    low, high = (np.array([getattr(one, end) for one in effect.parameters]) for end in ("low", "high"))
    columns = []
    for step in (vectors * np.sqrt(np.maximum(values, 0.0))).T:
        up, down = (design.reading(effect, effect, np.clip(theta + by, low, high)) for by in (step, -step))
        columns.append((up - down) / 2.0)
    return np.stack(columns, axis=-1)


def _seen_by_chance(spread: FloatArray, bar: float) -> float:
    """P(sum (1 + l_i) z_i^2 > bar), z standard normal: the score of an error with covariance l over noise."""
    z2 = np.random.default_rng(0).chisquare(1.0, size=(_DRAWS, spread.size))
    return float(np.mean(z2 @ (1.0 + spread) > bar))


def _others(closure: Closure, number: int) -> tuple[Other, ...]:
    """What might be in the place of a named effect, refitted, with posterior weights exp(-BIC / 2)."""
    problem, effect = closure.problem, closure.chosen[number][0]
    readings = Readings(problem, closure.whitener)
    own = refit(readings, closure.chosen, modelled=closure.modelled)
    samples = samples_of(closure.whitener.measured)
    found: list[Other] = []
    for other in closure.alternatives[number][:_MOST_TRIALS]:
        if other.name == effect.name and other.bound:
            continue  # the same error with a rate that no data ask for: what it would do elsewhere is a guess
        trial = list(closure.chosen)
        trial[number] = (other, np.zeros(len(other.parameters)))
        fit = refit(readings, trial, modelled=closure.modelled)
        worse = (fit.chi2 - own.chi2) / closure.variance + (fit.rank_chosen - own.rank_chosen) * np.log(samples)
        weight = float(np.exp(-0.5 * np.clip(worse, -100.0, 1400.0)))
        if weight > WORTH_SAYING:
            reading = problem.reading_nT([*fit.modelled, *fit.others(number)])
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
