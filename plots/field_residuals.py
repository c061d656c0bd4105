"""Measured minus model field along an orbit: maps of the components, and series against time and latitude."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from fluxtwin.plots import style
from fluxtwin.sim.base.types import FloatArray, TimeArray

PANELS = ("north", "east", "centre", "magnitude")
"""Components of a residual in the order in which they are drawn: geocentric, centre is down."""


@dataclass(frozen=True)
class ResidualTrack:
    """Measured minus model along an orbit of N samples."""

    label: str
    """What was subtracted."""
    time: TimeArray
    latitude_deg: FloatArray
    longitude_deg: FloatArray
    residual_NEC_nT: FloatArray
    """(N, 3) geocentric north, east, centre."""
    residual_F_nT: FloatArray
    """(N,) difference of the magnitudes."""

    def panel(self, number: int) -> FloatArray:
        """(N,) residual of `PANELS[number]` [nT]."""
        return self.residual_F_nT if number == 3 else self.residual_NEC_nT[:, number]


def residual_map(track: ResidualTrack, title: str, low_latitude_deg: float) -> Figure:
    """Four maps, north, east, centre and magnitude, each with a colour scale centred on zero.

    The scale of a panel ends at the 98th percentile of its sizes; beyond it the colour stays (the arrows on the
    scale say so). Dashed lines mark `low_latitude_deg`.
    """
    figure, grid = style.figure(style.FULL_WIDTH_IN, 5.4, 2, 2)
    style.heading(figure, title)
    for number, name in enumerate(PANELS):
        axes = grid[number // 2][number % 2]
        value = track.panel(number)
        limit = _round_up(float(np.percentile(np.abs(value), 98.0)))
        # the largest last, so that a spike is not hidden under its quiet neighbours
        order = np.argsort(np.abs(value), kind="stable")
        # a dark rim, so that a residual near zero is seen too
        axes.scatter(track.longitude_deg, track.latitude_deg, s=17.0, color=style.GREY, linewidths=0.0)
        place = (track.longitude_deg[order], track.latitude_deg[order])
        scale: dict[str, Any] = {"cmap": style.SIGNED_MAP, "vmin": -limit, "vmax": limit}
        points = axes.scatter(*place, c=value[order], s=7.0, linewidths=0.0, **scale)
        bar = figure.colorbar(points, ax=axes, extend="both", pad=0.02, shrink=0.9)
        bar.ax.tick_params(labelsize=style.TICK_PT)
        bar.set_label("[nT]", fontsize=style.LABEL_PT)
        for edge in (-low_latitude_deg, low_latitude_deg):
            axes.axhline(edge, color=style.GREY, linewidth=0.8, linestyle="--", zorder=0.9)
        axes.set_xlim(-180, 180)
        axes.set_ylim(-90, 90)
        axes.set_xticks([-180, -90, 0, 90, 180])
        axes.set_yticks([-90, -45, 0, 45, 90])
        style.coast(axes)
        x, y = "longitude [deg]" if number >= 2 else None, None if number % 2 else "latitude [deg]"
        style.label(axes, x=x, y=y, title=f"{name} residual")
    return figure


def residual_series(tracks: Sequence[ResidualTrack], title: str, low_latitude_deg: float) -> Figure:
    """Each component against time (left) and latitude (right), one line for each model subtracted.

    The band of low latitude is tinted on the right.
    """
    figure, grid = style.figure(style.FULL_WIDTH_IN, 7.6, 4, 2, share_x=True, share_y=True)
    style.heading(figure, title)
    for number, name in enumerate(PANELS):
        left, right = grid[number]
        for place, track in enumerate(tracks):
            look = _look(place, len(tracks))
            stamps, values = style.broken(track.time, track.panel(number))
            left.plot(stamps, values, label=track.label, **look)
            right.plot(style.broken(track.time, track.latitude_deg)[1], values, **look)
        style.label(left, y=f"{name} [nT]")
        right.axvspan(-low_latitude_deg, low_latitude_deg, color=style.PALE, alpha=0.45, linewidth=0.0, zorder=0.2)
        for axes in (left, right):
            style.zero_line(axes)
    style.utc(grid[3][0], tracks[0].time)
    style.label(grid[3][1], x="geodetic latitude [deg]")
    reach = np.concatenate([track.latitude_deg for track in tracks])
    grid[3][1].set_xlim(max(float(reach.min()) - 4.0, -90.0), min(float(reach.max()) + 4.0, 90.0))
    grid[3][1].xaxis.set_major_locator(MaxNLocator(nbins=6, steps=[1, 2, 3, 6, 10], prune="both"))
    style.legend_below(figure, grid[0][0], columns=len(tracks), frame=False)
    return figure


def _look(place: int, count: int) -> dict[str, Any]:
    """The last series is the best model and stands out; the first, the plainest one, is thin and black."""
    if place == 0 and count > 1:
        return {"color": style.BLACK, "linewidth": 0.8}
    if place == count - 1:
        return {"color": style.BLUE, "linewidth": 1.6, "alpha": 0.85}
    return {"color": style.ORANGE, "linewidth": 1.6, "linestyle": (0, (4, 2))}


def _round_up(value: float) -> float:
    """The next of 1, 1.5, 2, 3, 4, 5, 6, 8 times a power of ten."""
    if value <= 0.0:
        return 1.0
    power = 10.0 ** np.floor(np.log10(value))
    return float(next((m * power for m in (1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 6.0, 8.0) if m * power >= value), 10 * power))
