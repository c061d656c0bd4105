"""What one noise model leads to: explanations with one cause more each, weighed against each other.

An explanation names none, one, two or three effects. What it leaves is noise, the shape error of its effects, or
something unknown; each has its worth by the one criterion. The noise is chosen beside each explanation, and each has the
noise that suits it best: a slow attitude error may be what another takes for a cause.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import Any

import numpy as np
from scipy.special import softmax

from fluxtwin.gap.detectors.finding import Finding
from fluxtwin.gap.detectors.lines import multiples
from fluxtwin.gap.detectors.residual_structure import Structure, judge
from fluxtwin.gap.hypotheses.blocks import Dictionary
from fluxtwin.gap.hypotheses.candidates import Candidate
from fluxtwin.gap.linear.projection import left_beside, projected
from fluxtwin.gap.noise.choice import (
    NoiseModel,
    RobustRows,
    Whitener,
    choose_noise,
    complete_budget,
    noise_beside,
    prior_of,
    whitener_of,
)
from fluxtwin.gap.problem.problem import Problem
from fluxtwin.gap.selection.criterion import LOG_FURTHER, SHAPE, SHAPE_DIRECTIONS, THRESHOLD, penalty, worth_of_shape
from fluxtwin.gap.selection.forward import Parameters, Search, begin, run, without
from fluxtwin.gap.selection.refit import Fit, Readings
from fluxtwin.gap.selection.score import Board
from fluxtwin.gap.selection.search import SearchResult, by_gain, result_of
from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.effects.base import Effect, SignalEffect
from fluxtwin.sim.effects.chain import Active

Known = tuple[list[Candidate], dict[str, str]]
"""What `candidates` gives for a problem."""
_Searched = tuple[Search[Readings], dict[str, str], list[tuple[Fit, Board]]]
"""A search, names that cannot be tested with the reason, and the path that it took."""
OneCause = Callable[[Effect, Effect], bool]
"""Whether two effects, as they are set, are one cause."""
ROUNDS = 2
"""Of a search, each beside what the one before found, if the names do not stay before."""


@dataclass(frozen=True, eq=False)
class Explanation:
    """Named effects at their refit, and what is left beside them."""

    fit: Fit
    beside: Board
    """Scores of all others."""
    left: Structure
    worth: float
    """Of its names, against none."""
    unknown: float
    """Of its names and of what is left, taken for something that the catalogue does not have; minus infinity where what is
    left is no more than noise and shape error."""


@dataclass(frozen=True, eq=False)
class Weighed:
    """A search and the explanation of it that weighs most, before the names in it are weighed against others."""

    searched: _Searched
    chosen: Explanation
    known: float
    """As in `Answer`, and so are the next two."""
    worth: float
    handicap: float

    def left(self, problem: Problem, shapes: Sequence[Finding]) -> tuple[FloatArray, FloatArray]:
        """Residual (N, 3) with the shapes in it, and columns (N, 3, q) of all that was fitted."""
        fit = self.chosen.fit
        modelled, order = fit.modelled[: len(problem.modelled)], by_gain(self.searched[0], fit)
        active = [*modelled, *(fit.chosen[number] for number in order)]
        signals = problem.derivatives(signals_of(shapes))
        return problem.residual_of(active), np.concatenate([problem.derivatives(active), signals], axis=2)


@dataclass(frozen=True, eq=False)
class Answer:
    """All explanations under one noise model, and the one that weighs most."""

    noise: NoiseModel
    robust: RobustRows
    whitener: Whitener
    result: SearchResult
    """Of the explanation that weighs most."""
    alone_nT: FloatArray
    """(N, 3, C) Jacobian of what is modelled."""
    fitted_nT: FloatArray
    """(N, 3, C + P) and of the named effects."""
    left: Structure
    known: float
    """Probability that nothing, or what is named, is all there is."""
    worth: float
    """Of the explanation that weighs most, in its best reading."""
    handicap: float = 0.0
    """Twice the log likelihood that another noise model gives to an explanation without names."""
    shapes: tuple[Finding, ...] = ()
    """Causes that are known by their own shape: a line, a sequence, a region, a walk."""
    fitted: Parameters = field(default_factory=dict)
    """All that was fitted on the way."""


def weighed_with(
    problem: Problem,
    robust: RobustRows,
    whitener: Whitener,
    dictionary: Dictionary,
    known: Known,
    shapes: Sequence[Finding],
    earlier: Parameters | None = None,
) -> Weighed:
    """The search under one whitening, beside shapes: those that are signals are fitted in every test."""
    searched = _searched(_beside(problem, signals_of(shapes)), whitener, known, earlier)
    return _weighed(robust, searched, dictionary, ())


def _searched(problem: Problem, whitener: Whitener, known: Known, earlier: Parameters | None = None) -> _Searched:
    found, untestable = known
    under_way = begin(Readings(problem, whitener), found, earlier=earlier)
    return under_way, untestable, run(under_way)


def _weighed(robust: RobustRows, searched: _Searched, dictionary: Dictionary, others: Sequence[NoiseModel]) -> Weighed:
    """others: noise models that an explanation may have as well."""
    under_way, _, path = searched
    lefts = structures_left(under_way, [fit for fit, _ in path], dictionary)
    gained = _gained(under_way, [fit for fit, _ in path], others, robust)
    explanations = weighed(under_way, path, lefts, gained)
    best, share, total = likeliest(explanations, under_way.one_cause)
    return Weighed(searched, explanations[best], share, total, gained[0])


def concluded(problem: Problem, robust: RobustRows, found: Weighed, shapes: tuple[Finding, ...] = ()) -> Answer:
    """The answer that a weighed search with these shapes leads to."""
    (under_way, untestable, _), chosen = found.searched, found.chosen
    whitener = under_way.channel.whitener
    result = result_of(under_way, untestable, chosen.fit, chosen.beside, len(problem.modelled))
    alone, (_, fitted) = problem.derivatives(result.modelled_alone), found.left(problem, shapes)
    rest = (chosen.left, found.known, found.worth, found.handicap, shapes, under_way.parameters)
    return Answer(whitener.noise, robust, whitener, result, alone, fitted, *rest)


def likeliest(explanations: Sequence[Explanation], one_cause: OneCause) -> tuple[int, float, float]:
    """The explanation that weighs most, the probability that nothing unknown is there, and the most worth.

    one_cause: whether two effects are one, as `Search.one_cause` has it.
    """
    logs = np.array([[one.worth, one.unknown] for one in explanations])
    for place, (one, more) in enumerate(pairwise(explanations)):
        if _added(one_cause, one.fit, more.fit) == 1 and not np.isfinite(more.unknown):
            logs[place, 1] = -np.inf  # the catalogue has it
    if not np.max(logs) > THRESHOLD:
        return 0, 1.0, float(np.max(logs))
    named = logs.copy()
    named[0, 0] = -np.inf  # something is there
    known = min(1.0, float(softmax(0.5 * named)[:, 0].sum()))  # rounding may leave a digit above one
    column = 0 if known >= 0.5 else 1
    return int(np.argmax(named[:, column])), known, float(np.max(logs))


def _added(one_cause: OneCause, one: Fit, more: Fit) -> int:
    """How many causes a fit has that another has not, in whatever settings."""
    known = [effect for effect, _ in one.chosen]
    return len({effect.name for effect, _ in more.chosen if not any(one_cause(effect, other) for other in known)})


def weighed(
    under_way: Search[Any], path: Sequence[tuple[Fit, Board]], lefts: Sequence[Structure], gained: Sequence[float]
) -> list[Explanation]:
    """Each step of a path with its worth, what is left beside it, and what it gains by the noise that suits it best."""
    samples = under_way.samples
    explained = [max(path[0][0].chi2 - fit.chi2, 0.0) for fit, _ in path]
    beyond = [left.drop if left.structured else 0.0 for left in lefts]
    one_more = [_added(under_way.one_cause, one, more) == 1 for (one, _), (more, _) in pairwise(path)]
    for place in reversed(range(len(one_more))):
        # What one more name explains is better known by its refit than by the finding that led to it.
        further = explained[place + 1] - explained[place] + beyond[place + 1]
        beyond[place] = further if one_more[place] else max(beyond[place], further)
    found: list[Explanation] = []
    names = 0.0
    for place, ((fit, beside), left) in enumerate(zip(path, lefts, strict=True)):
        if place:
            names = _worth_of_names(under_way, fit, names if one_more[place - 1] else None, path[place - 1][0])
        # What one more name takes away whole is in its direction alone.
        whole = place < len(one_more) and one_more[place] and not lefts[place + 1].structured
        seen = max(beyond[place], left.drop) if whole else beyond[place]
        shaped = names + worth_of_shape(seen, explained[place], SHAPE_DIRECTIONS if whole else max(left.rank, 1))
        worth = max(shaped, names + gained[place]) - gained[0]
        unknown = -np.inf
        apart = left.beyond(explained[place], samples) if left.structured and not left.of_named else -np.inf
        if apart > LOG_FURTHER:
            unknown = shaped + apart - LOG_FURTHER - gained[0]
        found.append(Explanation(fit, beside, left, worth, unknown))
    return found


def _worth_of_names(under_way: Search[Any], fit: Fit, known: float | None, before: Fit) -> float:
    """Worth of the names of a fit: that of all but one, and of this one beside them.

    known: that of `before`, which has all but one of its names; None: it has others, and the fit is compared with the best
    of its own that has one name less.
    """
    if known is None:
        fewer = [without(under_way, fit, number) for number in range(len(fit.chosen))]
        before = min(fewer, key=lambda one: one.chi2)
        known = _worth_of_names(under_way, before, None, before) if before.chosen else 0.0
    less, more = under_way.base.chi2 - before.chi2, before.chi2 - fit.chi2
    wider = 1.0 + SHAPE * max(less, 0.0)
    price = penalty(fit.rank_chosen - before.rank_chosen, more / wider, under_way.samples)
    further = LOG_FURTHER if before.chosen else 0.0
    return known + more - float(price) - 2.0 * float(np.log(under_way.tested)) - further


def _gained(
    under_way: Search[Readings], fits: Sequence[Fit], others: Sequence[NoiseModel], robust: RobustRows
) -> list[float]:
    """Twice the log likelihood that each fit wins by the best of other noise models; none is below zero."""
    problem, noise = under_way.channel.problem, under_way.channel.whitener.noise
    if not others or len(fits) < 2:
        return [0.0] * len(fits)
    gained = []
    for fit in fits:
        residual = problem.residual_of(fit.active)
        columns = problem.derivatives(fit.active)
        logs = [log_likelihood(problem, one, robust, residual, columns) for one in (noise, *others)]
        gained.append(max(logs) - logs[0])
    return gained


def log_likelihood(
    problem: Problem, noise: NoiseModel, robust: RobustRows, residual_nT: FloatArray, columns: FloatArray
) -> float:
    """Twice the log likelihood of a residual (N, 3) with columns (N, 3, c) fitted, and of the noise by its budget."""
    whitener = whitener_of(problem, noise, robust.weights)
    density = prior_of(complete_budget(problem)).log_density(noise.sigma_nT, noise.theta_rad, noise.tau_s)
    return 2.0 * density - whitener.log_det - projected(whitener, residual_nT, columns).energy


@dataclass(frozen=True, eq=False)
class Sought:
    """Noise models and the search under the last of them; of what is left beside its names nothing is asked yet."""

    robust: RobustRows
    searched: _Searched
    others: Sequence[NoiseModel]
    """Noise models that an explanation may have as well."""


def noise_and_search(problem: Problem, known: Known, earlier: Parameters | None = None) -> Sought:
    """The noise beside what is modelled, the search under it; then the noise beside the named effects too, and the search
    under that, in turn until the names stay.

    The noise is that of the model as it stands, never beside everything that might be there: some hundred columns can
    make up any slow error of the attitude, and what they leave would be taken for all there is.
    """
    first = choice = choose_noise(problem)
    searched = _searched(problem, whitener_of(problem, choice.noise, choice.robust.weights), known, earlier)
    for _ in range(ROUNDS):
        fit = searched[2][-1][0]
        if not fit.chosen:
            break
        choice = noise_beside(problem, fit.active)
        earlier = searched[0].parameters
        del searched  # there is room for one
        searched = _searched(problem, whitener_of(problem, choice.noise, choice.robust.weights), known, earlier)
        if {effect for effect, _ in searched[2][-1][0].chosen} == {effect for effect, _ in fit.chosen}:
            break
    return Sought(choice.robust, searched, [] if choice is first else [first.noise])


def answered(problem: Problem, sought: Sought, dictionary: Dictionary) -> Answer:
    """What a search says, where structure that is left is looked for with this dictionary."""
    return concluded(problem, sought.robust, _weighed(sought.robust, sought.searched, dictionary, sought.others))


def signals_of(shapes: Sequence[Finding]) -> list[Active]:
    """Those that a fit can have, with the parameters they were found with."""
    return [(one.effect, one.theta) for one in shapes if one.is_signal]


def without_names(problem: Problem, answer: Answer) -> FloatArray:
    """(N, 3, c) Jacobian of what is modelled and of the shapes that are signals."""
    return np.concatenate([answer.alone_nT, problem.derivatives(signals_of(answer.shapes))], axis=2)


def structures_left(under_way: Search[Readings], fits: Sequence[Fit], dictionary: Dictionary) -> list[Structure]:
    """The structure that each fit leaves, beyond what the size of its effects changes of their images.

    A line that is a multiple of a fitted wheel's turning is looked beyond.
    """
    problem, whitener = under_way.channel.problem, under_way.channel.whitener
    images = [fit.jacobian[:, :, fit.free] for fit in fits]
    changes = [_changes(under_way, fit) for fit in fits]
    owns = [fit.jacobian[:, :, fit.jacobian.shape[2] - sum(len(theta) for _, theta in fit.chosen) :] for fit in fits]
    rests = [left_beside(whitener, fit.residual, *both) for fit, *both in zip(fits, images, changes, strict=True)]
    lefts = [judge(problem, *one, 1.0) for one in zip(rests, dictionary.fits_each(rests), owns, strict=True)]
    for place, (fit, own) in enumerate(zip(fits, owns, strict=True)):
        if lefts[place].kind == "tone" and (lines := multiples(problem.setting, fit.active)).size:
            image = np.concatenate([images[place], whitener.apply(lines)], axis=2)
            rest = left_beside(whitener, fit.residual, image, changes[place])
            past = judge(problem, rest, dictionary.fits(rest), own, 1.0)
            lefts[place] = past if past.structured else replace(lefts[place], of_named=True)
    return lefts


def _changes(under_way: Search[Readings], fit: Fit) -> FloatArray:
    """(M, 3, p) by how much the whitened images of a fit's effects at nothing differ from those at their size: as much again
    may be left, where the attitude in both has errors."""
    found = [np.zeros((*fit.residual.shape, 0))]
    for number, (_, theta), where in zip(under_way.numbers(fit), fit.chosen, fit.slices(), strict=True):
        live = under_way.found[number].live
        at_nothing = under_way.white[:, :, under_way.first.owner == number]
        found.append((at_nothing - fit.jacobian[:, :, where][:, :, live]) * theta[live])
    return np.concatenate(found, axis=2)


def _beside(problem: Problem, signals: Sequence[Active]) -> Problem:
    """The problem with further signals among what is re-estimated."""
    if not signals:
        return problem
    every = [*problem.modelled_active, *signals]
    effects = tuple(effect for effect, _ in every if isinstance(effect, SignalEffect))
    return replace(problem, modelled=effects, modelled_theta=tuple(theta for _, theta in every))
