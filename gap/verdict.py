"""From what was found to the record: the verdict, its entries, one sentence to act on."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from fluxtwin.gap.candidates import settings_of
from fluxtwin.gap.flexible import FlexibleFinding
from fluxtwin.gap.named import Named
from fluxtwin.gap.places import place_of
from fluxtwin.gap.records import Closure, Diagnosis, EffectParameter, FoundEffect, Place, Shrinkage
from fluxtwin.sim.effects.base import Effect, SignalEffect
from fluxtwin.sim.effects.catalogue import find_effect
from fluxtwin.sim.signal import Setting

if TYPE_CHECKING:
    from fluxtwin.gap.diagnose import Work

CARRIED = 0.9
"""Share of the structured energy that the named effects must carry where structure is left."""
_OWN_AXIS = 0.8


def assemble(work: Work, provenance: Mapping[str, Any], *, without_attitude: int) -> Diagnosis:
    """The diagnosis of a finished investigation."""
    confirmed = [one for one in work.flexible if one.confirmed]
    structured = work.left.structured
    share = work.found.explained_share
    carried = share is not None and share >= CARRIED
    named = [] if work.found.resembles else list(work.found.named)
    stands = bool(named) and (not structured or carried)
    signals = [_found(one, work.problem.setting) for one in named] if stands else []
    stochastic = [_flexible(one, work.problem.setting) for one in confirmed]
    effects = [*signals, *stochastic]
    unexplained = bool(work.found.resembles) or (structured and not stands)
    verdict = "unknown" if unexplained else "effect" if effects else "no_gap"
    resembles = _resembles(work, verdict)
    gap = _gap(work.shrinkage, verdict, bool(effects), incomplete=stands and structured)
    where = _where(work, effects)
    return Diagnosis(
        verdict=verdict,
        effects=effects,
        resembles=resembles,
        where=where,
        gap=gap,
        modelled=[effect.name for effect in work.problem.modelled],
        untestable=dict(work.found.untestable),
        isolability={name: dict(shares) for name, shares in work.found.isolability.items()},
        minimum_detectable=dict(work.found.minimum_detectable),
        samples={
            "used": work.problem.rows - work.robust.rows_cut,
            "cut": work.robust.rows_cut,
            "without_attitude": without_attitude,
        },
        provenance=dict(provenance),
        sentence=_sentence(verdict, effects, where, gap, resembles, work.left.words),
        series=work.series,
        closure=_closure(work, named if stands else [], confirmed),
    )


def _closure(work: Work, named: Sequence[Named], confirmed: Sequence[FlexibleFinding]) -> Closure:
    """Effects with parameters and covariance, and the calibration that was re-estimated beside them."""
    effects: list[tuple[Any, Any, Any]] = [(one.effect, one.theta, one.covariance) for one in named]
    for finding in confirmed:
        effect = finding.instance if finding.instance is not None else find_effect(finding.effect)
        known = [finding.parameters.get(parameter.name) for parameter in effect.parameters]
        values = np.array([0.0 if entry is None else entry[0] for entry in known])
        effects.append((effect, values, None))
    theta = {effect.name: values for effect, values in work.found.modelled}
    S = np.asarray(theta.get("scale_misalignment", np.zeros(9))).reshape(3, 3)
    return Closure(effects, S, np.asarray(theta.get("bias", np.zeros(3))))


def _found(one: Named, setting: Setting) -> FoundEffect:
    sigmas = np.sqrt(np.diag(one.covariance))
    parameters = {
        parameter.name: EffectParameter(float(value), float(sigma) if np.isfinite(sigma) else None, parameter.unit)
        for parameter, value, sigma in zip(one.effect.parameters, one.theta, sigmas, strict=True)
    }
    place = place_of(one.effect, setting)
    shares = dict(zip("xyz", one.axis_shares, strict=True))
    axis = max(shares, key=lambda name: shares[name])
    return FoundEffect(
        name=one.name,
        group=one.group,
        rivals=one.rivals,
        probability=one.probability,
        parameters=parameters,
        settings=settings_of(one.effect),
        stage=one.effect.stage,
        axis=axis if shares[axis] >= _OWN_AXIS else "all",
        frame=place.frame,
        condition=place.condition,
        significance=one.p_value,
        visible_nT=one.visible_nT,
    )


def _flexible(one: FlexibleFinding, setting: Setting) -> FoundEffect:
    effect: Effect = one.instance if one.instance is not None else find_effect(one.effect)
    place = place_of(effect, setting)
    settings = settings_of(effect) if isinstance(effect, SignalEffect) else _plain_settings(effect)
    return FoundEffect(
        name=one.effect,
        group=(one.effect,),
        rivals=(),
        probability=float(np.clip(1.0 - one.p_value, 0.5, 0.999)),
        parameters={
            name: EffectParameter(float(value), float(sigma) if np.isfinite(sigma) else None, unit)
            for name, (value, sigma, unit) in one.parameters.items()
        },
        settings=settings,
        stage=effect.stage,
        axis="all",
        frame=place.frame,
        condition=place.condition,
        significance=one.p_value,
        visible_nT=0.0,
    )


def _plain_settings(effect: Effect) -> dict[str, object]:
    return {key: value for key, value in vars(effect).items() if isinstance(value, int | float | str)}


def _resembles(work: Work, verdict: str) -> list[str]:
    if verdict != "unknown":
        return []
    if work.found.resembles:
        return list(work.found.resembles)
    if work.found.named:
        return [one.name for one in work.found.named]
    return [line.name for line in work.found.ranking[:3] if line.p_value < 1e-3]


def _where(work: Work, effects: Sequence[FoundEffect]) -> Place:
    """The posterior of the stage, with the largest named effect's own probability in it."""
    place = work.where.place
    if not effects:
        return place
    first = effects[0]
    effect = find_effect(first.name)
    stages = {name: (1.0 - first.probability) * value for name, value in place.probabilities["stage"].items()}
    stages[first.stage] = stages.get(first.stage, 0.0) + first.probability
    equivalent = sorted({*effect.equivalent_stages, *place.equivalent} - {first.stage})
    return Place(
        first.stage, place.axis, place.frame, place.condition, equivalent,
        {**place.probabilities, "stage": stages},
    )  # fmt: skip


