"""From the posterior to the record: what is named, whether it is the whole gap, where it lies, how far it closes.

`assemble` is a function of what was found and of nothing else; it reads from top to bottom, and nothing is changed in the
record after it. Where nothing is named, the residual must be what the budget gives, in its size and in its outliers.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from scipy.stats import norm, poisson

from fluxtwin.gap.channels.sun_nadir import SunNadir
from fluxtwin.gap.channels.two_magnetometers import Apart
from fluxtwin.gap.detectors.finding import Finding
from fluxtwin.gap.detectors.residual_structure import Structure
from fluxtwin.gap.held_out.held_out import Prediction, floor_rms_nT
from fluxtwin.gap.hypotheses.blocks import OWN_STAGES
from fluxtwin.gap.hypotheses.candidates import OF_ERRORS
from fluxtwin.gap.noise.choice import (
    DECLARED,
    NoiseModel,
    NoisePrior,
    RobustRows,
    complete_budget,
    noise_beside,
    prior_of,
)
from fluxtwin.gap.noise.robust_rows import CUT_SIGMA
from fluxtwin.gap.posterior.explanations import Answer, signals_of
from fluxtwin.gap.posterior.stated import as_stated, likelier_unknown
from fluxtwin.gap.posterior.torques import Momentum
from fluxtwin.gap.problem.problem import Budget, Problem
from fluxtwin.gap.records.diagnosis import Closure, Detectable, Diagnosis, FoundEffect, Place, Shrinkage
from fluxtwin.gap.report import words
from fluxtwin.gap.selection.criterion import GATE, SHAPE_ERROR, still_known
from fluxtwin.gap.selection.forward import LARGEST, RATIOS
from fluxtwin.gap.selection.search import Support, found_effect
from fluxtwin.sim.effects.base import DistributionEffect, SignalEffect
from fluxtwin.sim.effects.catalogue import find_effect
from fluxtwin.sim.effects.chain import Active
from fluxtwin.sim.effects.signal import Setting

_AT_STAGE = 0.9
"""Probability of the stage where its error is beyond the declared one: a judgement, a residual may be large by a cause
elsewhere."""


@dataclass(frozen=True, eq=False)
class Work:
    """Everything that was found on the way."""

    problem: Problem
    answer: Answer
    flexible: tuple[Finding, ...]
    """Those that are confirmed."""
    every_row: tuple[Problem, RobustRows]
    """The rows among which wild readings are counted: those of the record, where not only some of them were looked at."""
    loud: str | None
    """Words for white noise above its budget that is not like noise."""
    minimum_detectable: Mapping[str, Detectable]
    """Of causes in the readings."""
    where: Place
    prediction: Prediction
    momentum: Momentum
    """The balance of the momentum."""
    attitude_would_do_rad: float | None
    """Size of an attitude error, 1 sigma per axis, that makes all the structure of the residual; None where none does."""
    angle: SunNadir | None = None
    """The angle between sun and nadir; None where it is not measured."""
    apart: Apart | None = None
    """The difference of two magnetometers; None where there is one."""
    differ: Structure | None = None
    """Of that difference."""
    stuck: str | None = None
    """Words for rows that were left out because a reading in them is stuck."""

    @cached_property
    def known(self) -> float:
        """Probability that nothing, or what is named, is all there is: by what is left in the fit, and of held-out
        samples, and by the noise that it takes."""
        if not self.answer.result.named and not any(one.is_signal for one in self.flexible):
            return self.answer.known
        return still_known(self.answer.known, self.prediction.log_ratio + self.by_noise)

    @cached_property
    def by_noise(self) -> float:
        """Log of the Bayes factor of the noise that the names take, as in `NoisePrior.log_ratio`; 0 where something is named
        that is in that noise: noise of another kind, a walk."""
        if not all(one.is_signal for one in self.flexible):
            return 0.0
        return self.prior.log_ratio(self.noise.sigma_nT, self.noise.theta_rad)

    @cached_property
    def prior(self) -> NoisePrior:
        """Of the noise, by its budget."""
        return prior_of(complete_budget(self.problem))

    @cached_property
    def noise(self) -> NoiseModel:
        """Beside all that is named. The answer's own may be that of an explanation on the way."""
        answer = self.answer
        if self.prior.log_ratio(answer.noise.sigma_nT, answer.noise.theta_rad) == 0.0:
            return answer.noise
        active = [*answer.result.modelled, *answer.result.chosen, *signals_of(self.flexible)]
        return noise_beside(self.problem, active).noise

    @property
    def in_readings(self) -> list[FoundEffect]:
        """Effects in the readings that stand: few would do in their places, and nothing unknown is likelier."""
        result = self.answer.result
        if result.resembles or self.known < 0.5:
            return []
        found = [replace(one, probability=one.probability * self.known) for one in result.named]
        return [] if likelier_unknown(found) else found

    @property
    def standing(self) -> list[FoundEffect]:
        """These, and what the balance of the momentum names."""
        return [*self.in_readings, *self.momentum.standing]


