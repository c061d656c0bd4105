"""Which effects the gap is made of: what a search that has ended says.

Groups, isolability and the smallest detectable sizes come from the design before the residual is looked at. Every named
effect has its support: rivals are refitted in its place, and its group and its probability count them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from fluxtwin.gap.hypotheses.candidates import Candidate, settings_of
from fluxtwin.gap.linear.projection import orthonormal
from fluxtwin.gap.records.diagnosis import EffectParameter, FoundEffect, Ranked, Score
from fluxtwin.gap.selection.criterion import IN_GROUP, SHAPE, penalty, weight_of
from fluxtwin.gap.selection.detectable import Smallest, smallest, visible_part
from fluxtwin.gap.selection.forward import NONLINEAR, WITHIN, Search, room_for, without
from fluxtwin.gap.selection.refit import Fit, Readings
from fluxtwin.gap.selection.score import Board
from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.effects.base import Effect, SignalEffect
from fluxtwin.sim.effects.chain import Active
from fluxtwin.sim.effects.signal import Setting

WORTH_SAYING = 0.001  # of a rival: a less likely one is neither stated nor tried on other designs


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
        parameters=parameters_of(effect, theta, sigma, setting),
        settings=settings_of(effect) | ({"assumed": assumed} if (assumed := effect.stands_in(setting)) else {}),
        stage=effect.stage,
        axis=axis,
        frame=effect.frame,
        condition=effect.condition_on(setting),
        significance=backing.p_value,
        visible_nT=visible_nT,
        effect=effect,
        covariance=covariance,
    )


def parameters_of(effect: Effect, theta: FloatArray, sigma: FloatArray, setting: Setting) -> dict[str, EffectParameter]:
    """By name: values and sigmas (p,) with their units on a design; a sigma that is not finite is not known."""
    return {
        one.name: EffectParameter(float(value), float(spread) if np.isfinite(spread) else None, one.unit)
        for one, value, spread in zip(effect.parameters_on(setting), theta, sigma, strict=True)
    }


def axis_of(energy: FloatArray) -> str | None:
    """The axis that has four fifths of an energy (3,), "all" where none has (a judgement, for words); None where the data
    do not separate the axes."""
    if not np.isfinite(energy).all():
        return None
    axis = int(np.argmax(energy))
    return "xyz"[axis] if energy[axis] >= 0.8 * max(float(energy.sum()), 1e-300) else "all"


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
    fit: Fit
    """With the named effects, in the order of the search."""
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


def result_of(
    under_way: Search[Readings], untestable: dict[str, str], fit: Fit, rest: Board, modelled: int
) -> SearchResult:
    """All that later steps need of a search that ended with a fit. rest: scores beside it; modelled: how many effects are
    re-estimated, those after them are causes. The probability of a name is that of its group given that named effects are
    all there is."""
    first, base, problem = under_way.first, under_way.base, under_way.channel.problem
    raw_nuisance = problem.derivatives(base.modelled)
    seen, hidden = smallest(first, under_way.tested)
    named = [_named(under_way, fit, number, rest.variance, raw_nuisance) for number in range(len(fit.chosen))]
    residual, alone = (problem.residual_of([*each.modelled[:modelled], *each.chosen]) for each in (fit, base))
    return SearchResult(
        named=tuple(named[number] for number in by_gain(under_way, fit)),
        ranking=ranking(under_way),
        untestable={**untestable, **hidden},
        isolability=first.isolability,
        smallest=seen,
        candidates=tuple(under_way.found),
        modelled=fit.modelled[:modelled],
        modelled_alone=base.modelled[:modelled],
        residual_nT=residual,
        residual_alone_nT=alone,
        fit=fit,
        variance=rest.variance,
        scores=_scores(under_way, first, rest if fit.chosen else None),
        tested=under_way.tested,
    )


def _scores(
    under_way: Search[Readings], first: Board, rest: Board | None
) -> tuple[tuple[Score, ...], tuple[Score, ...]]:
    """What the record says of each candidate, and beside the named effects if there are any; where an image is made of
    attitudes, also how much of it is their errors."""
    lost: dict[str, float] = {}
    for candidate in first.candidates:
        # Less would cost a cause that explains a drop of a thousand one unit of it.
        if len(candidate.scale) == 1 and candidate.change > 1e-3:
            size = candidate.scale
            drop = _chi_square_lost(under_way, (candidate.effect, size), under_way.base.jacobian)
            lost[candidate.label] = drop / float(size[0]) ** 2

    def of(board: Board) -> tuple[Score, ...]:
        return tuple(replace(one, of_errors=lost.get(one.label, 0.0) / board.variance) for one in board.scores())

    alone = of(first)
    return alone, alone if rest is None else of(rest)


def _named(
    under_way: Search[Readings], fit: Fit, number: int, variance: float, raw_nuisance: FloatArray
) -> FoundEffect:
    effect, theta = fit.chosen[number]
    assert isinstance(effect, SignalEffect)
    part = fit.slices()[number]
    signal = _visible(under_way, fit, number, raw_nuisance)
    problem = under_way.channel.problem
    visible, count = problem.in_row_axes(signal), problem.measured.sum()
    covariance = fit.covariance[part, part] * max(variance, 1.0)
    if problem.axes is not None:
        # From the field's size alone some sums of parameters are seen and their parts are not.
        covariance = np.where(fit.seen[part, None] & fit.seen[None, part], covariance, np.nan)
    return found_effect(
        effect,
        theta,
        np.sqrt(np.diag(covariance)),
        problem.setting,
        support(under_way, fit, number, variance),
        axis_of(_axis_energy(under_way, fit, number, signal)),
        float(np.sqrt(np.sum(visible**2) / count)),
        covariance,
    )


def _axis_energy(under_way: Search[Readings], fit: Fit, number: int, signal: FloatArray) -> FloatArray:
    """(3,) energy on each body axis of what an effect leaves, signal (M, 3); NaN where the data do not separate them.

    Rows without attitude see one direction at a time, so there the effect's own vector says which axis, and what the
    others may have within their sigma counts for them.
    """
    energy = np.mean(signal**2, axis=0)
    parameters = fit.chosen[number][0].parameters
    if under_way.channel.problem.axes is not None and len(parameters) > 1:
        part = fit.slices()[number]
        spread = np.where(fit.seen[part], np.diag(fit.covariance)[part], np.nan)
        if [one.name[-2:] for one in parameters] != ["_x", "_y", "_z"]:
            return np.full(3, np.nan)
        energy = fit.chosen[number][1] ** 2
        energy = energy + np.where(np.arange(3) == np.argmax(energy), 0.0, spread)
    return np.asarray(energy)


def _visible(under_way: Search[Readings], fit: Fit, number: int, raw_nuisance: FloatArray) -> FloatArray:
    """(M, 3) signal of one named effect beside the best re-estimation of what is modelled, nT."""
    problem = under_way.channel.problem
    raw = problem.reading_nT(fit.active) - problem.reading_nT([*fit.modelled, *fit.others(number)])
    white = under_way.channel.whitener.apply(raw)
    return visible_part(raw[:, :, None], white[:, :, None], raw_nuisance, under_way.base.jacobian)[:, :, 0]


def by_gain(under_way: Search[Readings], fit: Fit) -> list[int]:
    """The chosen effects of a fit, by how much larger chi-square is without one, all else as it is; the largest first."""

    def chi2(number: int) -> float:
        return float(np.sum(under_way.channel.residual([*fit.modelled, *fit.others(number)]) ** 2))

    return sorted(range(len(fit.chosen)), key=lambda number: -(chi2(number) - fit.chi2))


def ranking(under_way: Search[Any]) -> tuple[Ranked, ...]:
    """Every effect alone, by its best alternative."""
    first: Board = under_way.first
    columns = (first.candidates, first.statistic.tolist(), first.rank.tolist(), first.p_values.tolist())
    lines = [
        Ranked(one.name, drop, rank, min(1.0, under_way.tested * p))
        for one, drop, rank, p in zip(*columns, strict=True)
        if rank
    ]
    best: dict[str, Ranked] = {}
    for line in sorted(lines, key=lambda line: line.order):
        best.setdefault(line.name, line)
    return tuple(best.values())


def support(search: Search[Any], fit: Fit, number: int, variance: float) -> Support:
    """Weigh effect `number` of a fit against everything that might stand in its place, and against nothing.

    Among effects: weights exp(-cost / 2), the cost being that of `Search.cost` with the shape error of what is explained
    beside the noise: of two likenesses of nature the nearer one need not be the true one. Alternatives of one effect are
    added up.
    """
    effect = fit.chosen[number][0]
    bare = without(search, fit, number)
    weights = _weights(search, fit, number, bare, variance)
    present = weights.pop(effect.name)
    total = present + sum(weights.values())
    posterior = {name: weight / total for name, weight in weights.items()}
    likeliest = sorted(posterior.items(), key=lambda pair: -pair[1])
    alike = [name for name in search.first.alike_to(effect) if name != effect.name]
    likely = [name for name, share in likeliest if share >= IN_GROUP and name not in alike]
    group = (effect.name, *alike, *likely)
    drop, rank = bare.chi2 - fit.chi2, max(fit.rank_chosen - bare.rank_chosen, 1)
    inside = present + sum(weights.get(name, 0.0) for name in group)
    rivals = [(n, float(share)) for n, share in likeliest if n not in group and share >= WORTH_SAYING]
    p_value = min(1.0, search.tested * search.first.p_value(drop, rank))
    return Support(p_value, inside / total, group, tuple(rivals))


def _weights(search: Search[Any], fit: Fit, number: int, bare: Fit, variance: float) -> dict[str, float]:
    """{name: weight} of each effect in the place of effect `number`, whose own weight is near 1."""
    others = fit.others(number)
    taken = {effect.name for effect, _ in others}
    mine = fit.slices()[number]
    kept = [c for c in range(fit.jacobian.shape[2]) if not mine.start <= c < mine.stop]
    # The data with this effect's own signal put back: what the others would have to explain.
    put_back = search.channel.residual([*fit.modelled, *others])
    beside = fit.jacobian[:, :, kept]
    scored = search.scored(put_back, beside)
    # A large effect is not linear: what the others make up for at their own refit says how much it is worth.
    drop_own = max(scored.chi2, bare.chi2) - fit.chi2
    lost_own = _chi_square_lost(search, fit.chosen[number], beside)
    price_own = float(penalty(fit.rank_chosen - bare.rank_chosen, drop_own / variance, search.samples))
    wider = 1.0 + SHAPE * drop_own / variance
    weights: dict[str, float] = {fit.chosen[number][0].name: 1.0}
    trials = []
    for place, candidate in enumerate(search.found):
        if scored.rank[place] == 0 or candidate.name in taken or candidate.effect is fit.chosen[number][0]:
            continue
        price = float(penalty(scored.rank[place], scored.statistic[place] / variance, search.samples)) - price_own
        left = scored.chi2 - scored.statistic[place]
        trials.append(((left - fit.chi2) / variance / wider + price, place, price))
    refitted: list[str] = []
    for worse, place, price in sorted(trials):
        name = search.found[place].name
        if room_for(name, refitted) and worse < WITHIN + NONLINEAR * drop_own / variance / wider:
            refitted.append(name)
            present = search.numbers(fit)
            present[number] = place
            start = [theta for _, theta in fit.chosen]
            start[number] = scored.estimate([place])[0]
            there = search.fit(present, start)
            lost = _chi_square_lost(search, there.chosen[number], beside)
            worse = (there.chi2 - lost - fit.chi2 + lost_own) / variance / wider + price
        weights[name] = weights.get(name, 0.0) + float(weight_of(worse))
    return weights


def _chi_square_lost(search: Search[Any], active: Active, beside: FloatArray) -> float:
    """Chi-square that a cause is expected to lose even where it is the true one, because its image is made of an attitude
    with errors (Fuller 1987, Measurement Error Models, section 1.2). beside (M, 3, c): what is refitted with it."""
    blurred = search.channel.blur(active, search.base.modelled)
    if blurred is None:
        return 0.0
    blur, image = blurred
    basis = orthonormal(np.concatenate([beside, image], axis=2))
    flat = blur.reshape(-1)
    left = flat - basis @ (basis.T @ flat)
    return float(left @ left)
