"""For each question the manoeuvres that settle it soonest."""

from __future__ import annotations

from collections.abc import Sequence

from fluxtwin.gap.planning.designs import Design
from fluxtwin.gap.planning.power import Cause, Flown
from fluxtwin.gap.planning.questions import Open
from fluxtwin.gap.records.plan import ENOUGH, Answer, Course, Question
from fluxtwin.sim.effects.catalogue import find_effect

_SHARES = (0.25, 0.35, 0.5, 0.7, 0.85)
"""Of the longest flight, at which the power is computed too."""
_KEPT = 3
_WORTH_SAYING = 0.02


def choose(question: Open, flown: Sequence[tuple[Design, Flown]]) -> Question:
    """The best three manoeuvres for a question: those that are enough by their hours, then the others by their power."""
    whole = [(design, view, _answers(question, view, view.problem.rows)) for design, view in flown]
    whole = [one for one in whole if _least(one[2]) >= _WORTH_SAYING]
    # Of two that do as well the one without a wait, without tests, and first in the list.
    order = sorted(whole, key=lambda one: (-round(min(_least(one[2]), ENOUGH), 2), one[0].wait_days > 0, one[0].tests))
    good = [one for one in order if _least(one[2]) >= ENOUGH] or order[:_KEPT]
    courses = sorted((_course(question, *one) for one in good), key=_rank)
    instead = "" if question.causes else find_effect(question.names[0]).settled_by
    same = next((one for one in flown if one[0].kind == "nadir" and not one[0].tests and not one[0].wait_days), None)
    before = None if same is None else _course(question, *same, _answers(question, same[1], same[1].problem.rows))
    return Question(question.kind, question.names, question.words, courses[:_KEPT], before, instead)


def _rank(course: Course) -> tuple[bool, bool, float, float]:
    enough = course.power >= ENOUGH
    return (not enough, course.wait_days > 0, course.hours if enough else 0.0, 0.0 if enough else -course.power)


def _course(question: Open, design: Design, view: Flown, answers: Sequence[Answer]) -> Course:
    """With its curve, cut where it is enough."""
    rows = view.problem.rows
    hours = view.problem.setting.seconds / 3600.0
    curve, settled = [], None
    for share in _SHARES:
        part = max(int(rows * share), 2)
        so_far = _answers(question, view, part)
        curve.append((float(hours[part - 1]), _least(so_far)))
        if settled is None and _least(so_far) >= ENOUGH:
            settled = (float(hours[part - 1]), so_far)
        elif _least(so_far) < ENOUGH:
            settled = None
    curve.append((float(hours[-1]), _least(answers)))
    flies, said = (float(hours[-1]), answers) if settled is None else settled
    segment = design.scenario.schedule.segments[0] if design.scenario.schedule else None
    assert segment is not None
    cut = segment.model_dump(exclude_none=True) | {"duration_min": 60.0 * flies}
    scenario = design.scenario.updated({"schedule.segments": [cut], "name": "plan"})
    return Course(design.words, flies, design.wait_days, _least(said), said, curve, scenario)


def _answers(question: Open, view: Flown, rows: int) -> list[Answer]:
    if not question.causes:
        name = question.names[0]
        power = view.shown(rows).get(name, 0.0)
        return [
            Answer(name, power, f"named: it is there; not named: it is smaller than typical, at {100 * power:.0f} %")
        ]
    found = []
    for cause in question.causes:
        power = view.told(cause, question.names, rows)
        others = " and ".join(_others(question, cause))
        found.append(Answer(cause.name, power, f"{cause.name} is named and {others} not: it is {cause.name}"))
    return found


def _others(question: Open, cause: Cause) -> list[str]:
    return [other.name for other in question.causes if other is not cause]


def _least(answers: Sequence[Answer]) -> float:
    return min((answer.power for answer in answers), default=0.0)
