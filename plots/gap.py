"""Figures of a diagnosis: before and after, their spectra, the law; and of several side by side."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray
from scipy.stats import binned_statistic

from fluxtwin.gap.records.diagnosis import GapSeries, LawSeries
from fluxtwin.plots import style
from fluxtwin.plots.time_series import Line, Panel, TimeSeries
from fluxtwin.sim.base.types import FloatArray, TimeArray

_STRETCHES = 150
_BANDS = 60
_GROUPS = 12


def gap_series(series: GapSeries, aside_nT: FloatArray | None = None) -> TimeSeries:
    """How far: the residual of each axis before and after the named effects, samples and means of stretches.

    aside_nT: (N, 3) residual of the rows that were set aside, NaN elsewhere.
    """
    panels = []
    for axis, name in enumerate("xyz"):
        lines = []
        for values, words, pale, _, _ in _both(series):
            lines.append(Line(words, values[:, axis], pale))
        for values, words, _, strong, _ in _both(series):
            lines.append(Line(f"{words}, mean", _means(series.time, values[:, axis]), strong, "line"))
        if aside_nT is not None and np.isfinite(aside_nT).any():
            lines.append(Line("set aside", aside_nT[:, axis], style.BLACK, "cross"))
        panels.append(Panel(f"{name} [nT]", lines))
    title = "Residual before and after the named effects" if len(_both(series)) > 1 else "Residual"
    return TimeSeries(title, series.time, panels)


def draw_spectra(series: GapSeries) -> Figure:
    """Amplitude spectra of the residual before and after, rms over the axes and over bands of frequency."""
    figure, ((axes,),) = style.figure(7.2, 3.2)
    seconds = (series.time - series.time[0]) / np.timedelta64(1, "s")
    for values, name, _, colour, line in _both(series):
        frequency, amplitude = _bands(*_spectrum(seconds, values))
        axes.loglog(1e3 * frequency, amplitude, color=colour, linestyle=line, linewidth=1.3, label=name)
    style.log_ruler(axes.xaxis)
    style.log_ruler(axes.yaxis)
    style.legend(axes)
    style.label(axes, x="frequency [mHz]", y="amplitude [nT]", title="Spectrum of the residual")
    return figure


def draw_law(terms: Sequence[LawSeries]) -> Figure:
    """The law: for each term the residual without it, along its direction, against what it follows, and the term."""
    figure, grid = style.figure(7.2, 0.4 + 2.6 * len(terms), rows=len(terms), cols=1)
    for (axes,), term in zip(grid, terms, strict=True):
        x, y = term.follows, term.partial_nT
        spread = np.random.default_rng(0).uniform(-1.0, 1.0, x.size) * 0.02 * float(np.ptp(x))
        states = np.unique(x).size < _GROUPS  # dots of a switch beside each other, so that they are seen
        axes.plot(x + spread if states else x, y, ".", color=style.SKY, markersize=2.0, alpha=0.45, label="samples")
        middle = [(x[part].mean(), y[part].mean()) for part in alike_in(x)]
        axes.plot(*np.transpose(middle), "o", color=style.BLACK, markersize=4.5, label="their means")
        ends = np.array([x.min(), x.max()])
        axes.plot(ends, term.slope * ends, color=style.VERMILION, linewidth=1.4, label="the term")
        limit = np.percentile(y, [0.5, 99.5])
        axes.set_ylim(limit[0] - 0.15 * np.ptp(limit), limit[1] + 0.15 * np.ptp(limit))
        style.label(axes, x=term.label, y="partial residual [nT]")
    style.legend(grid[0][0], "best", columns=3)
    style.heading(figure, "The residual without the law, and the law")
    return figure


def alike_in(values: FloatArray) -> list[NDArray[np.intp]]:
    """Rows by their values: of each value where they are few, else in groups of about equal count."""
    states = np.unique(values)
    edges = states if states.size < _GROUPS else np.unique(np.quantile(values, np.linspace(0.0, 1.0, _GROUPS + 1)[:-1]))
    number = np.searchsorted(edges, values, side="right")
    return [np.flatnonzero(number == one) for one in np.unique(number)]


def _both(series: GapSeries) -> list[tuple[FloatArray, str, str, str, str]]:
    """Values, name, colour of dots, of the line, and its style; after is left out where it is before."""
    before = (series.before_nT, "before", style.ORANGE, style.VERMILION, "-")
    after = (series.after_nT, "after", style.SKY, style.BLUE, "--")
    same = np.array_equal(series.before_nT, series.after_nT, equal_nan=True)
    return [(*after[:1], "residual", *after[2:4], "-")] if same else [before, after]


def _means(time: TimeArray, values: FloatArray) -> FloatArray:
    """(N,) the mean of each of equal stretches of time in the row at its middle, NaN elsewhere."""
    known = np.flatnonzero(np.isfinite(values))
    made = np.full(values.size, np.nan)
    if known.size:
        count = max(2, min(_STRETCHES, time.size // 4))
        share = (time[known] - time[0]) / (time[-1] - time[0] + np.timedelta64(1, "ns"))
        for part in np.split(known, np.flatnonzero(np.diff((share * count).astype(np.int64))) + 1):
            made[part[part.size // 2]] = values[part].mean()
    return made


def _bands(frequency: FloatArray, amplitude: FloatArray) -> tuple[FloatArray, FloatArray]:
    """rms in even bands of log frequency: a spectrum of noise is a band of spikes, its level is what matters."""
    edges = np.geomspace(frequency[0], frequency[-1] * 1.0001, _BANDS + 1)
    place, power = np.asarray(binned_statistic(frequency, [frequency, amplitude**2], "mean", edges).statistic)
    filled = np.isfinite(place)
    return place[filled], np.sqrt(power[filled])


def _spectrum(seconds: FloatArray, values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Amplitudes on an even grid at the usual spacing; rows that are missing count as zero."""
    step = float(np.median(np.diff(seconds)))
    size = min(int(seconds[-1] / step) + 1, 1_000_000)
    even = np.zeros((size, 3))
    place = np.clip(np.rint(seconds / step).astype(int), 0, size - 1)
    even[place] = np.where(np.isfinite(values), values, 0.0)
    amplitude = np.sqrt(np.mean(np.abs(np.fft.rfft(even, axis=0)) ** 2, axis=1)) * 2.0 / max(len(place), 1)
    frequency = np.fft.rfftfreq(size, step)
    return np.asarray(frequency[1:], dtype=np.float64), np.asarray(amplitude[1:], dtype=np.float64)


