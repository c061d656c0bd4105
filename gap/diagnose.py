"""The diagnosis from end to end: where the gap lies, which effect causes it, how far it shrinks."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from fluxtwin.calib.checks.copies import saying_stuck, stuck_words, without_stuck
from fluxtwin.gap.channels import sun_nadir
from fluxtwin.gap.channels.momentum_arcs import Craft
from fluxtwin.gap.channels.two_magnetometers import apart
from fluxtwin.gap.detectors.codes import coarse_steps, floor_noise, in_the_readings, stochastic_nT
from fluxtwin.gap.detectors.finding import Finding
from fluxtwin.gap.detectors.lines import MOST_ROWS_FAST, full_rate
from fluxtwin.gap.detectors.random_walk import worth_of_a_walk
from fluxtwin.gap.detectors.residual_structure import Structure, judge, residual_structure
from fluxtwin.gap.held_out.held_out import Prediction, floor_rms_nT, one_step, predict_blocks
from fluxtwin.gap.hypotheses.blocks import BlockFit, Dictionary, blocks
from fluxtwin.gap.hypotheses.candidates import PerturbedDesign, candidates, parts_of
from fluxtwin.gap.law.found import closed_by, law_of
from fluxtwin.gap.law.words import beside_names
from fluxtwin.gap.linear.projection import ProjectedResidual, projected
from fluxtwin.gap.noise.choice import NoiseModel, choose_noise, complete_budget, likely_noises, prior_of, whitener_of
from fluxtwin.gap.noise.whitening import with_walk
from fluxtwin.gap.posterior.explanations import Answer, answered, noise_and_search, without_names
from fluxtwin.gap.posterior.structured import Structured
from fluxtwin.gap.posterior.torques import balanced
from fluxtwin.gap.posterior.where import where
from fluxtwin.gap.problem.problem import DEFAULT_MODELLED, Budget, Problem, calibrated, corrected, pose, realigned
from fluxtwin.gap.problem.row_axes import start_without_attitude
from fluxtwin.gap.records.diagnosis import Detectable, Diagnosis, Place
from fluxtwin.gap.report import input_warnings, verdict, words
from fluxtwin.gap.report.verdict import Work
from fluxtwin.gap.selection.criterion import FEWEST, THRESHOLD
from fluxtwin.gap.selection.detectable import detectable
from fluxtwin.gap.selection.forward import Parameters
from fluxtwin.gap.selection.refit import Readings, refit, settled
from fluxtwin.sim.base.errors import NoAnswer, amount
from fluxtwin.sim.base.progress import Progress, silent
from fluxtwin.sim.base.types import BoolArray, FloatArray
from fluxtwin.sim.earth.field_models import FieldModel
from fluxtwin.sim.effects.catalogue import find_effect
from fluxtwin.sim.effects.chain import Active
from fluxtwin.sim.spacecraft.sensors.magnetometer import Magnetometer
from fluxtwin.sim.telemetry.record import Telemetry

MOST_ROWS = 5_000
"""Longer records are thinned to this many rows, evenly; what is faster is looked for in a stretch at the full rate."""


def diagnose(
    telemetry: Telemetry,
    model: FieldModel,
    *,
    modelled: Sequence[str] = DEFAULT_MODELLED,
    budget: Budget | None = None,
    instrument: Magnetometer | None = None,
    frozen: Sequence[Active] = (),
    craft: Craft | None = None,
    provenance: Mapping[str, object] | None = None,
    law: bool = True,
    progress: Progress = silent,
) -> Diagnosis:
    """Diagnose a record against a field model.

    modelled: effects re-estimated as nuisance in every test. budget: the declared noise; what is missing is found in
    the data. instrument: starting S, b, T. frozen: effects applied as they are. craft: the vehicle as modelled, for the
    balance of its momentum. law: whether to look for one in what the names leave.
    Raises BadInput for unknown names and absent columns, NoAnswer when there are too few rows for the question.
    """
    progress("baseline", 0.0)
    moving, stuck = without_stuck(telemetry)
    estimated = "torquer_coupling" in modelled
    coupled = estimated or (instrument is not None and instrument.T_nT_per_Am2 is not None)
    moving, unknown = input_warnings.without_unknown_dipole(moving, estimated) if coupled else (moving, 0)
    whole, new = new_rounding(moving)
    every = max(1, int(np.ceil(len(whole) / MOST_ROWS)))
    record = _each(whole, every)
    if instrument is None and modelled and not record.has_attitude.any():
        instrument = start_without_attitude(record, model)
    denser = _denser(moving, new * every)
    with saying_stuck(telemetry, stuck):
        problem = pose(
            record, model, modelled=modelled, budget=budget, instrument=instrument, frozen=frozen, denser=denser
        )
        _require_rows(problem)
    faster = None if every == 1 else whole
    channel = sun_nadir.channel_of(telemetry, frozen)
    work = investigate(settled(problem), progress, faster, craft)
    while out := _ruled_out(work, channel):
        problem = replace(problem, ruled_out={**problem.ruled_out, **out})
        work = investigate(settled(problem), progress, faster, craft)
    if channel is not None:
        gone = [name for name, why in problem.ruled_out.items() if why == sun_nadir.NOT_THERE]
        work = replace(work, angle=sun_nadir.weighed(work.standing, channel, gone, unexplained=work.known < 0.5))
    left_out = [stuck_words(telemetry.time, stuck)] if stuck.any() else []
    work = replace(work, stuck=left_out[0] if left_out else None)
    left_out += [words.unknown_dipole(unknown)] if unknown else []
    answer, problem = work.answer, work.problem
    facts = {**(provenance or {}), "field_model": model.title, "noise": answer.noise.words}
    facts |= {"rows_thinned_by": every, "rounding_lasts_rows": new}
    sources = complete_budget(problem).sources or {}
    facts |= {f"budget: {name}": source for name, source in sources.items()}
    notes = left_out
    if problem.axes is not None:
        facts["without_attitude"] = problem.axes.words
        notes.append(problem.axes.words)
    counted, robust = work.every_row
    if robust.cut.any():
        facts["outliers"] = words.outliers(counted.time, robust.cut)
        notes.append(words.outliers(counted.time, robust.cut))
    if work.apart is not None:
        gone = [name for name, why in problem.ruled_out.items() if why in (words.DENIED_SENSOR, words.DENIED_SHARED)]
        differ = work.differ is not None and work.differ.structured
        rms = {"apart_nT": work.apart.rms_nT, "noise_nT": work.apart.noise_nT}
        other = 3 - telemetry.magnetometer
        facts["two_magnetometers"] = {**rms, "differ": differ, "ruled_out": gone, "other": other}
        notes += [f"{name} would explain the readings, but {problem.ruled_out[name]}: ruled out" for name in gone]
    elif problem.telemetry.mag2_B_nT is not None:
        notes.append(words.SECOND_UNUSED)
    notes += [] if new == 1 else [words.repeated_rounding(new)]
    notes += [] if every == 1 else [words.thinned(every, MOST_ROWS_FAST)]
    if work.angle is not None:
        facts["sun_nadir"] = {**work.angle.to_dict(), "ruled_out": list(work.angle.ruled_out)}
        notes += work.angle.notes
    found = verdict.assemble(
        work,
        facts,
        verdict.assumed(budget or Budget(), problem, answer.noise),
        without_attitude=int((moving.has_reading & ~moving.has_attitude).sum()),
        notes=notes,
    )
    less = input_warnings.noise_below(answer.noise, problem.budget.noise_nT)
    if less and not input_warnings.far_below_budget(found.gap.before_nT, found.gap.floor_nT, True):
        found = replace(found, notes=[*found.notes, less])
    found = _with_law(work, found, progress) if law else found
    progress("done", 1.0)
    return found


def _with_law(work: Work, found: Diagnosis, progress: Progress) -> Diagnosis:
    """The diagnosis with the law of what its names leave; where they leave nothing, as it is."""
    open_ = (found.verdict == "unknown" and words.APART_FROM_THEM not in found.sentence) or found.gap.shape_incomplete
    exact = any(effect.by_definition for effect, _ in work.answer.result.chosen)  # what it leaves is not its shape
    in_torques = work.momentum.unexplained and work.known >= 0.5
    if not (open_ or exact) or in_torques or found.closure is None:
        return found
    law = law_of(work.problem, work.answer, work.in_readings if found.verdict == "effect" else [], progress)
    if not open_ and not law.record.terms:
        return found
    assumed = words.assumed(found.assumed)
    said = beside_names(found.sentence.removesuffix(assumed).rstrip(), law.record)
    sentence = " ".join(filter(None, (said, assumed)))
    return replace(found, law=law.record, sentence=sentence, closure=closed_by(law, found.closure))


def _ruled_out(work: Work, channel: sun_nadir.Channel | None) -> dict[str, str]:
    """{name: why} of effects that the momentum, the sun-nadir angle or a second magnetometer newly rules out."""
    by_angle = {} if channel is None else sun_nadir.ruled_out(work.standing, channel)
    found = {**work.momentum.ruled_out, **by_angle, **_denied(work)}
    return {name: why for name, why in found.items() if name not in work.problem.ruled_out}


def _denied(work: Work) -> dict[str, str]:
    """{name: why} of named effects, and of what might be in their places, that two magnetometers deny."""
    if work.apart is None:
        return {}
    problem, result = work.problem, work.answer.result
    gone: dict[str, str] = {}
    for one in work.flexible:
        if one.name == "bias_random_walk":
            worth = worth_of_a_walk(problem.setting.seconds, work.apart.left, float(one.theta[0]))
            if -worth > THRESHOLD:
                gone[one.name] = words.DENIED_SENSOR
    if not work.in_readings:
        return gone
    readings = projected(work.answer.whitener, result.residual_nT, work.answer.alone_nT)
    columns = {own[0].name: problem.derivatives([own]) for own in result.chosen}
    for place, (effect, _) in enumerate(result.chosen):
        without = [*result.modelled, *result.chosen[:place], *result.chosen[place + 1 :]]
        image_nT = problem.residual_of(without) - result.residual_nT
        others = [one for name, one in columns.items() if name != effect.name]
        named = next(one for one in work.in_readings if one.name == effect.name)
        for name in {effect.name, *named.group, *(rival for rival, _ in named.rivals)}:
            stage = find_effect(name).stage
            likely = [one.jacobian for one in result.candidates if one.name == name and one.live.any()]
            trials = [columns[name]] if name == effect.name else likely
            if work.apart.denies(readings, stage, trials, image_nT, others):
                gone[name] = words.DENIED_SENSOR if stage == "sensor" else words.DENIED_SHARED
    return gone


def investigate(
    problem: Problem, progress: Progress = silent, whole: Telemetry | None = None, craft: Craft | None = None
) -> Work:
    """Noise, search, residual structure, where, how far. whole: the record that the problem's rows are thinned from."""
    progress("every effect on this design", 0.05)
    declared_lsb_nT = problem.budget.lsb_nT
    coarser = coarse_steps(np.asarray(problem.telemetry.mag_B_nT), declared_lsb_nT)
    if coarser is not None:  # the grid is part of the noise
        problem = replace(problem, budget=replace(problem.budget, lsb_nT=float(coarser.theta[0])))
    problem = _about_the_whitened_fit(problem)
    perturbed = PerturbedDesign(problem)
    known = candidates(problem, perturbed=perturbed)
    dictionary = Dictionary(blocks(problem, perturbed=perturbed), problem.rows)
    progress("noise, and which effects", 0.25)
    sought = noise_and_search(problem, known)
    answer = answered(problem, sought, dictionary)
    again = _beside_the_names(problem, answer)
    if again is not problem:
        del sought  # there is room for one
        earlier = _in_terms_of(again, problem, answer.fitted)
        problem, known = again, candidates(again)
        dictionary = Dictionary(blocks(problem), problem.rows)
        sought = noise_and_search(problem, known, earlier)
        answer = answered(problem, sought, dictionary)
    if problem.free_attitude_error and answer.left.structured:
        steady = blocks(problem, perturbed=PerturbedDesign(problem, parts_of(answer.noise.theta_rad)))
        if len(steady) < len(dictionary.found):  # the others are made of the error that is found beside the names
            dictionary = Dictionary(steady, problem.rows)
            answer = answered(problem, sought, dictionary)
    del sought
    progress("residual structure, and where", 0.75)
    fast = None if whole is None else full_rate(whole, problem, answer.result.modelled, answer.result.chosen)
    waveforms = Structured(problem, dictionary, known)
    answer = waveforms.with_line(waveforms.among(answer), fast)
    result = answer.result
    every_row = (problem, answer.robust)
    rows = (problem, answer.whitener, answer.robust, result.residual_nT, answer.fitted_nT)
    if fast is not None:
        rows = (fast.problem, fast.whitener, fast.robust, fast.residual_nT, fast.fitted_nT)
        if whole is not None and len(whole) <= MOST_ROWS_FAST:
            every_row = (fast.problem, fast.robust)
    found = (*answer.shapes, *(() if coarser is None else (coarser,)))
    findings = in_the_readings(*rows, verdict.shape_nT(problem, answer), found)
    del rows, fast  # of all that is held, the most
    flexible = tuple(one for one in findings if one.confirmed)
    attitude_would_do_rad = _attitude_would_do(problem, answer, dictionary)
    between = apart(problem)
    other = None if between is None else (between.left, dictionary.fits(between.left))
    progress("how far", 0.9)
    return Work(
        problem=problem,
        answer=answer,
        flexible=flexible,
        every_row=every_row,
        minimum_detectable=_minimum_detectable(problem, answer),
        loud=next((one.words for one in findings if one.name == "excess_noise" and not one.confirmed), None),
        where=_place(problem, answer, dictionary, other),
        prediction=_prediction(problem, answer, flexible, declared_lsb_nT),
        momentum=balanced(problem, craft, answer.whitener, result, answer.fitted_nT),
        attitude_would_do_rad=attitude_would_do_rad,
        apart=between,
        differ=None if other is None else _differ(problem, *other),
    )


