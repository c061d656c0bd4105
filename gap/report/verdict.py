"""From the posterior to the record: what is named, whether it is the whole gap, where it lies, how far it closes.

`assemble` is a function of what was found and of nothing else; it reads from top to bottom, and nothing is changed in the
record after it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

from fluxtwin.gap.channels.two_magnetometers import OWN_STAGES, Apart
from fluxtwin.gap.detectors.finding import Finding
from fluxtwin.gap.detectors.proposals import expected
from fluxtwin.gap.detectors.residual_structure import Structure
from fluxtwin.gap.held_out.held_out import Prediction
from fluxtwin.gap.hypotheses.candidates import OF_ERRORS
from fluxtwin.gap.noise.choice import RobustRows
from fluxtwin.gap.posterior.explanations import Answer
from fluxtwin.gap.posterior.stated import as_stated, likelier_unknown
from fluxtwin.gap.posterior.torques import Momentum
from fluxtwin.gap.problem.problem import Problem
from fluxtwin.gap.records.diagnosis import Closure, Detectable, Diagnosis, FoundEffect, Place, Shrinkage
from fluxtwin.gap.report import advice, level, words
from fluxtwin.gap.report.level import Excess
from fluxtwin.gap.report.second_channel import Angle
from fluxtwin.gap.selection.criterion import GATE, still_known
from fluxtwin.gap.selection.forward import LARGEST
from fluxtwin.gap.selection.named import Support, found_effect
from fluxtwin.sim.effects.base import SignalEffect
from fluxtwin.sim.effects.catalogue import find_effect
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
    angle: Angle | None = None
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
        samples."""
        if not self.answer.result.named and not any(one.is_signal for one in self.flexible):
            return self.answer.known
        return still_known(self.answer.known, self.prediction.log_ratio)

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
    """The diagnosis of a finished investigation. assumed: as from `level.assumed`."""
    problem, answer, momentum = work.problem, work.answer, work.momentum
    result, cut = answer.result, answer.robust.rows_cut
    found = _conclude(work)
    faults = [] if found.fault is None else [found.fault]
    alone = faults if found.verdict == "effect" else []
    where = _where(work, found.effects or alone) if found.beyond is None else _at(work, found.beyond.stage)
    in_readings = bool(found.effects) and bool(result.named or work.flexible)
    prediction = work.prediction.without_known_noise(bool(found.effects)) if found.already else work.prediction
    gap = prediction.shrinkage(in_readings, found.incomplete, level.residual_rms_nT(problem, answer))
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
        would_settle=advice.would_settle(detectable, _asked_for(untestable, work), advice.hours_of(problem.time)),
        sentence=" ".join(filter(None, (sentence, words.assumed(assumed)))),
        assumed=assumed,
        notes=notes,
        series=replace(prediction.series(problem.time, in_readings), cut=answer.robust.cut_rows),
        # Each was tested in its own channel.
        ranking=sorted([*result.ranking, *momentum.ranking], key=lambda line: (line.p_value, -line.drop)),
        momentum=momentum.gap,
        closure=_closure(work, found),
        scores=result.scores,
    )


