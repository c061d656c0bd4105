"""Parameters of a magnetometer over its calibrations, with what they are taken to have done."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
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
    changed: bool


def draw_calibration_trend(time: TimeArray, series: Sequence[ParameterSeries], *, title: str) -> Figure:
    """A panel a parameter, three in a row; bars are 1 sigma. A line in colour where a parameter changed, grey where not."""
    rows = -(-len(series) // 3)
    figure, grid = style.figure(7.6, 0.8 + 1.5 * rows, rows=rows, cols=3, share_x=True)
    style.heading(figure, title)
    days = (time - time[0]).astype("timedelta64[ns]").astype(np.float64) / 8.64e13
    panels = [axes for row in grid for axes in row]
    for axes, one in zip(panels, series, strict=False):
        axes.plot(days, one.fitted, "-", color=style.VERMILION if one.changed else style.GREY, linewidth=1.2)
        axes.errorbar(days, one.values, one.sigmas, fmt="o", markersize=3, color=style.BLUE, elinewidth=1.0, capsize=2)
        style.label(axes, y=f"{one.name} [{one.unit}]")
        axes.ticklabel_format(axis="y", useOffset=False)
    for axes in panels[len(series) :]:
        axes.set_visible(False)
    for axes in grid[-1]:
        style.label(axes, x=f"days since {np.datetime_as_string(time[0], unit='D')} [d]")
    return figure
