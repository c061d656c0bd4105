"""A plan as a table for the terminal and as a page."""

from __future__ import annotations

from dataclasses import replace

from fluxtwin.calib.common.digits import percent
from fluxtwin.console import shown
from fluxtwin.gap.records.plan import CalibrationPlan, Course, Plan, Question, SigmaCourse
from fluxtwin.scenarios.page import FigureBlock, Page, PageSection, Table


def plan_page(plan: Plan | CalibrationPlan, title: str) -> Page:
    """The page of a plan: a figure for every question that has names to tell apart, and for the first."""
    flown = PageSection("Every open question", [], [plan_table(plan)])
    if isinstance(plan, CalibrationPlan):
        from fluxtwin.plots.plan import draw_sigma

        caption = (
            "Against hours flown, with record and manoeuvre calibrated together; dotted: half of the present sigma."
        )
        sections = [replace(flown, figures=[FigureBlock("sigma", caption, draw_sigma(plan))])]
    else:
        first = [question for question in plan.questions if question.kind != "show"] or plan.questions[:1]
        sections = [*(_section(question) for question in first if question.courses), flown]
    facts = {key: _fact(value) for key, value in plan.limits.items()}
    facts |= {"notes": "; ".join(plan.notes), **{f"not flown: {words}": why for words, why in plan.refused.items()}}
    next_step = (
        "fluxtwin plan with --out PLAN.toml writes the first manoeuvre as a scenario. Fly it, and diagnose or calibrate the "
        "telemetry."
    )
    return Page(
        title=title,
        verdict=plan.sentence,
        sections=sections,
        provenance=facts,
        next_step=next_step if plan.scenario is not None else "",
        downloads={} if plan.scenario is None else {"plan.toml": plan.scenario.to_toml()},
    )


def _fact(value: object) -> str:
    return ", ".join(map(_fact, value)) if isinstance(value, list | tuple) else shown(value)


def plan_table(plan: Plan | CalibrationPlan) -> Table:
    """A line a question: what settles it soonest; of a calibration a line a manoeuvre."""
    if isinstance(plan, CalibrationPlan):
        unit = "" if plan.unit == "1" else f" [{plan.unit}]"
        lines = [
            [_words(one), f"{one.hours:.2g}", f"{one.sigma:.2g}", f"{one.sigma / plan.sigma:.2f}"]
            for one in plan.courses
        ]
        columns = ["manoeuvre", "time [h]", f"sigma of {plan.worst}{unit}", "of today's"]
        note = "Predicted for record and manoeuvre calibrated together, with the errors found in this record."
        return Table("What to fly", columns, lines, note)
    rows = []
    for question in plan.questions:
        best = question.best
        name = " or ".join(question.names)
        if best is None:
            rows.append(
                [name, "none of these manoeuvres" + (f"; {question.instead}" if question.instead else ""), "", ""]
            )
        else:
            rows.append([name, *_flown(best), _power(best.power)])
    return Table(
        "What to fly",
        ["open question", "manoeuvre", "time [h]", "power [%]"],
        rows,
        "With several names the question is which of them it is; with one name, whether it is present at its typical size. "
        "Power: probability that a diagnosis of the manoeuvre, with the noise of this record, gives the right answer (the "
        "lowest, if there are several names).",
    )


def answers_table(question: Question) -> Table:
    """What each way in which it may come out would mean."""
    rows = [
        [*(_flown(course) if number == 0 else ("", "")), answer.cause, _power(answer.power), answer.means]
        for course in question.courses
        for number, answer in enumerate(course.answers)
    ]
    return Table(
        f"What the answers would mean: {question.words}",
        ["manoeuvre", "time [h]", "if it is", "power [%]", "answer"],
        rows,
    )


def _section(question: Question) -> PageSection:
    from fluxtwin.plots.plan import draw_power

    caption = (
        "Probability of the right answer by the hours flown; dotted: the level at which a question counts as settled."
    )
    block = FigureBlock(f"power_{'_'.join(question.names)}", caption, draw_power(question))
    heading = question.words[0].upper() + question.words[1:]
    return PageSection(heading, [], [answers_table(question)], [block])


def _power(share: float) -> str:
    """Under a heading that has the unit."""
    return percent(share).removesuffix(" %")


def _flown(course: Course) -> tuple[str, str]:
    return _words(course), f"{course.hours:.2g}"


def _words(course: Course | SigmaCourse) -> str:
    later = f", {course.wait_days:g} days later"
    return course.words if not course.wait_days or later in course.words else course.words + later