_STEP_DEG = 5.0
_LEAST_ROWS = 4


def left_alone(
    names: Sequence[str], left_nT: Sequence[float], parameters: Sequence[int], limit_nT: float, title: str
) -> Figure:
    """What each fit leaves: a bar with its name, rms and parameters; the dashed line is what was there before.

    The words are in the bar where it is long, so that the line strikes none through.
    """
    figure, ((axes,),) = style.figure(style.FULL_WIDTH_IN, 0.9 + 0.32 * len(names))
    places = np.arange(len(names))
    axes.barh(places, left_nT, height=0.68, color=style.BLUE)
    axes.set_yticks(places, names)
    axes.invert_yaxis()
    for place, value, count in zip(places, left_nT, parameters, strict=True):
        remark = f"{value:.1f} nT, {count} parameter{'s' if count > 1 else ''}"
        inside = value > 0.5 * limit_nT
        box: dict[str, Any] = {"facecolor": "white", "edgecolor": "none", "pad": 1.0}
        look: dict[str, Any] = {"ha": "right", "color": "white"} if inside else {"ha": "left", "bbox": box}
        apart = (-0.012 if inside else 0.012) * limit_nT
        axes.text(value + apart, float(place), remark, va="center", fontsize=style.NOTE_PT, **look)
    axes.axvline(limit_nT, color=style.BLACK, linewidth=1.0, linestyle="--", zorder=1.5)
    axes.set_xlim(0.0, 1.1 * limit_nT)
    style.label(axes, x="residual rms per component [nT]; dashed: before", title=title)
    return figure


def by_latitude(tracks: Sequence[tuple[str, FloatArray, FloatArray]], title: str, aurora_deg: float) -> Figure:
    """rms over the components of residuals (N, 3) against latitude (N,): dots, and the rms in steps of 5 deg.

    Beyond `aurora_deg` the ground is tinted.
    """
    figure, ((axes,),) = style.figure(style.FULL_WIDTH_IN, 3.2)
    for place, (label, latitude_deg, residual_nT) in enumerate(tracks):
        size = np.sqrt(np.mean(np.square(residual_nT), axis=1))
        colour, line = style.CYCLE[place], ("-", "--", "-.", ":")[place % 4]
        if len(tracks) == 1:
            axes.plot(latitude_deg, size, ".", color=style.SKY, markersize=3.0, alpha=0.6, label="samples")
            colour = style.VERMILION
        axes.plot(*_steps(latitude_deg, size), color=colour, linestyle=line, linewidth=1.6, label=label)
    for low, high in ((-90.0, -aurora_deg), (aurora_deg, 90.0)):
        axes.axvspan(low, high, color=style.PALE, alpha=0.4, linewidth=0.0, zorder=0.2)
    axes.set_xlim(-90.0, 90.0)
    axes.set_xticks(np.arange(-90, 91, 30))
    axes.set_ylim(bottom=0.0)
    style.label(axes, x="geocentric latitude [deg]", y="rms over the axes [nT]", title=title)
    style.legend(axes, "upper center", columns=min(4, len(tracks) + 1))
    return figure


def groups(labels: Sequence[str], series: Mapping[str, Sequence[float]], quantity: str, title: str) -> Figure:
    """Bars in groups, one colour a series; `quantity` names the axis with its unit."""
    figure, ((axes,),) = style.figure(style.FULL_WIDTH_IN, 3.0)
    places, width = np.arange(len(labels)), 0.8 / len(series)
    hatches = ("", "//", "..", "xx")
    for number, (name, values) in enumerate(series.items()):
        shift = (number - 0.5 * (len(series) - 1)) * width
        look: dict[str, Any] = {"color": style.CYCLE[number], "hatch": hatches[number % 4], "edgecolor": "white"}
        axes.bar(places + shift, values, width=0.92 * width, label=name, linewidth=0.0, **look)
    axes.set_xticks(places, list(labels))
    style.zero_line(axes)
    style.label(axes, y=quantity, title=title)
    style.legend_below(figure, axes, columns=len(series), frame=False)
    return figure


def _steps(latitude_deg: FloatArray, size: FloatArray) -> tuple[FloatArray, FloatArray]:
    """rms in steps of latitude, NaN where there are too few rows."""
    edges = np.arange(-90.0, 90.0 + _STEP_DEG, _STEP_DEG)
    known = np.isfinite(size)
    count, square = (
        binned_statistic(latitude_deg[known], np.square(size[known]), how, edges).statistic for how in ("count", "mean")
    )
    return 0.5 * (edges[1:] + edges[:-1]), np.where(count >= _LEAST_ROWS, np.sqrt(square), np.nan)
