"""What a diagnosis leaves open, as questions to be settled by flying: read from the diagnosis or from its JSON."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from fluxtwin.gap.planning.power import FRAMES, Cause, Flown, Placed
from fluxtwin.sim.base.errors import BadInput
from fluxtwin.sim.effects.base import SignalEffect
from fluxtwin.sim.effects.catalogue import find_effect

_MOST_ALIKE = 4
"""Names of one question: six pairs."""
_POSSIBLE = 0.01
"""Probability from which axes are asked about: that from which the page shows them."""


@dataclass(frozen=True, eq=False)
class Open:
    """One question. Causes with their sizes are to be distinguished; a name alone is to be shown at its typical size."""

    names: tuple[str, ...]
    causes: tuple[Cause, ...]
    words: str
    placed: Placed | None = None
    """In place of causes: structure without a name, to be placed in one of the frames that `names` lists."""

    @property
    def kind(self) -> str:
        return "place" if self.placed is not None else "tell_apart" if self.causes else "show"


def asked(found: Mapping[str, Any], flown: Flown, recorded: bool) -> list[Open]:
    """Of a diagnosis as plain values: names that it does not tell apart, what an unknown cause resembles, what is
    untestable, what would not have shown at its typical size. flown: where the names looked alike; recorded: whether its
    readings are those of the record."""
    questions = []
    for effect in found["effects"]:
        if len(effect["group"]) > 1:
            questions += ambiguous(effect["group"], flown, flown.plausible(cause_of(effect)), recorded)
    if found["verdict"] == "unknown" and found["resembles"]:
        alike = [name for name in found["resembles"] if isinstance(find_effect(name), SignalEffect)]
        first = flown.likeliest(alike) if recorded else None
        if alike:
            questions += ambiguous(alike, flown, first or typical(alike[0]))
    if found["verdict"] == "unknown":
        questions += to_place(found, flown)
    named = {name for effect in found["effects"] for name in (effect["name"], *effect["group"])}
    small = [name for name in found["minimum_detectable"] if name not in named]
    asked = [name for name in dict.fromkeys([*small, *found["untestable"]]) if name in found["would_settle"]]
    return questions + [to_show(name) for name in asked if isinstance(find_effect(name), SignalEffect)]


def ambiguous(names: Sequence[str], flown: Flown, first: Cause, recorded: bool = True) -> list[Open]:
    """The question which of these it is; the first as it was found, the others as they look most like it.

    recorded: whether they looked alike in what was flown; else one that does not has its typical size.
    """
    causes = [first]
    for name in [name for name in names if name != first.name][: _MOST_ALIKE - 1]:
        other = flown.imitating(first, name)
        if (first.over or not recorded) and isinstance(find_effect(name), SignalEffect):
            # What has ended looks like nothing on a later flight.
            other = other if other is not None and other.theta.any() else typical(name)
        if other is not None and other.theta.any():  # else its sign is the wrong one
            causes.append(other)
    return [apart(causes)] if len(causes) > 1 else []


def apart(causes: Sequence[Cause]) -> Open:
    """The question which of these causes it is."""
    names = tuple(cause.name for cause in causes)
    return Open(names, tuple(causes), f"whether it is {' or '.join(names)}")


def by_pairs(question: Open) -> list[Open]:
    """The first cause against each of the others: what can be settled of a question that no one manoeuvre settles."""
    first, *others = question.causes
    return [apart([first, other]) for other in others]


def to_place(found: Mapping[str, Any], flown: Flown) -> list[Open]:
    """The question in which axes an unknown field is steady: those that the diagnosis leaves, or any."""
    shares = found["where"]["probabilities"]["frame"]
    frames = [frame for frame in FRAMES if shares.get(frame, 0.0) >= _POSSIBLE]
    frames = frames if len(frames) > 1 else list(FRAMES)
    gap, condition = found["gap"], found["where"]["condition"]
    excess = max(gap["before_nT"] ** 2 - gap["floor_nT"] ** 2, 0.0) / max(gap["floor_nT"], 1e-3) ** 2
    placed = flown.place(condition, frames, 3.0 * flown.problem.rows * excess)
    if placed is None or not excess:
        return []
    follows = "" if condition is None else f" that follows {condition}"
    words = f"whether the unknown cause{follows} is fixed in {', '.join(frames[:-1])} or {frames[-1]} axes"
    return [Open(tuple(frames), (), words, placed)]


def to_show(name: str) -> Open:
    """The question whether an effect of its typical size is there."""
    return Open((name,), (), f"whether {name} is present at its typical size")


def typical(name: str) -> Cause:
    """An effect at its typical size: one parameter, or all of a vector."""
    effect = signal(name)
    return Cause(effect, np.array([parameter.scale for parameter in effect.parameters]))


def signal(name: str) -> SignalEffect:
    """The effect of that name; BadInput for one that no image in the readings can be made of."""
    effect = find_effect(name, where="--for")
    if not isinstance(effect, SignalEffect):
        why = f"{name} is known by its distribution, not by its course"
        raise BadInput(why, where="--for", wanted="another effect")
    return effect


def cause_of(effect: Mapping[str, Any]) -> Cause:
    """An effect of a diagnosis, as it was found."""
    plain = signal(effect["name"])
    known = {one.name for one in dataclasses.fields(plain) if one.init}
    given = {key: tuple(v) if isinstance(v, list) else v for key, v in effect["settings"].items() if key in known}
    kind = dataclasses.replace(plain, **given)
    values = {name: one["value"] for name, one in effect["parameters"].items()}
    return Cause(kind, np.array([float(values.get(parameter.name, 0.0)) for parameter in kind.parameters]))
