"""The power of manoeuvres against the hours flown."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from fluxtwin.gap.records.plan import ENOUGH, CalibrationPlan, Course, Question
from fluxtwin.plots import style

_COLOURS = (style.BLUE, style.ORANGE, style.VERMILION)
_WIDTHS = (3.6, 2.4, 1.3)
"""The later ones on top and thinner: curves that coincide are all seen."""


def draw_power(question: Question) -> Figure:
    """Power against hours of the best manoeuvres for a question, and of more of the same."""
    figure, ((axes,),) = style.figure(7.2, 3.9)
    power_on(axes, question)
    style.legend_below(figure, axes, columns=1)
    return figure


def power_on(axes: Axes, question: Question) -> Axes:
    """The same into given axes, without a legend."""
    for course, colour, width in zip(question.courses, _COLOURS, _WIDTHS, strict=False):
        _line(axes, course, course.words, colour, "-", width)
    before = question.as_before
    if before is not None and before.words not in [course.words for course in question.courses]:
        _line(axes, before, f"{before.words} (more of the same)", style.GREY, "--", 1.6)
    axes.axhline(100.0 * ENOUGH, color=style.BLACK, lw=0.8, ls=":")
    axes.set_ylim(-2.0, 103.0)
    axes.set_xlim(left=0.0)
    names: Sequence[str] = question.names
    title = f"{' or '.join(names)}?" if len(names) > 1 else f"{names[0]}: there or not?"
    style.label(axes, x="time flown [h]", y="probability of the right answer [%]", title=title)
    return axes


def draw_sigma(plan: CalibrationPlan) -> Figure:
    """Sigma of the worst parameter against hours, of the first manoeuvres."""
    figure, ((axes,),) = style.figure(7.2, 3.9)
    sigma_on(axes, plan)
    style.legend_below(figure, axes, columns=2)
    return figure


def sigma_on(axes: Axes, plan: CalibrationPlan) -> Axes:
    """The same into given axes, without a legend."""
    for course, colour in zip(plan.courses, style.CYCLE, strict=False):
        hours, sigma = np.array([(0.0, plan.sigma), *course.curve]).T
        axes.plot(hours, sigma, color=colour, marker="o", ms=4.0, label=course.words)
    axes.axhline(0.5 * plan.sigma, color=style.BLACK, lw=0.8, ls=":")
    axes.set_yscale("log")
    style.log_ruler(axes.yaxis)
    axes.set_xlim(left=0.0)
    y, title = f"sigma of {plan.worst} [{plan.unit}]", f"What halves the sigma of {plan.worst}?"
    style.label(axes, x="time flown [h]", y=y, title=title)
    return axes


def _line(axes: Axes, course: Course, label: str, colour: str, dashes: str, width: float) -> None:
    hours, power = np.array([(0.0, 0.0), *course.curve]).T
    axes.plot(hours, 100.0 * power, dashes, color=colour, marker="o", ms=2.0 * width + 1.0, lw=width, label=label)
