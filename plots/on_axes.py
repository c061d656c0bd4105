"""One picture a result, drawn into axes of the caller's: for notebooks, where figures are arranged by hand."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes

from fluxtwin.plots import style
from fluxtwin.sim.base.types import FloatArray, TimeArray

_MOST = 20_000  # points of a series that can be distinguished


def components(
    axes: Axes,
    time: TimeArray,
    value: FloatArray,
    *,
    y: str,
    title: str,
    aside: np.ndarray | None = None,
    names: Sequence[str] = ("|B|",),
) -> Axes:
    """Components (N, 3), or what has names, against time in UTC; rows `aside` as grey crosses."""
    every = max(1, len(time) // _MOST)
    stamps = time[::every]
    chosen = value[::every]
    set_aside = np.zeros(len(chosen), dtype=bool) if aside is None else aside[::every]
    for k, name in enumerate(names if value.shape[1] == len(names) else "xyz"):
        colour = style.AXIS_COLOURS[k]
        axes.plot(stamps[~set_aside], chosen[~set_aside, k], ".", markersize=3, color=colour, label=name)
        axes.plot(stamps[set_aside], chosen[set_aside, k], "x", markersize=3, color=style.GREY)
    style.utc(axes, time)
    style.label(axes, y=y, title=title)
    style.legend(axes)
    return axes


def shares(axes: Axes, named: Sequence[tuple[str, float]], *, title: str) -> Axes:
    """Bars of shares in %, the first on top."""
    places = np.arange(len(named))
    axes.barh(places, [100.0 * share for _, share in named], height=0.7, color=style.BLUE)
    axes.set_yticks(places, [name for name, _ in named])
    axes.set_xlim(0, 100)
    axes.invert_yaxis()
    style.label(axes, x="probability [%]", title=title)
    return axes