def _differ(problem: Problem, left: ProjectedResidual, fits: Sequence[BlockFit]) -> Structure:
    """What two magnetometers have apart: whether, by what is left as a whole; what it looks like, by the noise that they
    have, as a large step makes all that is left look large."""
    found = judge(problem, left, fits)
    return judge(problem, left, fits, variance=1.0) if found.structured else found


def _beside_the_names(problem: Problem, answer: Answer) -> Problem:
    """The problem as the named effects leave it; itself where they change nothing that matters.

    A large effect moves where readings without attitude point to. And the first fit takes some of it for S, through which
    the sizes of effects are measured: S is then set anew, if a size would move by more than a part of its sigma.
    """
    result, old = answer.result, problem.setting.instrument
    moved = float(np.abs(corrected(old, result.modelled).S - old.S).max())
    sizes = [abs(size.value / size.sigma) for one in result.named for size in one.parameters.values() if size.sigma]
    found = problem
    if moved * max(sizes, default=0.0) > 0.5:  # less makes the error of a size at most 12 % larger
        found = calibrated(problem, result.modelled)
    if problem.axes is not None and result.chosen:
        beside = [*(result.modelled if found is problem else found.modelled_active), *result.chosen]
        found = realigned(found, beside=beside)
    return found


def _in_terms_of(again: Problem, problem: Problem, fitted: Parameters) -> Parameters:
    """Parameters of a problem's fits where it has been set anew: what is modelled stands where the new one has it."""
    if again.setting.instrument is problem.setting.instrument:
        return fitted
    return {key: [*again.modelled_active, *active[len(problem.modelled) :]] for key, active in fitted.items()}