@dataclass(frozen=True, eq=False)
class _Conclusion:
    """What is named, and whether it is the whole gap."""

    verdict: str
    named: Sequence[FoundEffect]
    """Of the search."""
    shapes: Sequence[FoundEffect]
    """Known by their own shape."""
    effects: Sequence[FoundEffect]
    """Those two and what the balance of the momentum names, best supported first."""
    fault: FoundEffect | None
    """Of an attitude sensor, that only the angle between sun and nadir shows."""
    already: bool
    """Whether noise was found that the scenario has."""
    excess: Excess | None
    """Of the residual over the budget."""
    outliers: Excess | None
    beyond: Excess | None
    """Which of them makes the verdict unknown."""
    incomplete: bool
    posterior: Sequence[tuple[str, float]]
    """Of each name, before it is stated."""


def assemble(
    work: Work,
    provenance: Mapping[str, Any],
    assumed: Mapping[str, Mapping[str, Any]],
    *,
    without_attitude: int,
    notes: Sequence[str] = (),
) -> Diagnosis:
    """The diagnosis of a finished investigation. assumed: as from `assumed`."""
    problem, answer, momentum = work.problem, work.answer, work.momentum
    result, cut = answer.result, int(answer.robust.cut_rows.sum())
    found = _conclude(work)
    faults = [] if found.fault is None else [found.fault]
    alone = faults if found.verdict == "effect" else []
    where = _where(work, found.effects or alone) if found.beyond is None else _at(work, found.beyond.stage)
    in_readings = bool(found.effects) and bool(result.named or work.flexible)
    prediction = work.prediction.without_known_noise(bool(found.effects)) if found.already else work.prediction
    gap = prediction.shrinkage(in_readings, found.incomplete, residual_rms_nT(problem, answer))
    resembles = _resembles(work) if found.verdict == "unknown" else []
    sentence = _sentence(work, found, where, gap, resembles)
    missing = {**result.untestable, **momentum.untestable}
    named = {one.name for one in (*found.effects, *faults)}
    untestable = {name: why for name, why in missing.items() if name not in named}
    detectable = {**work.minimum_detectable, **momentum.minimum_detectable}
    return Diagnosis(
        verdict=found.verdict,
        effects=[*found.effects, *faults],
        resembles=resembles,
        where=where,
        gap=gap,
        modelled=[effect.name for effect in problem.modelled],
        untestable=untestable,
        isolability={**result.isolability, **momentum.isolability},
        minimum_detectable=detectable,
        samples={"used": problem.rows - cut, "cut": cut, "without_attitude": without_attitude},
        provenance={**provenance, "posterior": [list(pair) for pair in found.posterior]},
        would_settle=words.would_settle(detectable, _asked_for(untestable, work), words.hours_of(problem.time)),
        sentence=" ".join(filter(None, (sentence, words.assumed(assumed)))),
        assumed=assumed,
        notes=notes,
        series=replace(prediction.series(problem.time, in_readings), cut=answer.robust.cut_rows),
        # Each was tested in its own channel.
        ranking=sorted([*result.ranking, *momentum.ranking], key=lambda line: line.order),
        momentum=momentum.gap,
        closure=_closure(work, found),
        scores=result.scores,
    )


