"""From what was found to the record: the verdict, its entries, one sentence to act on."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from fluxtwin.gap.detectors.flexible import FlexibleFinding
from fluxtwin.gap.detectors.stochastic import expected
from fluxtwin.gap.records.diagnosis import (
    Closure,
    Diagnosis,
    EffectParameter,
    FoundEffect,
    GapSeries,
    MomentumGap,
    Place,
    Ranked,
    Shrinkage,
)
from fluxtwin.gap.report import level
from fluxtwin.gap.report.level import Excess
from fluxtwin.gap.selection.named import found_effect
from fluxtwin.sim.effects.base import SignalEffect
from fluxtwin.sim.effects.catalogue import find_effect
from fluxtwin.sim.effects.signal import Setting
from fluxtwin.sim.effects.switched_field import SwitchedField

if TYPE_CHECKING:
    from fluxtwin.gap.report.work import Work

_AT_STAGE = 0.9  # probability of that stage where its error is beyond the declared one: a judgement


def assemble(
    work: Work, provenance: Mapping[str, Any], assumed: Mapping[str, Mapping[str, Any]], *, without_attitude: int
) -> Diagnosis:
    """The diagnosis of a finished investigation. assumed: as from `level.assumed`."""
    known = [one for one in work.flexible if one.confirmed and expected(one, work.problem.frozen)]
    confirmed = [one for one in work.flexible if one.confirmed and one not in known]
    unknown = work.known < 0.5 and work.attitude_would_do_rad is None
    named = [] if work.found.resembles else list(work.found.named)
    stands = bool(named) and work.known >= 0.5 and not work.shrinkage.worse
    signals = named if stands else []
    momentum = work.momentum
    if momentum.standing:
        signals = sorted([*signals, *momentum.standing], key=lambda effect: effect.significance)
    stochastic = [_of_shape(one, work.problem.setting) for one in confirmed]
    effects = [*signals, *stochastic]
    unexplained = bool(work.found.resembles) or (not stands and (unknown or bool(named))) or momentum.unexplained
    verdict = "unknown" if unexplained else "effect" if effects else "no_gap"
    outliers = level.outliers(work.problem, work.robust, level.confirmed_bits(work.flexible))
    excess = level.beyond_budget(work) if verdict != "unknown" else None
    beyond = excess or outliers if verdict == "no_gap" else None
    verdict = verdict if beyond is None else "unknown"
    resembles = _resembles(work, verdict)
    shrunk, series = _without_known(work.shrinkage, work.series, known, bool(effects))
    incomplete = (
        (stands and work.left.structured) or momentum.incomplete or (verdict == "effect" and excess is not None)
    )
    gap = _gap(shrunk, verdict, bool(effects), level.left_in_fit_nT(work), incomplete=incomplete)
    where = _where(work, effects) if beyond is None else _at(work, beyond.stage)
    said = _sentence(
        work,
        verdict,
        effects,
        where,
        gap,
        resembles,
        _left_words(work, where) if beyond is None else beyond.words,
        excess,
        outliers,
    )
    said = " ".join(one for one in (said, level.assumed_words(assumed)) if one)
    return Diagnosis(
        verdict=verdict,
        effects=effects,
        resembles=resembles,
        where=where,
        gap=gap,
        modelled=[effect.name for effect in work.problem.modelled],
        untestable={
            name: why
            for name, why in {**work.found.untestable, **momentum.untestable}.items()
            if name not in {one.name for one in effects}
        },
        isolability={
            name: dict(shares) for name, shares in (*work.found.isolability.items(), *momentum.isolability.items())
        },
        minimum_detectable={**work.found.minimum_detectable, **momentum.minimum_detectable},
        samples={
            "used": work.problem.rows - work.robust.rows_cut,
            "cut": work.robust.rows_cut,
            "without_attitude": without_attitude,
        },
        provenance=dict(provenance),
        sentence=said,
        assumed=assumed,
        series=series if effects else replace(series, after_nT=series.before_nT),
        ranking=_ranking(work),
        momentum=momentum.gap,
        closure=_closure(work, named if stands else [], stochastic, _incomplete(verdict, incomplete)),
    )


def _ranking(work: Work) -> list[Ranked]:
    """Both channels, most significant first; each was tested in its own."""
    lines = [*work.found.ranking, *work.momentum.ranking]
    if work.momentum.ranking:
        lines.sort(key=lambda line: (line.p_value, -line.drop))
    return lines


def _left_words(work: Work, where: Place) -> str:
    """What an answer without a name says of the data; of frame and condition the same as `where`."""
    if not work.left.structured and not work.found.resembles:
        return work.momentum.words or "what fits best predicts the samples held out worse than nothing does"
    left = work.left
    words = left.words
    if left.kind == "block" and (left.condition, left.frame) != (where.condition, where.frame):
        follows = (
            f" that follows {where.condition.replace('_', ' ')}" if where.condition else " that follows no condition"
        )
        words = f"structure{follows}" + (f", coherent in the {where.frame} frame" if where.frame else "")
    return "; ".join(one for one in (words, work.momentum.words) if one)


def _incomplete(verdict: str, left: bool) -> str | None:
    """Why the named effects are not the whole gap, for whoever simulates with them."""
    if verdict == "unknown":
        return "something is left that the catalogue does not explain"
    return "the shape is not complete: something smaller is left" if left else None


def _closure(
    work: Work, named: Sequence[FoundEffect], stochastic: Sequence[FoundEffect], incomplete: str | None
) -> Closure:
    """Effects with parameters, what was re-estimated together with them, and what might be in their place."""
    return Closure(
        problem=work.problem,
        whitener=work.whitener,
        modelled=work.found.modelled if named else work.found.modelled_alone,
        chosen=work.found.chosen if named else (),
        alternatives=tuple(_alternatives(work, one) for one in named),
        stochastic=(*stochastic, *work.momentum.standing),
        variance=work.found.variance,
        tested=work.found.tested,
        incomplete=incomplete,
    )


def _alternatives(work: Work, one: FoundEffect) -> tuple[SignalEffect, ...]:
    """Other settings of a named effect, its group and its rivals. A clip's settings are but places to linearise at."""
    names = {*one.group, *(name for name, _ in one.rivals)} - {other.name for other in work.found.named}
    own = {one.name} if one.name != "saturation" else set()
    found = [candidate.effect for candidate in work.found.candidates if candidate.name in names | own]
    return tuple(effect for effect in found if effect != one.effect)


