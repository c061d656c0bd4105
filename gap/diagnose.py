"""The diagnosis from end to end: where the gap lies, which effect causes it, how far it shrinks."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from fluxtwin.gap import far, verdict
from fluxtwin.gap.blocks import Block, blocks
from fluxtwin.gap.candidates import Candidate, candidates, derivatives
from fluxtwin.gap.constancy import MANY, constant, pliable
from fluxtwin.gap.evidence import Dictionary, leftover
from fluxtwin.gap.flexible import FlexibleFinding, wheel_line
from fluxtwin.gap.frail import Shaken
from fluxtwin.gap.full_rate import FullRate, full_rate
from fluxtwin.gap.growth import needed
from fluxtwin.gap.left import Left, what_is_left
from fluxtwin.gap.momentum import Momentum, balanced
from fluxtwin.gap.momentum_arcs import Craft
from fluxtwin.gap.named import SearchResult
from fluxtwin.gap.noise import (
    NoiseModel,
    RobustRows,
    Whitener,
    choose_noise,
    complete_budget,
    noise_choice,
    whitener_of,
)
from fluxtwin.gap.noise_range import plausible_noise
from fluxtwin.gap.problem import DEFAULT_MODELLED, Budget, Problem, pose, realigned
from fluxtwin.gap.records import Diagnosis, GapSeries, Shrinkage
from fluxtwin.gap.refit import settled
from fluxtwin.gap.search import search
from fluxtwin.gap.stochastic import coarse, flexible_findings, floor_noise, shape_of, stochastic_nT
from fluxtwin.gap.tones import tone_near
from fluxtwin.gap.where import Where, where
from fluxtwin.sim.effects.base import SignalEffect
from fluxtwin.sim.effects.chain import Active
from fluxtwin.sim.errors import NoAnswer
from fluxtwin.sim.field_models import FieldModel
from fluxtwin.sim.progress import Progress, silent
from fluxtwin.sim.sensors.magnetometer import Magnetometer
from fluxtwin.sim.telemetry import Telemetry
from fluxtwin.sim.types import BoolArray, FloatArray

MOST_ROWS = 5_000
"""Longer records are thinned to this many rows, evenly; what is faster is looked for in a stretch at the full rate."""
_LEAST_FREE = 30
_NOTHING = (False, 0)


@dataclass(frozen=True, eq=False)
class Work:
    """Everything that was found on the way; N rows."""

    problem: Problem
    noise: NoiseModel
    robust: RobustRows
    whitener: Whitener
    found: SearchResult
    nuisance_nT: FloatArray
    """(N, 3, C) Jacobian of what is modelled, without named effects."""
    fitted_nT: FloatArray
    """(N, 3, C + P) Jacobian of what is modelled and of the named effects, at the refit."""
    constant: bool
    """Whether the named effects keep their parameters over the record."""
    left: Left
    flexible: tuple[FlexibleFinding, ...]
    where: Where
    shrinkage: Shrinkage
    series: GapSeries
    momentum: Momentum
    """The balance of the momentum."""


def diagnose(
    telemetry: Telemetry,
    model: FieldModel,
    *,
    modelled: Sequence[str] = DEFAULT_MODELLED,
    budget: Budget | None = None,
    instrument: Magnetometer | None = None,
    frozen: Sequence[Active] = (),
    ruled_out: Sequence[str] = (),
    craft: Craft | None = None,
    provenance: Mapping[str, object] | None = None,
    progress: Progress = silent,
) -> Diagnosis:
    """Diagnose a record against a field model.

    modelled: effects re-estimated as nuisance in every test. budget: the declared noise; what is missing is found in
    the data. instrument: starting S, b, T. frozen: effects applied as they are. ruled_out: effects that another measurement
    has ruled out. craft: the vehicle as modelled, for the balance of its momentum.
    Raises BadInput for unknown names and absent columns, NoAnswer when there are too few rows for the question.
    """
    progress("baseline", 0.0)
    record, every = _thinned(telemetry)
    problem = pose(
        record, model, modelled=modelled, budget=budget, instrument=instrument, frozen=frozen
    )  # fmt: skip
    problem = replace(problem, ruled_out=tuple(ruled_out))
    _require_rows(problem)
    work = investigate(settled(problem), progress, None if every == 1 else telemetry, craft)
    notes: dict[str, object] = dict(provenance or {})
    notes |= {"field_model": model.title, "noise": work.noise.words, "rows_thinned_by": every}
    notes |= {f"budget: {name}": source for name, source in (complete_budget(work.problem).sources or {}).items()}
    if work.robust.words:
        notes["spoilt_readings"] = work.robust.words
    if work.problem.axes is not None:
        notes["without_attitude"] = work.problem.axes.words
    without = int((telemetry.has_reading & ~telemetry.has_attitude).sum())
    progress("done", 1.0)
    return verdict.assemble(work, notes, without_attitude=without)


def investigate(
    problem: Problem, progress: Progress = silent, whole: Telemetry | None = None, craft: Craft | None = None
) -> Work:
    """Noise, search, what is left, where, how far. whole: the record that the problem's rows are thinned from."""
    progress("every effect on this design", 0.05)
    coarser, declared_lsb_nT = coarse(problem), problem.budget.lsb_nT
    if coarser is not None and coarser.confirmed:
        wider = replace(problem.budget, lsb_nT=coarser.parameters["lsb"][0])
        problem = replace(problem, budget=wider)
    shaken = Shaken(problem)
    known = candidates(problem, shaken=shaken)
    dictionary = Dictionary(blocks(problem, shaken=shaken), problem.rows)
    progress("noise", 0.25)
    saturated = _saturated(problem, [c.jacobian for c in known[0]], dictionary)
    settled_on = noise_choice(problem, *saturated)
    noise, robust = settled_on.noise, settled_on.robust
    progress("which effects", 0.45)
    answer = _answer(problem, noise, robust, dictionary, known)
    if problem.axes is not None and answer.result.chosen:
        # A large effect moves where readings without attitude point to.
        problem = realigned(problem, beside=[*answer.result.modelled, *answer.result.chosen])
        known = candidates(problem)
        answer = _answer(problem, noise, robust, dictionary, known)
    if answer.burden > _NOTHING:
        # A finding must hold with every noise model that the data leave possible; the plainest answer counts.
        progress("whether the noise explains it", 0.6)
        for other in plausible_noise(problem, settled_on):
            if _stands(problem, answer, other, robust):
                continue
            answer = min(answer, _answer(problem, other, robust, dictionary, known), key=lambda one: one.burden)
            if answer.burden == _NOTHING:
                break
    del settled_on  # its likelihood holds the whole design once more
    progress("what is left, and where", 0.75)
    fast = None if whole is None else full_rate(whole, problem, answer.result.modelled, answer.result.chosen)
    answer, shape = _shaped(problem, answer, dictionary)
    answer, shape = _with_line(problem, answer, shape, fast)
    if shape is not None and isinstance(shape.instance, SignalEffect):
        # A line or a switched field was noise to the choice above.
        own = derivatives(problem, [(shape.instance, np.zeros(len(shape.instance.parameters)))])
        noise, robust = choose_noise(problem, *saturated, own)
        answer = _with_columns(problem, replace(answer, noise=noise), robust, own, dictionary)
    noise, whitener, result = answer.noise, answer.whitener, answer.result
    alone, fitted, left = answer.alone_nT, answer.fitted_nT, answer.left
    flexible = (
        flexible_findings(problem, whitener, noise, robust, result.residual_nT, fitted, left.structured, coarser, shape)
        if fast is None
        else flexible_findings(
            fast.problem, fast.whitener, fast.noise, fast.robust, fast.residual_nT, fast.fitted_nT, left.structured,
            coarser, shape,
        )
    )  # fmt: skip
    place = _place(problem, whitener, result, alone, fitted, dictionary, left)
    progress("how far", 0.9)
    shrinkage, series = _how_far(problem, robust, declared_lsb_nT, answer, flexible)
    momentum = balanced(problem, craft, whitener, result, fitted)
    return Work(
        problem, noise, robust, whitener, result, alone, fitted, answer.constant, left, flexible, place, shrinkage,
        series, momentum,
    )  # fmt: skip


