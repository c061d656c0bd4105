"""Which terms of the grammar a residual is made of, by the one criterion and with all that was tried in it.

Forward, one term at a time, each from the best few of the pool with their delays, lags, frames and powers moved; then the
terms before it once more, given it. What a term leaves for its own shape is no further term (`criterion.SHAPE`).
"""

from __future__ import annotations

from collections.abc import Sequence
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
from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.effects.law import Law

MOST_TERMS = 3
_BEAM = 8
"""Of the pool, whose delays and frames are looked at: the right pair undelayed is seldom the best, but among the first."""
_MOVES = (1.5, 1.25, 1.12)
"""Ratios by which a delay or lag is moved between those that were tried."""


@dataclass(frozen=True, eq=False)
class Trial:
    """A term beside what is fitted."""

    law: Law
    fit: BlockFit
    drop: float
    """Of chi-square."""
    rank: int


class Regression:
    """Terms against one residual."""

    def __init__(self, problem: Problem, grammar: Grammar) -> None:
        self.problem, self.grammar, self.carrier = problem, grammar, Carrier(problem)
        self.tried: dict[Law, int] = {}
        """Terms that were tried, and how much there is to each."""
        self._by_settings = [0] * 16
        laws = [law for law in (*grammar.singles(), *grammar.products()) if grammar.values(law) is not None]
        self.laws = list(dict.fromkeys(laws))
        self.pool = Dictionary([self.block(law) for law in self.laws], problem.rows)

    def plain(self) -> list[Law]:
        """One quantity each, as it stands, in body axes."""
        return [law for law in self.laws if _settings(law) == 1]

    @property
    def log_tried(self) -> float:
        """Of the number of terms that were truly tried."""
        return float(np.log(max(len(self.tried), 1)))

    def block(self, law: Law) -> Block:
        """A term's columns along the axes of its frame."""
        values = self.grammar.values(law)
        assert values is not None
        condition = Condition(None, "law", values[:, None])
        return Block(
            {"spacecraft": 1.0}, None, law.axes, "law", "xyz", lambda: self.carrier.additive(condition, law.axes)
        )

    def trial(self, law: Law, left: ProjectedResidual) -> Trial | None:
        """One term; None where it is missing, or dead."""
        if self.grammar.values(law) is None:
            return None
        self._count([law])
        found = fit(self.block(law), left)
        drop, rank = found.explained()
        return Trial(law, found, drop, rank) if rank else None

    def best(self, left: ProjectedResidual, beside: Sequence[Law] = ()) -> list[Trial]:
        """The best few of the pool with their settings moved, best first."""
        self._count(self.laws)
        fits = self.pool.fits(left)
        scored = [(one.explained(), law, one) for law, one in zip(self.laws, fits, strict=True) if law not in beside]
        scored.sort(key=lambda each: -each[0][0])
        few = [Trial(law, one, drop, rank) for (drop, rank), law, one in scored[: 4 * _BEAM] if rank]
        kept: list[Trial] = []
        for one in few:  # several settings of the same factors are one place in the beam
            if len(kept) < _BEAM and all(set(one.law.quantities()) != set(k.law.quantities()) for k in kept):
                kept.append(one)
        moved = [self.moved(one, left) for one in kept]
        return sorted([*moved, *few], key=lambda one: -self.order(one, left))

    def moved(self, start: Trial, left: ProjectedResidual) -> Trial:
        """A term with its settings where the data want them: those of the grammar twice in turn, then between them."""
        best = start
        for _ in range(2):
            again = self._better(best, self.grammar.variants(best.law), left)
            if again is best:
                break
            best = again
        for ratio in _MOVES:
            for step in (ratio, 1.0 / ratio):
                law = best.law
                moved = [replace(law, delay_s=law.delay_s * step), replace(law, lag_s=law.lag_s * step)]
                best = self._better(best, [one for one in moved if one != law], left)
        return best

    def _better(self, best: Trial, laws: Sequence[Law], left: ProjectedResidual) -> Trial:
        trials = [found for law in laws if (found := self.trial(law, left)) is not None]
        return max([best, *trials], key=lambda one: self.order(one, left))

    def worth(self, one: Trial, left: ProjectedResidual, wider: float = 1.0) -> float:
        """By the criterion, where noise and shape error have so many times the variance of the noise."""
        return worth(one.drop / wider, one.rank, left.degrees / 3.0, self.log_tried)

    def order(self, one: Trial, left: ProjectedResidual, wider: float = 1.0) -> float:
        """The same for a choice between terms: a plain one was one of the plain ones that were tried, which are fewer."""
        as_plain = sum(self._by_settings[: _settings(one.law) + 1])
        return worth(one.drop / wider, one.rank, left.degrees / 3.0, float(np.log(max(as_plain, 1))))

    def _count(self, laws: Sequence[Law]) -> None:
        for law in laws:
            if law not in self.tried:
                self.tried[law] = _settings(law)
                self._by_settings[self.tried[law]] += 1

    def left(
        self, whitener: Whitener, residual_nT: FloatArray, fitted_nT: FloatArray, laws: Sequence[Law]
    ) -> ProjectedResidual:
        """The residual with what is fitted and these terms out of it."""
        own = [self.block(law).make() for law in laws]
        return projected(whitener, residual_nT, np.concatenate([fitted_nT, *own], axis=2))

    def run(
        self, whitener: Whitener, residual_nT: FloatArray, fitted_nT: FloatArray
    ) -> tuple[list[Law], float, list[Law]]:
        """Terms, their worth together, and terms that do as well in the place of the first.

        residual_nT (N, 3), fitted_nT (N, 3, q): as for `projected`.
        """
        chosen: list[Law] = []
        whole, alike = 0.0, list[Law]()
        bare = self.left(whitener, residual_nT, fitted_nT, ())
        for _ in range(MOST_TERMS):
            left = self.left(whitener, residual_nT, fitted_nT, chosen) if chosen else bare
            wider = 1.0 + SHAPE * max(bare.energy - left.energy, 0.0)
            ranked = self.best(left, chosen)
            if not ranked:
                break
            value = self.worth(ranked[0], left, wider) - (LOG_FURTHER if chosen else 0.0)
            if value <= THRESHOLD:
                break
            if not chosen:
                alike = self._alike(ranked, left)
            chosen, whole = [*chosen, ranked[0].law], whole + value
            if len(chosen) > 1:
                chosen = self._again(chosen, whitener, residual_nT, fitted_nT)
        return chosen, whole, alike

    def _again(
        self, chosen: list[Law], whitener: Whitener, residual_nT: FloatArray, fitted_nT: FloatArray
    ) -> list[Law]:
        """Each term sought once more given the others: the first was chosen with the others in the residual."""
        for number in range(len(chosen)):
            others = [law for place, law in enumerate(chosen) if place != number]
            left = self.left(whitener, residual_nT, fitted_nT, others)
            ranked = self.best(left, others)
            chosen[number] = ranked[0].law if ranked else chosen[number]
        return chosen

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


def _settings(law: Law) -> int:
    """How much there is to a term: factors, what is done to them, delay, lag, and a frame that is not the body's."""
    done = sum(factor != name for factor, name in zip(law.of, law.quantities(), strict=True))
    return len(law.of) + done + bool(law.delay_s) + bool(law.lag_s) + (law.axes != "body")
