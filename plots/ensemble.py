"""Figures of many flights: their pointing against time, and how often an effect is named, against its size."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from fluxtwin.plots import style
from fluxtwin.sim.base.types import BoolArray, FloatArray, TimeArray


def pointing_envelope(time: TimeArray, around_deg: Sequence[FloatArray], *, title: str, vehicles: int) -> Figure:
    """Percentiles over the vehicles at each time, and the worst vehicle of that time; in logarithms.

    around_deg: 5, 50 and 95 %, and the worst, each (T,).
    """
    low_deg, median_deg, high_deg, max_deg = around_deg
    figure, ((axes,),) = style.figure(style.FULL_WIDTH_IN, 3.6)
    axes.fill_between(time, low_deg, high_deg, color=style.SKY, alpha=0.45, linewidth=0, label="5 to 95 %")
    axes.plot(time, median_deg, color=style.BLUE, linewidth=1.4, label="median")
    axes.plot(time, max_deg, color=style.VERMILION, linewidth=0.9, linestyle="--", label="worst at each time")
    if low_deg.min() > 0.0:
        axes.set_yscale("log")
        style.log_ruler(axes.yaxis)
    style.utc(axes, time)
    style.label(axes, y="pointing error [deg]", title=f"{title}: {vehicles} vehicles")
    style.legend_below(figure, axes)
    return figure


_COLUMNS = 3


@dataclass(frozen=True)
class PowerSeries:
    """The runs of one effect."""

    name: str
    unit: str
    size: FloatArray
    """(R,) in the unit."""
    named: BoolArray
    """(R,)."""
    bins: Sequence[tuple[float, float, float, float, float]]
    """Of some sizes: from, to [unit], share named, and its 95 % interval."""
    line: tuple[float, float] | None
    """Intercept and slope of the log odds over the logarithm of the size."""


def draw_power(effects: Sequence[PowerSeries], *, title: str) -> Figure:
    """A panel an effect: runs as ticks (named above, missed below), shares with intervals, the fitted curve."""
    columns = min(_COLUMNS, len(effects))
    rows = -(-len(effects) // columns)
    figure, grid = style.figure(style.FULL_WIDTH_IN, 2.6 * rows + 0.5, rows, columns)
    for place in range(rows * columns):
        axes = grid[place // columns][place % columns]
        if place >= len(effects):
            axes.set_visible(False)
            continue
        one = effects[place]
        ticks: dict[str, Any] = {"linestyle": "", "marker": "|", "markersize": 6}
        axes.plot(one.size[one.named], np.full(one.named.sum(), 104.0), color=style.BLUE, label="runs, named", **ticks)
        missed = one.size[~one.named]
        axes.plot(missed, np.full(missed.size, -4.0), color=style.VERMILION, label="runs, not named", **ticks)
        low, high, share, least, most = np.reshape(one.bins, (-1, 5)).T
        reach = 100.0 * np.maximum([share - least, most - share], 0.0)  # of none or all an end is rounded off
        look: dict[str, Any] = {"fmt": "o", "markersize": 4, "color": style.BLACK, "ecolor": style.GREY}
        look["elinewidth"] = 1.2
        axes.errorbar(np.sqrt(low * high), 100.0 * share, reach, label="share named, 95 % interval", **look)
        if one.line is not None:
            x = np.geomspace(one.size.min(), one.size.max(), 200)
            z = one.line[0] + one.line[1] * np.log(x)
            curve = 100.0 / (1.0 + np.exp(-np.clip(z, -50, 50)))
            axes.plot(x, curve, color=style.BLUE, linewidth=1.4, label="fitted to the runs")
        if np.ptp(one.size) > 0 and one.size.max() > 3.0 * one.size.min():
            axes.set_xscale("log")
            style.log_ruler(axes.xaxis)
        axes.set_ylim(-9.0, 109.0)
        axes.axhline(90.0, color=style.GREY, linewidth=0.8, linestyle=":", zorder=0, label="90 %")
        first = place % columns == 0
        style.label(axes, x=f"size [{one.unit}]", y="named [%]" if first else "", title=one.name)
    style.legend_below(figure, grid[0][0])
    style.heading(figure, title)
    return figure