def _conclude(work: Work) -> _Conclusion:
    problem, answer, momentum = work.problem, work.answer, work.momentum
    already = [one for one in work.flexible if expected(one, problem.frozen)]
    named = work.in_readings
    whole = work.known >= 0.5 and bool(named) == bool(answer.result.named)
    # The codes show a step or a bit whatever was fitted; the level of the noise is that beside names that have to stand.
    beside = whole or not answer.result.named
    noise = [one for one in work.flexible if one.is_noise and (beside or one.name != "excess_noise")]
    new = [one for one in work.flexible if one not in already and (whole or one in noise)]
    shapes = [_of_shape(one, problem.setting, work.known) for one in new]
    signals = sorted([*named, *momentum.standing], key=lambda one: one.significance) if momentum.standing else named
    effects, fault = [*signals, *shapes], None
    if work.angle is not None:
        effects, fault = work.angle.beside(effects)
    every = [*effects, *([] if fault is None else [fault])]
    posterior = [(one.name, one.probability) for one in every]
    effects = as_stated(every)
    if fault is not None:
        fault = effects.pop()

    unknown = work.known < 0.5 and work.attitude_would_do_rad is None
    unexplained = (not named and (unknown or bool(answer.result.named))) or momentum.unexplained
    unexplained = unexplained or (answer.left.of_named and not effects)  # of a wheel that is modelled
    excess = None
    stays = any(one.name != "bit_errors" for one in work.flexible)  # a named noise, walk or line stays in the residual
    if not unexplained and not stays:
        excess = beyond_budget(problem, answer)
    if not unexplained and excess is None and work.loud is not None:
        excess = Excess("sensor", work.loud)
    bits = any(one.name == "bit_errors" for one in work.flexible)
    outliers = None if bits else too_many_outliers(*work.every_row)
    if work.stuck is not None:
        outliers = Excess("telemetry", "; ".join([work.stuck, *([] if outliers is None else [outliers.words])]))
    beyond = None if unexplained or effects else excess or outliers
    verdict = "unknown" if unexplained or beyond is not None else "effect" if effects or fault is not None else "no_gap"
    incomplete = (answer.left.structured and bool(named or answer.left.of_named)) or momentum.incomplete
    incomplete = incomplete or (verdict == "effect" and excess is not None)
    about = (bool(already), excess, outliers, beyond, incomplete, posterior)
    return _Conclusion(verdict, named, shapes, effects, fault, *about)


def _sentence(work: Work, found: _Conclusion, where: Place, gap: Shrinkage, resembles: Sequence[str]) -> str:
    if work.angle is not None and found.fault is not None:
        others = None
        if found.effects or found.verdict == "unknown":
            others = _sentence(work, replace(found, fault=None), where, gap, resembles)
        return work.angle.said(others, gap.before_nT)
    if found.verdict == "no_gap":
        # What is said is the residual of the fit, which has no error of a prediction.
        fit = replace(gap, floor_nT=(gap.floor_nT**2 - work.prediction.unsure_nT[0] ** 2) ** 0.5)
        return words.no_gap(fit, work.attitude_would_do_rad) + _differ(work)
    if found.verdict == "unknown":
        what = _what(work, where) if found.beyond is None else found.beyond.words
        only_outliers = found.beyond is not None and found.beyond is found.outliers
        apart = f" {words.APART_FROM_THEM}" if only_outliers else ""
        return f"{words.unexplained(what, where, resembles)}{apart}"
    remains = words.remains(work.answer.left) if found.excess is None else found.excess.words
    outlying = None if found.outliers is None else found.outliers.words
    own = any(find_effect(name).stage in OWN_STAGES for one in found.effects for name in one.group)
    said = words.named(found.effects, gap, work.momentum.gap, remains, outlying) + ("" if own else _differ(work))
    after = {one.condition for one in found.effects} - {None}
    unseen = [name for name, why in work.answer.result.untestable.items() if why == OF_ERRORS]
    alike = [name for name in unseen if find_effect(name).follows in after]
    return said + words.not_tested(alike)