def _minimum_detectable(problem: Problem, answer: Answer) -> dict[str, Detectable]:
    """The smallest size of each effect that would have been named, by what the record says of its noise."""
    result, robust = answer.result, answer.robust
    if not result.smallest:
        return {}
    walk = next((float(one.theta[0]) for one in answer.shapes if one.name == "bias_random_walk"), 0.0)
    rate = walk / answer.noise.sigma_nT
    likely = likely_noises(problem, answer.whitener, result.residual_nT, answer.fitted_nT, rate)
    noises = [(answer.whitener, 0.0, 0.0)]
    for one in likely:
        own = whitener_of(problem, one.noise, robust.weights)
        whitener = with_walk(own, rate * one.noise.sigma_nT) if walk else own
        noises.append((whitener, one.probability, one.cost))
    images, seen = [], {}
    for name, least in result.smallest.items():
        owner = result.candidates[least.owner]
        images.append(owner.jacobian[:, :, least.place])
        seen[name] = least._replace(parameter=owner.effect.parameters_on(problem.setting)[least.place])
    return detectable(seen, np.stack(images, axis=-1), without_names(problem, answer), noises)


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
    boundless = replace(answer.noise, theta_rad=1.0, tau_s=0.0)  # beside it any other error in a reading is nothing
    whitener = whitener_of(problem, boundless, answer.robust.weights)
    if residual_structure(problem, whitener, answer.result.residual_nT, answer.fitted_nT, dictionary).structured:
        return None
    rest = problem.in_row_axes(answer.result.residual_nT)[~answer.robust.cut.any(axis=1)]
    reach = floor_rms_nT(problem.noise_field_nT, 0.0, 1.0, problem.measured, answer.noise.roll)
    excess = max(float(np.mean(rest**2)) - float(np.mean(answer.noise.white_nT**2)), 0.0)
    return float(np.sqrt(excess)) / max(reach, 1e-9)


