"""What a diagnosis leaves open, as questions to be settled by flying: read from the diagnosis or from its JSON;
and for each the manoeuvres that settle it soonest.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from fluxtwin.calib.common.digits import percent
from fluxtwin.gap.planning.designs import Design
from fluxtwin.gap.planning.power import FRAMES, Cause, Flown, Placed
from fluxtwin.gap.records.plan import ENOUGH, Answer, Course, Question
from fluxtwin.gap.selection.criterion import GATE
from fluxtwin.sim.base.errors import BadInput
from fluxtwin.sim.effects.base import SignalEffect
from fluxtwin.sim.effects.catalogue import find_effect
from fluxtwin.sim.scenario.scenario import Scenario

_SHARES = (0.25, 0.35, 0.5, 0.7, 0.85)
"""Of the longest flight, at which the power is computed too; after less than a quarter nothing is proposed: what noise there
is must be found from the same rows."""


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
    for name in [name for name in names if name != first.name][:3]:  # six pairs
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
    frames = [frame for frame in FRAMES if shares.get(frame, 0.0) >= 0.01]  # that the page shows
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


def choose(question: Open, flown: Sequence[tuple[Design, Flown]]) -> Question:
    """The best three manoeuvres for a question: those that are enough by their hours, then the others by their power."""
    tried = [one for each in flown if (one := _shortest(question, *each)).power >= 0.02]
    courses = [_course(question, one) for one in sorted(tried, key=_rank)[:3]]
    by_manoeuvre = question.kind == "place" or (question.kind == "tell_apart" and courses)
    instead = "" if by_manoeuvre else find_effect(question.names[0]).settled_by
    same = next((one for one in flown if one[0].kind == "nadir" and not one[0].tests and not one[0].wait_days), None)
    before = None if same is None else _course(question, _shortest(question, *same))
    return Question(question.kind, question.names, question.words, courses, before, instead)


@dataclass(frozen=True, eq=False)
class _Tried:
    """A manoeuvre, as long as it takes, or as long as it may last."""

    design: Design
    view: Flown
    rows: int
    answers: Sequence[Answer]

    @property
    def power(self) -> float:
        return _least(self.answers)


def _shortest(question: Open, design: Design, view: Flown) -> _Tried:
    def after(rows: int) -> _Tried:
        return _Tried(design, view, rows, _answers(question, view, rows))

    whole = after(view.problem.rows)
    parts = (after(int(whole.rows * share)) for share in _SHARES) if whole.power >= ENOUGH else ()
    return next((part for part in parts if part.power >= ENOUGH), whole)


def _rank(one: _Tried) -> tuple[bool, bool, float, bool, float]:
    """Of two that do as well the one without a wait, without tests, and first in the list."""
    design, enough = one.design, one.power >= ENOUGH
    hours = round(one.rows * design.step_h, 2) if enough else 0.0
    return (not enough, design.wait_days > 0, hours, enough and design.tests, 0.0 if enough else -one.power)


def _course(question: Open, one: _Tried) -> Course:
    rows, hours = one.view.problem.rows, one.view.problem.setting.seconds / 3600.0
    at = sorted({*(max(int(rows * share), 2) for share in (0.03, 0.08, 0.15, *_SHARES)), one.rows, rows})
    curve = [(float(hours[part - 1]), _least(_answers(question, one.view, part))) for part in at]
    flies, design = float(hours[one.rows - 1]), one.design
    scenario = shortened(design.scenario, flies)
    return Course(design.words, flies, design.wait_days, one.power, one.answers, curve, scenario)


def shortened(scenario: Scenario, hours: float) -> Scenario:
    """A manoeuvre, flown for so long only; named a plan."""
    assert scenario.schedule is not None
    segment = scenario.schedule.segments[0].model_dump(exclude_none=True) | {"duration_min": 60.0 * hours}
    return scenario.updated({"schedule.segments": [segment], "name": "plan"})


def _answers(question: Open, view: Flown, rows: int) -> list[Answer]:
    if question.placed is not None:
        said = "the diagnosis places it in these axes: look for a source that is fixed in them"
        return [Answer(frame, view.placed(question.placed, frame, rows), said) for frame in question.names]
    if not question.causes:
        name = question.names[0]
        power = view.shown(rows).get(name, 0.0)
        said = f"if it is named, it is present; if not, it is smaller than typical, with {percent(power)} confidence"
        return [Answer(name, power, said)]
    found = []
    ended = [cause.name for cause in question.causes if cause.over]
    for cause in question.causes:
        if cause.name in ended:
            # Of two that have ended no later flight tells which it was.
            power = 1.0 - GATE if len(ended) == 1 else 0.0
            found.append(
                Answer(cause.name, power, f"if nothing is named, it was {' or '.join(ended)}, which has ended")
            )
            continue
        power = view.distinguishing(cause, question.names, rows)
        others = " and ".join(other.name for other in question.causes if other is not cause)
        found.append(Answer(cause.name, power, f"it is named and {others} is not"))
    return found


def _least(answers: Sequence[Answer]) -> float:
    return min((answer.power for answer in answers), default=0.0)
