"""Yaw from the magnetometer beside yaw from the sun sensor, drawn as in Lerner & Shuster's figures 1 and 2."""

from __future__ import annotations

from dataclasses import dataclass

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


@dataclass(frozen=True)
class YawSweep:
    """How often yaw = 0 is the better estimate, by the amplitude of the true yaw."""

    amplitude_deg: FloatArray
    share_full: FloatArray
    """Share of windows in which yaw = 0 beats the full calibration; mean over seeds."""
    spread_full: FloatArray
    """Standard deviation of that share over seeds."""
    share_bias_only: FloatArray
    spread_bias_only: FloatArray
    share_white: FloatArray
    """As `share_full`, had the unexplained part of the residual been white noise."""
    spread_white: FloatArray
    crossover_deg: float | None
    """Amplitude at which the full calibration begins to win half of the windows; None outside the sweep."""
    crossover_white_deg: float | None
    seeds_won: FloatArray
    """Share of the seeds for which yaw = 0 beats the full calibration in most windows, slow unknown."""


@dataclass(frozen=True)
class YawSigma:
    """Expected yaw error along one orbit and the worst value of many."""

    latitude_deg: FloatArray
    sigma_deg: FloatArray
    """(N,) along one orbit, same length as latitude."""
    worst_orbit_deg: FloatArray
    """Largest value of each of many single orbits."""
    worst_base_deg: FloatArray
    """Largest value of each of many data bases of four orbits."""
    printed_deg: float


def draw_mean_bias(record: YawComparison, *, title: str) -> Figure:
    """Figure 1: averages of the sun sensor dashed, of the magnetometer dotted, and the trivial solution yaw = 0.

    Shaded: the windows in which yaw = 0 is the worse estimate; bars above: near the nodes.
    """
    figure, ((axes,),) = style.figure(7.2, 4.0)
    half = record.window_s / 120.0
    for number, minute in enumerate(record.mean_minutes[record.nearer]):
        axes.axvspan(
            minute - half,
            minute + half,
            color=style.PALE,
            alpha=0.7,
            linewidth=0,
            label=None if number else "magnetometer nearer than yaw = 0",
        )
    ends = record.mean_minutes[record.near_node] + half * np.array([[-1.0], [1.0]])
    axes.plot(
        ends,
        np.ones_like(ends),
        color=style.GREY,
        linewidth=5,
        solid_capstyle="butt",
        transform=axes.get_xaxis_transform(),
        label=["near the equator"] + [""] * (ends.shape[1] - 1),
    )
    _dashed(axes, record)
    _dotted(axes, record)
    axes.legend(loc="lower left", frameon=True)
    axes.set(title=title, xlabel="time from the start of the orbit [min]", ylabel="yaw [deg]")
    axes.set_xlim(record.minutes[0], record.minutes[-1])
    _zero(axes)
    return figure


def draw_full(record: YawComparison, *, title: str, panels: int = 3) -> Figure:
    """Figure 2: single solutions as broken lines with X and Y at the bit changes, in `panels` panels.

    What lies beyond a panel is marked by triangles at its edge.
    """
    figure, grid = style.figure(7.2, 2.9 * panels, rows=panels)
    all_axes = [row[0] for row in grid]
    edges = np.linspace(record.minutes[0], record.minutes[-1], panels + 1)
    shown = np.concatenate([record.magnetometer_deg, record.sun_deg[np.isfinite(record.sun_deg)]])
    low, high = np.percentile(shown, [2.0, 98.0])
    pad = 0.2 * (high - low)
    for number, axes in enumerate(all_axes):
        inside = (record.minutes >= edges[number]) & (record.minutes <= edges[number + 1])
        _dashed(axes, record)
        _broken(axes, record, inside)
        _dotted(axes, record)
        axes.set(xlim=(edges[number], edges[number + 1]), ylim=(low - pad, high + pad), ylabel="yaw [deg]")
        axes.text(0.01, 0.95, f"{number + 1} of {panels}", transform=axes.transAxes, va="top", fontsize=8)
        means = (record.mean_minutes >= edges[number]) & (record.mean_minutes <= edges[number + 1])
        style.mark_beyond(axes, record.minutes[inside], record.magnetometer_deg[inside], colour=style.BLUE, size=4.0)
        style.mark_beyond(axes, record.mean_minutes[means], record.mean_deg[means], colour=style.VERMILION, size=8.0)
        _zero(axes)
    figure.suptitle(title)
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
    axes.errorbar(
        record.mean_minutes[middle],
        record.mean_deg[middle],
        error_bar_deg,
        color=style.VERMILION,
        capsize=4,
        label=f"error bar, {error_bar_deg:.2f} deg",
    )
    axes.set(title=title, xlabel="time from rise [min]", ylabel="yaw [deg]")
    _zero(axes)
    style.legend_below(figure, axes)
    return figure