@dataclass(frozen=True, eq=False)
class _Answer:
    """What one noise model leads to; Jacobians as in `Work`."""

    noise: NoiseModel
    whitener: Whitener
    result: SearchResult
    alone_nT: FloatArray
    fitted_nT: FloatArray
    left: Left

    @property
    def burden(self) -> tuple[bool, int]:
        """How much has to be believed: structure without a name, then names."""
        return self.left.structured, len(self.result.named)

    @cached_property
    def constant(self) -> bool:
        """Whether what is named keeps its parameters."""
        return constant(self.result)

    @property
    def carries(self) -> bool:
        """Whether something is named that leaves no structure, or little of it."""
        left = self.left.structured and (self.result.explained_share or 0.0) < verdict.CARRIED
        return bool(self.result.named) and not left


def _answer(
    problem: Problem,
    noise: NoiseModel,
    robust: RobustRows,
    dictionary: Sequence[Block],
    known: tuple[list[Candidate], dict[str, str]],
) -> _Answer:
    """The answer; where what it names does not keep its parameters, and has many, one without such names if it stands."""
    answer = _plain_answer(problem, noise, robust, dictionary, known)
    if not pliable(answer.result) or answer.constant:
        return answer
    bound = [candidate for candidate in known[0] if len(candidate.effect.parameters) <= MANY]
    other = _plain_answer(problem, noise, robust, dictionary, (bound, known[1]))
    if not other.carries:
        return answer
    whole = answer.result  # what was asked of every candidate
    result = replace(
        other.result, ranking=whole.ranking, untestable=whole.untestable, isolability=whole.isolability,
        minimum_detectable=whole.minimum_detectable,
    )  # fmt: skip
    return replace(other, result=result)


