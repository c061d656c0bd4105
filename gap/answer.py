"""What one noise model leads to: the named effects, and what is left beside them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from fluxtwin.gap.blocks import Block
from fluxtwin.gap.candidates import Candidate, derivatives, in_order
from fluxtwin.gap.constancy import MANY, constant, pliable
from fluxtwin.gap.evidence import Leftover, leftover
from fluxtwin.gap.flexible import FlexibleFinding
from fluxtwin.gap.left import Left, what_is_left
from fluxtwin.gap.named import SearchResult
from fluxtwin.gap.noise import NoiseChoice, NoiseModel, RobustRows, Whitener, noise_choice, whitener_of
from fluxtwin.gap.problem import Problem
from fluxtwin.gap.search import search
from fluxtwin.gap.tones import TONE_DEGREES, strongest_tone
from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.effects.base import SignalEffect
from fluxtwin.sim.effects.chain import Active

Known = tuple[list[Candidate], dict[str, str]]
"""What `candidates` gives for a problem."""
_ROUNDS = 2
CARRIED = 0.9
"""Share of the structured energy that the named effects must carry where structure is left."""


@dataclass(frozen=True, eq=False)
class Answer:
    """What one noise model leads to; Jacobians as in `diagnose.Work`."""

    noise: NoiseModel
    robust: RobustRows
    whitener: Whitener
    result: SearchResult
    alone_nT: FloatArray
    fitted_nT: FloatArray
    left: Left
    shapes: tuple[FlexibleFinding, ...] = ()
    """Causes that are known by their own shape: a line, a sequence, a region in the dark, a walk."""

    @cached_property
    def constant(self) -> bool:
        """Whether what is named keeps its parameters over the record."""
        return constant(self.result)

    @property
    def carries(self) -> bool:
        """Whether something is named that leaves no structure, or little of it."""
        left = self.left.structured and (self.result.explained_share or 0.0) < CARRIED
        return bool(self.result.named) and not left

    @property
    def burden(self) -> tuple[bool, int]:
        """How much has to be believed: structure without a name, then names."""
        return self.left.structured, len(self.result.named)


def answered(
    problem: Problem, noise: NoiseModel, robust: RobustRows, dictionary: Sequence[Block], known: Known
) -> Answer:
    """The search with one noise model, and what is left."""
    return answered_with(problem, noise, robust, whitener_of(problem, noise, robust.weights), dictionary, known)


def answered_with(
    problem: Problem,
    noise: NoiseModel,
    robust: RobustRows,
    whitener: Whitener,
    dictionary: Sequence[Block],
    known: Known,
    shapes: tuple[FlexibleFinding, ...] = (),
) -> Answer:
    """The same with a whitening at hand, beside shapes: those that are signals are fitted in every test.

    What has many parameters and does not keep them follows something else; then an answer without such names is taken,
    if it carries the structure.
    """
    answer = _once(problem, noise, robust, whitener, dictionary, known, shapes)
    if not pliable(answer.result) or answer.constant:
        return answer
    bound = [candidate for candidate in known[0] if len(candidate.effect.parameters) <= MANY]
    other = _once(problem, noise, robust, whitener, dictionary, (bound, known[1]), shapes)
    if not other.carries:
        return answer
    whole = answer.result  # what was asked of every candidate
    result = replace(
        other.result,
        ranking=whole.ranking,
        untestable=whole.untestable,
        isolability=whole.isolability,
        minimum_detectable=whole.minimum_detectable,
        smallest_images_nT=whole.smallest_images_nT,
    )
    return replace(other, result=result)


def _once(
    problem: Problem,
    noise: NoiseModel,
    robust: RobustRows,
    whitener: Whitener,
    dictionary: Sequence[Block],
    known: Known,
    shapes: tuple[FlexibleFinding, ...],
) -> Answer:
    signals = signals_of(shapes)
    result = _stripped(problem, search(_beside(problem, signals), whitener, known=known), signals)
    alone = derivatives(problem, result.modelled_alone)
    fitted = derivatives(problem, [*result.modelled, *result.chosen]) if result.chosen else alone
    if signals:
        fitted = np.concatenate([fitted, derivatives(problem, signals)], axis=2)
    left = left_of(problem, whitener, result, fitted, dictionary)
    if signals and left.kind == "tone":
        result = _with_the_line(problem, result, leftover(whitener, result.residual_nT, fitted))
    return Answer(noise, robust, whitener, result, alone, fitted, left, shapes)


def noise_and_answer(problem: Problem, dictionary: Sequence[Block], known: Known) -> tuple[NoiseChoice, Answer]:
    """The noise beside what is modelled, the answer under it; then the noise beside the named effects too, and the answer
    under that, in turn until the names stay.

    The noise is that of the model as it stands, never beside everything that might be there: some hundred columns can
    make up any slow error of the attitude, and what they leave would be taken for all there is.
    """
    choice = noise_choice(problem)
    answer = answered(problem, choice.noise, choice.robust, dictionary, known)
    for _ in range(_ROUNDS):
        names = {effect for effect, _ in answer.result.chosen}
        if not names:
            break
        beside = noise_choice(problem, answer.fitted_nT, residual_nT=answer.result.residual_nT)
        then = answered(problem, beside.noise, beside.robust, dictionary, known)
        if not (answer.carries or then.carries):
            break  # what is named is not what there is, under either noise
        choice, answer = beside, then
        if {effect for effect, _ in answer.result.chosen} == names:
            break
    return choice, answer


def signals_of(shapes: Sequence[FlexibleFinding]) -> list[Active]:
    """Those that a fit can have, with the parameters they were found with."""
    found: list[Active] = []
    for one in shapes:
        if isinstance(one.instance, SignalEffect):
            theta = np.array([one.parameters.get(p.name, (0.0,))[0] for p in one.instance.parameters])
            found.append((one.instance, theta))
    return found


def left_of(
    problem: Problem, whitener: Whitener, result: SearchResult, fitted: FloatArray, dictionary: Sequence[Block]
) -> Left:
    """What is left beside the named effects at their refit and, of a large one, beside its image at nothing too.

    The two images of one effect differ by what its size changes and by errors of the attitude in both: structure along
    that difference is the same cause once more.
    """
    at_nothing = [c.jacobian for c in result.candidates if any(c.effect == effect for effect, _ in result.chosen)]
    columns = np.concatenate([fitted, *at_nothing], axis=2)
    return what_is_left(problem, whitener, result.residual_nT, columns, found=dictionary)


def bare(problem: Problem, answer: Answer, dictionary: Sequence[Block]) -> Answer:
    """The same noise with no effect named."""
    found = answer.result
    result = replace(
        found,
        named=(),
        chosen=(),
        modelled=found.modelled_alone,
        residual_nT=found.residual_alone_nT,
        residual_white=found.residual_alone_white,
        jacobian_white=found.nuisance_alone_white,
        chi2={**found.chi2, "named": found.chi2["nuisance"]},
    )
    signals = signals_of(answer.shapes)
    own = [derivatives(problem, signals)] if signals else []
    fitted = np.concatenate([answer.alone_nT, *own], axis=2)
    left = what_is_left(problem, answer.whitener, result.residual_nT, fitted, found=dictionary)
    return replace(answer, result=result, fitted_nT=fitted, left=left)


def _beside(problem: Problem, signals: Sequence[Active]) -> Problem:
    """The problem with further signals among what is re-estimated."""
    if not signals:
        return problem
    every = [*problem.modelled_active, *signals]
    effects = [effect for effect, _ in every if isinstance(effect, SignalEffect)]
    return replace(problem, modelled=tuple(effects), modelled_theta=tuple(np.asarray(theta) for _, theta in every))


def _stripped(problem: Problem, result: SearchResult, signals: Sequence[Active]) -> SearchResult:
    """The result with those signals not among what is re-estimated: they are causes, and in the residual."""
    if not signals:
        return result
    count = len(problem.modelled)
    modelled, alone = result.modelled[:count], result.modelled_alone[:count]
    return replace(
        result,
        modelled=modelled,
        modelled_alone=alone,
        residual_nT=problem.residual_of(in_order([*problem.frozen, *modelled, *result.chosen])),
        residual_alone_nT=problem.residual_of(in_order([*problem.frozen, *alone])),
    )


def _with_the_line(problem: Problem, result: SearchResult, rest: Leftover) -> SearchResult:
    """The result with the strongest line in what is structured: no image of an effect holds it."""
    tone = strongest_tone(problem.setting.seconds, rest)
    whole, rank = result.chi2["saturated"]
    line = (whole - tone.explained, rank + TONE_DEGREES)
    return replace(result, chi2={**result.chi2, "saturated": line})