def draw_sweep(record: YawSweep, *, title: str) -> Figure:
    """Share of windows in which yaw = 0 wins, against the amplitude of the true yaw."""
    figure, ((axes,),) = style.figure(7.2, 4.0)
    for share, spread, label, colour in (
        (record.share_full, record.spread_full, "full calibration (figure 2), slow unknown", style.BLUE),
        (record.share_white, record.spread_white, "full calibration, white unknown", style.GREEN),
        (record.share_bias_only, record.spread_bias_only, "mean bias only (figure 1)", style.VERMILION),
    ):
        axes.errorbar(record.amplitude_deg, 100 * share, 100 * spread, color=colour, marker="o", capsize=3, label=label)
    axes.axhline(50.0, color="black", linewidth=0.8)
    for crossover, colour in ((record.crossover_deg, style.BLUE), (record.crossover_white_deg, style.GREEN)):
        if crossover is not None:
            axes.axvline(crossover, color=colour, linestyle=":")
            axes.text(crossover, 3.0, f" {crossover:.2f} deg", color=colour)
    axes.set(
        title=title,
        xlabel="amplitude of the true yaw, sqrt 2 times its rms [deg]",
        ylabel="windows in which yaw = 0 is better [%]",
        ylim=(0, 100),
    )
    axes.legend()
    return figure


def draw_sigma(record: YawSigma, *, title: str) -> Figure:
    """Yaw sigma along an orbit, and the distribution of the worst value with the printed one in it."""
    figure, ((along, worst),) = style.figure(7.2, 3.6, cols=2)
    along.semilogy(record.latitude_deg, record.sigma_deg, color=style.BLUE)
    along.axhline(record.printed_deg, color="black", linestyle="--", linewidth=0.8)
    along.annotate(
        "printed",
        (0.5, record.printed_deg),
        (0, 3),
        xycoords=("axes fraction", "data"),
        fontsize=8,
        textcoords="offset points",
        ha="center",
    )
    along.set(xlabel="geocentric latitude [deg]", ylabel="sigma of yaw, equation 14 [deg]", title="one orbit")
    for values, label, colour in (
        (record.worst_orbit_deg, "one orbit", style.BLUE),
        (record.worst_base_deg, "four orbits", style.VERMILION),
    ):
        ordered = np.sort(values)
        worst.plot(ordered, 100 * np.arange(1, ordered.size + 1) / ordered.size, color=colour, label=label)
    worst.axvline(record.printed_deg, color="black", linestyle="--", linewidth=0.8, label="printed")
    worst.set(xscale="log", xlabel="largest sigma of yaw [deg]", ylabel="share of cases [%]", title="worst value")
    style.log_ruler(along.yaxis)
    style.log_ruler(worst.xaxis)
    worst.legend()
    figure.suptitle(title)
    return figure


def _broken(axes: Axes, record: YawComparison, inside: BoolArray) -> None:
    """Single solutions, the line broken before a bit change, with the letter of the axis on the first sample after it."""
    rows = np.flatnonzero(inside)
    breaks = np.flatnonzero((record.change_x | record.change_y)[rows])
    axes.plot(
        np.insert(record.minutes[rows], breaks, np.nan),
        np.insert(record.magnetometer_deg[rows], breaks, np.nan),
        color=style.BLUE,
        linewidth=0.9,
        label="magnetometer, each sample",
    )
    for flags, letter, colour in ((record.change_x, "X", style.GREEN), (record.change_y, "Y", style.VERMILION)):
        rows = np.flatnonzero(inside & flags)
        axes.scatter(
            record.minutes[rows],
            record.magnetometer_deg[rows],
            marker=f"${letter}$",
            s=16,
            linewidths=0.2,
            color=colour,
            label=f"{letter} bit change",
            zorder=3,
        )


def _dashed(axes: Axes, record: YawComparison) -> None:
    axes.plot(
        record.mean_minutes,
        record.mean_sun_deg,
        color="black",
        linestyle="--",
        linewidth=1.4,
        label=f"sun sensor, {record.window_s:.0f} s means",
    )


def _dotted(axes: Axes, record: YawComparison) -> None:
    axes.plot(
        record.mean_minutes,
        record.mean_deg,
        color=style.VERMILION,
        linestyle=":",
        linewidth=1.8,
        label=f"magnetometer, {record.window_s:.0f} s means",
    )


def _zero(axes: Axes) -> None:
    axes.axhline(0.0, color="grey", linewidth=0.8)
    axes.annotate(
        " yaw = 0",
        xy=(1.0, 0.0),
        xycoords=("axes fraction", "data"),
        fontsize=8,
        color="grey",
        ha="left",
        va="center",
        annotation_clip=False,
    )