def _plain_answer(
    problem: Problem,
    noise: NoiseModel,
    robust: RobustRows,
    dictionary: Sequence[Block],
    known: tuple[list[Candidate], dict[str, str]],
) -> _Answer:
    whitener = whitener_of(problem, noise, robust.weights)
    result = search(problem, whitener, known=known)
    alone = derivatives(problem, result.modelled_alone)
    fitted = derivatives(problem, [*result.modelled, *result.chosen]) if result.chosen else alone
    left = _left(problem, whitener, result, fitted, dictionary)
    return _Answer(noise, whitener, result, alone, fitted, left)


def _stands(problem: Problem, answer: _Answer, other: NoiseModel, robust: RobustRows) -> bool:
    """Whether an answer of one name and nothing left could not be plainer under another noise model."""
    if answer.left.structured or len(answer.result.chosen) != 1:
        return False
    effect, _ = answer.result.chosen[0]
    one = next(c for c in answer.result.candidates if c.effect == effect)
    return needed(problem, whitener_of(problem, other, robust.weights), one, answer.result.tested)


def _left(
    problem: Problem, whitener: Whitener, result: SearchResult, fitted: FloatArray, dictionary: Sequence[Block]
) -> Left:
    """What is left beside the named effects at their refit and, of a large one, beside its image at nothing too.

    The two images of one effect differ by what its size changes and by errors of the attitude in both: structure along
    that difference is the same cause once more.
    """
    at_nothing = [c.jacobian for c in result.candidates if any(c.effect == effect for effect, _ in result.chosen)]
    columns = np.concatenate([fitted, *at_nothing], axis=2)
    return what_is_left(problem, whitener, result.residual_nT, columns, found=dictionary)


