"""Attitude error over two settings of a filter, before and after calibration, with a published value as a line."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from fluxtwin.plots import style
from fluxtwin.sim.base.types import FloatArray

_MARKERS = ("o", "s", "^", "D")


@dataclass(frozen=True)
class SettingsPanel:
    """One quantity over W walks and F sun factors."""

    words: str
    rss_deg: FloatArray
    """(W, F)."""
    printed_deg: float


@dataclass(frozen=True)
class Mark:
    """One pair of settings."""

    words: str
    walk_rad_s: float
    sun_factor: float


def draw_settings(
    panels: Sequence[SettingsPanel], marks: Sequence[Mark], *, walks_rad_s: FloatArray, factors: FloatArray, title: str
) -> Figure:
    """A panel for each quantity: contours labelled in deg, the printed value a heavy line, each pair a marker.

    walks_rad_s: (W,) and factors: (F,), both ascending; the axes are logarithmic.
    """
    figure, grid = style.figure(7.2, 3.6, cols=len(panels))
    style.heading(figure, title)
    for axes, panel in zip(grid[0], panels, strict=True):
        _panel(axes, panel, marks, walks_rad_s, factors)
    style.legend(grid[0][-1], "upper right")
    return figure


def _panel(
    axes: Axes, panel: SettingsPanel, marks: Sequence[Mark], walks_rad_s: FloatArray, factors: FloatArray
) -> None:
    values = panel.rss_deg.T
    levels = [float(f"{ratio * panel.printed_deg:.2g}") for ratio in (0.5, 0.7, 0.85, 1.2, 1.5, 2.0, 4.0)]
    thin = axes.contour(walks_rad_s, factors, values, levels=levels, colors=style.GREY, linewidths=0.8)
    axes.clabel(thin, fontsize=style.TICK_PT, fmt="%.3g")
    axes.contour(walks_rad_s, factors, values, levels=[panel.printed_deg], colors=style.PAPER, linewidths=2.2)
    axes.plot([], [], color=style.PAPER, linewidth=2.2, label="as printed")
    for mark, marker in zip(marks, _MARKERS, strict=False):
        axes.plot(
            mark.walk_rad_s,
            mark.sun_factor,
            marker,
            markersize=7,
            color=style.BLUE,
            markeredgecolor="white",
            label=mark.words,
        )
    axes.set_xscale("log")
    axes.set_yscale("log")
    style.log_ruler(axes.yaxis)
    style.label(
        axes,
        x="random walk of L/Jt in 1 s [rad/s]",
        y="sun noise taken over true [1]",
        title=f"{panel.words}: RSS [deg], printed {panel.printed_deg:g}",
    )
