"""Figures of diagnosed cases: what shows each cause, and the passes that were not used, before and after."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from fluxtwin.plots import style
from fluxtwin.sim.base.types import BoolArray, FloatArray


def draw_later(
    labels: Sequence[str],
    unit: str,
    before: FloatArray,
    after: FloatArray,
    concerned: BoolArray,
    floor: float,
    *,
    title: str,
) -> Figure:
    """A pair of points a pass; passes in which the cause acts are marked."""
    figure, ((axes,),) = style.figure(7.2, 3.0)
    at = np.arange(len(labels))
    for place in at[concerned]:
        axes.axvspan(place - 0.5, place + 0.5, color=style.PALE, alpha=0.5, linewidth=0)
    axes.vlines(at, after, before, color=style.GREY, linewidth=1)
    axes.plot(at, before, "o", color=style.ORANGE, markersize=4, label="without the cause")
    axes.plot(at, after, "s", color=style.BLUE, markersize=4, label="with it, as found")
    axes.axhline(floor, color=style.BLACK, linewidth=1, linestyle=":", label="where nothing is wrong")
    ticks = at[:: max(1, len(at) // 12)]
    axes.set_xticks(ticks, [labels[k] for k in ticks], rotation=45, ha="right", fontsize=7)
    style.label(axes, x="start of the pass [UTC]", y=f"residual, rms [{unit}]", title=title)
    axes.legend(loc="upper right", frameon=True, ncols=3, fontsize=8)
    axes.set(xlim=(-0.6, len(at) - 0.4), ylim=(0, 1.25 * max(np.nanmax(before), np.nanmax(after))))
    return figure


def draw_heads(hours: FloatArray, error_deg: FloatArray, head: np.ndarray, *, title: str) -> Figure:
    """Dots by time, one colour and marker a head."""
    figure, ((axes,),) = style.figure(7.2, 3.0)
    for number, colour, marker in ((2, style.GREY, "."), (3, style.SKY, "x"), (1, style.VERMILION, "o")):
        mine = head == number
        axes.plot(hours[mine], error_deg[mine], marker, color=colour, markersize=3, label=f"head {number}")
    axes.axhline(0.0, color=style.BLACK, linewidth=0.8)
    style.label(axes, x="hours from the first sample [h]", y="measured less computed [deg]", title=title)
    axes.set_ylim(top=1.45 * float(np.nanmax(error_deg)))
    axes.legend(loc="upper right", frameon=True, ncols=3, markerscale=2)
    return figure


def draw_night_map(
    latitude_deg: FloatArray,
    longitude_deg: FloatArray,
    residual_nT: FloatArray,
    put_in_deg: tuple[float, float, float, float],
    found_deg: tuple[float, float, float, float] | None,
    *,
    title: str,
) -> Figure:
    """Rows by night on the map, coloured by residual; the box that was put in and the one found."""
    figure, ((axes,),) = style.figure(7.2, 3.6)
    limit = float(np.nanpercentile(np.abs(residual_nT), 99))
    look: dict[str, Any] = {"cmap": style.SIGNED_MAP, "vmin": -limit, "vmax": limit}
    rim: dict[str, Any] = {"edgecolors": style.GREY, "linewidths": 0.2}
    shown = axes.scatter(longitude_deg, latitude_deg, c=residual_nT, s=7, **look, **rim)
    for box, colour, line, label in ((found_deg, style.SKY, "-", "found"), (put_in_deg, style.BLACK, ":", "put in")):
        if box is not None:
            south, north, west, east = box
            edge: dict[str, Any] = {"edgecolor": colour, "linestyle": line, "linewidth": 4.0 if line == "-" else 1.8}
            axes.add_patch(Rectangle((west, south), east - west, north - south, fill=False, label=label, **edge))
    style.coast(axes)
    figure.colorbar(shown, ax=axes, label="|B| less model [nT]")
    style.label(axes, x="longitude [deg]", y="latitude [deg]", title=title)
    axes.set(xlim=(-180, 180), ylim=(-75, 85))
    axes.legend(loc="lower left", frameon=True)
    return figure


def draw_following(driver: FloatArray, residual_nT: FloatArray, driver_label: str, *, title: str) -> Figure:
    """One panel an axis. driver: (N, 3); residual_nT: (N, 3)."""
    figure, (panels,) = style.figure(7.2, 2.8, cols=3, share_y=True)
    for number, (axes, name) in enumerate(zip(panels, "xyz", strict=True)):
        axes.plot(driver[:, number], residual_nT[:, number], ".", color=style.AXIS_COLOURS[number], markersize=2)
        style.label(axes, x=driver_label, title=name)
    panels[0].set(ylabel="residual [nT]")
    style.heading(figure, title)
    return figure


def draw_real_passes(
    stations: Sequence[str],
    night: BoolArray,
    printed_mG: FloatArray,
    ratio: FloatArray,
    notes: tuple[str, str],
    *,
    title: str,
) -> Figure:
    """Left: printed residuals by station. Right: over what the error of the flown model lets expect.

    notes: what the tests say, one line a panel.
    """
    names = sorted({*stations}, key=list(stations).index)
    figure, ((left, right),) = style.figure(7.2, 3.8, cols=2)
    for axes, values, words in ((left, printed_mG, notes[0]), (right, ratio, notes[1])):
        for place, name in enumerate(names):
            mine = np.array([station == name for station in stations])
            for chosen, shift, marker, colour, label in (
                (mine & night, 0.13, "o", style.BLACK, "night"),
                (mine & ~night, -0.13, "s", style.ORANGE, "day"),
            ):
                first = place == 0 or (place == 1 and label == "night")
                at = np.full(int(chosen.sum()), place + shift)
                axes.plot(at, values[chosen], marker, color=colour, markersize=4, label=label if first else None)
        axes.set_xticks(np.arange(len(names)), names)
        style.label(axes, title=words)
    right.axhline(1.0, color=style.GREY, linewidth=0.8)
    style.label(left, y="printed residual [mG]")
    left.set(ylim=(0, None))
    style.label(right, y="residual over the expected one")
    right.set(ylim=(0, None))
    handles, labels = left.get_legend_handles_labels()
    unique = dict(zip(labels, handles, strict=True))
    left.legend(unique.values(), unique.keys(), loc="upper right", frameon=True)
    style.heading(figure, title)
    return figure