def new_rounding(telemetry: Telemetry) -> tuple[Telemetry, int]:
    """The record with every n-th row, and n: as few as it takes for the rounding to be new from row to row, as noise is: it
    is so only where the reading moves by about a step (Widrow & Kollar 2008, Quantization Noise, chapter 20).

    At least 200 rows are left: several for each of some fifteen parameters of a usual problem.
    """
    every = 1
    while _repeated(telemetry.mag_B_nT[::every]) > 0.5 and len(telemetry) >= 400 * every:
        every *= 2
    return _each(telemetry, every), every


def _denser(telemetry: Telemetry, every: int) -> Telemetry | None:
    """The record for the motion between each `every`-th of its rows, these among them; None where there is no more of it."""
    steps = (step for step in range(1, every) if every % step == 0 and len(telemetry) <= step * MOST_ROWS_FAST)
    step = next(steps, None)
    return None if step is None else _each(telemetry, step)


def _each(telemetry: Telemetry, every: int) -> Telemetry:
    return telemetry if every == 1 else telemetry.select(slice(None, None, every))


def _repeated(mag_B_nT: FloatArray) -> float:
    """Share of readings (N, 3) that are the same to the digit as those of the row before; of the middle one of the axes."""
    same = mag_B_nT[1:] == mag_B_nT[:-1]
    return float(np.median(same.mean(axis=0))) if len(same) else 0.0


