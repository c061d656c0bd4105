"""Figures of diagnoses side by side: what each name explains alone, the residual by latitude, satellites compared."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from scipy.stats import binned_statistic

from fluxtwin.plots import style
from fluxtwin.sim.base.types import FloatArray

_STEP_DEG = 5.0
_LEAST_ROWS = 4


def left_alone(
    names: Sequence[str], left_nT: Sequence[float], parameters: Sequence[int], limit_nT: float, title: str
) -> Figure:
    """What each fit leaves: a bar with its name, rms and parameters; the dashed line is what was there before.

    The words are in the bar where it is long, so that the line strikes none through.
    """
    figure, ((axes,),) = style.figure(style.FULL_WIDTH_IN, 0.9 + 0.32 * len(names))
    places = np.arange(len(names))
    axes.barh(places, left_nT, height=0.68, color=style.BLUE)
    axes.set_yticks(places, names)
    axes.invert_yaxis()
    for place, value, count in zip(places, left_nT, parameters, strict=True):
        remark = f"{value:.1f} nT, {count} parameter{'s' if count > 1 else ''}"
        inside = value > 0.5 * limit_nT
        box: dict[str, Any] = {"facecolor": "white", "edgecolor": "none", "pad": 1.0}
        look: dict[str, Any] = {"ha": "right", "color": "white"} if inside else {"ha": "left", "bbox": box}
        apart = (-0.012 if inside else 0.012) * limit_nT
        axes.text(value + apart, float(place), remark, va="center", fontsize=style.NOTE_PT, **look)
    axes.axvline(limit_nT, color=style.BLACK, linewidth=1.0, linestyle="--", zorder=1.5)
    axes.set_xlim(0.0, 1.1 * limit_nT)
    style.label(axes, x="rms left per component [nT]; dashed: before", title=title)
    return figure


def by_latitude(tracks: Sequence[tuple[str, FloatArray, FloatArray]], title: str, aurora_deg: float) -> Figure:
    """rms over the components of residuals (N, 3) against latitude (N,): dots, and the rms in steps of 5 deg.

    Beyond `aurora_deg` the ground is tinted.
    """
    figure, ((axes,),) = style.figure(style.FULL_WIDTH_IN, 3.2)
    for place, (label, latitude_deg, residual_nT) in enumerate(tracks):
        size = np.sqrt(np.mean(np.square(residual_nT), axis=1))
        colour, line = style.CYCLE[place], ("-", "--", "-.", ":")[place % 4]
        if len(tracks) == 1:
            axes.plot(latitude_deg, size, ".", color=style.SKY, markersize=3.0, alpha=0.6, label="samples")
            colour = style.VERMILION
        axes.plot(*_steps(latitude_deg, size), color=colour, linestyle=line, linewidth=1.6, label=label)
    for low, high in ((-90.0, -aurora_deg), (aurora_deg, 90.0)):
        axes.axvspan(low, high, color=style.PALE, alpha=0.4, linewidth=0.0, zorder=0.2)
    axes.set_xlim(-90.0, 90.0)
    axes.set_xticks(np.arange(-90, 91, 30))
    axes.set_ylim(bottom=0.0)
    style.label(axes, x="geocentric latitude [deg]", y="rms over the axes [nT]", title=title)
    style.legend(axes, "upper center", columns=min(4, len(tracks) + 1))
    return figure


def groups(labels: Sequence[str], series: Mapping[str, Sequence[float]], quantity: str, title: str) -> Figure:
    """Bars in groups, one colour a series; `quantity` names the axis with its unit."""
    figure, ((axes,),) = style.figure(style.FULL_WIDTH_IN, 3.0)
    places, width = np.arange(len(labels)), 0.8 / len(series)
    hatches = ("", "//", "..", "xx")
    for number, (name, values) in enumerate(series.items()):
        shift = (number - 0.5 * (len(series) - 1)) * width
        look: dict[str, Any] = {"color": style.CYCLE[number], "hatch": hatches[number % 4], "edgecolor": "white"}
        axes.bar(places + shift, values, width=0.92 * width, label=name, linewidth=0.0, **look)
    axes.set_xticks(places, list(labels))
    style.zero_line(axes)
    style.label(axes, y=quantity, title=title)
    style.legend_below(figure, axes, columns=len(series), frame=False)
    return figure


def _steps(latitude_deg: FloatArray, size: FloatArray) -> tuple[FloatArray, FloatArray]:
    """rms in steps of latitude, NaN where there are too few rows."""
    edges = np.arange(-90.0, 90.0 + _STEP_DEG, _STEP_DEG)
    known = np.isfinite(size)
    count, square = (
        binned_statistic(latitude_deg[known], np.square(size[known]), how, edges).statistic for how in ("count", "mean")
    )
    return 0.5 * (edges[1:] + edges[:-1]), np.where(count >= _LEAST_ROWS, np.sqrt(square), np.nan)
