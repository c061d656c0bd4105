"""Figures of a spinner whose sensor follows sun and shadow."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from fluxtwin.plots import style
from fluxtwin.sim.base.types import FloatArray


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
