"""Figures of spinners: a sensor that follows sun and shadow; the error of an attitude estimate, and over two settings."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from fluxtwin.plots import style
from fluxtwin.sim.base.types import FloatArray

_FRAME_PERCENT = 99.0
_OUTSTANDING = 2.0
_ROOM = 1.1
_MARKERS = ("o", "s", "^", "D")


def response_figure(
    numbers: Sequence[int],
    since_shadow_s: Sequence[FloatArray],
    responses: Sequence[NDArray[np.complex128]],
    lights: Sequence[str],
    shadow_s: float,
) -> Figure:
    """Responses of channels X and Y to the field across the spin axis against the time since the shadow was entered.

    By zone: its number, seconds (M,), responses of the channels (M, 3), and its light. The shadow itself is tinted.
    """
    made, grid = style.figure(style.FULL_WIDTH_IN, 3.4, 1, 2)
    for channel, axes in enumerate(grid[0]):
        name = f"channel {'XY'[channel]}"
        axes.axvspan(0.0, shadow_s / 60.0, color=style.PALE, alpha=0.6, zorder=0, linewidth=0.0)
        for place, (number, seconds, response) in enumerate(zip(numbers, since_shadow_s, responses, strict=True)):
            look: dict[str, Any] = {
                "color": style.CYCLE[place % len(style.CYCLE)],
                "linestyle": "--" if lights[place] == "sunlit" else "-",
            }
            axes.plot(seconds / 60.0, np.abs(response[:, channel]), label=f"zone {number}", linewidth=1.3, **look)
        style.label(axes, x="time since the shadow was entered [min]", y=f"response of {name} [nT/nT]", title=name)
        axes.set_xlim(left=0.0)
    style.legend(grid[0][-1], "upper right", columns=2)
    return made


def zones_figure(
    numbers: Sequence[int], unseen_nT: Mapping[str, Sequence[float]], own_nT: Mapping[str, Sequence[float]]
) -> Figure:
    """rms of each zone, unseen by models and of its own, one mark a series, on a logarithmic scale."""
    series_nT = {**{f"unseen: {name}": rms_nT for name, rms_nT in unseen_nT.items()}, **own_nT}
    made, grid = style.figure(style.FULL_WIDTH_IN, 3.6)
    axes = grid[0][0]
    for number, (label, rms_nT) in enumerate(series_nT.items()):
        look: dict[str, Any] = {"marker": "osD^vP*"[number % 7], "color": style.CYCLE[number % len(style.CYCLE)]}
        axes.plot(numbers, rms_nT, label=label, linestyle=":", linewidth=0.8, markersize=5.0, **look)
    axes.set_yscale("log")
    style.log_ruler(axes.yaxis)
    axes.set_xticks(list(numbers))
    every = [value for rms_nT in series_nT.values() for value in rms_nT]
    axes.set_ylim(0.6 * min(every), 12.0 * max(every))
    style.label(axes, x="zone", y="rms of the residual vector [nT]")
    style.legend(axes, "upper left", columns=2)
    return made


def residuals_figure(shown: Mapping[int, Sequence[FloatArray]]) -> Figure:
    """Residuals of unseen zones, static sensor left, best one right.

    shown: by number of the zone, minutes (N,) and residual (N, 3) in sensor axes [nT] of the one, then of the other.
    """
    made, grid = style.figure(style.FULL_WIDTH_IN, 2.4 * len(shown) + 0.4, len(shown), 2, share_x=True, share_y=True)
    for row, (number, (minutes, before_nT, minutes_after, after_nT)) in zip(grid, shown.items(), strict=True):
        pairs = ((minutes, before_nT, "static"), (minutes_after, after_nT, "follows sun and shadow"))
        for axes, (time, value, name) in zip(row, pairs, strict=True):
            for axis, colour in enumerate(style.AXIS_COLOURS):
                axes.plot(time, value[:, axis], ".", color=colour, markersize=2.5, label="XYZ"[axis])
            style.zero_line(axes)
            style.label(axes, title=f"zone {number}: {name}")
        style.label(row[0], y="reading - model [nT]")
        bound = float(np.abs(before_nT).max())
        row[0].set_ylim(-1.05 * bound, 1.05 * bound)
    for axes in grid[-1]:
        style.label(axes, x="minutes of the zone")
    style.legend(grid[0][1], "upper right", columns=3)
    return made


def draw_attitude_error(start: np.datetime64, seconds_s: FloatArray, error_deg: FloatArray, *, title: str) -> Figure:
    """A panel for each axis, because X and Y of a spinner swing alike and one would hide the other; every sample is drawn.

    seconds_s: (N,) from `start`, UTC; error_deg: (N, 3) about body x, y, z.

    The three have one scale. Where a few samples (the first seconds of a filter) would flatten the rest they are left out
    of it, an arrow marks the edge where they are, and the panel's title says how far they go.
    """
    figure, grid = style.figure(7.2, 5.2, rows=3, share_x=True)
    rms_deg = np.sqrt((error_deg**2).mean(axis=0))
    style.heading(figure, f"{title}; RSS {np.linalg.norm(rms_deg):.3g} deg")
    size = np.abs(error_deg)
    usual, largest = float(np.percentile(size, _FRAME_PERCENT, axis=0).max()), float(size.max())
    edge = _ROOM * (largest if largest < _OUTSTANDING * usual else usual)
    minutes = seconds_s / 60.0
    for k, (axes,) in enumerate(grid):
        error = error_deg[:, k]
        style.zero_line(axes)
        axes.plot(minutes, error, linewidth=0.4, color=style.AXIS_COLOURS[k], rasterized=True)
        axes.set_ylim(-edge, edge)
        words = f"{'XYZ'[k]}: rms {rms_deg[k]:.3g} deg{_beyond(axes, minutes, error, edge)}"
        style.label(axes, y="error [deg]", title=words)
    since = np.datetime_as_string(start, unit="s").replace("T", " ")
    style.label(grid[-1][0], x=f"time after {since} UTC [min]")
    return figure


def _beyond(axes: Axes, minutes: FloatArray, error: FloatArray, edge: float) -> str:
    """An arrow on each side that is left, where the error goes furthest; and what to say of it."""
    said = ""
    for side, arrow in ((1.0, "^"), (-1.0, "v")):
        furthest = int(np.argmax(side * error))
        if side * error[furthest] > edge:
            axes.plot(minutes[furthest], 0.9 * side * edge, arrow, color=style.BLACK, markersize=6)
            said += f", {error[furthest]:+.2g} deg at {minutes[furthest]:.1f} min"
    return f"; beyond the frame{said[1:]}" if said else ""


def draw_settings(
    panels: Mapping[str, tuple[FloatArray, float]],
    marks: Mapping[str, tuple[float, float]],
    walks_rad_s: Sequence[float],
    factors: Sequence[float],
    *,
    title: str,
) -> Figure:
    """A panel for each quantity: contours labelled in deg, the printed value a heavy line, each pair a marker.

    panels: by words, RSS (W, F) and its printed value [deg]; marks: by words, a walk and a factor. walks_rad_s: (W,) and
    factors: (F,), both ascending; the axes are logarithmic.
    """
    figure, grid = style.figure(7.2, 3.6, cols=len(panels))
    style.heading(figure, title)
    for axes, (words, (rss_deg, printed_deg)) in zip(grid[0], panels.items(), strict=True):
        levels = [float(f"{ratio * printed_deg:.2g}") for ratio in (0.5, 0.7, 0.85, 1.2, 1.5, 2.0, 4.0)]
        thin = axes.contour(walks_rad_s, factors, rss_deg.T, levels=levels, colors=style.GREY, linewidths=0.8)
        axes.clabel(thin, fontsize=style.TICK_PT, fmt="%.3g")
        axes.contour(walks_rad_s, factors, rss_deg.T, levels=[printed_deg], colors=style.PAPER, linewidths=2.2)
        axes.plot([], [], color=style.PAPER, linewidth=2.2, label="as printed")
        for (name, at), marker in zip(marks.items(), _MARKERS, strict=False):
            look: dict[str, Any] = {"markersize": 7, "color": style.BLUE, "markeredgecolor": "white"}
            axes.plot(*at, marker, label=name, **look)
        axes.set_xscale("log")
        axes.set_yscale("log")
        style.log_ruler(axes.yaxis)
        style.label(axes, x="random walk of L/Jt in 1 s [rad/s]", y="sun noise taken over true [1]")
        style.label(axes, title=f"{words}: RSS [deg], printed {printed_deg:g}")
    style.legend(grid[0][-1], "upper right")
    return figure
