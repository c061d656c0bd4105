"""Figures of calibrations: how parameters scatter, what they do in time, and what makes up the residual."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from fluxtwin.plots import style
from fluxtwin.sim.base.types import BoolArray, FloatArray, TimeArray


def draw_scatter(
    names: Sequence[str],
    data_sets: Sequence[str],
    estimates: FloatArray,
    truth: FloatArray,
    printed: FloatArray,
    signed: BoolArray,
    *,
    title: str,
) -> Figure:
    """One panel a parameter: spread of the estimates per data set, truth, and what is printed.

    estimates: (R, D, K); truth: (K,); printed: (D, K) values printed in the paper, NaN where there is none; signed:
    (D,) data sets whose printed values have their signs; of the others both are drawn.
    """
    rows = int(np.ceil(len(names) / 3))
    figure, grid = style.figure(7.2, 2.0 * rows + 0.6, rows=rows, cols=3)
    all_axes = [axes for row in grid for axes in row]
    places = np.arange(len(data_sets))
    largest = np.max(np.abs(np.nanpercentile(estimates, [2.5, 97.5], axis=0)), axis=(0, 1))
    marked = np.maximum(largest, np.nanmax(np.abs(printed), axis=0))
    limits = [marked[column::3].max() for column in range(3)]
    either = ~signed
    for number, (axes, name) in enumerate(zip(all_axes, names, strict=False)):
        low, middle, high = np.nanpercentile(estimates[:, :, number], [2.5, 50.0, 97.5], axis=0)
        theirs = printed[:, number]
        axes.vlines(places, low, high, color=style.BLUE, linewidth=4, alpha=0.6, label="95 % of the simulated runs")
        axes.plot(places, middle, "_", color=style.BLUE, markersize=10, label="their median")
        axes.plot(places[signed], theirs[signed], "x", color=style.PAPER, markersize=6, label="printed, with its sign")
        both, words = np.concatenate([theirs[either], -theirs[either]]), "printed without a sign: both are drawn"
        open_: dict[str, Any] = {"color": style.PAPER, "markersize": 4, "markerfacecolor": "none"}
        axes.plot(np.tile(places[either], 2), both, "o", label=words, **open_)
        axes.axhline(truth[number], color="black", linewidth=0.8, label="put in")
        style.label(axes, title=name)
        axes.set_xticks(places, data_sets, rotation=60, fontsize=7)
        limit = 1.1 * limits[number % 3]
        axes.set_ylim(-limit, limit)
        if number % 3 == 0:
            style.label(axes, y="value [1]")
    style.heading(figure, title)
    style.legend_below(figure, all_axes[0])
    return figure


def draw_budget(
    sources: Sequence[str],
    simulated_mG: FloatArray,
    paper_rule_mG: FloatArray,
    paper_range_mG: FloatArray | None = None,
    *,
    title: str,
) -> Figure:
    """Bars of the residual's sources: simulated alone, and by the paper's arithmetic.

    paper_range_mG: (N, 2) lowest and highest, where the papers give a range.
    """
    figure, ((axes,),) = style.figure(7.2, 3.8)
    places = np.arange(len(sources))
    for shift, values, label, colour in (
        (-0.2, simulated_mG, "simulated, source alone", style.BLUE),
        (0.2, paper_rule_mG, "the papers' arithmetic", style.ORANGE),
    ):
        axes.bar(places + shift, values, 0.38, label=label, color=colour)
    tops = paper_rule_mG
    if paper_range_mG is not None:
        low, tops = paper_range_mG.T
        wide = tops > low
        axes.vlines(
            places[wide] + 0.2, low[wide], tops[wide], color=style.BLACK, linewidth=1.5, label="range in the papers"
        )
    for shift, values, heights in ((-0.2, simulated_mG, simulated_mG), (0.2, paper_rule_mG, tops)):
        for place, value, height in zip(places + shift, values, heights, strict=True):
            axes.annotate(f"{value:.2f}", (place, height), (0, 2), textcoords="offset points", ha="center", fontsize=8)
    axes.set_xticks(places, [textwrap.fill(name, 14) for name in sources])
    style.label(axes, y="rms per component [mG]", title=title)
    axes.legend()
    return figure


def draw_node_misfit(
    raan_deg: FloatArray, misfit: FloatArray, chosen_deg: float, witness_deg: float, *, title: str
) -> Figure:
    """Misfit against the node, with the chosen one and the one that the launch gives."""
    figure, ((axes,),) = style.figure(7.2, 3.4)
    axes.plot(raan_deg, 100 * misfit, color=style.BLUE)
    axes.axvline(chosen_deg, color=style.VERMILION, label=f"chosen: {chosen_deg:.0f} deg")
    axes.axvline(witness_deg, color="black", linestyle="--", label=f"from the launch: {witness_deg:.1f} deg")
    words = "right ascension of the node, 0 h UTC of day 205 of 1978 [deg]"
    style.label(axes, x=words, y="misfit [% of the orbit]", title=title)
    axes.set(xlim=(0, 360))
    axes.legend()
    return figure


def draw_trend(time: TimeArray, courses: Mapping[str, tuple[FloatArray, FloatArray, FloatArray, str]]) -> Figure:
    """A panel a parameter, three in a row; bars are 1 sigma. A line in colour where a parameter changed, grey where not.

    courses: by name with unit, (K,) values, their sigmas and what the parameter is taken to have done; and the kind of it:
    constant, step, drift, temperature or varies.
    """
    rows = -(-len(courses) // 3)
    figure, grid = style.figure(7.6, 0.8 + 1.5 * rows, rows=rows, cols=3, share_x=True)
    style.heading(figure, "Parameters over the calibrations; bars are 1 sigma")
    panels = [axes for row in grid for axes in row]
    for axes, (name, (values, sigmas, fitted, kind)) in zip(panels, courses.items(), strict=False):
        colour, words = (style.GREY, "constant") if kind == "constant" else (style.VERMILION, "changed")
        course = "steps-mid" if kind == "step" else "default"
        axes.plot(time, fitted, "-", drawstyle=course, linewidth=1.2, color=colour, label=words)
        axes.errorbar(time, values, sigmas, fmt="o", markersize=3, color=style.BLUE, elinewidth=1.0, capsize=2)
        style.label(axes, title=name)
        axes.ticklabel_format(axis="y", useOffset=False)
    for axes in panels[len(courses) :]:
        axes.set_visible(False)
    for axes in grid[-1]:
        style.utc(axes, time, most=3)
    return figure
