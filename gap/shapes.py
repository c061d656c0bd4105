"""Causes that are known by their own shape (a line, a sequence, a region in the dark, a walk) among the named effects.

What has such a shape is not in the catalogue's images, so the search explains it by several effects that each mop up
a little. Where a shape is found, effects are therefore sought afresh beside it: a line or a sequence is fitted in every
test, a walk belongs to the noise. Whether a walk is there is a matter of the likelihood: "a walk and these effects"
against "those effects", with the same price for parameters and names.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from fluxtwin.gap.answer import CARRIED, Answer, Known, answered_with, bare, left_of, signals_of
from fluxtwin.gap.blocks import Block
from fluxtwin.gap.candidates import derivatives
from fluxtwin.gap.constancy import pliable
from fluxtwin.gap.evidence import Leftover, leftover, orthonormal
from fluxtwin.gap.flexible import FlexibleFinding, wheel_line
from fluxtwin.gap.full_rate import FullRate
from fluxtwin.gap.growth import price
from fluxtwin.gap.noise import NoiseModel, RobustRows, whitener_of
from fluxtwin.gap.problem import Problem
from fluxtwin.gap.stochastic import shape_of
from fluxtwin.gap.tones import tone_near
from fluxtwin.gap.walk_noise import Wander, without_walk
from fluxtwin.gap.wandering import random_walk
from fluxtwin.sim.base.types import FloatArray

_MOST = 3
_ROUNDS = 3
_SETTLED = 0.2  # in the logarithm of the rate
_CERTAIN = 6.0  # twice the log of 20


@dataclass(frozen=True, eq=False)
class Shapes:
    """Looks for shapes on one design."""

    problem: Problem
    dictionary: Sequence[Block]
    known: Known
    choose: Callable[[FloatArray], tuple[NoiseModel, RobustRows]]
    """The noise with these columns (N, 3, P) in the signal: a line was noise to the first choice."""

    def among(self, answer: Answer) -> Answer:
        """The answer with the shapes that are in the data, effects sought afresh beside them."""
        for _ in range(_MOST):
            more = self._one_more(answer)
            if more is None:
                break
            found = len(more.shapes) > len(answer.shapes)
            answer = more
            if not found:
                break
        return answer

    def _one_more(self, answer: Answer) -> Answer | None:
        walks = any(one.effect == "bias_random_walk" for one in answer.shapes)
        if answer.left.structured:
            trials = [answer]
            if answer.result.named and (answer.result.explained_share or 0.0) < CARRIED:
                trials.insert(0, bare(self.problem, answer, self.dictionary))
            for trial in trials:
                finding = self._signal(trial)
                if finding is not None:
                    return self.beside(answer, finding)
        if not walks and (answer.left.structured or _may_follow_a_walk(answer)):
            return self._walking(answer)
        return None

    def _signal(self, trial: Answer) -> FlexibleFinding | None:
        return shape_of(
            self.problem,
            trial.whitener,
            trial.result.residual_nT,
            trial.fitted_nT,
            trial.left,
            self.dictionary,
            [effect for effect, _ in trial.result.chosen],
        )

    def beside(self, answer: Answer, finding: FlexibleFinding) -> Answer:
        """Effects sought afresh beside one more signal."""
        shapes = (*answer.shapes, finding)
        noise, robust = self.choose(derivatives(self.problem, signals_of(shapes)))
        whitener = whitener_of(self.problem, noise, robust.weights)
        for one in shapes:
            if one.effect == "bias_random_walk":
                whitener = Wander(whitener, self.problem.setting.seconds).whitening(one.parameters["rate"][0])
        return answered_with(self.problem, noise, robust, whitener, self.dictionary, self.known, shapes)

    def _walking(self, answer: Answer) -> Answer | None:
        """The answer with a walk in the noise, where that says more with less."""
        wander = Wander(answer.whitener, self.problem.setting.seconds)
        none = bare(self.problem, answer, self.dictionary) if answer.result.named else answer
        if not answer.left.structured and not self._hopeful(answer, none, wander):
            return None
        best: tuple[float, float, Answer] | None = None
        for start in [none] if none is answer else [none, answer]:
            rate = wander.rate(self._left(start))
            if best is not None and rate is not None and abs(np.log(rate / best[1])) < _SETTLED:
                continue
            found = self._settled(answer, wander, rate)
            if found is not None and (best is None or found[0] < best[0]):
                best = found
        if best is None:
            return None
        cost, rate, walking = best
        if cost > self._cost(answer, walking.result.variance) - _CERTAIN:
            return None
        left = self._left(walking)
        finding = random_walk(self.problem.setting.seconds, left, self.dictionary, answer.noise.sigma_nT)
        if finding is None or not finding.confirmed:
            return self._fewer(answer, walking, left)
        likeliest = rate * float(np.sqrt(walking.result.variance))
        _, sigma, unit = finding.parameters["rate"]
        finding = replace(finding, parameters={"rate": (likeliest, sigma, unit)})
        return replace(walking, shapes=(*answer.shapes, finding))

    def _fewer(self, answer: Answer, walking: Answer, left: Leftover) -> Answer | None:
        """The fewer names that are needed where the slow rest is free to wander: the others only mopped it up.

        What wanders is no walk, so it stays without a name. The names must carry the structure without it: else what
        was taken for mopping up may be a cause that comes back, or stays, as a step does.
        """
        before, after = len(answer.result.chosen), len(walking.result.chosen)
        if before < 2 or after >= before:  # a single name mops up after nothing
            return None
        plain = answer.result.chi2
        rank = plain["nuisance"][1] + walking.result.chi2["named"][1] - walking.result.chi2["nuisance"][1]
        result = replace(walking.result, chi2={**plain, "named": (left.energy, rank)}, variance=answer.result.variance)
        rest = left_of(self.problem, answer.whitener, result, walking.fitted_nT, self.dictionary)
        fewer = replace(walking, whitener=answer.whitener, result=result, left=rest)
        fewer = replace(fewer, left=replace(rest, structured=True))
        return fewer if fewer.carries else None

    def _hopeful(self, answer: Answer, none: Answer, wander: Wander) -> bool:
        """Whether a walk with fewer of the named effects, linear about their refit, costs less than all of them."""
        rate = wander.rate(self._left(none))
        if rate is None:
            return False
        chosen = answer.result.chosen
        columns = derivatives(self.problem, [*answer.result.modelled, *chosen])
        ends = np.cumsum([answer.alone_nT.shape[2], *(len(theta) for _, theta in chosen)])
        white = wander.whitening(rate).apply(columns)
        target = wander.whitening(rate).apply(none.result.residual_nT).reshape(-1)
        charged = wander.log_det(rate, self._basis(none)) + float(np.log(_samples(none)))
        least, whole = np.inf, 0.0
        for some in (kept for size in range(len(chosen)) for kept in combinations(range(len(chosen)), size)):
            pick = [*range(ends[0]), *(c for one in some for c in range(ends[one], ends[one + 1]))]
            basis = orthonormal(white[:, :, pick].reshape(target.size, -1))
            chi2 = float(target @ target - np.sum((basis.T @ target) ** 2))
            whole = whole if some else chi2
            worth = price(basis.shape[1] - ends[0], whole - chi2, _samples(none))
            least = min(least, chi2 + float(worth) + 2.0 * (len(some) + 1) * float(np.log(none.result.tested)))
        return bool(least + charged < self._cost(answer, 1.0))

    def _settled(self, answer: Answer, wander: Wander, rate: float | None) -> tuple[float, float, Answer] | None:
        """Effects beside a walk whose rate is the likeliest beside those effects: cost of both, rate, effects."""
        if rate is None:
            return None
        for _ in range(_ROUNDS):
            found = answered_with(
                self.problem,
                answer.noise,
                answer.robust,
                wander.whitening(rate),
                self.dictionary,
                self.known,
                answer.shapes,
            )
            again = wander.rate(self._left(found))
            if again is None:
                return None
            if abs(np.log(again / rate)) < _SETTLED:
                break
            rate = again
        base = self._basis(found)
        walk = wander.log_det(rate, base) + float(np.log(_samples(found))) + 2.0 * float(np.log(found.result.tested))
        return self._cost(found, found.result.variance) + walk, rate, found

    def _left(self, answer: Answer) -> Leftover:
        """Beside what was fitted, with no walk in the noise."""
        return leftover(without_walk(answer.whitener), answer.result.residual_nT, answer.fitted_nT)

    def _basis(self, answer: Answer) -> FloatArray:
        """(3N, c) of what is re-estimated in any case, with no walk in the noise."""
        signals = signals_of(answer.shapes)
        own = [derivatives(self.problem, signals)] if signals else []
        columns = np.concatenate([answer.alone_nT, *own], axis=2)
        white = without_walk(answer.whitener).apply(columns)
        return orthonormal(white.reshape(3 * white.shape[0], -1))

    def _cost(self, answer: Answer, variance: float) -> float:
        """As `growth.Search.cost`: chi-square, and the price of parameters and names."""
        result = answer.result
        (whole, free), (rest, rank) = result.chi2["nuisance"], result.chi2["named"]
        names = 2 * len(result.chosen) * np.log(result.tested)
        return float(rest / variance + price(rank - free, (whole - rest) / variance, _samples(answer)) + names)

    def with_line(self, answer: Answer, fast: FullRate | None) -> Answer:
        """A line that only the full rate shows, with its name or as structure that has none."""
        if fast is None or not fast.has_line:
            return answer
        line = fast.line()
        if line is not None:
            # The thinned rows hold the phase over the whole record.
            tone = tone_near(self.problem.setting.seconds, self._left(answer), fast.tone.frequency_Hz)
            longer = wheel_line(self.problem.setting, self._left(answer), tone)
            return self.beside(answer, longer if longer is not None and longer.confirmed else line)
        if answer.left.structured:
            return answer
        words = f"a line at a period of {1 / fast.tone.frequency_Hz:.3g} s, in the full rate"
        p_value = min(1.0, 4.0 * float(10**fast.tone.log10_p))
        found = replace(
            answer.left,
            structured=True,
            p_value=p_value,
            condition=None,
            frame=None,
            kind="tone",
            words=words,
            label="tone",
            frequency_Hz=fast.tone.frequency_Hz,
        )
        return replace(answer, left=found)


def _may_follow_a_walk(answer: Answer) -> bool:
    """Whether the named effects, all together, are flexible enough to have followed a walk."""
    return len(answer.result.named) > 1 or pliable(answer.result)


def _samples(answer: Answer) -> float:
    return max(answer.whitener.measured / 3.0, 2.0)
