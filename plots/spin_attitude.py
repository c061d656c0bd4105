"""The error of an attitude estimate: along the time about the three body axes, and over two settings of a filter."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from fluxtwin.plots import style
from fluxtwin.sim.base.types import FloatArray

_FRAME_PERCENT = 99.0
_OUTSTANDING = 2.0
_ROOM = 1.1


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


_MARKERS = ("o", "s", "^", "D")


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
