"""Causes with a waveform of their own (a line, a sequence, a region, a walk) among the named effects.

Such a waveform is not among the catalogue's images, so the search explains it by several effects that each take a
little of it. Where one is found, effects are therefore sought afresh given it: a line or a sequence is fitted in every
test, a walk belongs to the noise. Whether a walk is there is a matter of the likelihood: "a walk and these effects"
against "those effects", by the one criterion.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy.special import expit

from fluxtwin.gap.detectors.finding import Finding, fitted
from fluxtwin.gap.detectors.lines import (
    FullRate,
    independent_frequencies,
    line_near,
    multiples,
    strongest_line,
    wheel_line,
)
from fluxtwin.gap.detectors.random_walk import random_walk
from fluxtwin.gap.detectors.residual_structure import Structure, residual_structure
from fluxtwin.gap.detectors.switched_region import switched_region
from fluxtwin.gap.detectors.thermostat import heater_sequence, log_sequences
from fluxtwin.gap.hypotheses.blocks import Dictionary, in_body
from fluxtwin.gap.linear.projection import ProjectedResidual, projected
from fluxtwin.gap.noise.choice import NoiseModel, Whitener, choose_noise, whitener_of
from fluxtwin.gap.noise.whitening import gain, likeliest_rate, with_walk
from fluxtwin.gap.posterior.explanations import (
    Answer,
    Known,
    concluded,
    log_likelihood,
    signals_of,
    weighed_with,
    without_names,
)
from fluxtwin.gap.problem.problem import Problem
from fluxtwin.gap.selection.criterion import IN_GROUP, LOG_FURTHER, THRESHOLD, samples_of, worth
from fluxtwin.gap.selection.forward import LARGEST
from fluxtwin.sim.base.types import BoolArray, FloatArray
from fluxtwin.sim.effects.calibration import Step
from fluxtwin.sim.effects.chain import Active
from fluxtwin.sim.effects.switched_field import HeaterSwitching

_WALK, _LIKE_A_WALK = "bias_random_walk", ("bias_step", "linear_drift")
"""A walk's largest excursion looks like a step, its whole way like a drift: what a name can be before it is a walk."""


class _Walk(NamedTuple):
    """A walk in the noise, and the effects given it."""

    worth: float
    """Of both."""
    rate: float
    names: set[str]
    whitener: Whitener
    """Of its noise, without the walk."""
    residual_nT: FloatArray
    fitted_nT: FloatArray
    answer: Answer | None
    """None where another has more worth."""


