"""The sky of the body: which directions the field has had."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke

from fluxtwin.plots import style
from fluxtwin.sim.base.types import FloatArray, IntArray


@dataclass(frozen=True)
class FieldCoverage:
    """Equal areas of directions in body axes."""

    directions_B: FloatArray
    """(K, 3) their middles, unit vectors."""
    counts: IntArray
    """(K,) rows in each."""


def draw_field_coverage(record: FieldCoverage, *, title: str) -> Figure:
    """Dots as wide as the areas, in an equal-area map: longitude from body x to y, latitude to z. Open dots had no row."""
    figure = style.figure(7.2, 3.9)[0]
    figure.clf()
    axes = figure.add_subplot(projection="mollweide")
    style.heading(figure, title)
    x, y, z = record.directions_B.T
    longitude, latitude = np.arctan2(y, x), np.arcsin(np.clip(z, -1.0, 1.0))
    seen = record.counts > 0
    axes.scatter(longitude[~seen], latitude[~seen], s=110, facecolors="none", edgecolors=style.GREY, linewidths=0.8)
    dots = axes.scatter(
        longitude[seen], latitude[seen], s=110, c=np.log10(record.counts[seen]), cmap="viridis", vmin=0.0
    )
    quarter = np.pi / 2
    sides = {"+x": (0.0, 0.0), "+y": (quarter, 0.0), "-y": (-quarter, 0.0), "+z": (0.0, 1.45), "-z": (0.0, -1.45)}
    rim = [withStroke(linewidth=2.5, foreground="white")]  # readable on a dot of any colour
    for name, place in sides.items():
        axes.annotate(
            name, place, ha="center", va="center", fontsize=9, weight="bold", color=style.BLACK, path_effects=rim
        )
    axes.set_xticklabels([])
    axes.set_yticklabels([])
    axes.grid(alpha=0.3)
    bar = figure.colorbar(dots, ax=axes, shrink=0.7, ticks=range(int(np.log10(max(record.counts.max(), 1))) + 1))
    bar.ax.set_yticklabels([f"{10 ** int(tick)}" for tick in bar.get_ticks()])
    bar.set_label("rows")
    return figure