def _conclude(work: Work) -> _Conclusion:
    problem, answer, momentum = work.problem, work.answer, work.momentum
    already = [one for one in work.flexible if expected(one, problem.frozen)]
    new = [one for one in work.flexible if one not in already and (work.known >= 0.5 or one.is_noise)]
    shapes = [_of_shape(one, problem.setting, work.known) for one in new]
    named = work.in_readings
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
    excess = None
    stays = any(one.name != "bit_errors" for one in work.flexible)  # a named noise, walk or line stays in the residual
    if not unexplained and not stays:
        excess = level.beyond_budget(problem, answer)
    if not unexplained and excess is None and work.loud is not None:
        excess = Excess("sensor", work.loud)
    bits = any(one.name == "bit_errors" for one in work.flexible)
    outliers = None if bits else level.outliers(*work.every_row)
    if work.stuck is not None:
        outliers = Excess("telemetry", "; ".join([work.stuck, *([] if outliers is None else [outliers.words])]))
    beyond = None if unexplained or effects else excess or outliers
    verdict = "unknown" if unexplained or beyond is not None else "effect" if effects or fault is not None else "no_gap"
    incomplete = (bool(named) and answer.left.structured) or momentum.incomplete
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
        fit = replace(gap, floor_nT=(gap.floor_nT**2 - work.prediction.unsure_nT**2) ** 0.5)
        return words.no_gap(fit, work.attitude_would_do_rad) + _differ(work)
    if found.verdict == "unknown":
        what = _what(work, where) if found.beyond is None else found.beyond.words
        only_outliers = found.beyond is not None and found.beyond is found.outliers
        apart = f" {words.APART_FROM_THEM}" if only_outliers else ""
        return f"{words.unexplained(what, where, resembles)}{apart}"
    remains = words.SHAPE_INCOMPLETE if found.excess is None else found.excess.words
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
    incomplete = f"the explanation is incomplete: {words.SHAPE_INCOMPLETE}" if found.incomplete else None
    return Closure(
        problem=work.problem,
        whitener=work.answer.whitener,
        modelled=result.modelled if found.named else result.modelled_alone,
        chosen=result.chosen if found.named else (),
        alternatives=tuple(_alternatives(work, one) for one in found.named),
        stochastic=(*found.shapes, *work.momentum.standing),
        variance=result.variance,
        tested=result.tested,
        incomplete=words.UNEXPLAINED if found.verdict == "unknown" else incomplete,
    )


def _of_shape(one: Finding, setting: Setting, known: float) -> FoundEffect:
    """A cause that is known by its own shape; known: the probability that a signal is of the catalogue."""
    backing = Support(one.p_value, one.probability * (known if one.is_signal else 1.0), (one.name,))
    axis = getattr(one.effect, "axis", None)
    return found_effect(one.effect, one.theta, one.sigma, setting, backing, axis if axis in ("x", "y", "z") else "all")


def _alternatives(work: Work, one: FoundEffect) -> tuple[SignalEffect, ...]:
    """Other settings of a named effect, its group and its rivals. A clip's settings are but places to linearise at."""
    result = work.answer.result
    names = {*one.group, *(name for name, _ in one.rivals)} - {other.name for other in result.named}
    own = {one.name} if one.name != "saturation" else set()
    found = [candidate.effect for candidate in result.candidates if candidate.name in names | own]
    return tuple(effect for effect in found if effect != one.effect)


def _what(work: Work, where: Place) -> str:
    """What an answer without a name says of the data."""
    left, momentum = work.answer.left, work.momentum
    if not left.structured and not work.answer.result.resembles:
        names = len(work.answer.result.named)
        several = words.several(names) if names > 1 and work.known >= 0.5 else None
        return momentum.left.words or several or words.left_over(work.prediction.shrinkage(True))
    return "; ".join(filter(None, (words.structure(left, where), momentum.left.words)))


def _asked_for(untestable: Mapping[str, str], work: Work) -> dict[str, str]:
    """Effects that cannot be tested and are not ruled out; those on the dynamics only where the momentum was balanced."""
    balanced = work.momentum.gap is not None
    found = {name: why for name, why in untestable.items() if name not in work.problem.ruled_out}
    return {name: why for name, why in found.items() if balanced or find_effect(name).stage != "dynamics"}


def _resembles(work: Work) -> list[str]:
    result = work.answer.result
    if result.resembles or result.named:
        return list(result.resembles) or [one.name for one in result.named]
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
    either = blended(blended(stages, stage, 0.5), other, 0.5 - _AT_STAGE / 2.0)
    even = {name: blended(shares, "none", 0.5) for name, shares in work.where.probabilities.items()}
    return Place(stage, None, None, None, [other], {**even, "stage": either})


def blended(shares: Mapping[str, float], name: str, probability: float) -> dict[str, float]:
    """Shares that sum to one, with so much given to one name."""
    found = {key: (1.0 - probability) * value for key, value in shares.items()}
    found[name] = found.get(name, 0.0) + probability
    return found
