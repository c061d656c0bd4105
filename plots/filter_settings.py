"""Attitude error over two settings of a filter, before and after calibration, with a published value as a line."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from matplotlib.figure import Figure

from fluxtwin.plots import style
from fluxtwin.sim.base.types import FloatArray

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
