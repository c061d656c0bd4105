"""The power of manoeuvres against the hours flown."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from fluxtwin.gap.records.plan import ENOUGH, Course, Question
from fluxtwin.plots import style

_COLOURS = (style.BLUE, style.VERMILION, style.GREEN)


def draw_power(question: Question) -> Figure:
    """Power against hours of the best manoeuvres for a question, and of more of the same."""
    figure, ((axes,),) = style.figure(7.2, 3.9)
    power_on(axes, question)
    style.legend_below(figure, axes, columns=1)
    return figure


def power_on(axes: Axes, question: Question) -> Axes:
    """The same into given axes, without a legend."""
    for course, colour in zip(question.courses, _COLOURS, strict=False):
        later = f", {course.wait_days:g} days later" if course.wait_days and "later" not in course.words else ""
        _line(axes, course, f"{course.words}{later}", colour, "-")
    before = question.as_before
    if before is not None and before.words not in [course.words for course in question.courses]:
        _line(axes, before, f"{before.words} (more of the same)", style.GREY, "--")
    axes.axhline(100.0 * ENOUGH, color=style.BLACK, lw=0.8, ls=":")
    axes.set_ylim(-2.0, 103.0)
    axes.set_xlim(left=0.0)
    style.label(axes, x="hours flown [h]", y="probability of the right answer [%]", title=_title(question))
    return axes


def _line(axes: Axes, course: Course, label: str, colour: str, dashes: str) -> None:
    hours, power = np.array([(0.0, 0.0), *course.curve]).T
    axes.plot(hours, 100.0 * power, dashes, color=colour, marker="o", ms=4.0, label=label)


def _title(question: Question) -> str:
    names: Sequence[str] = question.names
    return f"{' or '.join(names)}?" if len(names) > 1 else f"{names[0]}: there or not?"