def _differ(work: Work) -> str:
    """What two magnetometers have apart, where nothing that was said explains it."""
    if work.apart is None or work.differ is None or not work.differ.structured:
        return ""
    other = 3 - work.problem.telemetry.magnetometer
    return f" {words.differ(work.differ, work.apart.rms_nT, work.apart.noise_nT, other)}"


def _closure(work: Work, found: _Conclusion) -> Closure:
    """What is named, what was re-estimated together with it, and what might be in its place."""
    result = work.answer.result
    incomplete = f"the explanation is incomplete: {words.remains(work.answer.left)}" if found.incomplete else None
    if found.verdict == "unknown":
        incomplete = "the catalogue does not explain all of the gap"
    return Closure(
        problem=work.problem,
        whitener=work.answer.whitener,
        modelled=result.modelled if found.named else result.modelled_alone,
        chosen=result.chosen if found.named else (),
        alternatives=tuple(_alternatives(work, one) for one in found.named),
        stochastic=(*found.shapes, *work.momentum.standing),
        variance=result.variance,
        tested=result.tested,
        incomplete=incomplete,
    )


def _of_shape(one: Finding, setting: Setting, known: float) -> FoundEffect:
    """A cause that is known by its own shape; known: the probability that a signal is of the catalogue."""
    backing = Support(one.p_value, one.probability * (known if one.is_signal else 1.0), (one.name,))
    axis = getattr(one.effect, "axis", None)
    return found_effect(one.effect, one.theta, one.sigma, setting, backing, axis if axis in ("x", "y", "z") else "all")


def _alternatives(work: Work, one: FoundEffect) -> tuple[SignalEffect, ...]:
    """Other settings of a named effect, those beside its own first, its group and its rivals. A clip's settings are but
    places to linearise at."""
    result = work.answer.result
    names = {*one.group, *(name for name, _ in one.rivals)} - {other.name for other in result.named}
    own = {one.name} if one.name != "saturation" else set()
    found = [candidate.effect for candidate in result.candidates if candidate.name in names | own]
    near = [one.effect and one.effect.between(work.problem.setting, step) for step in (RATIOS[1], 1.0 / RATIOS[1])]
    beside = [effect for effect in near if isinstance(effect, SignalEffect)]
    return tuple(effect for effect in (*beside, *found) if effect != one.effect)


def _what(work: Work, where: Place) -> str:
    """What an answer without a name says of the data."""
    answer, momentum = work.answer, work.momentum
    left = answer.left
    if not left.structured:
        names = len(answer.result.named)
        several = words.several(names) if names > 1 and work.known >= 0.5 else None
        louder = None
        if names and work.by_noise < min(work.prediction.log_ratio, 0.0):
            louder = words.louder(work.noise, work.prior)
        any_of = words.any_of(len(answer.result.resembles)) if answer.result.resembles else None
        return momentum.left.words or several or louder or any_of or words.left_over(work.prediction.shrinkage(True))
    return "; ".join(filter(None, (words.structure(left, where), momentum.left.words)))


def _asked_for(untestable: Mapping[str, str], work: Work) -> dict[str, str]:
    """Effects that cannot be tested and are not ruled out; those on the dynamics only where the momentum was balanced."""
    balanced = work.momentum.gap is not None
    found = {name: why for name, why in untestable.items() if name not in work.problem.ruled_out}
    return {name: why for name, why in found.items() if balanced or find_effect(name).stage != "dynamics"}


def _resembles(work: Work) -> list[str]:
    result = work.answer.result
    found = [*(result.resembles or [one.name for one in result.named]), *(one.name for one in work.answer.shapes)]
    if found:
        return list(dict.fromkeys(found))
    return [line.name for line in result.ranking[:LARGEST] if line.p_value < GATE]


