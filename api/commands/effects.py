"""`fluxtwin effects`: what reality may do that the baseline lacks."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Annotated, Any

from fluxtwin.commands import options as of
from fluxtwin.console import Output, wrapped

if TYPE_CHECKING:
    from fluxtwin.sim.effects.base import Effect

BRIEF = "List the catalogue of effects, with units and typical sizes."


def command(
    output: Output,
    effect: Annotated[str | None, of.argument("[NAME]", "One effect in detail, with a section for a scenario.")] = None,
) -> None:
    """List the effects that a simulation may lack, a line each. With NAME, that effect in full.

    The keys are those of [effects.NAME] in a scenario; with zero for each there is no effect.
    """
    from fluxtwin.sim.effects.catalogue import CATALOGUE, find_effect

    output.claim({}, [])
    chosen = CATALOGUE if effect is None else (find_effect(effect, where="effects"),)
    _overview(output, chosen) if effect is None else _in_full(output, chosen[0])
    output.result({"effects": [_record(one) for one in chosen]})


def _overview(output: Output, effects: tuple[Effect, ...]) -> None:
    """A line for each, whole in a terminal of 80 columns, under the stage at which nature applies it."""
    width = max(len(effect.name) for effect in effects)
    output.say("Effects, in the order in which nature applies them, by stage")
    stage = ""
    for effect in effects:
        if effect.stage != stage:
            stage = effect.stage
            output.say(f"\n{stage}")
        output.say(f"{effect.name:<{width}}  {effect.title}.")
    output.say("\n`fluxtwin effects NAME`: parameters, typical sizes, ranges, use in a scenario.")


def _in_full(output: Output, effect: Effect) -> None:
    from fluxtwin.sim.scenario.effect_sections import effect_toml, every_key

    others = f" ({', '.join(effect.equivalent_stages)})" if effect.equivalent_stages else ""
    output.say(f"{effect.name}: stage {effect.stage}{others}")
    output.say(f"{effect.title}.")
    output.say(wrapped(f"{effect.about[0].upper()}{effect.about[1:]}.", 100))
    rows = [
        (p.name, _unit(p.unit), p.scale, _bound(p.low), _bound(p.high), key.name)
        for key in every_key(effect)
        for p in key.parameters
    ]
    output.say()
    output.table("", ("parameter", "unit", "typical", "lowest", "highest", "key in the scenario"), rows)
    output.say("In a scenario, at its typical size:")
    output.say()
    output.say(effect_toml(effect, [p.scale for p in effect.parameters]))


def _record(effect: Effect) -> dict[str, Any]:
    import dataclasses

    from fluxtwin.sim.effects.base import SignalEffect
    from fluxtwin.sim.scenario.effect_sections import every_key

    return {
        "name": effect.name,
        "stage": effect.stage,
        "equivalent_stages": list(effect.equivalent_stages),
        "kind": "signal" if isinstance(effect, SignalEffect) else "distribution",
        "about": effect.about,
        "settings": {item.name: getattr(effect, item.name) for item in dataclasses.fields(effect)},
        "parameters": [
            {
                "name": p.name,
                "unit": _unit(p.unit),
                "typical": p.scale,
                "key": key.name,
                "range": [_bound(p.low), _bound(p.high)],
            }
            for key in every_key(effect)
            for p in key.parameters
        ],
    }


def _unit(unit: str) -> str:
    return "" if unit == "1" else unit


def _bound(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None