def _of_shape(one: FlexibleFinding, setting: Setting) -> FoundEffect:
    """A cause that is known by its own shape."""
    effect = one.instance if one.instance is not None else find_effect(one.effect)
    axis = getattr(effect, "axis", None)
    return found_effect(
        effect,
        {
            name: EffectParameter(float(value), float(sigma) if np.isfinite(sigma) else None, unit)
            for name, (value, sigma, unit) in one.parameters.items()
        },
        setting,
        p_value=one.p_value,
        probability=one.probability,
        axis=axis if axis in ("x", "y", "z") else "all",
    )


def _at(work: Work, stage: str) -> Place:
    """What is beyond the budget. White noise that is too large may come from the sensor or from telemetry."""
    other = {"sensor": "telemetry", "telemetry": "sensor"}.get(stage)
    probabilities = {}
    for name, shares in work.where.place.probabilities.items():
        probabilities[name] = blended(shares, stage if name == "stage" else "none", _AT_STAGE if other is None else 0.5)
        if name == "stage" and other is not None:
            probabilities[name] = blended(probabilities[name], other, 1.0 - _AT_STAGE / 2.0 - 0.5)
    return Place(stage, None, None, None, [] if other is None else [other], probabilities)


def _resembles(work: Work, verdict: str) -> list[str]:
    if verdict != "unknown":
        return []
    if work.found.resembles:
        return list(work.found.resembles)
    if work.found.named:
        return [one.name for one in work.found.named]
    return [line.name for line in work.found.ranking[:3] if line.p_value < 1e-3]


def _where(work: Work, effects: Sequence[FoundEffect]) -> Place:
    """The place of the first entry, with its probability in the posteriors; of what is unexplained where none is named."""
    place = work.where.place
    if work.momentum.unexplained and not effects:
        condition, frame = work.momentum.left_condition, work.momentum.left_frame
        stages = {"dynamics": 1.0, "none": 0.0}
        return Place("dynamics", None, frame, condition, [], {**place.probabilities, "stage": stages})
    if not effects:
        return place
    first = effects[0]
    effect = find_effect(first.name)
    equivalent = sorted({*effect.equivalent_stages, *place.equivalent} - {first.stage})
    own = {"stage": first.stage, "axis": first.axis, "frame": first.frame, "condition": first.condition}
    probabilities = {
        name: blended(place.probabilities[name], value or "none", first.probability) for name, value in own.items()
    }
    return Place(first.stage, first.axis, first.frame, first.condition, equivalent, probabilities)


def blended(shares: Mapping[str, float], name: str, probability: float) -> dict[str, float]:
    """Shares that sum to one, with so much given to one name."""
    found = {key: (1.0 - probability) * value for key, value in shares.items()}
    found[name] = found.get(name, 0.0) + probability
    return found


def _without_known(
    gap: Shrinkage, series: GapSeries, known: Sequence[FlexibleFinding], named: bool
) -> tuple[Shrinkage, GapSeries]:
    """Noise that the scenario has already belongs to the floor; where nothing else is named there is no before."""
    if not known:
        return gap, series
    lifted = replace(gap, floor_nT=gap.floor_with_effects_nT)
    if named:
        return lifted, series
    per_axis = {axis: {**values, "before_nT": values["after_nT"]} for axis, values in gap.per_axis.items()}
    return replace(lifted, before_nT=gap.after_nT, per_axis=per_axis), replace(series, before_nT=series.after_nT)