def _where(work: Work, effects: Sequence[FoundEffect]) -> Place:
    """The place of the first effect, with its probability in the posteriors; of what is unexplained where none is named."""
    place, momentum = work.where, work.momentum
    if momentum.unexplained and not effects:
        stages = {"dynamics": 1.0, "none": 0.0}
        shares = {**place.probabilities, "stage": stages}
        return Place("dynamics", None, momentum.left.frame, momentum.left.condition, [], shares)
    if not effects:
        return place
    first = effects[0]
    alike = [find_effect(name) for name in first.group]
    equivalent = {*alike[0].equivalent_stages, *place.equivalent}
    if work.apart is not None:  # it separates what both share from what they do not, but for the names left
        equivalent = {name for name in equivalent if (name in OWN_STAGES) == (first.stage in OWN_STAGES)}
    equivalent = (equivalent | {one.stage for one in alike}) - {first.stage}
    return place_of(first, place.probabilities, sorted(equivalent))


def place_of(effect: FoundEffect, shares: Mapping[str, Mapping[str, float]], equivalent: Sequence[str] = ()) -> Place:
    """The place of an effect, with its probability in those of other places; stages are those of all names of its group."""
    own = {"stage": effect.stage, "axis": effect.axis, "frame": effect.frame, "condition": effect.condition}
    probabilities = {name: blended(shares[name], value or "none", effect.probability) for name, value in own.items()}
    stages = {name: (1.0 - effect.probability) * share for name, share in shares["stage"].items()}
    for name in effect.group:
        stages[find_effect(name).stage] += effect.probability / len(effect.group)
    probabilities["stage"] = stages
    return Place(effect.stage, effect.axis, effect.frame, effect.condition, equivalent, probabilities)


def _at(work: Work, stage: str) -> Place:
    """Of what is beyond the budget. White noise that is too large may come from the sensor or from telemetry."""
    probabilities = {name: blended(shares, "none", _AT_STAGE) for name, shares in work.where.probabilities.items()}
    stages = work.where.probabilities["stage"]
    other = {"sensor": "telemetry", "telemetry": "sensor"}.get(stage)
    if other is None:
        return Place(stage, None, None, None, [], {**probabilities, "stage": blended(stages, stage, _AT_STAGE)})
    half = 0.5 * _AT_STAGE
    either = blended(blended(stages, stage, half / (1.0 - half)), other, half)
    even = {name: blended(shares, "none", 0.5) for name, shares in work.where.probabilities.items()}
    return Place(stage, None, None, None, [other], {**even, "stage": either})


def blended(shares: Mapping[str, float], name: str, probability: float) -> dict[str, float]:
    """Shares that sum to one, with so much given to one name."""
    found = {key: (1.0 - probability) * value for key, value in shares.items()}
    found[name] = found.get(name, 0.0) + probability
    return found


@dataclass(frozen=True)
class Excess:
    """More than the budget gives."""

    stage: str
    words: str


def residual_rms_nT(problem: Problem, answer: Answer) -> float:
    """rms per component of the residual of the fit, over the readings that are not cut [nT]."""
    rest = problem.in_row_axes(answer.result.residual_nT)[problem.measured & ~answer.robust.cut]
    return float(np.sqrt(np.mean(rest**2))) if rest.size else 0.0


def shape_nT(problem: Problem, answer: Answer) -> float | None:
    """What named causes may leave because nature's form is not theirs, rms per component [nT]; None where what is left is
    something unknown."""
    result = answer.result
    if answer.left.structured and not answer.left.of_named and (not result.named or answer.known < 0.5):
        return None
    if not answer.left.structured and not answer.shapes:
        return 0.0
    rest_nT = problem.residual_of([*result.modelled, *result.chosen, *signals_of(answer.shapes)])
    signal_nT = problem.in_row_axes(result.residual_alone_nT - rest_nT)[problem.measured]
    return SHAPE_ERROR * float(np.sqrt(np.mean(signal_nT**2)))