@dataclass(frozen=True, eq=False)
class Structured:
    """Looks for such causes on one design."""

    problem: Problem
    dictionary: Dictionary
    known: Known

    def among(self, answer: Answer) -> Answer:
        """The answer with the waveforms that are in the data, effects sought afresh given them."""
        for _ in range(LARGEST):
            more = self._one_more(answer)
            if more is None:
                break
            answer = more
        for one in answer.shapes[:-1]:  # what was found first may be a piece of what was found after it
            fewer = self.given([other for other in answer.shapes if other is not one], answer)
            if fewer.known >= 0.5 and len(fewer.result.named) <= len(answer.result.named):
                answer = fewer
        return answer

    def _one_more(self, answer: Answer) -> Answer | None:
        named = answer.result.named
        walks = any(one.name == _WALK for one in answer.shapes) or any(_WALK in one.group for one in named)
        walks = walks or _WALK in self.problem.ruled_out
        if answer.left.structured and not answer.left.of_named:
            for bare in (True, False) if named and answer.known < 0.5 else (False,):
                finding = self._signal(answer, bare=bare)
                if finding is not None:
                    more = self.given([*answer.shapes, finding], answer)
                    return self._merged(more) if isinstance(finding.effect, HeaterSwitching) else more
        stepped = any(one.name in _LIKE_A_WALK for one in named)
        if not walks and (answer.left.structured or len(named) > 1 or stepped):
            return self._walking(answer)
        return None

    def _signal(self, answer: Answer, *, bare: bool) -> Finding | None:
        result, whitener = answer.result, answer.whitener
        residual, columns, left = result.residual_nT, answer.fitted_nT, answer.left
        if bare:
            residual, columns = result.residual_alone_nT, without_names(self.problem, answer)
        fitted_too = [*result.modelled, *signals_of(answer.shapes), *(() if bare else result.chosen)]
        columns = np.concatenate([columns, multiples(self.problem.setting, fitted_too)], axis=2)
        if bare:
            left = residual_structure(self.problem, whitener, residual, columns, self.dictionary)
        proposed = self._proposed(whitener, residual, columns, left)
        return next((one for one in proposed if one is not None and one.confirmed), None)

    def _merged(self, answer: Answer) -> Answer:
        """The answer with the sequence of a thermostat that does another cause's work too, where one does.

        A heater that runs through the shadow but for a pause in each turn was its pauses and a field that follows the sun.
        """
        result, whitener, setting = answer.result, answer.whitener, self.problem.setting
        named = list(result.chosen)
        heater = next((one for one in reversed(answer.shapes) if isinstance(one.effect, HeaterSwitching)), None)
        if heater is None:
            return answer

        def beside(
            shapes: Sequence[Finding], chosen: Sequence[Active]
        ) -> tuple[FloatArray, FloatArray, ProjectedResidual]:
            active = [*result.modelled, *signals_of(shapes), *chosen]
            residual, columns = self.problem.residual_of(active), self.problem.derivatives(active)
            return residual, columns, projected(whitener, residual, columns)

        kept = [one for one in answer.shapes if one is not heater]
        with_all, _, rest = beside(kept, named)
        with_all = with_all - self.problem.derivatives([(heater.effect, heater.theta)]) @ heater.theta
        best, least = None, self._cost(rest, heater)
        one_name = LOG_FURTHER + 2.0 * float(np.log(result.tested))
        fewer: list[tuple[Sequence[Finding], Sequence[Active], float]]
        fewer = [(kept, [other for other in named if other is not one], one_name) for one in named]
        for other in kept:
            if isinstance(other.effect, HeaterSwitching):
                saved = one_name + 2.0 * log_sequences(_on(other))
                fewer.append(([one for one in kept if one is not other], named, saved))
        for shapes, chosen, saved in fewer:
            residual, columns, rest = beside(shapes, chosen)
            along = (residual - with_all) @ heater.theta
            start = along > 0.5 * (along.min() + along.max())
            line, fits = strongest_line(setting.seconds, rest), self.dictionary.fits(rest)
            found = heater_sequence(setting, rest, residual, columns, fits, line, start)
            if found is not None and found.confirmed and (cost := self._cost(rest, found) - saved) < least:
                best, least = [*shapes, found], cost
        merged = answer if best is None else self.given(best, answer)
        fewer_causes = len(merged.result.named) + len(merged.shapes) < len(result.named) + len(answer.shapes)
        return self._merged(merged) if fewer_causes else answer

    def _cost(self, left: ProjectedResidual, one: Finding) -> float:
        """Of a thermostat's sequence in a residual: the chi-square that it leaves, and twice the log of what was tried."""
        on = _on(one)
        return left.energy - fitted(left, in_body(on.astype(float))).energy + 2.0 * log_sequences(on)

    def _proposed(
        self,
        whitener: Whitener,
        residual_nT: FloatArray,
        fitted_nT: FloatArray,
        left: Structure,
    ) -> Iterator[Finding | None]:
        """A line whose waveform a residual (N, 3) has, then a region and a thermostat, that of more worth first."""
        setting, rest = self.problem.setting, projected(whitener, residual_nT, fitted_nT)
        line, fits = strongest_line(setting.seconds, rest), self.dictionary.fits(rest)
        if left.kind == "tone":
            yield wheel_line(setting, rest, line, fits)
        switched = [switched_region(self.problem, rest, fits)]
        if setting.column("heater_on") is None:
            switched.append(heater_sequence(setting, rest, residual_nT, fitted_nT, fits, line))
        # Where a thermostat cycles, a region is found too: some of its cycles.
        yield from sorted(switched, key=lambda one: 0.0 if one is None else -one.worth)

    def given(self, shapes: Sequence[Finding], before: Answer) -> Answer:
        """Effects sought afresh given these shapes; before: the answer without."""
        # A line was noise to the first choice.
        noise, robust = choose_noise(self.problem, self.problem.derivatives(signals_of(shapes)))
        whitener = whitener_of(self.problem, noise, robust.weights)
        for one in shapes:
            if one.name == _WALK:
                whitener = with_walk(whitener, float(one.theta[0]))
        found = weighed_with(self.problem, robust, whitener, self.dictionary, self.known, shapes, before.fitted)
        return concluded(self.problem, robust, found, tuple(shapes))

    def _walking(self, answer: Answer) -> Answer | None:
        """The answer with a walk in the noise, where that explains more; where it explains nearly as much, the answer with
        the walk beside the name in whose place it would be; else None."""
        bare_nT, alone = answer.result.residual_alone_nT, without_names(self.problem, answer)
        best: _Walk | None = None
        for residual_nT, columns in self._where_it_walks(answer, bare_nT, alone):
            likely = likeliest_rate(answer.whitener, residual_nT, columns)
            if likely is None:
                continue
            # Given a walk, the error of the attitude is another: without one it took its place.
            named = columns[:, :, alone.shape[2] :]
            rate = likely / answer.noise.sigma_nT
            noise = choose_noise(self.problem, named, residual_nT=residual_nT, walk=rate).noise
            gained = [(self._gain(answer, one, residual_nT, columns), one) for one in (noise, answer.noise)]
            (_, first), likeliest = max(gained, key=lambda found: found[0][0])
            walk = self._walks(answer, likeliest, first, bare_nT, alone)
            if walk is not None and (best is None or walk.worth > best.worth):
                best = walk
        if best is None or best.worth < THRESHOLD:
            return None
        found = _with_rival(answer, best.names, best.worth) if best.answer is None else best.answer
        if found is None:
            return None
        left = projected(best.whitener, best.residual_nT, best.fitted_nT)
        walking = projected(with_walk(best.whitener, best.rate), best.residual_nT, best.fitted_nT)
        finding = random_walk(self.problem.setting.seconds, left, walking, best.whitener.noise.sigma_nT)
        if finding is None or not finding.confirmed:
            return None
        if best.answer is None:
            return found
        if any(isinstance(one, Step) or one.name in _LIKE_A_WALK for one, _ in found.result.chosen):
            return None  # the largest increment of a walk is one of its own: where it had to be taken out, this is none
        finding = replace(finding, theta=np.array([best.rate * float(np.sqrt(found.result.variance))]))
        return replace(found, shapes=(*answer.shapes, finding))

    def _where_it_walks(
        self, answer: Answer, bare_nT: FloatArray, alone: FloatArray
    ) -> Iterator[tuple[FloatArray, FloatArray]]:
        """Residuals (N, 3) and fitted columns to look for a walk in: no name fitted, and all but a step or a drift."""
        yield bare_nT, alone
        result = answer.result
        others = [one for one in result.chosen if one[0].name not in _LIKE_A_WALK]
        if others:
            active = [*result.modelled, *signals_of(answer.shapes), *others]
            columns = np.concatenate([alone, self.problem.derivatives(others)], axis=2)
            yield self.problem.residual_of(active), columns

    def _gain(
        self, answer: Answer, noise: NoiseModel, bare_nT: FloatArray, alone: FloatArray, rate: float | None = None
    ) -> tuple[float, float | None]:
        """Twice the log likelihood that a walk in this noise wins against the best noise without one, and its rate
        (default: the likeliest)."""
        whitener = whitener_of(self.problem, noise, answer.robust.weights)
        rate = likeliest_rate(whitener, bare_nT, alone) if rate is None else rate
        if rate is None:
            return -np.inf, None
        given = (answer.robust, bare_nT, alone)
        before, now = (log_likelihood(self.problem, one, *given) for one in (answer.noise, noise))
        return gain(whitener, bare_nT, alone, rate) + now - before - answer.handicap, rate

    def _walks(
        self, answer: Answer, noise: NoiseModel, rate: float | None, bare_nT: FloatArray, alone: FloatArray
    ) -> _Walk | None:
        """A walk in this noise and the effects given it; rate: a first guess."""
        whitener = whitener_of(self.problem, noise, answer.robust.weights)
        about = (self.dictionary, self.known, answer.shapes, answer.fitted)
        for _ in range(3):
            if rate is None:
                return None
            before = rate
            found = weighed_with(self.problem, answer.robust, with_walk(whitener, rate), *about)
            left = found.left(self.problem, answer.shapes)
            rate = likeliest_rate(whitener, *left)
            if rate is not None and abs(np.log(rate / before)) < 0.2:
                break
        if rate is None:
            return None
        gain, _ = self._gain(answer, noise, bare_nT, alone, rate)
        samples, tried = samples_of(whitener.measured), float(np.log(answer.result.tested))
        names = {effect.name for effect, _ in found.chosen.fit.chosen}
        further = LOG_FURTHER if names else 0.0  # the names beside it are paid for as if alone
        whole = worth(gain, 1, samples, tried) + max(found.worth, 0.0) - further
        wins = whole >= max(answer.worth, THRESHOLD)
        more = concluded(self.problem, answer.robust, found, answer.shapes) if wins else None
        return _Walk(whole, rate, names, whitener, *left, more)

    def with_line(self, answer: Answer, fast: FullRate | None) -> Answer:
        """A line that only the full rate shows, with its name or as structure that has none."""
        spacing_s = float(np.median(np.diff(self.problem.setting.seconds)))
        if fast is None or fast.line.frequency_Hz <= 0.5 / spacing_s or fast.line.worth <= THRESHOLD:
            return answer
        wheel = wheel_line(fast.problem.setting, fast.left, fast.line)
        if wheel is not None and wheel.confirmed:
            # The thinned rows hold the phase over the whole record.
            whitener = whitener_of(self.problem, answer.noise, answer.robust.weights)  # without a walk
            left = projected(whitener, answer.result.residual_nT, answer.fitted_nT)
            setting = self.problem.setting
            longer = wheel_line(setting, left, line_near(setting.seconds, left, fast.line.frequency_Hz))
            shape = longer if longer is not None and longer.confirmed else wheel
            return self.given([*self._other_lines(answer.shapes, fast.line.frequency_Hz), shape], answer)
        if answer.left.structured and answer.left.kind != "tone":
            return answer  # but a slower line may be this one, seen in some rows only
        words = f"a line at a period of {1 / fast.line.frequency_Hz:.3g} s, in the full rate"
        tried = float(np.log(independent_frequencies(fast.problem.setting.seconds)))
        found = Structure(fast.line.worth, fast.line.explained, "tone", words, rank=6, log_tried=tried)
        return replace(answer, left=found, known=answer.known * self._known(answer, found))

    def _other_lines(self, shapes: Sequence[Finding], frequency_Hz: float) -> list[Finding]:
        """The shapes but that which is a line of this frequency as the evenly spaced rows fold it."""
        seconds = self.problem.setting.seconds
        fastest, least = 1.0 / float(np.median(np.diff(seconds))), 1.0 / float(seconds[-1] - seconds[0])
        folded = abs(frequency_Hz - fastest * round(frequency_Hz / fastest))
        lines = [getattr(one.effect, "frequency_Hz", None) for one in shapes]
        return [one for one, at in zip(shapes, lines, strict=True) if at is None or abs(at - folded) > least]

    def _known(self, answer: Answer, line: Structure) -> float:
        """Probability that a line is of the shape error of what is named."""
        result, whitener = answer.result, answer.whitener
        if not result.chosen:
            return 0.0
        alone = projected(whitener, result.residual_alone_nT, without_names(self.problem, answer))
        explained = max(alone.energy - projected(whitener, result.residual_nT, answer.fitted_nT).energy, 0.0)
        beyond = line.beyond(explained, samples_of(whitener.measured))
        return float(expit(0.5 * (LOG_FURTHER - beyond)))


def _on(heater: Finding) -> BoolArray:
    """(N,) whether a heater that was found is on."""
    assert isinstance(heater.effect, HeaterSwitching)
    return np.array(heater.effect.sequence, dtype=np.bool_)


def _with_rival(answer: Answer, kept: set[str], whole: float) -> Answer | None:
    """The answer with a walk beside the only one of its names that is not kept given the walk; None where that is not so,
    or where the walk and what is kept are not nearly worth as much."""
    replaced = [one for one in answer.result.named if one.name not in kept]
    share = float(expit(0.5 * (whole - answer.worth)))
    if len(replaced) != 1 or share < IN_GROUP or _WALK in replaced[0].group:
        return None
    wider = replace(replaced[0], group=(*replaced[0].group, _WALK))
    named = tuple(wider if one is replaced[0] else one for one in answer.result.named)
    return replace(answer, result=replace(answer.result, named=named))
