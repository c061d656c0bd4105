"""Parameters of a magnetometer over its calibrations, with what they are taken to have done."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from matplotlib.figure import Figure

from fluxtwin.plots import style
from fluxtwin.sim.base.types import FloatArray, TimeArray


@dataclass(frozen=True)
class ParameterSeries:
    """One parameter."""

    name: str
    unit: str
    values: FloatArray
    """(K,)."""
    sigmas: FloatArray
    """(K,) 1 sigma."""
    fitted: FloatArray
    """(K,) what it is taken to have done."""
    kind: str
    """constant, step, drift or temperature."""


def draw_calibration_trend(time: TimeArray, series: Sequence[ParameterSeries], *, title: str) -> Figure:
    """A panel a parameter, three in a row; bars are 1 sigma. A line in colour where a parameter changed, grey where not."""
    rows = -(-len(series) // 3)
    figure, grid = style.figure(7.6, 0.8 + 1.5 * rows, rows=rows, cols=3, share_x=True)
    style.heading(figure, title)
    panels = [axes for row in grid for axes in row]
    for axes, one in zip(panels, series, strict=False):
        colour, words = (style.GREY, "constant") if one.kind == "constant" else (style.VERMILION, "changed")
        course = "steps-mid" if one.kind == "step" else "default"
        axes.plot(time, one.fitted, "-", drawstyle=course, linewidth=1.2, color=colour, label=words)
        axes.errorbar(time, one.values, one.sigmas, fmt="o", markersize=3, color=style.BLUE, elinewidth=1.0, capsize=2)
        style.label(axes, title=one.name if one.unit == "1" else f"{one.name} [{one.unit}]")
        axes.ticklabel_format(axis="y", useOffset=False)
    for axes in panels[len(series) :]:
        axes.set_visible(False)
    for axes in grid[-1]:
        style.utc(axes, time, most=3)
    return figure
