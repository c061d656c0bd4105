"""Figures of station passes: what was printed beside what is predicted, and errors with one thing wrong."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.figure import Figure

from fluxtwin.plots import style
from fluxtwin.sim.base.types import BoolArray, FloatArray


@dataclass(frozen=True)
class AngleRanges:
    """Printed and predicted ranges of an angle, one row a pass [deg]."""

    labels: Sequence[str]
    printed_deg: FloatArray
    """(P, 2)."""
    predicted_deg: FloatArray
    """(P, 2)."""
    misread: BoolArray
    """(P, 2) ends whose digits were corrected."""
    scanned_deg: FloatArray
    """(P, 2) as the scan shows them."""


@dataclass(frozen=True)
class NullTests:
    """Median error with everything right, and with one thing wrong [deg]."""

    median_deg: float
    nulls_deg: Mapping[str, float]
    ends: int
    """How many ends each median is of."""


@dataclass(frozen=True)
class ResidualEvidence:
    """Printed residual of each pass beside the error that the flown field model made there."""

    labels: Sequence[str]
    printed_mG: FloatArray
    predicted_mG: FloatArray
    night: FloatArray
    turns_deg: FloatArray
    turned_correlation: FloatArray


@dataclass(frozen=True)
class MovedErrors:
    """What a scanner's errors leave when they are moved along the orbit."""

    shifts_deg: FloatArray
    ratio: Mapping[str, FloatArray]
    """By scanner: night over day."""
    correlation: Mapping[str, FloatArray]
    printed_ratio: float
    ratio_without: float
    correlation_without: float


@dataclass(frozen=True)
class Ideas:
    """How many ends of the printed ranges each idea explains."""

    names: Sequence[str]
    explained: Sequence[int]
    explained_with_digits: Sequence[int]
    by_chance: Sequence[float]
    total: int


@dataclass(frozen=True)
class BiasOfPasses:
    """The X bias that each pass alone gives with S = 0, by its mean X reading."""

    mean_x_mG: FloatArray
    bias_x_mG: FloatArray
    explained_mG: FloatArray
    """What the printed S makes of each pass's mean reading, with the printed bias."""


def draw_ranges(record: AngleRanges, *, title: str, unit: str = "angle [deg]") -> Figure:
    """One bar a pass from the lowest to the highest printed angle, and the predicted ends on it."""
    count = len(record.labels)
    figure, ((axes,),) = style.figure(7.2, 0.21 * count + 1.2)
    rows = np.arange(count)[::-1]
    axes.hlines(rows, record.printed_deg[:, 0], record.printed_deg[:, 1], color=style.PALE, linewidth=7)
    for end, marker in ((0, ">"), (1, "<")):
        axes.plot(
            record.predicted_deg[:, end], rows, marker, color=style.BLUE, markersize=5,
            label="predicted ends" if end == 0 else None,
        )  # fmt: skip
        axes.plot(
            record.printed_deg[:, end], rows, "|", color=style.BLACK, markersize=9,
            label="printed ends" if end == 0 else None,
        )  # fmt: skip
    wrong = np.argwhere(record.misread)
    axes.plot(
        [record.scanned_deg[k, e] for k, e in wrong], [rows[k] for k, _ in wrong], "x", color=style.PAPER, markersize=6,
        label="digits of the scan, corrected",
    )  # fmt: skip
    axes.set_yticks(rows, record.labels, fontsize=7)
    axes.set(title=title, xlabel=unit, ylim=(-1, count))
    axes.legend(loc="lower left", frameon=True)
    return figure


def draw_nulls(record: NullTests, *, title: str) -> Figure:
    """Bars of the median error; the right model first."""
    names = ["as it was", *record.nulls_deg]
    values = [record.median_deg, *record.nulls_deg.values()]
    figure, ((axes,),) = style.figure(7.2, 3.2)
    bars = axes.bar(np.arange(len(names)), values, 0.6, color=[style.BLUE] + [style.ORANGE] * len(record.nulls_deg))
    axes.bar_label(bars, fmt="%.2f", fontsize=8)
    axes.set_xticks(np.arange(len(names)), [textwrap.fill(name, 15) for name in names])
    axes.set(title=title, ylabel=f"median error of {record.ends} ends [deg]")
    return figure


