"""How often an effect is named, against its size: the runs of a campaign."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.figure import Figure

from fluxtwin.plots import style
from fluxtwin.sim.base.types import BoolArray, FloatArray

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
    width = style.FULL_WIDTH_IN if columns > 1 else 4.8
    figure, grid = style.figure(width, 2.6 * rows + 0.5, rows, columns)
    for place in range(rows * columns):
        axes = grid[place // columns][place % columns]
        if place >= len(effects):
            axes.set_visible(False)
            continue
        one = effects[place]
        axes.plot(one.size[one.named], np.full(one.named.sum(), 104.0), "|", color=style.BLUE, markersize=6)
        axes.plot(one.size[~one.named], np.full((~one.named).sum(), -4.0), "|", color=style.VERMILION, markersize=6)
        for low, high, share, least, most in one.bins:
            middle = np.sqrt(low * high)
            axes.plot([middle, middle], [100 * least, 100 * most], color=style.GREY, linewidth=1.2)
            axes.plot([middle], [100 * share], "o", color=style.BLACK, markersize=4)
        if one.line is not None:
            x = np.geomspace(one.size.min(), one.size.max(), 200)
            z = one.line[0] + one.line[1] * np.log(x)
            axes.plot(x, 100.0 / (1.0 + np.exp(-np.clip(z, -50, 50))), color=style.BLUE, linewidth=1.4)
        if np.ptp(one.size) > 0 and one.size.max() > 3.0 * one.size.min():
            axes.set_xscale("log")
            axes.xaxis.set_major_formatter(lambda value, _: f"{value:g}")
            axes.xaxis.set_minor_formatter("")
        axes.set_ylim(-9.0, 109.0)
        axes.axhline(90.0, color=style.PALE, linewidth=0.8, zorder=0)
        first = place % columns == 0
        style.label(axes, x=f"size [{one.unit}]", y="named [%]" if first else "", title=one.name)
    style.heading(figure, title)
    return figure
