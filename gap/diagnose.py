"""The diagnosis from end to end: where the gap lies, which effect causes it, how far it shrinks."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from fluxtwin.gap.channels.momentum import balanced
from fluxtwin.gap.channels.momentum_arcs import Craft
from fluxtwin.gap.detectors.flexible import FlexibleFinding
from fluxtwin.gap.detectors.full_rate import full_rate
from fluxtwin.gap.detectors.residual_structure import Left, what_is_left
from fluxtwin.gap.detectors.stochastic import coarse, flexible_findings, floor_noise, stochastic_nT
from fluxtwin.gap.held_out import held_out
from fluxtwin.gap.held_out.held_out import floor_rms_nT
from fluxtwin.gap.hypotheses.blocks import Block, blocks
from fluxtwin.gap.hypotheses.candidates import candidates
from fluxtwin.gap.hypotheses.evidence import Dictionary
from fluxtwin.gap.hypotheses.perturbed_design import Shaken
from fluxtwin.gap.noise.choice import (
    RobustRows,
    Whitener,
    choose_noise,
    complete_budget,
    whitener_of,
)
from fluxtwin.gap.posterior.explanations import Answer, noise_and_answer
from fluxtwin.gap.posterior.structured import Shapes
from fluxtwin.gap.posterior.where import Where, where
from fluxtwin.gap.problem.problem import DEFAULT_MODELLED, Budget, Problem, pose, realigned
from fluxtwin.gap.problem.start import start_without_attitude
from fluxtwin.gap.records.diagnosis import Diagnosis, GapSeries, Shrinkage
from fluxtwin.gap.report import level, verdict
from fluxtwin.gap.report.work import Work
from fluxtwin.gap.selection.detectable import under_all
from fluxtwin.gap.selection.named import SearchResult
from fluxtwin.gap.selection.refit import Readings, refit, settled
from fluxtwin.sim.base.errors import NoAnswer
from fluxtwin.sim.base.progress import Progress, silent
from fluxtwin.sim.base.types import BoolArray, FloatArray
from fluxtwin.sim.earth.field_models import FieldModel
from fluxtwin.sim.effects.base import SignalEffect
from fluxtwin.sim.effects.chain import Active
from fluxtwin.sim.spacecraft.sensors.magnetometer import Magnetometer
from fluxtwin.sim.telemetry.record import Telemetry

MOST_ROWS = 5_000
"""Longer records are thinned to this many rows, evenly; what is faster is looked for in a stretch at the full rate."""
_REPEATED = 0.5
"""Share of readings that may be the same code as in the row before: rounding errors are noise, new in every row, only where
the reading moves by about a step from row to row (Widrow & Kollar 2008, Quantization Noise, chapter 20)."""
_FEWEST_ROWS = 200
_LEAST_FREE = 30
_BOUNDLESS_RAD = 1.0


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
    whole, new = _new_rounding(telemetry)
    every = max(1, int(np.ceil(len(whole) / MOST_ROWS)))
    record = _each(whole, every)
    if instrument is None and modelled and not record.has_attitude.any():
        instrument = start_without_attitude(record, model)
    problem = pose(record, model, modelled=modelled, budget=budget, instrument=instrument, frozen=frozen)
    out = dict.fromkeys(ruled_out, "the angle between sun and nadir has nothing of it")
    problem = replace(problem, ruled_out=out)
    _require_rows(problem)
    faster = None if every == 1 else whole
    work = investigate(settled(problem), progress, faster, craft)
    if work.momentum.ruled_out:
        problem = replace(problem, ruled_out={**out, **work.momentum.ruled_out})
        work = investigate(settled(problem), progress, faster, craft)
    notes: dict[str, object] = dict(provenance or {})
    notes |= {"field_model": model.title, "noise": work.noise.words}
    notes |= {"rows_thinned_by": every, "rounding_lasts_rows": new}
    complete = complete_budget(work.problem)
    notes |= {f"budget: {name}": source for name, source in (complete.sources or {}).items()}
    if work.robust.components_cut:
        notes["outliers"] = level.outlier_words(work.problem, work.robust)
    if work.problem.axes is not None:
        notes["without_attitude"] = work.problem.axes.words
    without = int((telemetry.has_reading & ~telemetry.has_attitude).sum())
    progress("done", 1.0)
    found = level.assumed(budget or Budget(), work.problem, work.noise)
    return verdict.assemble(work, notes, found, without_attitude=without)


def investigate(
    problem: Problem, progress: Progress = silent, whole: Telemetry | None = None, craft: Craft | None = None
) -> Work:
    """Noise, search, what is left, where, how far. whole: the record that the problem's rows are thinned from."""
    progress("every effect on this design", 0.05)
    coarser, declared_lsb_nT = coarse(problem), problem.budget.lsb_nT
    if coarser is not None and coarser.confirmed:
        wider = replace(problem.budget, lsb_nT=coarser.parameters["lsb"][0])
        problem = replace(problem, budget=wider)
    problem = _about_the_whitened_fit(problem)
    shaken = Shaken(problem)
    known = candidates(problem, shaken=shaken)
    dictionary = Dictionary(blocks(problem, shaken=shaken), problem.rows)
    progress("noise, and which effects", 0.25)
    first_noise, answer = noise_and_answer(problem, dictionary, known)
    if problem.axes is not None and answer.result.chosen:
        # A large effect moves where readings without attitude point to.
        problem = realigned(problem, beside=[*answer.result.modelled, *answer.result.chosen])
        known = candidates(problem)
        dictionary = Dictionary(blocks(problem), problem.rows)
        first_noise, answer = noise_and_answer(problem, dictionary, known)
    progress("what is left, and where", 0.75)
    fast = None if whole is None else full_rate(whole, problem, answer.result.modelled, answer.result.chosen)
    shapes = Shapes(problem, dictionary, known, lambda own: choose_noise(problem, own))
    answer = shapes.with_line(shapes.among(answer), fast)
    robust = answer.robust
    noise, whitener, result = answer.noise, answer.whitener, answer.result
    alone, fitted, left = answer.alone_nT, answer.fitted_nT, answer.left
    every = [whitener, whitener_of(problem, first_noise, robust.weights)]
    smallest = under_all(result.minimum_detectable, result.smallest_images_nT, alone, every)
    result = replace(result, minimum_detectable=smallest)
    rows = (problem, whitener, noise, robust, result.residual_nT, fitted)
    if fast is not None:
        rows = (fast.problem, fast.whitener, fast.noise, fast.robust, fast.residual_nT, fast.fitted_nT)
    findings = flexible_findings(*rows, left.structured, coarser, answer.shapes)
    flexible = tuple(one for one in findings if one.confirmed)
    loud = next((one.words for one in findings if one.effect == "excess_noise" and not one.confirmed), None)
    would_do_rad = _attitude_would_do(problem, answer, dictionary)
    place = _place(problem, whitener, result, alone, fitted, dictionary, left, answer.known)
    progress("how far", 0.9)
    shrinkage, series = _how_far(problem, robust, declared_lsb_nT, answer, flexible)
    momentum = balanced(problem, craft, whitener, result, fitted)
    return Work(
        problem,
        noise,
        robust,
        whitener,
        result,
        alone,
        fitted,
        answer.known,
        left,
        flexible,
        loud,
        place,
        shrinkage,
        series,
        momentum,
        would_do_rad,
    )


