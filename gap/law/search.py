"""Which terms of the grammar a residual is made of, by the one criterion and with all that was tried in it.

Forward, one term at a time, each from the best few of the pool with their delays, lags, frames and powers moved; then the
terms before it once more, given it. What a term leaves for its own shape is no further term (`criterion.SHAPE`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from fluxtwin.gap.hypotheses.blocks import Block, Carrier
from fluxtwin.gap.hypotheses.conditions import Condition
from fluxtwin.gap.hypotheses.evidence import BlockFit, Dictionary, fit
from fluxtwin.gap.law.grammar import Grammar
from fluxtwin.gap.linear.projection import ProjectedResidual, projected
from fluxtwin.gap.noise.choice import Whitener
from fluxtwin.gap.problem.problem import Problem
from fluxtwin.gap.selection.criterion import LOG_FURTHER, SHAPE, THRESHOLD, worth
from fluxtwin.gap.selection.forward import RATIOS
from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.effects.law import Law

MOST_TERMS = 3
"""Not counting those of lower order that go with one."""
_MOST_BYTES = 400e6  # that the pool may take, which is asked again after every term
_BEAM = 8
"""Of the pool, whose delays and frames are looked at: the right pair undelayed is seldom the best, but among the first."""


Terms = tuple[Law, ...]
"""A term, and the terms of lower order that go with it."""


@dataclass(frozen=True, eq=False)
class Trial:
    """A term, with those of lower order or alone, beside what is fitted."""

    terms: Terms
    fit: BlockFit
    drop: float
    """Of chi-square."""
    rank: int

    @property
    def law(self) -> Law:
        """The term itself."""
        return self.terms[0]


class Regression:
    """Terms against one residual."""

    def __init__(self, problem: Problem, grammar: Grammar) -> None:
        self.problem, self.grammar, self.carrier = problem, grammar, Carrier(problem)
        self.tried: dict[Terms, int] = {}
        """Terms that were tried, and how much there is to each."""
        self._by_settings = [0] * 24
        self._latest: tuple[ProjectedResidual | None, dict[Terms, Trial]] = (None, {})
        laws = dict.fromkeys((*grammar.singles(), *grammar.products()))
        self.terms = [grammar.with_lower(law) for law in laws if grammar.values(law) is not None]
        self.pool = Dictionary([self.block(terms) for terms in self.terms], problem.rows, _MOST_BYTES)

    def plain(self) -> list[Law]:
        """One quantity each, as it stands, in body axes."""
        return [terms[0] for terms in self.terms if _settings(terms) == 1]

    @property
    def log_tried(self) -> float:
        """Of the number of terms that were truly tried."""
        return float(np.log(max(len(self.tried), 1)))

    def block(self, terms: Terms) -> Block:
        """The columns of a term and those of lower order along the axes of their frame.

        Of unit rms, and the term without what is like those of lower order: the same span, but a housekeeping column whose
        mean is far from zero would otherwise hide in them.
        """

        def made() -> FloatArray:
            values = np.stack([np.asarray(self.grammar.values(law)) for law in reversed(terms)], axis=1)
            apart = np.linalg.qr(values / np.sqrt(np.mean(values**2, axis=0)))[0] * np.sqrt(len(values))
            return self.carrier.additive(Condition(None, "law", apart[:, ::-1]), terms[0].axes)

        return Block({"spacecraft": 1.0}, None, None, "law", "xyz" * len(terms), made)

    def columns(self, terms: Sequence[Law]) -> FloatArray:
        """(N, 3, 3 terms) of fields along the axes of each, nT per unit."""
        made = [np.zeros((self.problem.rows, 3, 0))]
        for law in terms:
            values = np.asarray(self.grammar.values(law), dtype=np.float64)
            made.append(self.carrier.additive(Condition(None, "law", values[:, None]), law.axes))
        return np.concatenate(made, axis=2)

    def trial(self, terms: Terms, left: ProjectedResidual) -> Trial | None:
        """Terms; None where one is missing, or all are dead."""
        if any(self.grammar.values(law) is None for law in terms):
            return None
        if self._latest[0] is not left:
            self._latest = (left, {})
        known = self._latest[1]
        if terms not in known:  # one beam comes to the same terms from several starts
            self._count([terms])
            found = fit(self.block(terms), left)
            known[terms] = Trial(terms, found, *found.explained())
        return known[terms] if known[terms].rank else None

    def best(self, left: ProjectedResidual, beside: Sequence[Law] = ()) -> list[Trial]:
        """The best few of the pool with their settings moved, best first."""
        self._count(self.terms)
        pairs = zip(self.terms, self.pool.fits(left), strict=True)
        found = [Trial(terms, one, *one.explained()) for terms, one in pairs if terms[0] not in beside]
        few = sorted((one for one in found if one.rank), key=lambda one: -self.order(one, left))[: 4 * _BEAM]
        kept: list[Trial] = []
        for one in few:  # several settings of the same factors are one place in the beam
            if len(kept) < _BEAM and all(set(one.law.quantities()) != set(k.law.quantities()) for k in kept):
                kept.append(one)
        every = [*(self.moved(one, left) for one in kept), *few]
        wider = 1.0 + SHAPE * max((one.drop for one in every), default=0.0)
        return sorted(every, key=lambda one: -self.order(one, left, wider))

    def moved(self, start: Trial, left: ProjectedResidual) -> Trial:
        """A term with its settings where the data want them: those of the grammar twice in turn, then between them.

        Times at which something goes on or off are searched by halves, down to a row.
        """
        best = self._better(start, [start.law], left)
        for _ in range(2):
            again = self._better(best, self.grammar.variants(best.law), left)
            if again is best:
                break
            best = again
        for ratio in RATIOS:
            for step in (ratio, 1.0 / ratio):
                law = best.law
                moved = [replace(law, delay_s=law.delay_s * step), replace(law, lag_s=law.lag_s * step)]
                best = self._better(best, [one for one in moved if one != law], left)
        for rows in self.grammar.halves():
            best = self._better(best, self.grammar.retimed(best.law, rows), left)
        return best

    def _better(self, best: Trial, laws: Sequence[Law], left: ProjectedResidual) -> Trial:
        """The best of a trial and these terms, each alone and with those of lower order."""
        every = dict.fromkeys(terms for law in laws for terms in ((law,), self.grammar.with_lower(law)) if terms)
        trials = [found for terms in every if (found := self.trial(terms, left)) is not None]
        return max([best, *trials], key=lambda one: self.order(one, left))

    def worth(self, one: Trial, left: ProjectedResidual, wider: float = 1.0) -> float:
        """By the criterion, where noise and shape error have so many times the variance of the noise."""
        return worth(one.drop / wider, one.rank, left.degrees / 3.0, self.log_tried)

    def order(self, one: Trial, left: ProjectedResidual, wider: float = 1.0) -> float:
        """The same for a choice between terms: a plain one was one of the plain ones that were tried, which are fewer."""
        as_plain = sum(self._by_settings[: _settings(one.terms) + 1])
        return worth(one.drop / wider, one.rank, left.degrees / 3.0, float(np.log(max(as_plain, 1))))

    def _count(self, tried: Sequence[Terms]) -> None:
        for terms in tried:
            if terms not in self.tried:
                self.tried[terms] = _settings(terms)
                self._by_settings[self.tried[terms]] += 1

    def run(self, whitener: Whitener, residual_nT: FloatArray, fitted_nT: FloatArray) -> tuple[list[Law], list[Law]]:
        """Terms, and terms that do as well in the place of the first.

        residual_nT (N, 3), fitted_nT (N, 3, q): as for `projected`.
        """
        chosen: list[Terms] = []
        alike: list[Law] = []
        bare = projected(whitener, residual_nT, fitted_nT)

        def beside(others: Sequence[Terms]) -> ProjectedResidual:
            if not others:
                return bare
            return projected(whitener, residual_nT, np.concatenate([fitted_nT, self.columns(_members(others))], axis=2))

        for _ in range(MOST_TERMS):
            left = beside(chosen)
            wider = 1.0 + SHAPE * max(bare.energy - left.energy, 0.0)
            ranked = self.best(left, _members(chosen))
            value = self.worth(ranked[0], left, wider) - (LOG_FURTHER if chosen else 0.0) if ranked else -np.inf
            if value <= THRESHOLD:
                break
            if not chosen:
                alike = self._alike(ranked, left)
            chosen.append(ranked[0].terms)
            for number in range(len(chosen) - 1):  # the first was chosen with the others in the residual
                others = [*chosen[:number], *chosen[number + 1 :]]
                again = self.best(beside(others), _members(others))
                chosen[number] = again[0].terms if again else chosen[number]
        return self._needed(_members(chosen), bare, beside), alike

    def _needed(
        self, laws: list[Law], bare: ProjectedResidual, beside: Callable[[Sequence[Terms]], ProjectedResidual]
    ) -> list[Law]:
        """Terms without those, of lower order or overtaken by later ones, that are not worth their own parameters."""
        whole = beside([tuple(laws)])
        wider = 1.0 + SHAPE * max(bare.energy - whole.energy, 0.0)
        for law in reversed(laws):
            others = [one for one in laws if one != law]
            one = self.trial((law,), beside([tuple(others)])) if others else None
            if one is not None and worth(one.drop / wider, one.rank, whole.degrees / 3.0, 0.0) <= THRESHOLD:
                laws = others
        return laws

    def _alike(self, ranked: Sequence[Trial], left: ProjectedResidual) -> list[Law]:
        """Terms of other quantities that noise and shape error do not tell from the first."""
        first = ranked[0]
        wider = 1.0 + SHAPE * first.drop
        best = self.order(first, left, wider)
        found: list[Law] = []
        for one in ranked[1:]:
            new = all(set(one.law.quantities()) != set(k.quantities()) for k in (first.law, *found))
            if new and best - self.order(one, left, wider) < LOG_FURTHER:
                found.append(one.law)
        return found


def _members(chosen: Sequence[Terms]) -> list[Law]:
    return list(dict.fromkeys(law for terms in chosen for law in terms))


def _settings(terms: Terms) -> int:
    """How much there is to terms: factors, what is done to them, delay, lag, a frame not the body's, lower orders."""
    law = terms[0]
    done = sum(factor not in law.quantities() for factor in law.of)
    return len(law.of) + done + bool(law.delay_s) + bool(law.lag_s) + (law.axes != "body") + len(terms) - 1