def beyond_budget(problem: Problem, answer: Answer) -> Excess | None:
    """A residual larger than the declared noise and attitude error give, or None: by three standard deviations beyond
    what they are at the most, two standard deviations of the prior of the noise, one of the attitude error's.

    Held-out figures are no measure of this: right answers may be at 1.6 of what is expected there.
    """
    declared, noise = problem.budget, answer.noise
    if declared.attitude_sigma_rad is None or declared.noise_nT is None:
        return None
    kept = ~answer.robust.cut.any(axis=1)
    field_nT, measured = problem.noise_field_nT[kept], problem.measured[kept]

    def expected_nT(noise_trust: float, attitude_trust: float) -> float:
        theta_rad = attitude_trust * (declared.attitude_sigma_rad or 0.0)
        return floor_rms_nT(field_nT, noise_trust * noise.sigma_prior_nT, theta_rad, measured, noise.roll)

    prior = prior_of(complete_budget(problem))
    most_nT = expected_nT(float(np.exp(2.0 * prior.sigma_log_sd)), float(np.exp(prior.theta_log_sd)))
    found_nT = residual_rms_nT(problem, answer)
    # However many rows: structure that nobody looks for is in any record.
    spread = np.hypot(0.05, noise.theta_log_sd if np.isfinite(noise.theta_log_sd) else 0.0)
    if found_nT <= most_nT * np.exp(3.0 * spread):
        return None
    said = f"the residual of the fit is {found_nT:.1f} nT rms, where {expected_nT(1.0, 1.0):.1f} nT were expected"
    whiter = noise.white_rms_nT**2 - noise.sigma_prior_nT**2
    errors_rad = (noise.theta_rad, declared.attitude_sigma_rad)
    turned = [floor_rms_nT(field_nT, 0.0, rad, measured, noise.roll) ** 2 for rad in errors_rad]
    if turned[0] - turned[1] <= whiter:
        return Excess("sensor", said)
    return Excess("attitude", f"{words.attitude_error(noise, declared.attitude_sigma_rad)}: {said}")


def too_many_outliers(problem: Problem, robust: RobustRows) -> Excess | None:
    """Readings that were set aside, where noise does not give as many, or None."""
    count = int(robust.cut.sum())
    by_chance = 2.0 * float(norm.sf(CUT_SIGMA)) * float(problem.measured.sum())
    if count == 0 or poisson.sf(count - 1, by_chance) > GATE:
        return None
    return Excess("telemetry", words.outliers(problem.time, robust.cut))


def assumed(budget: Budget, problem: Problem, noise: NoiseModel) -> dict[str, dict[str, Any]]:
    """The noise that the answer rests on, by name: value, source (`declared`, `scenario` or `found`) and its flag.

    budget: as given; noise: as found. Without the attitude's where no row has one.
    """
    complete, sources = complete_budget(problem), budget.sources or {}
    declared_deg = None if budget.attitude_sigma_rad is None else float(np.degrees(budget.attitude_sigma_rad))
    rounding_nT = (complete.lsb_nT or 0.0) / np.sqrt(12.0)
    pairs = {  # as given, and as found
        "noise_nT": (budget.noise_nT, float(np.sqrt(max(noise.sigma_nT**2 - rounding_nT**2, 0.0)))),
        "lsb_nT": (budget.lsb_nT, complete.lsb_nT),
        "attitude_sigma_deg": (declared_deg, float(np.degrees(noise.theta_rad))),
        "attitude_tau_s": (budget.attitude_tau_s, noise.tau_s),
    }
    return {
        name: {
            "value": found if given is None else given,
            "source": "found" if given is None else "scenario" if sources.get(name) == "scenario" else DECLARED,
            "flag": f"--{name.replace('_', '-')}",
        }
        for name, (given, found) in pairs.items()
        if not name.startswith("attitude") or problem.noise_image_nT.any()
    }


def expected(finding: Finding, frozen: Sequence[Active]) -> bool:
    """Whether the scenario has this stochastic effect already, in this size (to a quarter, or three sigma)."""
    had = [size[0] for one, size in frozen if one.name == finding.name and isinstance(one, DistributionEffect)]
    bar = 3.0 * float(np.sqrt(2.0)) * finding.sigma[0]
    return any(abs(finding.theta[0] - size) <= max(bar, 0.25 * size) for size in had)
