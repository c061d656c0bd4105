"""The diagnosis from end to end: where the gap lies, which effect causes it, how far it shrinks."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from fluxtwin.gap import far, verdict
from fluxtwin.gap.blocks import Block, blocks
from fluxtwin.gap.candidates import candidates, derivative, in_order
from fluxtwin.gap.flexible import FlexibleFinding
from fluxtwin.gap.left import Left, what_is_left
from fluxtwin.gap.named import SearchResult
from fluxtwin.gap.noise import NoiseModel, RobustRows, Whitener, choose_noise, complete_budget, make_whitener
from fluxtwin.gap.noise_range import plausible_noise
from fluxtwin.gap.problem import DEFAULT_MODELLED, Budget, Problem, pose
from fluxtwin.gap.records import Diagnosis, GapSeries, Shrinkage
from fluxtwin.gap.refit import settled
from fluxtwin.gap.search import search
from fluxtwin.gap.stochastic import coarse, flexible_findings, shape_of, stochastic_nT, white_rms_nT
from fluxtwin.gap.where import Where, where
from fluxtwin.sim.effects.base import SignalEffect
from fluxtwin.sim.effects.chain import Active
from fluxtwin.sim.errors import NoAnswer
from fluxtwin.sim.field_models import FieldModel
from fluxtwin.sim.progress import Progress, silent
from fluxtwin.sim.sensors.magnetometer import Magnetometer
from fluxtwin.sim.telemetry import Telemetry
from fluxtwin.sim.types import BoolArray, FloatArray

MOST_ROWS = 12_000
"""Longer records are thinned to this many rows, evenly: what is slow stays, what is fast is seen less well."""
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
    left: Left
    flexible: tuple[FlexibleFinding, ...]
    where: Where
    shrinkage: Shrinkage
    series: GapSeries


def diagnose(
    telemetry: Telemetry,
    model: FieldModel,
    *,
    modelled: Sequence[str] = DEFAULT_MODELLED,
    budget: Budget | None = None,
    instrument: Magnetometer | None = None,
    frozen: Sequence[Active] = (),
    provenance: Mapping[str, object] | None = None,
    progress: Progress = silent,
) -> Diagnosis:
    """Diagnose a record against a field model.

    modelled: effects re-estimated as nuisance in every test. budget: the declared noise; what is missing is found in
    the data. instrument: starting S, b, T. frozen: effects applied as they are.
    Raises BadInput for unknown names and absent columns, NoAnswer when there are too few rows for the question.
    """
    progress("baseline", 0.0)
    record, every = _thinned(telemetry)
    problem = pose(
        record, model, modelled=modelled, budget=budget, instrument=instrument, frozen=frozen
    )  # fmt: skip
    _require_rows(problem)
    work = investigate(settled(problem), progress)
    notes: dict[str, object] = dict(provenance or {})
    notes |= {"field_model": model.title, "noise": work.noise.words, "rows_thinned_by": every}
    notes |= {f"budget: {name}": source for name, source in (complete_budget(work.problem).sources or {}).items()}
    if work.robust.words:
        notes["spoilt_readings"] = work.robust.words
    without = int((telemetry.has_reading & ~telemetry.has_attitude).sum())
    progress("done", 1.0)
    return verdict.assemble(work, notes, without_attitude=without)


def investigate(problem: Problem, progress: Progress = silent) -> Work:
    """Noise, search, what is left, where, how far."""
    progress("every effect on this design", 0.05)
    coarser, declared_lsb_nT = coarse(problem), problem.budget.lsb_nT
    if coarser is not None and coarser.confirmed:
        wider = replace(problem.budget, lsb_nT=coarser.parameters["lsb"][0])
        problem = replace(problem, budget=wider)
    found, _ = candidates(problem)
    dictionary = blocks(problem)
    progress("noise", 0.25)
    saturated = _saturated(problem, [c.jacobian for c in found], dictionary)
    noise, robust = choose_noise(problem, saturated)
    progress("which effects", 0.45)
    answer = _answer(problem, noise, robust, dictionary)
    if answer.burden > _NOTHING:
        # A finding must hold with every noise model that the data leave possible; the plainest answer counts.
        progress("whether the noise explains it", 0.6)
        for other in plausible_noise(problem, saturated, noise, robust):
            answer = min(answer, _answer(problem, other, robust, dictionary), key=lambda one: one.burden)
            if answer.burden == _NOTHING:
                break
    progress("what is left, and where", 0.75)
    answer, shape = _shaped(problem, answer, dictionary)
    if shape is not None and isinstance(shape.instance, SignalEffect):
        # A line or a switched field was noise to the choice above.
        own = _own_jacobian(problem, shape.instance)
        noise, robust = choose_noise(problem, np.concatenate([saturated, own], axis=2))
        answer = _with_columns(problem, replace(answer, noise=noise), robust, own, dictionary)
    noise, whitener, result = answer.noise, answer.whitener, answer.result
    alone, fitted, left = answer.alone_nT, answer.fitted_nT, answer.left
    flexible = flexible_findings(
        problem, whitener, noise, robust, result.residual_nT, fitted, left.structured, coarser, shape
    )
    place = _place(problem, whitener, result, alone, fitted, dictionary, left)
    progress("how far", 0.9)
    shrinkage, series = _how_far(problem, robust, declared_lsb_nT, answer, flexible)
    return Work(problem, noise, robust, whitener, result, alone, fitted, left, flexible, place, shrinkage, series)


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


def _answer(problem: Problem, noise: NoiseModel, robust: RobustRows, dictionary: Sequence[Block]) -> _Answer:
    whitener = make_whitener(problem.field_B_nT, problem.setting.seconds, problem.segment, noise, robust.weights)
    result = search(problem, whitener)
    alone = _jacobian(problem, result.modelled_alone, ())
    fitted = _jacobian(problem, result.modelled, result.chosen) if result.chosen else alone
    left = what_is_left(problem, whitener, result.residual_nT, fitted, found=dictionary)
    return _Answer(noise, whitener, result, alone, fitted, left)


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
        if not isinstance(finding.instance, SignalEffect):
            return replace(trial, left=replace(trial.left, structured=False)), finding
        return trial, finding
    return answer, None


def _own_jacobian(problem: Problem, effect: SignalEffect) -> FloatArray:
    """(N, 3, P) of an effect that the search did not have among its candidates."""
    on = in_order([*problem.frozen, (effect, np.zeros(len(effect.parameters)))])
    return derivative(problem.chain, on, next(place for place, pair in enumerate(on) if pair[0] is effect))


def _with_columns(
    problem: Problem, answer: _Answer, robust: RobustRows, own: FloatArray, dictionary: Sequence[Block]
) -> _Answer:
    """The answer with further effect columns (N, 3, P) fitted, whitened by its own noise model."""
    whitener = make_whitener(problem.field_B_nT, problem.setting.seconds, problem.segment, answer.noise, robust.weights)
    fitted = np.concatenate([answer.fitted_nT, own], axis=2)
    left = what_is_left(problem, whitener, answer.result.residual_nT, fitted, found=dictionary)
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
    if problem.rows < wanted:
        raise NoAnswer(
            f"{problem.rows} rows with reading, position and attitude are too few to tell a gap from "
            f"{problem.nuisance.shape[2]} parameters that are re-estimated; at least {wanted} are needed",
            evidence={"rows": problem.rows, "needed": wanted},
        )


def _saturated(problem: Problem, jacobians: Sequence[FloatArray], dictionary: Sequence[Block]) -> FloatArray:
    """(N, 3, P) every column that may be in the signal, as far as the rows can bear them."""
    columns = [*jacobians]
    room = problem.rows - sum(block.shape[2] for block in columns)
    for block in dictionary:
        made = block.make()
        if room < made.shape[2] or problem.rows * 3 * made.shape[2] > 5e7:
            continue
        columns.append(made)
        room -= made.shape[2]
    return np.concatenate(columns, axis=2) if columns else np.zeros((problem.rows, 3, 0))


def _jacobian(problem: Problem, modelled: Sequence[Active], chosen: Sequence[Active]) -> FloatArray:
    """(N, 3, C + P) derivative of the reading: what is modelled first, then the chosen effects, in their order."""
    wanted = [*modelled, *chosen]
    on = in_order([*problem.frozen, *wanted])
    parts = []
    for effect, _ in wanted:
        number = next(place for place, pair in enumerate(on) if pair[0] is effect)
        parts.append(derivative(problem.chain, on, number))
    return np.concatenate(parts, axis=2) if parts else np.zeros((problem.rows, 3, 0))


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
    white = tuple(answer.whitener.apply(part) if part.size else part for part in raw)
    prediction = far.predict_blocks(problem.setting.seconds, kept, raw, (white[0], white[1], white[2], white[3]))
    with_effects = far.floor_rms_nT(problem.field_B_nT[kept], white_rms_nT(noise), noise.theta_rad)
    extra = stochastic_nT(flexible, noise, declared_lsb_nT)
    floor = float(np.sqrt(max(with_effects**2 - extra**2, 0.0)))
    walk = next((one for one in flexible if one.effect == "bias_random_walk"), None)
    if walk is not None:
        after, unsure = far.one_step(
            result.residual_nT, problem.setting.seconds, kept, walk.parameters["rate"][0], with_effects
        )
        prediction = far.Prediction(prediction.before_nT, after)
        with_effects = float(np.hypot(with_effects, unsure))
    named = bool(result.named) or bool(flexible)
    shrinkage = far.shrinkage(
        prediction, kept, floor, with_effects, seed=problem.rows, named=named, one_step=walk is not None
    )
    before = np.where(kept[:, None], prediction.before_nT, np.nan)
    after = np.where(kept[:, None], prediction.after_nT, np.nan) if named else before
    return shrinkage, GapSeries(problem.time, before, after)


__all__ = ["MOST_ROWS", "SignalEffect", "Work", "diagnose", "investigate"]