def _about_the_whitened_fit(problem: Problem) -> Problem:
    """The problem, linear about the fit of what is modelled under its noise, with the attitude error found where none was
    declared.

    Plain least squares takes up slow attitude errors in S: of a few passes S is then off by half a percent, and with it
    the direction in which the noise model lets an attitude error reach a reading. That is a nanotesla or two along the
    field, where a fine sensor sees tenths.
    """
    if not problem.noise_image_nT.any():
        return problem
    noise, robust = choose_noise(problem)
    if problem.free_attitude_error:
        problem = replace(problem, attitude_found_rad=noise.theta_rad)
    if not problem.modelled:
        return problem
    fit = refit(Readings(problem, whitener_of(problem, noise, robust.weights)))
    return realigned(replace(problem, modelled_theta=tuple(theta for _, theta in fit.modelled)))


def _attitude_would_do(problem: Problem, answer: Answer, dictionary: Dictionary) -> float | None:
    """How large an attitude error would make all of what is structured, where nothing bounds that error; else None.

    An attitude error leaves the component along the field alone. So the rows are whitened as if it were without bounds,
    and what is structured then is none of its doing.
    """
    if not problem.free_attitude_error or answer.known >= 0.5 or answer.result.named:
        return None
    boundless = replace(answer.noise, theta_rad=_BOUNDLESS_RAD, tau_s=0.0)
    whitener = whitener_of(problem, boundless, answer.robust.weights)
    if what_is_left(problem, whitener, answer.result.residual_nT, answer.fitted_nT, found=dictionary).structured:
        return None
    rest = problem.judged(answer.result.residual_nT)[~answer.robust.cut.any(axis=1)]
    reach = floor_rms_nT(problem.noise_field_nT, 0.0, 1.0, problem.measured)
    excess = max(float(np.mean(rest**2)) - float(np.mean(answer.noise.white_nT**2)), 0.0)
    return float(np.sqrt(excess)) / max(reach, 1e-9)