def _shaped(problem: Problem, answer: _Answer, dictionary: Sequence[Block]) -> tuple[_Answer, FlexibleFinding | None]:
    """The structure that is left as a line, a thermostat or a walk, if it has the shape of one.

    First in place of named effects that do not carry the structure (many effects each mop up a little of a walk),
    then beside them.
    """
    if not answer.left.structured:
        return answer, None
    trials = [answer]
    if answer.result.named and (answer.result.explained_share or 0.0) < verdict.CARRIED:
        trials.insert(0, _bare(problem, answer, dictionary))
    for trial in trials:
        finding = shape_of(
            problem, trial.whitener, trial.noise, trial.result.residual_nT, trial.fitted_nT, trial.left, dictionary
        )
        if finding is None:
            continue
        if finding.effect == "bias_random_walk" and trial.result.named:
            # Beside effects that mopped up a part of it a walk is a walk still; alone it says the same with less.
            bare = _bare(problem, answer, dictionary)
            alone = shape_of(
                problem, bare.whitener, bare.noise, bare.result.residual_nT, bare.fitted_nT, bare.left, dictionary
            )
            if alone is not None and alone.effect == finding.effect:
                trial, finding = bare, alone
        if not isinstance(finding.instance, SignalEffect):
            return replace(trial, left=replace(trial.left, structured=False)), finding
        return trial, finding
    if len(trials) == 1 and answer.result.named:
        # Steps and drifts may carry most of a large walk, and leave it wandering still.
        bare = _bare(problem, answer, dictionary)
        alone = shape_of(
            problem, bare.whitener, bare.noise, bare.result.residual_nT, bare.fitted_nT, bare.left, dictionary
        )
        if alone is not None and alone.effect == "bias_random_walk":
            return replace(bare, left=replace(bare.left, structured=False)), alone
    return answer, None


def _with_line(
    problem: Problem, answer: _Answer, shape: FlexibleFinding | None, fast: FullRate | None
) -> tuple[_Answer, FlexibleFinding | None]:
    """A line that only the full rate shows, with its name or as structure that has none."""
    if fast is None or not fast.has_line:
        return answer, shape
    line = fast.line()
    if line is not None:
        # The thinned rows hold the phase over the whole record.
        rest = leftover(answer.whitener, answer.result.residual_nT, answer.fitted_nT)
        tone = tone_near(problem.setting.seconds, rest, fast.tone.frequency_Hz)
        longer = wheel_line(problem.setting, rest, tone)
        line = longer if longer is not None and longer.confirmed else line
        return replace(answer, left=replace(answer.left, structured=False)), line
    if answer.left.structured:
        return answer, shape
    words = f"a line at a period of {1 / fast.tone.frequency_Hz:.3g} s, in the full rate"
    p_value = min(1.0, 4.0 * float(10**fast.tone.log10_p))
    found = replace(
        answer.left, structured=True, p_value=p_value, condition=None, frame=None, kind="tone", words=words,
        label="tone", frequency_Hz=fast.tone.frequency_Hz,
    )  # fmt: skip
    return replace(answer, left=found), shape


def _with_columns(
    problem: Problem, answer: _Answer, robust: RobustRows, own: FloatArray, dictionary: Sequence[Block]
) -> _Answer:
    """The answer with further effect columns (N, 3, P) fitted, whitened by its own noise model."""
    whitener = whitener_of(problem, answer.noise, robust.weights)
    fitted = np.concatenate([answer.fitted_nT, own], axis=2)
    left = _left(problem, whitener, answer.result, fitted, dictionary)
    return replace(answer, whitener=whitener, fitted_nT=fitted, left=left)


def _bare(problem: Problem, answer: _Answer, dictionary: Sequence[Block]) -> _Answer:
    """The same noise with no effect named."""
    found = answer.result
    result = replace(
        found, named=(), chosen=(), modelled=found.modelled_alone, residual_nT=found.residual_alone_nT,
        residual_white=found.residual_alone_white, jacobian_white=found.nuisance_alone_white,
        chi2={**found.chi2, "named": found.chi2["nuisance"]},
    )  # fmt: skip
    left = what_is_left(problem, answer.whitener, result.residual_nT, answer.alone_nT, found=dictionary)
    return replace(answer, result=result, fitted_nT=answer.alone_nT, left=left)


def _thinned(telemetry: Telemetry) -> tuple[Telemetry, int]:
    every = max(1, int(np.ceil(len(telemetry) / MOST_ROWS)))
    return (telemetry if every == 1 else telemetry.select(slice(None, None, every))), every


