"""Which effects: forward selection by score tests and refits in the nonlinear chain, and backward elimination.

One effect is sought first; others are sought given its refit (a large lag is not linear, and tested at zero it would call
for partners). When one more is significant, pairs (and triples) are ranked afresh, so that a wrong first pick can be
undone; before that, a setting of which only a few values were tried is moved where the data want it. Sets are compared by
the one criterion, with prior 1/K for each effect among K alternatives tested.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations
from typing import Any, Generic, TypeVar

import numpy as np

from fluxtwin.gap.hypotheses.candidates import Candidate
from fluxtwin.gap.linear.projection import SHARE_LEFT, explained
from fluxtwin.gap.selection.criterion import GATE, penalty, samples_of
from fluxtwin.gap.selection.refit import Channel, Fit, refit
from fluxtwin.gap.selection.score import Board, board, whitened
from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.effects.base import Effect, SignalEffect
from fluxtwin.sim.effects.calibration import Step
from fluxtwin.sim.effects.chain import Active
from fluxtwin.sim.effects.signal import Setting
from fluxtwin.sim.effects.switched_field import FLAG

LARGEST = 3
"""Causes, waveforms, or names that an unknown one resembles, at the most."""
WITHIN = 8.0
NONLINEAR = 0.2
"""A candidate is refitted if its linear score comes within the first, or this share, of the best: so much of a drop may be
lost by taking a large effect as linear (8 % of a clock 10 s late, whose linear image is made of an attitude with errors of
its own). Generous, because what it costs is at most four refits."""
BEGINS = 2
"""Fits of some of the effects that a refit of all begins from: a lag may be no help beside a late clock, and a clock one
beside a lag."""
_ALIKE = 1  # decimals of a cost: where causes are alike to rounding, that of the catalogue's order comes first
RATIOS = (1.5, 1.25, 1.12)
"""By which a setting is moved to either side, between the few values of it that were tried."""

Parameters = Mapping[frozenset[str], Sequence[Active]]
"""Of sets of effects that were fitted, by their labels."""

OfChannel = TypeVar("OfChannel", bound=Channel)


@dataclass(eq=False)
class Search(Generic[OfChannel]):
    """A search under way: what it needs, and the fits it has made."""

    channel: OfChannel
    found: list[Candidate]
    base: Fit
    first: Board
    """All candidates beside what is modelled alone."""
    white: FloatArray
    """(M, 3, P) their whitened live columns."""
    gram: FloatArray
    """(P, P) inner products of these."""
    same: dict[str, tuple[str, ...]]
    """Names that imitate each other on this design, from `Board.same`: one cause under two names."""
    tested_before: int
    """Alternatives tested in other channels."""
    fits: dict[frozenset[str], Fit] = field(default_factory=dict)
    earlier: Parameters = field(default_factory=dict)
    """Parameters of sets that were fitted in another noise: near those in this one."""

    def one_cause(self, one: Effect, other: Effect) -> bool:
        """Whether two effects, as they are set here, are one cause: of one name, or of names that imitate each other.

        A field in eclipse and that of an array whose current was not recorded are; beside either a field by a flag is not.
        """
        if one.name == other.name:
            return True
        return other.name in self.same.get(one.name, ()) and self._flag(one) == self._flag(other)

    def _flag(self, effect: Effect) -> str | None:
        """The recorded flag that an effect follows, if it does."""
        setting = self.channel.setting
        condition = None if setting is None else effect.condition_on(setting)
        return condition if condition is not None and condition.startswith(FLAG) else None

    def same_cause(self, numbers: Sequence[int]) -> bool:
        """Whether two of these candidates are one cause under two names."""
        return any(self.one_cause(self.found[a].effect, self.found[b].effect) for a, b in combinations(numbers, 2))

    @property
    def tested(self) -> int:
        return max(self.tested_before + int((self.first.rank > 0).sum()), 1)

    @property
    def samples(self) -> float:
        return samples_of(self.channel.measured)

    def fit(self, numbers: Sequence[int], start: Sequence[FloatArray]) -> Fit:
        """The refit of these candidates, from the best fit of some of them; each set is fitted once."""
        key = frozenset(self.found[number].label for number in numbers)
        if key not in self.fits:
            chosen = [(self.found[number].effect, theta) for number, theta in zip(numbers, start, strict=True)]
            begins: list[tuple[Sequence[Active], FloatArray]]
            if key in self.earlier:
                begins = [(self.earlier[key], self._image(self.base, numbers))]
            else:
                parts = sorted((fit for some, fit in self.fits.items() if some < key), key=lambda one: one.chi2)
                begins = [(part.active, self._image(part, numbers)) for part in (parts or [self.base])[:BEGINS]]
            modelled = self.base.modelled
            fits = [refit(self.channel, chosen, modelled=modelled, near=near, guess=guess) for near, guess in begins]
            self.fits[key] = min(fits, key=lambda one: one.chi2)
        return self.fits[key]

    @property
    def parameters(self) -> Parameters:
        """Of all sets that were fitted, here or earlier."""
        return {**self.earlier, **{key: fit.active for key, fit in self.fits.items()}}

    def _image(self, fit: Fit, numbers: Sequence[int]) -> FloatArray:
        """(M, 3, c + p) whitened Jacobian of what is modelled and of these candidates: that of a fit, or at the base."""
        modelled = sum(len(theta) for _, theta in fit.modelled)
        own = {effect: where for (effect, _), where in zip(fit.chosen, fit.slices(), strict=True)}
        parts = [fit.jacobian[:, :, :modelled]]
        for number in numbers:
            candidate = self.found[number]
            if candidate.effect in own:
                parts.append(fit.jacobian[:, :, own[candidate.effect]])
                continue
            part = np.zeros((*self.white.shape[:2], candidate.live.size))
            part[:, :, candidate.live] = self.white[:, :, self.first.owner == number]
            parts.append(part)
        return np.concatenate(parts, axis=2)

    def cost(self, fit: Fit, variance: float) -> float:
        """chi2 / variance + the price of parameters and names; lower is better."""
        drop = (self.base.chi2 - fit.chi2) / variance
        names = 2 * len(fit.chosen) * np.log(self.tested)
        return float(fit.chi2 / variance + penalty(fit.rank_chosen, drop, self.samples) + names)

    def beside(self, fit: Fit) -> Board:
        """Effects other than those chosen, scored at a refit.

        The residual and what is projected out are those of the refit. The candidates' own images are those at the
        base: a chosen effect changes them little, and whatever is picked is fitted in the nonlinear chain.
        """
        taken = {effect.name for effect, _ in fit.chosen}
        others = [number for number, candidate in enumerate(self.found) if candidate.name not in taken]
        return self.scored(fit.residual, fit.basis).of(others)

    def scored(self, residual: FloatArray, nuisance: FloatArray) -> Board:
        """All candidates against a whitened residual (M, 3), beside a nuisance as `board` has it."""
        measured, share_left = self.channel.measured, self.channel.share_left
        return board(self.found, self.white, residual, nuisance, measured, share_left, self.gram)

    def add(self, effects: Sequence[SignalEffect], fit: Fit | None = None) -> None:
        """Further candidates, and the fit that has them if there is one."""
        more = [self.channel.candidate(effect, self.base.modelled) for effect in effects]
        own = whitened(more, self.channel, self.base.residual.shape[0])
        self.found = [*self.found, *more]
        new = own.reshape(3 * len(own), own.shape[2])
        mixed = self.white.reshape(len(new), -1).T @ new
        self.gram = np.block([[self.gram, mixed], [mixed.T, new.T @ new]])
        self.white = np.concatenate([self.white, own], axis=2)
        self.first = self.scored(self.base.residual, self.base.basis)
        if fit is not None:
            self.fits[frozenset(self.found[number].label for number in self.numbers(fit))] = fit

    def numbers(self, fit: Fit) -> list[int]:
        return [next(n for n, c in enumerate(self.found) if c.effect == effect) for effect, _ in fit.chosen]


def begin(
    channel: OfChannel,
    found: list[Candidate],
    tested_before: int = 0,
    earlier: Parameters | None = None,
) -> Search[OfChannel]:
    """Fit what is modelled, and score every candidate beside it, with those that its residual points to."""
    base = refit(channel)
    steps = {c.name: c.effect for c in found if isinstance(c.effect, Step)}.values()
    jumps = [replace(effect, at=at) for effect in steps for at in channel.jumps(base)]
    found = [*found, *(channel.candidate(effect, base.modelled) for effect in jumps)]
    white = whitened(found, channel, base.residual.shape[0])
    flat = white.reshape(3 * len(white), white.shape[2])
    gram = flat.T @ flat
    first = board(found, white, base.residual, base.basis, channel.measured, channel.share_left, gram)
    return Search(channel, found, base, first, white, gram, first.same, tested_before, earlier=earlier or {})


def run(search: Search[Any]) -> list[tuple[Fit, Board]]:
    """The best sets of none, one, two, three effects, as long as one more is significant and worth it; each with what
    is to be scored beside it."""
    path = [(search.base, search.first)]
    if not search.found or search.tested * float(search.first.p_values.min()) > GATE:
        return path
    names = {candidate.name for candidate in search.found}
    proposed = [effect for effect in search.channel.proposed(search.base) if effect.name in names]
    if proposed:
        search.add(proposed)
    # Started from the linear estimates at zero.
    fits = [search.fit([number], search.first.estimate([number])) for number in _shortlist(search, search.first)]
    fit = min(fits, key=lambda one: round(search.cost(one, search.first.variance), _ALIKE))
    fit, rest = _sharper(search, fit)
    path.append((fit, rest))
    while len(fit.chosen) < LARGEST and (larger := _grown(search, fit, rest)) is not None:
        fit, rest = _sharper(search, larger)
        path.append((fit, rest))
    last = _eliminated(search, fit, rest)
    if last is not fit:
        kept = [pair for pair in path if len(pair[0].chosen) < len(last.chosen)]
        path = [*kept, (last, search.beside(last))]
    return path


def _sharper(search: Search[Any], fit: Fit) -> tuple[Fit, Board]:
    """The fit with settings between the values that were tried, as further candidates, and what is to be scored beside it.

    What a setting that is a little off leaves would be taken for one more cause.
    """
    start, setting = fit, search.channel.setting
    if setting is None:
        return fit, search.beside(fit)
    for number in range(len(start.chosen)):
        while (moved := _neighbour(search, setting, fit, number)) is not fit:
            fit = moved
    for effect, theta in fit.chosen:
        fit = _as_suggested(search, setting, fit, effect, theta)
    old = [effect for effect, _ in start.chosen]
    new = [effect for effect, _ in fit.chosen if isinstance(effect, SignalEffect) and effect not in old]
    new += [one for effect, theta in fit.chosen if effect in new for one in effect.suggested(setting, theta)]
    # What else may have happened at that moment: tried only beside it, another kind of step would seem worse than it is.
    kinds = {c.name: c.effect for c in search.found if isinstance(c.effect, Step)}
    moments = [one for one in new if isinstance(one, Step)]
    new += [replace(kind, at=one.at) for one in moments for name, kind in kinds.items() if name != one.name]
    if new:
        search.add(new, fit)
    return fit, search.beside(fit)


def _as_suggested(search: Search[Any], setting: Setting, fit: Fit, effect: Effect, theta: FloatArray) -> Fit:
    """The fit with what one of its effects suggests in its place, and in that of one of that name, if it is worth more."""
    for other in effect.suggested(setting, theta):
        kept = [pair for pair in fit.chosen if pair[0] != effect and pair[0].name != other.name]
        chosen = [*kept, (other, np.zeros(len(other.parameters)))]
        trial = refit(search.channel, chosen, modelled=search.base.modelled, near=[*fit.modelled, *kept])
        while (moved := _neighbour(search, setting, trial, len(kept))) is not trial:
            trial = moved
        if search.cost(trial, search.first.variance) < search.cost(fit, search.first.variance):
            fit = trial
    return fit


def _neighbour(search: Search[Any], setting: Setting, fit: Fit, number: int) -> Fit:
    """The best fit with the settings of one effect a little beside those it has; itself where none is better."""
    for step in [step for ratio in RATIOS for step in (ratio, 1.0 / ratio)]:
        fit = _with_setting(search, fit, number, fit.chosen[number][0].between(setting, step))
    for place in range(len(fit.chosen[number][0].variants(setting))):
        fit = _with_setting(search, fit, number, fit.chosen[number][0].variants(setting)[place])
    return fit


def _with_setting(search: Search[Any], fit: Fit, number: int, moved: Effect | None) -> Fit:
    """The fit with another setting of one effect, if it is better.

    Looked at first along the images at hand, so that only what will be taken is fitted in the nonlinear chain.
    """
    if not isinstance(moved, SignalEffect):
        return fit
    chosen = [(moved, theta) if place == number else (one, theta) for place, (one, theta) in enumerate(fit.chosen)]
    rest = search.channel.residual([*fit.modelled, *chosen]).reshape(-1)
    if float(np.sum((rest - fit.basis @ (fit.basis.T @ rest)) ** 2)) >= fit.chi2 - 1.0:
        return fit
    trial = refit(search.channel, chosen, modelled=fit.modelled, guess=fit.jacobian)
    return trial if trial.chi2 < fit.chi2 - 1.0 else fit


def _shortlist(search: Search[Any], scored: Board) -> list[int]:
    """Candidates whose linear model is nearly as good as the best one."""
    drop = scored.statistic / scored.variance
    cost = -drop + penalty(scored.rank, drop, search.samples)
    cost = np.where(scored.rank > 0, cost, np.inf)
    window = max(WITHIN, NONLINEAR * float(scored.statistic.max() / scored.variance))
    chosen: list[int] = []
    for number in np.argsort(np.round(cost, _ALIKE), kind="stable"):
        names = [scored.candidates[other].name for other in chosen]
        if cost[number] <= cost.min() + window and room_for(scored.candidates[number].name, names):
            chosen.append(int(number))
    return chosen


def room_for(name: str, refitted: Sequence[str]) -> bool:
    """Whether one more of that name is refitted: at most two alternatives each, of four effects."""
    return refitted.count(name) < 2 and len({name, *refitted}) <= 4


def _grown(search: Search[Any], fit: Fit, rest: Board) -> Fit | None:
    """The best larger set, if one more effect is significant at the refit and worth its price."""
    if not rest.candidates or search.tested * float(rest.p_values.min()) > GATE:
        return None
    present = search.numbers(fit)
    pairs = [(place, search.found.index(rest.candidates[place])) for place in _shortlist(search, rest)]
    pairs = [(place, partner) for place, partner in pairs if not search.same_cause([*present, partner])][:3]
    thetas = [theta for _, theta in fit.chosen]
    trials = [search.fit([*present, partner], [*thetas, rest.estimate([place])[0]]) for place, partner in pairs]
    afresh = _afresh(search, len(present) + 1, present, [partner for _, partner in pairs])
    trials += [search.fit(numbers, search.first.estimate(numbers)) for numbers in afresh]
    if not trials:
        return None
    best = min(trials, key=lambda trial: search.cost(trial, rest.variance))
    gain, rank = fit.chi2 - best.chi2, max(best.rank_chosen - fit.rank_chosen, 1)
    significant = search.tested * rest.p_value(gain, rank) < GATE
    return best if significant and search.cost(best, rest.variance) < search.cost(fit, rest.variance) else None


def _afresh(search: Search[Any], size: int, present: Sequence[int], partners: Sequence[int]) -> list[list[int]]:
    """The two best sets of `size` effects at zero: all pairs; for triples, a beam of pairs with every third."""
    scored = search.first
    if size == 2:
        seeds = [[n] for n in range(len(search.found)) if scored.rank[n] > 0]
    else:
        seeds = [[a, b] for a in [*present, *partners] for b in [*present, *partners] if a < b]
    ranked: list[tuple[float, list[int]]] = []
    for seed in seeds:
        drop, rank = scored.given(seed)
        inside = np.isin(scored.block, seed)
        own, _ = explained(scored.unit_gram[np.ix_(inside, inside)], scored.score[inside], SHARE_LEFT)
        whole = (own + drop) / scored.variance
        cost = -whole + penalty(int(inside.sum()) + rank, whole, search.samples)
        names = {search.found[n].name for n in seed}
        free = [n for n in np.argsort(cost)[:3] if rank[n] > 0 and search.found[n].name not in names]
        ranked += [(float(cost[n]), sorted([*seed, int(n)])) for n in free]
    ranked.sort(key=lambda pair: pair[0])
    distinct: list[list[int]] = []
    for _, numbers in ranked:
        if numbers not in distinct and not search.same_cause(numbers):
            distinct.append(numbers)
    return distinct[:2]


def _eliminated(search: Search[Any], fit: Fit, rest: Board) -> Fit:
    """Effects that the others have made needless are taken out again."""
    while len(fit.chosen) > 1:
        smaller = [without(search, fit, number) for number in range(len(fit.chosen))]
        drops = [(one.chi2 - fit.chi2, max(fit.rank_chosen - one.rank_chosen, 1)) for one in smaller]
        worst = int(np.argmax([rest.p_value(*drop) for drop in drops]))
        needless = search.tested * rest.p_value(*drops[worst]) > GATE
        if not needless and search.cost(smaller[worst], rest.variance) > search.cost(fit, rest.variance):
            break
        fit = smaller[worst]
    return fit


def without(search: Search[Any], fit: Fit, number: int) -> Fit:
    """The refit without one of the chosen effects."""
    left = fit.others(number)
    numbers = [one for place, one in enumerate(search.numbers(fit)) if place != number]
    return search.fit(numbers, [theta for _, theta in left]) if left else search.base
