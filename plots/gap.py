"""Figures of a diagnosis: before and after, their spectra, the law."""

from __future__ import annotations

from collections.abc import Sequence

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
