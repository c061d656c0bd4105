"""Yaw from the magnetometer beside yaw from the sun sensor, drawn as in Lerner & Shuster's figures 1 and 2."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from fluxtwin.plots import style
from fluxtwin.sim.base.types import BoolArray, FloatArray


@dataclass(frozen=True)
class YawComparison:
    """One stretch of yaw solutions; N samples, M averages."""

    minutes: FloatArray
    """(N,) time from the start."""
    sun_deg: FloatArray
    """(N,) sun-sensor solution, NaN where no head sees the sun."""
    magnetometer_deg: FloatArray
    """(N,) solution from each sample."""
    change_x: BoolArray
    """(N,) the X reading differs from the one before."""
    change_y: BoolArray
    mean_minutes: FloatArray
    """(M,) middle of each averaging window."""
    mean_deg: FloatArray
    """(M,) magnetometer solution averaged over the window."""
    mean_sun_deg: FloatArray
    """(M,) sun-sensor solution averaged alike."""
    near_node: BoolArray
    """(M,) windows near the equator."""
    window_s: float

    @property
    def mean_error_deg(self) -> FloatArray:
        """(M,) averaged magnetometer less sun sensor, within half a turn."""
        return np.asarray((self.mean_deg - self.mean_sun_deg + 180.0) % 360.0 - 180.0)

    @property
    def nearer(self) -> BoolArray:
        """(M,) windows in which that is nearer to the sun-sensor solution than yaw = 0 is."""
        return np.asarray(np.abs(self.mean_error_deg) < np.abs(self.mean_sun_deg))


def draw_mean_bias(record: YawComparison, *, title: str) -> Figure:
    """Figure 1: averages of the sun sensor dashed, of the magnetometer dotted, and the trivial solution yaw = 0.

    Shaded: the windows in which yaw = 0 is the worse estimate; bars above: near the nodes.
    """
    figure, ((axes,),) = style.figure(7.2, 4.0)
    half = record.window_s / 120.0
    for number, minute in enumerate(record.mean_minutes[record.nearer]):
        label = None if number else "magnetometer nearer than yaw = 0"
        axes.axvspan(minute - half, minute + half, color=style.PALE, alpha=0.7, linewidth=0, label=label)
    ends = record.mean_minutes[record.near_node] + half * np.array([[-1.0], [1.0]])
    labels = ["near the equator"] + [""] * (ends.shape[1] - 1)
    bar: dict[str, Any] = {"color": style.GREY, "linewidth": 5, "solid_capstyle": "butt"}
    axes.plot(ends, np.ones_like(ends), transform=axes.get_xaxis_transform(), label=labels, **bar)
    _dashed(axes, record)
    _dotted(axes, record)
    axes.legend(loc="lower left", frameon=True)
    style.label(axes, x="time from the start of the orbit [min]", y="yaw [deg]", title=title)
    axes.set_xlim(record.minutes[0], record.minutes[-1])
    _zero(axes)
    return figure


def draw_full(record: YawComparison, *, title: str) -> Figure:
    """Figure 2: single solutions as broken lines with X and Y at the bit changes, in three panels.

    What lies beyond a panel is marked by triangles at its edge.
    """
    figure, grid = style.figure(7.2, 2.9 * 3, rows=3)
    all_axes = [row[0] for row in grid]
    edges = np.linspace(record.minutes[0], record.minutes[-1], 4)
    shown = np.concatenate([record.magnetometer_deg, record.sun_deg[np.isfinite(record.sun_deg)]])
    low, high = np.percentile(shown, [2.0, 98.0])
    pad = 0.2 * (high - low)
    for number, axes in enumerate(all_axes):
        inside = (record.minutes >= edges[number]) & (record.minutes <= edges[number + 1])
        _dashed(axes, record)
        _broken(axes, record, inside)
        _dotted(axes, record)
        style.label(axes, y="yaw [deg]")
        axes.set(xlim=(edges[number], edges[number + 1]), ylim=(low - pad, high + pad))
        axes.text(0.01, 0.95, f"{number + 1} of 3", transform=axes.transAxes, va="top", fontsize=8)
        means = (record.mean_minutes >= edges[number]) & (record.mean_minutes <= edges[number + 1])
        style.mark_beyond(axes, record.minutes[inside], record.magnetometer_deg[inside], colour=style.BLUE, size=4.0)
        style.mark_beyond(axes, record.mean_minutes[means], record.mean_deg[means], colour=style.VERMILION, size=8.0)
        _zero(axes)
    style.heading(figure, title)
    style.legend_below(figure, all_axes[0])
    all_axes[-1].set_xlabel("time from the start of the orbit [min]; triangles at an edge: beyond the panel")
    return figure


def draw_pass(record: YawComparison, error_bar_deg: float, *, title: str) -> Figure:
    """A single pass: sun sensor dashed, each magnetometer sample, the averages dotted, and one error bar."""
    figure, ((axes,),) = style.figure(7.2, 3.8)
    axes.plot(record.minutes, record.sun_deg, color="black", linestyle="--", linewidth=1.4, label="sun sensor")
    _broken(axes, record, np.ones(record.minutes.size, dtype=bool))
    _dotted(axes, record)
    middle = record.mean_minutes.size // 2
    at, words = (record.mean_minutes[middle], record.mean_deg[middle]), f"error bar, {error_bar_deg:.2f} deg"
    axes.errorbar(*at, error_bar_deg, color=style.VERMILION, capsize=4, label=words)
    style.label(axes, x="time from rise [min]", y="yaw [deg]", title=title)
    _zero(axes)
    style.legend_below(figure, axes)
    return figure


def draw_sweep(
    amplitude_deg: FloatArray,
    shares: Mapping[str, tuple[FloatArray, FloatArray]],
    crossovers_deg: Sequence[float | None],
    *,
    title: str,
) -> Figure:
    """Share of windows in which yaw = 0 wins, against the amplitude of the true yaw.

    shares: by words, mean and standard deviation over seeds at each amplitude; crossovers_deg: of the first ones.
    """
    figure, ((axes,),) = style.figure(7.2, 4.0)
    colours = (style.BLUE, style.GREEN, style.VERMILION)
    for (label, (share, spread)), colour in zip(shares.items(), colours, strict=True):
        axes.errorbar(amplitude_deg, 100 * share, 100 * spread, color=colour, marker="o", capsize=3, label=label)
    axes.axhline(50.0, color="black", linewidth=0.8)
    for crossover, colour in zip(crossovers_deg, colours, strict=False):
        if crossover is not None:
            axes.axvline(crossover, color=colour, linestyle=":")
            axes.text(crossover, 3.0, f" {crossover:.2f} deg", color=colour)
    x, y = "amplitude of the true yaw, sqrt 2 times its rms [deg]", "windows in which yaw = 0 is better [%]"
    style.label(axes, x=x, y=y, title=title)
    axes.set(ylim=(0, 100))
    axes.legend()
    return figure


def draw_sigma(
    latitude_deg: FloatArray,
    sigma_deg: FloatArray,
    worst_orbit_deg: FloatArray,
    worst_base_deg: FloatArray,
    printed_deg: float,
    *,
    title: str,
) -> Figure:
    """Yaw sigma along an orbit, and the distribution of the worst value with the printed one in it.

    worst_orbit_deg, worst_base_deg: largest values of single orbits, and of data bases of four.
    """
    figure, ((along, worst),) = style.figure(7.2, 3.6, cols=2)
    along.semilogy(latitude_deg, sigma_deg, color=style.BLUE)
    along.axhline(printed_deg, color="black", linestyle="--", linewidth=0.8)
    above: dict[str, Any] = {"textcoords": "offset points", "ha": "center", "fontsize": 8}
    along.annotate("printed", (0.5, printed_deg), (0, 3), xycoords=("axes fraction", "data"), **above)
    style.label(along, x="geocentric latitude [deg]", y="sigma of yaw, equation 14 [deg]", title="one orbit")
    pairs = ((worst_orbit_deg, "one orbit", style.BLUE), (worst_base_deg, "four orbits", style.VERMILION))
    for values, label, colour in pairs:
        ordered = np.sort(values)
        worst.plot(ordered, 100 * np.arange(1, ordered.size + 1) / ordered.size, color=colour, label=label)
    worst.axvline(printed_deg, color="black", linestyle="--", linewidth=0.8, label="printed")
    style.label(worst, x="largest sigma of yaw [deg]", y="share of cases [%]", title="worst value")
    worst.set(xscale="log")
    style.log_ruler(along.yaxis)
    style.log_ruler(worst.xaxis)
    worst.legend()
    style.heading(figure, title)
    return figure


def _broken(axes: Axes, record: YawComparison, inside: BoolArray) -> None:
    """Single solutions, the line broken before a bit change, with the letter of the axis on the first sample after it."""
    rows = np.flatnonzero(inside)
    breaks = np.flatnonzero((record.change_x | record.change_y)[rows])
    line = (np.insert(values[rows], breaks, np.nan) for values in (record.minutes, record.magnetometer_deg))
    axes.plot(*line, color=style.BLUE, linewidth=0.9, label="magnetometer, each sample")
    for flags, letter, colour in ((record.change_x, "X", style.GREEN), (record.change_y, "Y", style.VERMILION)):
        rows = np.flatnonzero(inside & flags)
        look: dict[str, Any] = {"marker": f"${letter}$", "s": 16, "linewidths": 0.2, "color": colour, "zorder": 3}
        axes.scatter(record.minutes[rows], record.magnetometer_deg[rows], label=f"{letter} bit change", **look)


def _dashed(axes: Axes, record: YawComparison) -> None:
    label = f"sun sensor, {record.window_s:.0f} s means"
    axes.plot(record.mean_minutes, record.mean_sun_deg, color="black", linestyle="--", linewidth=1.4, label=label)


def _dotted(axes: Axes, record: YawComparison) -> None:
    look: dict[str, Any] = {"color": style.VERMILION, "linestyle": ":", "linewidth": 1.8}
    axes.plot(record.mean_minutes, record.mean_deg, label=f"magnetometer, {record.window_s:.0f} s means", **look)


def _zero(axes: Axes) -> None:
    axes.axhline(0.0, color="grey", linewidth=0.8)
    beside: dict[str, Any] = {"ha": "left", "va": "center", "annotation_clip": False, "fontsize": 8, "color": "grey"}
    axes.annotate(" yaw = 0", xy=(1.0, 0.0), xycoords=("axes fraction", "data"), **beside)
