"""Figures of a spinner whose sensor follows sun and shadow."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.figure import Figure

from fluxtwin.plots import style
from fluxtwin.sim.base.types import FloatArray


@dataclass(frozen=True)
class Response:
    """One zone: the response of one channel to the field across the spin axis."""

    label: str
    since_shadow_s: FloatArray
    response: FloatArray
    in_sunlight: bool


@dataclass(frozen=True)
class Bars:
    """One series of figures, one a zone."""

    label: str
    value_nT: Sequence[float]


@dataclass(frozen=True)
class Left:
    """What is left of one zone before and after, fitted without it."""

    title: str
    minutes: FloatArray
    before_nT: FloatArray
    """(N, 3) sensor axes."""
    minutes_after: FloatArray
    after_nT: FloatArray


def response_figure(channels: Sequence[tuple[str, Sequence[Response]]], shadow_s: float) -> Figure:
    """Responses of the channels against the time since the shadow was entered; the shadow itself is tinted."""
    made, grid = style.figure(style.FULL_WIDTH_IN, 3.4, 1, len(channels))
    for axes, (name, zones) in zip(grid[0], channels, strict=True):
        axes.axvspan(0.0, shadow_s / 60.0, color=style.PALE, alpha=0.6, zorder=0, linewidth=0.0)
        for number, zone in enumerate(zones):
            axes.plot(
                zone.since_shadow_s / 60.0, zone.response, label=zone.label, linewidth=1.3,
                color=style.CYCLE[number % len(style.CYCLE)], linestyle="--" if zone.in_sunlight else "-",
            )  # fmt: skip
        style.label(axes, x="time since the shadow was entered [min]", y=f"response of {name} [nT/nT]", title=name)
        axes.set_xlim(left=0.0)
    style.legend(grid[0][-1], "upper right", columns=2)
    return made


def zones_figure(series: Sequence[Bars], numbers: Sequence[int]) -> Figure:
    """rms of each zone, one mark a series, on a logarithmic scale."""
    made, grid = style.figure(style.FULL_WIDTH_IN, 3.6)
    axes = grid[0][0]
    marks = "osD^vP*"
    for number, one in enumerate(series):
        axes.plot(
            numbers, one.value_nT, marks[number % len(marks)], label=one.label, linestyle=":", linewidth=0.8,
            markersize=5.0, color=style.CYCLE[number % len(style.CYCLE)],
        )  # fmt: skip
    axes.set_yscale("log")
    axes.set_xticks(list(numbers))
    low, high = min(min(s.value_nT) for s in series), max(max(s.value_nT) for s in series)
    axes.set_ylim(0.6 * low, 12.0 * high)
    style.label(axes, x="zone", y="rms of the residual vector [nT]")
    style.legend(axes, "upper left", columns=2)
    return made


def left_figure(shown: Sequence[Left]) -> Figure:
    """Residuals of unseen zones, static sensor left, best one right."""
    made, grid = style.figure(style.FULL_WIDTH_IN, 2.4 * len(shown) + 0.4, len(shown), 2, share_x=True, share_y=True)
    for row, one in zip(grid, shown, strict=True):
        pairs = ((one.minutes, one.before_nT, "static"), (one.minutes_after, one.after_nT, "follows sun and shadow"))
        for axes, (minutes, value, name) in zip(row, pairs, strict=True):
            for axis in range(3):
                axes.plot(
                    minutes, value[:, axis], ".", color=style.AXIS_COLOURS[axis], markersize=2.5, label="XYZ"[axis]
                )
            style.zero_line(axes)
            style.label(axes, title=f"{one.title}: {name}")
        style.label(row[0], y="reading - model [nT]")
        bound = float(np.abs(one.before_nT).max())
        row[0].set_ylim(-1.05 * bound, 1.05 * bound)
    for axes in grid[-1]:
        style.label(axes, x="minutes of the zone")
    style.legend(grid[0][1], "upper right", columns=3)
    return made