def _gap(gap: Shrinkage, verdict: str, named: bool, *, incomplete: bool) -> Shrinkage:
    after = gap.after_nT if named and verdict != "no_gap" else gap.before_nT
    measured = named and verdict != "no_gap"
    per_axis = {
        axis: dict(values) if measured else {**values, "after_nT": values["before_nT"]}
        for axis, values in gap.per_axis.items()
    }
    return Shrinkage(
        gap.before_nT, after, gap.floor_nT, gap.floor_with_effects_nT if measured else gap.floor_nT,
        gap.closed if measured else None, gap.interval if measured else None, gap.prediction, incomplete, per_axis,
    )  # fmt: skip


def _sentence(
    verdict: str, effects: Sequence[FoundEffect], where: Place, gap: Shrinkage, resembles: Sequence[str], left: str
) -> str:
    if verdict == "no_gap":
        return (
            f"No gap: what is left, {gap.before_nT:.1f} nT rms per component, is what noise and attitude error give "
            f"({gap.floor_nT:.1f} nT)."
        )
    if verdict == "unknown":
        at = f"at the stage {where.stage}" if where.stage else "at a stage that cannot be told"
        like = f" It resembles {', '.join(resembles)}." if resembles else ""
        return f"Something that the catalogue does not explain, {at}: {left}.{like}"
    parts = []
    for effect in effects:
        name = " or ".join(effect.group) or effect.name
        sizes = ", ".join(f"{key} {value.value:.3g} {value.unit}" for key, value in list(effect.parameters.items())[:3])
        parts.append(f"{name} ({sizes})")
    closed = "how far it closes the gap cannot be measured here"
    if gap.closed is not None:
        closed = (
            f"it takes the gap from {gap.before_nT:.1f} to {gap.after_nT:.1f} nT and closes {100 * gap.closed:.0f} %"
        )
    rest = " Its shape is not complete: something smaller is left." if gap.shape_incomplete else ""
    return f"The gap is {' and '.join(parts)}; {closed}.{rest}"