def _require_rows(problem: Problem) -> None:
    wanted = -(-(problem.nuisance.shape[2] + _LEAST_FREE) // 3) + 10
    if problem.whole_rows < wanted:
        plain = problem.axes is None
        each = "" if plain else f" (a row without attitude counts for a third: {problem.rows} rows in all)"
        raise NoAnswer(
            f"{problem.whole_rows} rows with reading, position and attitude{each} are too few to tell a gap from "
            f"{problem.nuisance.shape[2]} parameters that are re-estimated; at least {wanted} are needed",
            evidence={"rows": problem.rows, "needed": wanted},
        )


def _saturated(problem: Problem, jacobians: Sequence[FloatArray], dictionary: Dictionary) -> list[FloatArray]:
    """Every column that may be in the signal (N, 3, p), as far as the rows can bear them."""
    room = problem.whole_rows - sum(block.shape[2] for block in jacobians)
    if dictionary.small and dictionary.width and room >= dictionary.width:
        return [*jacobians, dictionary.columns]
    columns = [*jacobians]
    for block in dictionary:
        made = block.make()
        if room < made.shape[2] or problem.rows * 3 * made.shape[2] > 5e7:
            continue
        columns.append(made)
        room -= made.shape[2]
    return columns


def _place(
    problem: Problem,
    whitener: Whitener,
    result: SearchResult,
    alone: FloatArray,
    fitted: FloatArray,
    dictionary: Sequence[Block],
    left: Left,
) -> Where:
    """Of the whole gap where it is explained, of the rest where structure remains that is not."""
    if left.structured and result.named and (result.explained_share or 1.0) < verdict.CARRIED:
        return where(problem, whitener, result.residual_nT, fitted, found=dictionary)
    return where(problem, whitener, result.residual_alone_nT, alone, found=dictionary, candidates=result.candidates)


def _how_far(
    problem: Problem,
    robust: RobustRows,
    declared_lsb_nT: float | None,
    answer: _Answer,
    flexible: Sequence[FlexibleFinding],
) -> tuple[Shrinkage, GapSeries]:
    """Held-out figures. Where a walk was found it is judged one step ahead."""
    kept: BoolArray = ~np.any(robust.cut, axis=1)
    result, alone, noise = answer.result, answer.alone_nT, answer.noise
    effect_columns = answer.fitted_nT[:, :, alone.shape[2] :]
    raw = (result.residual_alone_nT, alone, result.residual_nT, effect_columns)
    own = tuple(problem.judged(part) for part in raw)
    white = tuple(answer.whitener.apply(part) if part.size else part for part in raw)
    prediction = far.predict_blocks(
        problem.setting.seconds, kept, (own[0], own[1], own[2], own[3]), (white[0], white[1], white[2], white[3])
    )
    white_nT, theta_rad = floor_noise(flexible, noise, problem.budget)
    with_effects = far.floor_rms_nT(problem.noise_field_nT[kept], white_nT, theta_rad, problem.measured[kept])
    extra = stochastic_nT(flexible, noise, declared_lsb_nT)
    floor = float(np.sqrt(max(with_effects**2 - extra**2, 0.0)))
    walk = next((one for one in flexible if one.effect == "bias_random_walk"), None)
    if walk is not None:
        after, unsure = _one_step(problem, result.residual_nT, kept, walk.parameters["rate"][0], with_effects)
        prediction = far.Prediction(prediction.before_nT, after)
        with_effects = float(np.hypot(with_effects, unsure))
    named = bool(result.named) or bool(flexible)
    shrinkage = far.shrinkage(
        prediction, kept, floor, with_effects, seed=problem.rows, named=named, one_step=walk is not None,
        axes=problem.axes,
    )  # fmt: skip
    parts = (prediction.before_nT, prediction.after_nT if named else prediction.before_nT)
    before, after = (part if problem.axes is None else problem.axes.in_body(part) for part in parts)
    unseen = ~kept[:, None]
    return shrinkage, GapSeries(problem.time, np.where(unseen, np.nan, before), np.where(unseen, np.nan, after))


def _one_step(
    problem: Problem, residual_nT: FloatArray, kept: BoolArray, rate: float, noise_nT: float
) -> tuple[FloatArray, float]:
    seconds = problem.setting.seconds
    if problem.axes is None:
        return far.one_step(residual_nT, seconds, kept, rate, noise_nT)
    return far.one_step_seen(problem.judged(residual_nT), problem.axes, seconds, kept, rate, noise_nT)


__all__ = ["MOST_ROWS", "SignalEffect", "Work", "diagnose", "investigate"]