def _new_rounding(telemetry: Telemetry) -> tuple[Telemetry, int]:
    """The record with every n-th row, and n: as few as it takes for the rounding to be new from row to row."""
    every = 1
    while _repeated(telemetry.mag_B_nT[::every]) > _REPEATED and len(telemetry) >= 2 * every * _FEWEST_ROWS:
        every *= 2
    return _each(telemetry, every), every


def _each(telemetry: Telemetry, every: int) -> Telemetry:
    return telemetry if every == 1 else telemetry.select(slice(None, None, every))


def _repeated(mag_B_nT: FloatArray) -> float:
    """Share of readings (N, 3) that are the same to the digit as those of the row before; of the middle one of the axes."""
    same = mag_B_nT[1:] == mag_B_nT[:-1]
    return float(np.median(same.mean(axis=0))) if len(same) else 0.0


def _require_rows(problem: Problem) -> None:
    wanted = -(-(problem.nuisance.shape[2] + _LEAST_FREE) // 3) + 10
    if problem.whole_rows < wanted:
        plain = problem.axes is None
        each = "" if plain else f", where three without attitude count as one ({problem.rows} rows in all)"
        raise NoAnswer(
            f"the record is too short: it has {problem.whole_rows} rows with reading, position and attitude{each}; "
            f"at least {wanted} are needed to tell a gap from {problem.nuisance.shape[2]} parameters that are re-estimated",
            evidence={"rows": problem.rows, "needed": wanted},
        )


def _place(
    problem: Problem,
    whitener: Whitener,
    result: SearchResult,
    alone: FloatArray,
    fitted: FloatArray,
    dictionary: Sequence[Block],
    left: Left,
    known: float,
) -> Where:
    """Of the whole gap where it is explained, of the rest where structure remains that is not."""
    if result.named and known < 0.5:
        return where(problem, whitener, result.residual_nT, fitted, found=dictionary)
    return where(problem, whitener, result.residual_alone_nT, alone, found=dictionary, candidates=result.candidates)


def _how_far(
    problem: Problem,
    robust: RobustRows,
    declared_lsb_nT: float | None,
    answer: Answer,
    flexible: Sequence[FlexibleFinding],
) -> tuple[Shrinkage, GapSeries]:
    """Held-out figures. Where a walk was found it is judged one step ahead."""
    kept: BoolArray = ~np.any(robust.cut, axis=1)
    result, alone, noise = answer.result, answer.alone_nT, answer.noise
    effect_columns = answer.fitted_nT[:, :, alone.shape[2] :]
    raw = (result.residual_alone_nT, alone, result.residual_nT, effect_columns)
    own = tuple(problem.judged(part) for part in raw)
    white = tuple(answer.whitener.apply(part) if part.size else part for part in raw)
    white_nT, theta_rad = floor_noise(flexible, noise, problem.budget)
    with_effects = held_out.floor_rms_nT(problem.noise_field_nT[kept], white_nT, theta_rad, problem.measured[kept])
    prediction = held_out.predict_blocks(
        problem.setting.seconds,
        kept,
        (own[0], own[1], own[2], own[3]),
        (white[0], white[1], white[2], white[3]),
        with_effects,
    )
    extra = stochastic_nT(flexible, noise, declared_lsb_nT)
    floor = float(np.sqrt(max(with_effects**2 - extra**2, 0.0)))
    walk = next((one for one in flexible if one.effect == "bias_random_walk"), None)
    if walk is not None:
        after, unsure = _one_step(problem, result.residual_nT, kept, walk.parameters["rate"][0], with_effects)
        prediction = held_out.Prediction(prediction.before_nT, after, "one_step", prediction.known)
        with_effects = float(np.hypot(with_effects, unsure))
    named = bool(result.named) or bool(flexible)
    shrinkage = held_out.shrinkage(
        prediction, kept, floor, with_effects, seed=problem.rows, named=named, axes=problem.axes
    )
    parts = (prediction.before_nT, prediction.after_nT if named else prediction.before_nT)
    before, after = (part if problem.axes is None else problem.axes.in_body(part) for part in parts)
    unseen = ~(kept if prediction.known is None else kept & prediction.known)[:, None]
    return shrinkage, GapSeries(problem.time, np.where(unseen, np.nan, before), np.where(unseen, np.nan, after))


def _one_step(
    problem: Problem, residual_nT: FloatArray, kept: BoolArray, rate: float, noise_nT: float
) -> tuple[FloatArray, float]:
    seconds = problem.setting.seconds
    if problem.axes is None:
        return held_out.one_step(residual_nT, seconds, kept, rate, noise_nT)
    return held_out.one_step_seen(problem.judged(residual_nT), problem.axes, seconds, kept, rate, noise_nT)


__all__ = ["MOST_ROWS", "SignalEffect", "Work", "diagnose", "investigate"]
