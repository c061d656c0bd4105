"""A law for what the catalogue does not explain: searched, refitted in the nonlinear chain, and held against what it has
not seen.

It is kept where its coefficients are those of every part of the record (Chow 1960), and where it closes most of what is
left on held-out samples: of one that leaves more, nobody can say that it is what nature does.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from fluxtwin.gap.detectors.residual_structure import PARTS, parts, residual_structure
from fluxtwin.gap.held_out.held_out import floor_rms_nT, predict_blocks
from fluxtwin.gap.law import words
from fluxtwin.gap.law.search import Grammar, Regression
from fluxtwin.gap.linear.projection import projected
from fluxtwin.gap.noise.choice import NoiseChoice, noise_beside, whitener_of
from fluxtwin.gap.noise.whitening import Whitener
from fluxtwin.gap.posterior.explanations import Answer, signals_of, without_names
from fluxtwin.gap.problem.problem import Problem
from fluxtwin.gap.records.diagnosis import Closure, FoundEffect, Law, LawLimit, LawSeries, LawTerm, Shrinkage
from fluxtwin.gap.selection.criterion import LOG_FURTHER, SHAPE, THRESHOLD, worth
from fluxtwin.gap.selection.detectable import noncentrality
from fluxtwin.gap.selection.refit import Fit, Readings, refit
from fluxtwin.sim.base.progress import Progress, silent
from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.effects.chain import Active
from fluxtwin.sim.effects.drivers import orbital_period_s
from fluxtwin.sim.effects.law import Law as LawEffect


@dataclass(frozen=True)
class Weighed:
    """What names and terms explain together, in the noise of the answer."""

    explained: float
    rank: int
    log_tried: float
    causes: int

    def worth(self, wider: float, samples: float) -> float:
        """By the criterion, against nothing."""
        return worth(self.explained / wider, self.rank, samples, self.log_tried) - LOG_FURTHER * (self.causes - 1)


@dataclass(frozen=True, eq=False)
class Lawful:
    """A law with what closing needs of it."""

    record: Law
    chosen: tuple[Active, ...] = ()
    """The names that it stands beside, and then its terms, as refitted together."""
    modelled: tuple[Active, ...] = ()
    alternatives: tuple[tuple[LawEffect, ...], ...] = ()
    """For each of its terms."""
    whitener: Whitener | None = None
    complete: bool = False
    """Whether nothing structured is left beside it."""
    weighed: Weighed | None = None


@dataclass(frozen=True, eq=False)
class _Base:
    """What a law stands beside."""

    named: tuple[Active, ...]
    modelled: tuple[Active, ...]
    residual_nT: FloatArray
    fitted_nT: FloatArray
    """(N, 3, q) Jacobian of all that is fitted."""


def law_of(problem: Problem, answer: Answer, named: Sequence[FoundEffect], progress: Progress = silent) -> Lawful:
    """The law of what named effects (none: of the whole gap) leave, beside them or in their place."""
    progress("the law of what is left", 0.92)
    regression = Regression(problem, Grammar(problem))
    result, alone_nT = answer.result, without_names(problem, answer)
    alone = _Base((), result.modelled_alone, result.residual_alone_nT, alone_nT)
    if not named:
        return _Search(regression, answer, alone, alone).found()
    beside = _Base(result.chosen, result.modelled, result.residual_nT, answer.fitted_nT)
    search = _Search(regression, answer, beside, alone)
    found = search.found()
    progress("the law of the whole gap", 0.95)
    instead = _Search(regression, answer, alone, alone).found()
    now = found.weighed or search.weighed(beside.residual_nT, beside.fitted_nT, 0)
    if instead.weighed is not None:
        most = max(now.explained, instead.weighed.explained)
        wider = 1.0 + SHAPE * max(most - _by_definition(problem, answer), 0.0)
        samples = problem.measured.sum() / 3.0
        if instead.weighed.worth(wider, samples) - LOG_FURTHER > now.worth(wider, samples):
            names = tuple(one.name for one in named)
            return replace(instead, record=words.instead(replace(instead.record, instead_of=names)))
    return found


def _by_definition(problem: Problem, answer: Answer) -> float:
    """Drop of chi-square by names whose form is a definition: a law of more than they say is none of their shape.

    A column may be recorded coarsely or early, so beside names that alone is no reason to look for anything unknown.
    """
    bare = without_names(problem, answer)
    exact = problem.derivatives([one for one in answer.result.chosen if one[0].by_definition])
    both = (bare, np.concatenate([bare, exact], axis=2))
    nothing, drivers = (projected(answer.whitener, answer.result.residual_alone_nT, one).energy for one in both)
    return nothing - drivers


def closed_by(law: Lawful, closure: Closure) -> Closure:
    """A closure with the terms of a law among what is named; itself where none was found."""
    if law.whitener is None:
        return closure
    named = len(law.chosen) - len(law.alternatives)
    return replace(
        closure,
        whitener=law.whitener,
        modelled=law.modelled,
        chosen=law.chosen,
        alternatives=(*closure.alternatives[:named], *law.alternatives),
        incomplete=None if law.complete else "the law is incomplete: structure remains",
    )


@dataclass(frozen=True, eq=False)
class _Search:
    """One search and what is said of it."""

    regression: Regression
    answer: Answer
    base: _Base
    alone: _Base
    """Without any name: against which all are worth something."""

    @property
    def problem(self) -> Problem:
        return self.regression.problem

    def found(self) -> Lawful:
        """The law, or why there is none."""
        answer = self.answer
        choice, whitener = NoiseChoice(answer.noise, answer.robust), answer.whitener
        fit, alike = self._fitted(whitener)
        for _ in range(2):
            if fit is None or _alike(again := noise_beside(self.problem, fit.active), choice):
                break
            choice, whitener = again, whitener_of(self.problem, again.noise, again.robust.weights)
            fit, alike = self._fitted(whitener)
        if fit is None:
            return Lawful(
                self._none(whitener, "no term lowers chi-square by more than the best of so many would by chance")
            )
        return self._lawful(fit, choice, whitener, alike)

    def _fitted(self, whitener: Whitener) -> tuple[Fit | None, list[LawEffect]]:
        """Names and terms in the nonlinear chain, from nothing for the terms: in them it is linear; none where there are no
        terms. And terms that do as well in the place of the first."""
        base, regression = self.base, self.regression
        laws, alike = regression.run(whitener, base.residual_nT, base.fitted_nT)
        had = [effect for effect, _ in self.problem.frozen]
        usual = words.with_names((regression.grammar.usual(law) for law in laws), had)
        terms = [(law, np.zeros(3)) for law in usual]
        chosen = [*base.named, *signals_of(self.answer.shapes), *terms]
        readings = Readings(self.problem, whitener)
        return refit(readings, chosen, modelled=base.modelled) if laws else None, alike

    def _lawful(self, fit: Fit, choice: NoiseChoice, whitener: Whitener, alike: Sequence[LawEffect]) -> Lawful:
        problem, count = self.problem, len(self.base.named) + len(signals_of(self.answer.shapes))
        terms = fit.chosen[count:]
        residual_nT = problem.residual_of(fit.active)
        columns_nT = problem.derivatives(fit.active)
        weighed = self.weighed(residual_nT, columns_nT, len(terms))
        left = projected(whitener, residual_nT, columns_nT)
        samples = left.degrees / 3.0
        own = fit.jacobian[:, :, fit.jacobian.shape[2] - 3 * len(terms) :]
        gap = self._held_out(whitener, choice, residual_nT, columns_nT)
        record = self._record(fit, terms, gap, alike)
        best = words.made_of(record.terms)
        for gain, more in parts(left, own):
            if worth(gain, more, samples, float(np.log(len(PARTS)))) > THRESHOLD + LOG_FURTHER:
                why = "differ from one part of the record to the next"
                return Lawful(self._none(whitener, f"the coefficients of the best one ({best}) {why}"))
        if gap.closed is None or gap.closed < 0.5:  # one that leaves more than it explains is none
            return Lawful(self._none(whitener, f"the best one ({best}) {words.too_little(gap)}"))
        rest = residual_structure(problem, whitener, residual_nT, columns_nT)
        return Lawful(
            replace(record, fitted=self._series(terms, residual_nT)),
            (*fit.chosen[: len(self.base.named)], *terms),
            fit.modelled,
            tuple(tuple(words.with_names(alike)) if number == 0 else () for number in range(len(terms))),
            whitener,
            not (rest.structured and rest.beyond(weighed.explained, samples) > LOG_FURTHER),
            weighed,
        )

    def weighed(self, residual_nT: FloatArray, columns_nT: FloatArray, terms: int) -> Weighed:
        """What names and so many terms explain, with what is left beside them and all that is fitted."""
        whitener, count = self.answer.whitener, len(self.base.named)
        left = projected(whitener, residual_nT, columns_nT)
        bare = projected(whitener, self.alone.residual_nT, self.alone.fitted_nT)
        tried = terms * self.regression.log_tried + count * float(np.log(self.answer.result.tested))
        rank = left.basis.shape[1] - bare.basis.shape[1]
        return Weighed(max(bare.energy - left.energy, 0.0), rank, tried, terms + count)

    def _held_out(
        self, whitener: Whitener, choice: NoiseChoice, residual_nT: FloatArray, columns_nT: FloatArray
    ) -> Shrinkage:
        """As for the names: each block of the record predicted from the others, without the law and with it."""
        problem = self.problem
        kept = ~np.any(choice.robust.cut, axis=1)
        noise, measured = choice.noise, problem.measured[kept]
        floor_nT = floor_rms_nT(problem.noise_field_nT[kept], noise.white_rms_nT, noise.theta_rad, measured, noise.roll)
        fits = ((self.base.residual_nT, self.base.fitted_nT), (residual_nT, columns_nT))
        held = predict_blocks(problem, whitener, kept, floor_nT, *fits)
        # Of over a thousand terms that were tried, one that predicts badly is not excused by being unsure.
        gap = held.shrinkage(True)
        return replace(gap, closed=None, interval=None) if held.of == "fit" else gap

    def _record(self, fit: Fit, terms: Sequence[Active], gap: Shrinkage, alike: Sequence[LawEffect]) -> Law:
        slices = fit.slices()[len(fit.chosen) - len(terms) :]
        variance = max(self.answer.result.variance, 1.0) if self.base.named else 1.0
        found = []
        for (law, theta), part in zip(terms, slices, strict=True):
            assert isinstance(law, LawEffect)
            sigma = np.sqrt(np.diag(fit.covariance)[part] * variance)
            values = {
                axis: (float(k), float(s) if np.isfinite(s) else None)
                for axis, k, s in zip("xyz", theta, sigma, strict=True)
            }
            found.append(LawTerm(law.term, law.of, law.axes, law.delay_s, law.lag_s, words.unit(law), values))
        said = Law(
            terms=found,
            instead_of=(),
            before_nT=gap.before_nT,
            after_nT=gap.after_nT,
            floor_nT=gap.floor_nT,
            closed=gap.closed,
            interval=gap.interval,
            tried=len(self.regression.tried),
            could_be=[one.of for one in alike],
            why_none="",
            looked_at=(),
            sentence="",
        )
        orbits = float(self.problem.setting.seconds[-1]) / orbital_period_s(self.problem.setting)
        return replace(said, sentence=words.sentence(said, bool(self.base.named), orbits))

    def _none(self, whitener: Whitener, why: str) -> Law:
        """What was looked at, and how large each would have had to be."""
        base, regression = self.base, self.regression
        left = projected(whitener, base.residual_nT, base.fitted_nT)
        bar = noncentrality(3, max(len(regression.tried), 1), left.degrees / 3.0)
        limits = []
        for law in regression.plain():
            trial = regression.trial((law,), left)
            if trial is None:
                continue
            visible_nT = float(np.sqrt(bar / np.trace(trial.fit.gram)))  # columns of unit rms, all axes alike
            values = np.asarray(regression.grammar.values(law), dtype=np.float64)
            rms = float(np.sqrt(np.mean(np.square(values))))
            limits.append(LawLimit(law.of[0], visible_nT / rms, words.unit(law), visible_nT))
        share = float(np.sqrt(np.mean(self.problem.in_row_axes(base.residual_nT) ** 2)))
        said = Law((), (), share, share, 0.0, None, None, max(len(regression.tried), 1), (), why, limits, "")
        return replace(said, sentence=words.nothing(said))

    def _series(self, terms: Sequence[Active], residual_nT: FloatArray) -> tuple[LawSeries, ...]:
        """Each term against the residual without it, along its own direction."""
        found, every = [], max(1, self.problem.rows // 4000)
        for law, theta in terms:
            assert isinstance(law, LawEffect)
            size = float(np.linalg.norm(theta))
            values = np.asarray(self.regression.grammar.values(law), dtype=np.float64)
            turned = np.einsum("nij,j->ni", self.regression.carrier.turns[law.axes], theta / size)
            partial = np.einsum("ni,ni->n", residual_nT, turned) + size * values
            found.append(LawSeries(words.axis_label(law), values[::every], partial[::every], size))
        return tuple(found)


def _alike(one: NoiseChoice, other: NoiseChoice) -> bool:
    """Whether two noise models are the same to a tenth, and cut the same rows."""
    pairs = ((one.noise.sigma_nT, other.noise.sigma_nT), (one.noise.theta_rad, other.noise.theta_rad))
    same = all(abs(a - b) <= 0.1 * max(a, b) for a, b in pairs)
    return same and bool(np.array_equal(one.robust.cut, other.robust.cut))