def _require_rows(problem: Problem) -> None:
    wanted = -(-(problem.nuisance.shape[2] + FEWEST) // 3) + 10
    whole = int(problem.measured.sum()) // 3  # rows of three components that are worth as many as are compared
    if whole < wanted:
        plain = problem.axes is None
        each = "" if plain else f" ({problem.rows} rows in all; three without attitude count as one)"
        raise NoAnswer(
            f"the record is too short: it has {amount(whole, 'row|rows')} with reading, position and attitude{each}; "
            f"at least {wanted} are needed to tell a gap from {problem.nuisance.shape[2]} parameters that are re-estimated",
            evidence={"rows": problem.rows, "needed": wanted},
        )


def _place(
    problem: Problem, answer: Answer, dictionary: Dictionary, other: tuple[ProjectedResidual, Sequence[BlockFit]] | None
) -> Place:
    """Of the whole gap where it is explained, of the rest where structure remains that is not."""
    result, whitener = answer.result, answer.whitener
    other = other if result.named or answer.left.structured else None
    unexplained = answer.known < 0.5
    if result.named and unexplained:
        rest = (result.residual_nT, answer.fitted_nT)
        return where(problem, whitener, *rest, dictionary, apart=other, unexplained=True)
    gap = (result.residual_alone_nT, answer.alone_nT)
    return where(problem, whitener, *gap, dictionary, result.candidates, other, unexplained=unexplained)


def _prediction(
    problem: Problem, answer: Answer, flexible: Sequence[Finding], declared_lsb_nT: float | None
) -> Prediction:
    """Held-out residuals; a walk is predicted one row ahead."""
    result, noise = answer.result, answer.noise
    kept: BoolArray = ~np.any(answer.robust.cut, axis=1)
    white_nT, theta_rad = floor_noise(flexible, noise, problem.budget)
    about = (problem.measured[kept], noise.roll)
    with_effects_nT = floor_rms_nT(problem.noise_field_nT[kept], white_nT, theta_rad, *about)
    floor_nT = float(np.sqrt(max(with_effects_nT**2 - stochastic_nT(flexible, noise, declared_lsb_nT) ** 2, 0.0)))
    own = answer.fitted_nT[:, :, answer.alone_nT.shape[2] :]
    both = np.concatenate([answer.alone_nT, own], axis=2)
    fits = ((result.residual_alone_nT, answer.alone_nT), (result.residual_nT, both))
    held = predict_blocks(problem, answer.whitener, kept, with_effects_nT, *fits)
    log_sd = _floor_log_sd(problem, noise, min((white_nT / with_effects_nT) ** 2, 1.0))
    before_nT, after_nT = np.hypot([floor_nT, with_effects_nT], held.unsure_nT).tolist()
    held = replace(held, floor_nT=before_nT, floor_with_effects_nT=after_nT, floor_log_sd=log_sd)
    walk = next((one for one in flexible if one.name == "bias_random_walk"), None)
    if walk is None:
        return held
    about_walk = (problem.setting.seconds, kept, float(walk.theta[0]), with_effects_nT, problem.axes)
    after, unsure_nT = one_step(problem.in_row_axes(result.residual_nT), *about_walk)
    floor_nT = float(np.hypot(with_effects_nT, unsure_nT))
    return replace(held, after_nT=after, floor_with_effects_nT=floor_nT, of="one_step")


def _floor_log_sd(problem: Problem, noise: NoiseModel, white: float) -> float:
    """Standard deviation of the logarithm of what the budget makes expect; white: share of the white noise in its square.

    What is declared is trusted as far as its prior says, what was found as far as the data say.
    """
    budget, prior = problem.budget, prior_of(complete_budget(problem))
    of_noise = noise.sigma_log_sd if budget.noise_nT is None else prior.sigma_log_sd
    of_attitude = noise.theta_log_sd if budget.attitude_sigma_rad is None else prior.theta_log_sd
    if not np.isfinite(of_attitude):
        of_attitude = prior.theta_log_sd
    return float(np.hypot(white * of_noise, (1.0 - white) * of_attitude))
