"""Figures of a record: what its residual follows, and which directions the field has had."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke

from fluxtwin.plots import style
from fluxtwin.plots.gap import alike_in
from fluxtwin.plots.time_series import extremes
from fluxtwin.sim.base.types import FloatArray, IntArray

_MOST = 6  # panels rows: those that the residual follows most
_DOTS = 2000  # of a panel


def draw_drivers(columns: Mapping[str, FloatArray], residuals: Mapping[str, FloatArray]) -> Figure | None:
    """A row of panels a quantity, a panel an axis: samples, and means of groups of like values with their 1 sigma.

    columns: (N,) by name with unit; residuals: (N, K) [nT] by what they are called, at most two. The quantities are in the
    order of the share of the first residual's variance that the groups explain. None where nothing varies.
    """
    first = next(iter(residuals.values()))
    shares = {name: _share(column, first) for name, column in columns.items()}
    names = sorted((name for name, share in shares.items() if share >= 0), key=lambda name: -shares[name])[:_MOST]
    if not names:
        return None
    axes_count = first.shape[1]
    figure, grid = style.figure(7.2, 0.8 + 1.7 * len(names), rows=len(names), cols=axes_count)
    # Colours of the dots, and of the means.
    looks = [(style.ORANGE, style.VERMILION), (style.SKY, style.BLUE)][-len(residuals) :]
    for panels, name in zip(grid, names, strict=True):
        for number, axes in enumerate(panels):
            for (words, residual), (pale, strong) in zip(residuals.items(), looks, strict=True):
                known = np.isfinite(columns[name]) & np.isfinite(residual[:, number])
                x, y = columns[name][known], residual[known, number]
                few = extremes(np.column_stack([x, y]), _DOTS)
                axes.plot(x[few], y[few], ".", color=pale, markersize=1.5, alpha=0.4, zorder=1)
                groups = alike_in(x)
                middle = [(x[part].mean(), y[part].mean(), y[part].std() / part.size**0.5) for part in groups]
                look: dict[str, Any] = {"fmt": "o", "markersize": 3.5, "capsize": 2, "elinewidth": 1.0, "color": strong}
                axes.errorbar(*np.transpose(middle), label=f"{words}, means", **look)
            style.zero_line(axes)
            style.label(axes, x=name, y="residual [nT]" if number == 0 else None)
            if panels is grid[0]:
                style.label(axes, title="xyz"[number] if axes_count == 3 else "|B|")
    style.legend_below(figure, grid[0][0])
    style.heading(figure, "The residual against what it may follow")
    return figure


def _share(column: FloatArray, residual: FloatArray) -> float:
    """Of the residual's variance that the groups explain; -1 for a column that does not vary."""
    known = np.isfinite(column) & np.isfinite(residual).all(axis=1)
    x, y = column[known], residual[known]
    if x.size < 2 or not np.ptp(x) > 0.0:
        return -1.0
    explained = sum(part.size * ((y[part].mean(axis=0) - y.mean(axis=0)) ** 2).sum() for part in alike_in(x))
    return float(explained / max(((y - y.mean(axis=0)) ** 2).sum(), 1e-300))


def draw_field_coverage(directions_B: FloatArray, counts: IntArray) -> Figure:
    """Dots as wide as the areas, in an equal-area map: longitude from body x to y, latitude to z. Open dots had no row.

    directions_B: (K, 3) middles of equal areas, unit vectors; counts: (K,) rows in each.
    """
    figure = style.figure(7.2, 3.9)[0]
    figure.clf()
    axes = figure.add_subplot(projection="mollweide")
    style.heading(figure, "Directions of the field in the body")
    x, y, z = directions_B.T
    longitude, latitude = np.arctan2(y, x), np.arcsin(np.clip(z, -1.0, 1.0))
    seen = counts > 0
    axes.scatter(longitude[~seen], latitude[~seen], s=110, facecolors="none", edgecolors=style.GREY, linewidths=0.8)
    dots = axes.scatter(longitude[seen], latitude[seen], s=110, c=np.log10(counts[seen]), cmap="viridis", vmin=0.0)
    quarter = np.pi / 2
    sides = {"+x": (0.0, 0.0), "+y": (quarter, 0.0), "-y": (-quarter, 0.0), "+z": (0.0, 1.45), "-z": (0.0, -1.45)}
    sides |= {"-x": (0.95 * np.pi, 0.0)}
    rim = [withStroke(linewidth=2.5, foreground="white")]  # readable on a dot of any colour
    for name, place in sides.items():
        axes.annotate(
            name, place, ha="center", va="center", fontsize=9, weight="bold", color=style.BLACK, path_effects=rim
        )
    axes.set_xticklabels([])
    axes.set_yticklabels([])
    axes.set_axisbelow(True)
    axes.grid(alpha=0.3)
    bar = figure.colorbar(dots, ax=axes, shrink=0.7, ticks=range(int(np.log10(max(counts.max(), 1))) + 1))
    bar.ax.set_yticklabels([f"{10 ** int(tick)}" for tick in bar.get_ticks()])
    bar.set_label("rows")
    return figure
