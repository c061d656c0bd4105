"""Figures of station passes: what was printed beside what is predicted, errors with one thing wrong, and diagnosed cases."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from fluxtwin.plots import style
from fluxtwin.sim.base.types import BoolArray, FloatArray


def draw_ranges(
    labels: Sequence[str],
    printed_deg: FloatArray,
    predicted_deg: FloatArray,
    misread: BoolArray,
    scanned_deg: FloatArray,
    *,
    title: str,
    unit: str = "angle [deg]",
) -> Figure:
    """One bar a pass from the lowest to the highest printed angle, and the predicted ends on it.

    printed_deg: (P, 2); predicted_deg: (P, 2); misread: (P, 2) ends whose digits were corrected; scanned_deg: (P,
    2) as the scan shows them.
    """
    count = len(labels)
    figure, ((axes,),) = style.figure(7.2, 0.21 * count + 1.2)
    rows = np.arange(count)[::-1]
    axes.hlines(rows, printed_deg[:, 0], printed_deg[:, 1], color=style.PALE, linewidth=7)
    for end, marker in ((0, ">"), (1, "<")):
        said = (None, None) if end else ("predicted ends", "printed ends")
        axes.plot(predicted_deg[:, end], rows, marker, color=style.BLUE, markersize=5, label=said[0])
        axes.plot(printed_deg[:, end], rows, "|", color=style.BLACK, markersize=9, label=said[1])
    wrong, words = rows[np.nonzero(misread)[0]], "digits of the scan, corrected"
    axes.plot(scanned_deg[misread], wrong, "x", color=style.PAPER, markersize=6, label=words)
    axes.set_yticks(rows, labels, fontsize=7)
    style.label(axes, x=unit, title=title)
    axes.set(ylim=(-1, count))
    axes.legend(loc="lower left", frameon=True)
    return figure


def draw_nulls(median_deg: float, nulls_deg: Mapping[str, float], ends: int, *, title: str) -> Figure:
    """Bars of the median error; the right model first.

    ends: how many ends each median is of.
    """
    names = ["as it was", *nulls_deg]
    values = [median_deg, *nulls_deg.values()]
    figure, ((axes,),) = style.figure(7.2, 3.2)
    bars = axes.bar(np.arange(len(names)), values, 0.6, color=[style.BLUE] + [style.ORANGE] * len(nulls_deg))
    axes.bar_label(bars, fmt="%.2f", fontsize=8)
    axes.set_xticks(np.arange(len(names)), [textwrap.fill(name, 15) for name in names])
    style.label(axes, y=f"median error of {ends} ends [deg]", title=title)
    return figure


def draw_evidence(
    labels: Sequence[str],
    printed_mG: FloatArray,
    predicted_mG: FloatArray,
    night: BoolArray,
    turns_deg: FloatArray,
    turned_correlation: FloatArray,
    *,
    title: str,
) -> Figure:
    """Printed residual against predicted model error, and the rank correlation as the map is turned."""
    figure, ((left, right),) = style.figure(7.2, 3.8, cols=2)
    for chosen, marker, label, colour in ((night, "o", "night", style.BLACK), (~night, "s", "sunlit", style.ORANGE)):
        left.plot(predicted_mG[chosen], printed_mG[chosen], marker, color=colour, markersize=4, label=label)
    for rank, k in enumerate(np.argsort(-printed_mG)[:4]):
        beside: dict[str, Any] = {"xytext": (-7, -9 if rank % 2 else 4), "textcoords": "offset points"}
        left.annotate(labels[k], (predicted_mG[k], printed_mG[k]), fontsize=7, ha="right", **beside)
    style.label(left, x="error of IGRF 1975 in field strength [mG, rms]", y="printed residual [mG]", title="43 passes")
    left.legend(loc="upper left")
    turns = np.append(turns_deg, 360.0)
    right.plot(turns, np.append(turned_correlation, turned_correlation[0]), color=style.BLUE, marker="o", markersize=3)
    right.axhline(0.0, color="grey", linewidth=0.8)
    style.label(right, x="map of errors turned east by [deg]", y="rank correlation", title="the map turned")
    right.set(xlim=(0, 360))
    style.heading(figure, title)
    return figure


def draw_moved(
    shifts_deg: FloatArray,
    ratio: Mapping[str, FloatArray],
    correlation: Mapping[str, FloatArray],
    printed_ratio: float,
    ratio_without: float,
    correlation_without: float,
    *,
    title: str,
) -> Figure:
    """Ratio of night to day and rank correlation, as the errors are moved.

    ratio: by scanner: night over day.
    """
    figure, ((left, right),) = style.figure(7.2, 3.9, cols=2)
    turns, colours = np.append(shifts_deg, 360.0), (style.BLUE, style.ORANGE, style.BLACK)
    for axes, curves in ((left, ratio), (right, correlation)):
        for (name, values), colour, marker in zip(curves.items(), colours, "os^", strict=True):
            axes.plot(turns, np.append(values, values[0]), color=colour, marker=marker, markersize=3, label=name)
        style.label(axes, x="errors moved along the orbit by [deg]")
        axes.set(xlim=(0, 360), xticks=np.arange(0, 361, 90))
    left.axhline(printed_ratio, color=style.VERMILION, linewidth=1.0, label="printed")
    left.axhline(ratio_without, color="grey", linestyle="--", linewidth=1.0, label="no horizon error")
    right.axhline(correlation_without, color="grey", linestyle="--", linewidth=1.0)
    style.label(left, y="residual by night over that by day", title="the factor")
    style.label(right, y="rank correlation of the night passes", title="the ranking")
    style.legend_below(figure, left)
    style.heading(figure, title)
    return figure


def draw_bias(mean_x_mG: FloatArray, bias_x_mG: FloatArray, explained_mG: FloatArray, *, title: str) -> Figure:
    """Found X bias of every pass, and what S alone would make of it.

    explained_mG: what the printed S makes of each pass's mean reading, with the printed bias.
    """
    figure, ((axes,),) = style.figure(7.2, 3.6)
    axes.plot(mean_x_mG, bias_x_mG, "o", color=style.BLUE, markersize=3, label="bias from the pass alone")
    words = "b1 and the first row of S at the mean reading"
    axes.plot(mean_x_mG, explained_mG, ".", color=style.VERMILION, markersize=3, label=words)
    style.label(axes, x="mean X reading of the pass [mG]", y="X bias with S = T = 0 [mG]", title=title)
    axes.legend(loc="best", frameon=True)
    return figure


def draw_ideas(
    names: Sequence[str],
    explained: Sequence[int],
    explained_with_digits: Sequence[int],
    by_chance: Sequence[float],
    total: int,
    *,
    title: str,
) -> Figure:
    """Ends explained by each idea, as read and with one confused digit allowed."""
    count = len(names)
    figure, ((axes,),) = style.figure(7.2, 0.34 * count + 1.3)
    rows = np.arange(count)[::-1]
    axes.barh(rows + 0.18, explained, 0.34, color=style.BLUE, label="digits as scanned")
    axes.barh(rows - 0.18, explained_with_digits, 0.34, color=style.ORANGE, label="one confused digit allowed")
    axes.plot(by_chance, rows, "|", color=style.BLACK, markersize=16, label="by chance, as scanned")
    axes.set_yticks(rows, names, fontsize=8)
    style.label(axes, x=f"ends explained within 1.5 deg, of {total}", title=title)
    axes.set(xlim=(0, total))
    style.legend_below(figure, axes)
    return figure


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
    style.label(axes, x="time from the first sample [h]", y="measured minus computed [deg]", title=title)
    axes.set_ylim(top=1.45 * float(np.nanmax(error_deg)))
    axes.legend(loc="upper right", frameon=True, ncols=3, markerscale=2)
    return figure


def draw_night_map(
    latitude_deg: FloatArray,
    longitude_deg: FloatArray,
    residual_nT: FloatArray,
    put_in_deg: FloatArray,
    found_deg: FloatArray | None,
    *,
    title: str,
) -> Figure:
    """Rows by night on the map, coloured by residual; the edges of the region that was put in and of the
    one found, longitude and latitude (2, K)."""
    figure, ((axes,),) = style.figure(7.2, 3.6)
    limit = float(np.nanpercentile(np.abs(residual_nT), 99))
    look: dict[str, Any] = {"cmap": style.SIGNED_MAP, "vmin": -limit, "vmax": limit}
    rim: dict[str, Any] = {"edgecolors": style.GREY, "linewidths": 0.2}
    shown = axes.scatter(longitude_deg, latitude_deg, c=residual_nT, s=7, **look, **rim)
    for outline, colour, line, label in (
        (found_deg, style.SKY, "-", "found"),
        (put_in_deg, style.BLACK, ":", "put in"),
    ):
        if outline is not None:
            axes.plot(*outline, color=colour, linestyle=line, linewidth=4.0 if line == "-" else 1.8, label=label)
    style.coast(axes)
    figure.colorbar(shown, ax=axes, label="|B| minus model [nT]")
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
