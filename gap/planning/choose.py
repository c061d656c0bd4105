"""For each question the manoeuvres that settle it soonest."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from fluxtwin.gap.planning.designs import Design
from fluxtwin.gap.planning.power import Flown
from fluxtwin.gap.planning.questions import Open
from fluxtwin.gap.records.plan import ENOUGH, Answer, Course, Question
from fluxtwin.gap.selection.criterion import GATE
from fluxtwin.sim.effects.catalogue import find_effect
from fluxtwin.sim.scenario.scenario import Scenario

_EARLY = (0.03, 0.08, 0.15)
_SHARES = (0.25, 0.35, 0.5, 0.7, 0.85)
"""Of the longest flight, at which the power is computed too; after less than a quarter nothing is proposed: what noise there
is must be found from the same rows."""
_KEPT = 3
_WORTH_SAYING = 0.02


def choose(question: Open, flown: Sequence[tuple[Design, Flown]]) -> Question:
    """The best three manoeuvres for a question: those that are enough by their hours, then the others by their power."""
    tried = [one for each in flown if (one := _shortest(question, *each)).power >= _WORTH_SAYING]
    courses = [_course(question, one) for one in sorted(tried, key=_rank)[:_KEPT]]
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
    at = sorted({*(max(int(rows * share), 2) for share in (*_EARLY, *_SHARES)), one.rows, rows})
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
        said = f"if it is named, it is present; if not, it is smaller than typical, with {100 * power:.0f} % confidence"
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