def _gap(gap: Shrinkage, verdict: str, named: bool, left_nT: float, *, incomplete: bool) -> Shrinkage:
    after = gap.after_nT if named and verdict != "no_gap" else gap.before_nT
    measured = named and verdict != "no_gap"
    per_axis = {
        axis: dict(values) if measured else {**values, "after_nT": values["before_nT"]}
        for axis, values in gap.per_axis.items()
    }
    return replace(
        gap,
        after_nT=after,
        floor_with_effects_nT=gap.floor_with_effects_nT if measured else gap.floor_nT,
        closed=gap.closed if measured else None,
        interval=gap.interval if measured else None,
        shape_incomplete=incomplete,
        per_axis=per_axis,
        left_nT=left_nT,
    )


def _sentence(
    work: Work,
    verdict: str,
    effects: Sequence[FoundEffect],
    where: Place,
    gap: Shrinkage,
    resembles: Sequence[str],
    left: str,
    excess: Excess | None,
    outliers: Excess | None,
) -> str:
    if verdict == "no_gap":
        if work.attitude_would_do_rad is not None:
            return (
                f"No gap that these data can tell from an error of the reference attitude of "
                f"{np.degrees(work.attitude_would_do_rad):.2g} deg, which was not declared: what is structured lies across "
                "the field, where such an error lies, and nothing along it."
            )
        return (
            f"No gap: what is left in the fit, {gap.left_nT:.1f} nT rms per component, is what noise and attitude error "
            f"give ({gap.floor_nT:.1f} nT)."
        )
    if verdict == "unknown":
        at = (
            f"at the stage {' or '.join([where.stage, *where.equivalent])}"
            if where.stage
            else "at a stage that is open"
        )
        like = f" It resembles {', '.join(resembles)}." if resembles else ""
        return f"Something that the catalogue does not explain, {at}: {left}.{like}"
    parts = []
    for effect in effects:
        name = " or ".join(effect.group) or effect.name
        known = [item for item in effect.parameters.items() if item[1].sigma is not None]
        sizes = ", ".join(
            f"{key} {value.value:.3g}{'' if value.unit == '1' else f' {value.unit}'}"
            for key, value in (known or list(effect.parameters.items()))[:3]
        )
        parts.append(f"{name}{_over(effect.settings)} ({sizes})")
    rest = ""
    if gap.shape_incomplete:
        rest = f" Its shape is not complete: {'something smaller is left' if excess is None else excess.words}."
    if outliers is not None:
        rest += f" Beside it, {outliers.words}."
    return f"The gap is {' and '.join(parts)}; {_closed_words(effects, gap, work.momentum.gap)}.{rest}"


def _over(settings: Mapping[str, Any]) -> str:
    """The region of an effect that has one, in words."""
    if "region_deg" not in settings:
        return ""
    where = SwitchedField(str(settings["condition"]), region_deg=tuple(settings["region_deg"]))
    return f" by {where.condition} over {where.region_words}"


def _closed_words(effects: Sequence[FoundEffect], gap: Shrinkage, momentum: MomentumGap | None) -> str:
    if momentum is not None and all(effect.stage == "dynamics" for effect in effects):
        share = "" if momentum.closed is None else f" and closes {100 * momentum.closed:.0f} %"
        return (
            "it leaves the readings as they are, and takes the attitude against the balance of the momentum from "
            f"{momentum.before_deg:.2g} to {momentum.after_deg:.2g} deg{share}"
        )
    if all(effect.name == "bit_errors" for effect in effects) and gap.closed is None:
        return "the wrong readings are set aside, and count neither before nor after"
    if gap.closed is None:
        return _not_measured(effects, gap)
    share = f"closes {100 * gap.closed:.0f} %"
    if gap.after_nT == gap.before_nT:
        expected_nT = gap.floor_with_effects_nT
        return f"with it {expected_nT:.1f} nT of noise are expected where {gap.before_nT:.1f} are left: it {share}"
    return f"it takes the gap from {gap.before_nT:.1f} to {gap.after_nT:.1f} nT and {share}"


def _not_measured(effects: Sequence[FoundEffect], gap: Shrinkage) -> str:
    """Why a share is not stated although an effect is sure, and what would measure it."""
    sure = min(effect.significance for effect in effects)
    signal_nT = max((effect.visible_nT or 0.0) for effect in effects)
    chance = "less than 1e-12" if sure < 1e-12 else f"{sure:.0e}"
    return (
        f"chance alone would give it with a probability of {chance}, but its {signal_nT:.1f} nT rms are too small a part of "
        f"the {gap.before_nT:.1f} nT that noise leaves on held-out samples for the share that it closes to be measured: "
        "more data of the same kind would do it"
    )
