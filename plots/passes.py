"""Figures of station passes: what was printed beside what is predicted, and errors with one thing wrong."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from fluxtwin.plots import style
from fluxtwin.sim.base.types import BoolArray, FloatArray


def draw_ranges(
    labels: Sequence[str],
    printed_deg: FloatArray,
    predicted_deg: FloatArray,
    misread: BoolArray,
    scanned_deg: FloatArray,
    *,
    title: str,
    unit: str = "angle [deg]",
) -> Figure:
    """One bar a pass from the lowest to the highest printed angle, and the predicted ends on it.

    printed_deg: (P, 2); predicted_deg: (P, 2); misread: (P, 2) ends whose digits were corrected; scanned_deg: (P,
    2) as the scan shows them.
    """
    count = len(labels)
    figure, ((axes,),) = style.figure(7.2, 0.21 * count + 1.2)
    rows = np.arange(count)[::-1]
    axes.hlines(rows, printed_deg[:, 0], printed_deg[:, 1], color=style.PALE, linewidth=7)
    for end, marker in ((0, ">"), (1, "<")):
        said = (None, None) if end else ("predicted ends", "printed ends")
        axes.plot(predicted_deg[:, end], rows, marker, color=style.BLUE, markersize=5, label=said[0])
        axes.plot(printed_deg[:, end], rows, "|", color=style.BLACK, markersize=9, label=said[1])
    wrong, words = rows[np.nonzero(misread)[0]], "digits of the scan, corrected"
    axes.plot(scanned_deg[misread], wrong, "x", color=style.PAPER, markersize=6, label=words)
    axes.set_yticks(rows, labels, fontsize=7)
    style.label(axes, x=unit, title=title)
    axes.set(ylim=(-1, count))
    axes.legend(loc="lower left", frameon=True)
    return figure


def draw_nulls(median_deg: float, nulls_deg: Mapping[str, float], ends: int, *, title: str) -> Figure:
    """Bars of the median error; the right model first.

    ends: how many ends each median is of.
    """
    names = ["as it was", *nulls_deg]
    values = [median_deg, *nulls_deg.values()]
    figure, ((axes,),) = style.figure(7.2, 3.2)
    bars = axes.bar(np.arange(len(names)), values, 0.6, color=[style.BLUE] + [style.ORANGE] * len(nulls_deg))
    axes.bar_label(bars, fmt="%.2f", fontsize=8)
    axes.set_xticks(np.arange(len(names)), [textwrap.fill(name, 15) for name in names])
    style.label(axes, y=f"median error of {ends} ends [deg]", title=title)
    return figure


def draw_evidence(
    labels: Sequence[str],
    printed_mG: FloatArray,
    predicted_mG: FloatArray,
    night: BoolArray,
    turns_deg: FloatArray,
    turned_correlation: FloatArray,
    *,
    title: str,
) -> Figure:
    """Printed residual against predicted model error, and the rank correlation as the map is turned."""
    figure, ((left, right),) = style.figure(7.2, 3.8, cols=2)
    for chosen, marker, label, colour in ((night, "o", "night", style.BLACK), (~night, "s", "sunlit", style.ORANGE)):
        left.plot(predicted_mG[chosen], printed_mG[chosen], marker, color=colour, markersize=4, label=label)
    for rank, k in enumerate(np.argsort(-printed_mG)[:4]):
        beside: dict[str, Any] = {"xytext": (-7, -9 if rank % 2 else 4), "textcoords": "offset points"}
        left.annotate(labels[k], (predicted_mG[k], printed_mG[k]), fontsize=7, ha="right", **beside)
    style.label(left, x="error of IGRF 1975 in field strength [mG, rms]", y="printed residual [mG]", title="43 passes")
    left.legend(loc="upper left")
    turns = np.append(turns_deg, 360.0)
    right.plot(turns, np.append(turned_correlation, turned_correlation[0]), color=style.BLUE, marker="o", markersize=3)
    right.axhline(0.0, color="grey", linewidth=0.8)
    style.label(right, x="map of errors turned east by [deg]", y="rank correlation", title="the map turned")
    right.set(xlim=(0, 360))
    style.heading(figure, title)
    return figure


def draw_moved(
    shifts_deg: FloatArray,
    ratio: Mapping[str, FloatArray],
    correlation: Mapping[str, FloatArray],
    printed_ratio: float,
    ratio_without: float,
    correlation_without: float,
    *,
    title: str,
) -> Figure:
    """Ratio of night to day and rank correlation, as the errors are moved.

    ratio: by scanner: night over day.
    """
    figure, ((left, right),) = style.figure(7.2, 3.9, cols=2)
    turns, colours = np.append(shifts_deg, 360.0), (style.BLUE, style.ORANGE, style.BLACK)
    for axes, curves in ((left, ratio), (right, correlation)):
        for (name, values), colour, marker in zip(curves.items(), colours, "os^", strict=True):
            axes.plot(turns, np.append(values, values[0]), color=colour, marker=marker, markersize=3, label=name)
        style.label(axes, x="errors moved along the orbit by [deg]")
        axes.set(xlim=(0, 360), xticks=np.arange(0, 361, 90))
    left.axhline(printed_ratio, color=style.VERMILION, linewidth=1.0, label="printed")
    left.axhline(ratio_without, color="grey", linestyle="--", linewidth=1.0, label="no horizon error")
    right.axhline(correlation_without, color="grey", linestyle="--", linewidth=1.0)
    style.label(left, y="residual by night over that by day", title="the factor")
    style.label(right, y="rank correlation of the night passes", title="the ranking")
    style.legend_below(figure, left)
    style.heading(figure, title)
    return figure


def draw_bias(mean_x_mG: FloatArray, bias_x_mG: FloatArray, explained_mG: FloatArray, *, title: str) -> Figure:
    """Found X bias of every pass, and what S alone would make of it.

    explained_mG: what the printed S makes of each pass's mean reading, with the printed bias.
    """
    figure, ((axes,),) = style.figure(7.2, 3.6)
    axes.plot(mean_x_mG, bias_x_mG, "o", color=style.BLUE, markersize=3, label="bias from the pass alone")
    words = "b1 and the first row of S at the mean reading"
    axes.plot(mean_x_mG, explained_mG, ".", color=style.VERMILION, markersize=3, label=words)
    style.label(axes, x="mean X reading of the pass [mG]", y="X bias with S = T = 0 [mG]", title=title)
    axes.legend(loc="best", frameon=True)
    return figure


def draw_ideas(
    names: Sequence[str],
    explained: Sequence[int],
    explained_with_digits: Sequence[int],
    by_chance: Sequence[float],
    total: int,
    *,
    title: str,
) -> Figure:
    """Ends explained by each idea, as read and with one confused digit allowed."""
    count = len(names)
    figure, ((axes,),) = style.figure(7.2, 0.34 * count + 1.3)
    rows = np.arange(count)[::-1]
    axes.barh(rows + 0.18, explained, 0.34, color=style.BLUE, label="digits as scanned")
    axes.barh(rows - 0.18, explained_with_digits, 0.34, color=style.ORANGE, label="one confused digit allowed")
    axes.plot(by_chance, rows, "|", color=style.BLACK, markersize=16, label="by chance, as scanned")
    axes.set_yticks(rows, names, fontsize=8)
    style.label(axes, x=f"ends explained within 1.5 deg, of {total}", title=title)
    axes.set(xlim=(0, total))
    style.legend_below(figure, axes)
    return figure