def draw_evidence(record: ResidualEvidence, *, title: str) -> Figure:
    """Printed residual against predicted model error, and the rank correlation as the map is turned."""
    figure, ((left, right),) = style.figure(7.2, 3.8, cols=2)
    night = record.night > 0.5
    for chosen, marker, label, colour in (
        (night, "o", "night", style.BLACK), (~night, "s", "sunlit", style.ORANGE),
    ):  # fmt: skip
        left.plot(
            record.predicted_mG[chosen], record.printed_mG[chosen], marker, color=colour, markersize=4, label=label
        )
    for rank, k in enumerate(np.argsort(-record.printed_mG)[:4]):
        left.annotate(record.labels[k], (record.predicted_mG[k], record.printed_mG[k]), fontsize=7,
                      xytext=(-7, -9 if rank % 2 else 4), textcoords="offset points", ha="right")  # fmt: skip
    left.set(xlabel="error of IGRF 1975 in field strength [mG, rms]", ylabel="printed residual [mG]", title="43 passes")
    left.legend(loc="upper left")
    turns = np.append(record.turns_deg, 360.0)
    right.plot(turns, np.append(record.turned_correlation, record.turned_correlation[0]), color=style.BLUE, marker="o",
               markersize=3)  # fmt: skip
    right.axhline(0.0, color="grey", linewidth=0.8)
    right.set(xlabel="map of errors turned east by [deg]", ylabel="rank correlation", title="the map turned",
              xlim=(0, 360))  # fmt: skip
    figure.suptitle(title)
    return figure


def draw_moved(record: MovedErrors, *, title: str) -> Figure:
    """Ratio of night to day and rank correlation, as the errors are moved."""
    figure, ((left, right),) = style.figure(7.2, 3.9, cols=2)
    turns, colours = np.append(record.shifts_deg, 360.0), (style.BLUE, style.ORANGE, style.BLACK)
    for axes, curves in ((left, record.ratio), (right, record.correlation)):
        for (name, values), colour, marker in zip(curves.items(), colours, "os^", strict=True):
            axes.plot(turns, np.append(values, values[0]), color=colour, marker=marker, markersize=3, label=name)
        axes.set(xlabel="errors moved along the orbit by [deg]", xlim=(0, 360), xticks=np.arange(0, 361, 90))
    left.axhline(record.printed_ratio, color=style.VERMILION, linewidth=1.0, label="printed")
    left.axhline(record.ratio_without, color="grey", linestyle="--", linewidth=1.0, label="no horizon error")
    right.axhline(record.correlation_without, color="grey", linestyle="--", linewidth=1.0)
    left.set(ylabel="residual by night over that by day", title="the factor")
    right.set(ylabel="rank correlation of the night passes", title="the ranking")
    figure.legend(*left.get_legend_handles_labels(), loc="outside lower center", ncols=3, fontsize=style.NOTE_PT)
    figure.suptitle(title)
    return figure


def draw_bias(record: BiasOfPasses, *, title: str) -> Figure:
    """Found X bias of every pass, and what S alone would make of it."""
    figure, ((axes,),) = style.figure(7.2, 3.6)
    axes.plot(record.mean_x_mG, record.bias_x_mG, "o", color=style.BLUE, markersize=3, label="bias from the pass alone")
    axes.plot(
        record.mean_x_mG, record.explained_mG, ".", color=style.VERMILION, markersize=3,
        label="b1 and the first row of S at the mean reading",
    )  # fmt: skip
    axes.set(title=title, xlabel="mean X reading of the pass [mG]", ylabel="X bias with S = T = 0 [mG]")
    axes.legend(loc="best", frameon=True)
    return figure


def draw_ideas(record: Ideas, *, title: str) -> Figure:
    """Ends explained by each idea, as read and with one confused digit allowed."""
    count = len(record.names)
    figure, ((axes,),) = style.figure(7.2, 0.34 * count + 1.3)
    rows = np.arange(count)[::-1]
    axes.barh(rows + 0.18, record.explained, 0.34, color=style.BLUE, label="digits as scanned")
    axes.barh(rows - 0.18, record.explained_with_digits, 0.34, color=style.ORANGE, label="one confused digit allowed")
    axes.plot(record.by_chance, rows, "|", color=style.BLACK, markersize=16, label="by chance, as scanned")
    axes.set_yticks(rows, record.names, fontsize=8)
    axes.set(title=title, xlabel=f"ends explained within 1.5 deg, of {record.total}", xlim=(0, record.total))
    handles, labels = axes.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=3, fontsize=8)
    return figure
