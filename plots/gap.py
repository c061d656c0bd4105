"""Figures of a diagnosis: the map of where, the ranking of which, before and after of how far."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FormatStrFormatter, LogLocator, NullFormatter
from numpy.typing import NDArray

from fluxtwin.gap.records.diagnosis import Diagnosis, GapSeries, LawSeries
from fluxtwin.plots import style
from fluxtwin.sim.base.types import FloatArray

_SHOWN = 4000  # points of a series that a page can show apart
_STRETCHES = 150
_BANDS = 60
_LEAST = 0.01  # probability of a place that is worth a bar
_BARS = 7
_GROUPS = 12


def draw_where(diagnosis: Diagnosis) -> Figure:
    """Where: a bar for each candidate stage, axis, frame and condition, with its probability."""
    sets = diagnosis.where.to_dict()["probabilities"]
    chosen = {}
    for name, shares in sets.items():
        ordered = sorted(shares.items(), key=lambda item: -item[1])
        chosen[name] = [pair for pair in ordered if pair[1] >= _LEAST][:_BARS]
    rows = [max(len(chosen[a]), len(chosen[b]), 1) for a, b in (("stage", "axis"), ("frame", "condition"))]
    figure, grid = style.figure(7.2, 1.8 + 0.27 * sum(rows), rows=2, cols=2, height_ratios=[row + 1.2 for row in rows])
    for place, name in enumerate(("stage", "axis", "frame", "condition")):
        axes = grid[place // 2][place % 2]
        _bars(axes, chosen[name], rows[place // 2])
        style.label(axes, x="probability [%]" if place > 1 else None, title=name)
    return figure


def _bars(axes: Axes, shares: Sequence[tuple[str, float]], rows: int) -> None:
    places = np.arange(len(shares))
    values = 100 * np.array([share for _, share in shares])
    colours = [style.GREY if label == "none" else style.BLUE for label, _ in shares]
    axes.barh(places, values, height=0.7, color=colours)
    axes.set_yticks(places, [label for label, _ in shares])
    for spot, value in zip(places, values, strict=True):
        inside = value > 80
        axes.text(
            value - 2 if inside else value + 2,
            float(spot),
            "> 99 %" if value > 99 else f"{value:.0f} %",
            va="center",
            ha="right" if inside else "left",
            fontsize=style.NOTE_PT,
            color="white" if inside else style.BLACK,
        )
    axes.set_xlim(0, 100)
    axes.set_ylim(rows - 0.4, -0.6)  # the likeliest on top, bars alike in both panels of a row
    axes.grid(False, axis="y")
    for text in axes.get_yticklabels():
        text.set_parse_math(False)


def draw_which(diagnosis: Diagnosis) -> Figure:
    """Which: the named effects and their rivals with probabilities."""
    rows: list[tuple[str, float, bool]] = []
    for effect in diagnosis.effects:
        rows.append((" /\n".join(effect.group) or effect.name, effect.probability, True))
        rows += [(f"rival: {name}", probability, False) for name, probability in effect.rivals]
    lines = sum(label.count("\n") + 1 for label, *_ in rows)
    figure, ((axes,),) = style.figure(7.2, 0.9 + 0.3 * max(lines, 1))
    if not rows:
        style.note(axes, "no effect is named")
        axes.set_axis_off()
        return figure
    _bars(axes, [(label, share) for label, share, _ in rows], len(rows))
    for bar, (*_, named) in zip(axes.patches, rows, strict=True):
        if not named:
            bar.set(facecolor=style.ORANGE, hatch="///", edgecolor="white")
    style.label(axes, x="probability [%]")
    return figure


def draw_series(series: GapSeries) -> Figure:
    """How far: the residual of each axis before and after the named effects, samples and means of stretches."""
    figure, grid = style.figure(7.2, 6.0, rows=3, cols=1, share_x=True)
    hours = (series.time - series.time[0]) / np.timedelta64(1, "h")
    step = max(1, hours.size // _SHOWN)
    finite = np.abs(series.before_nT[np.isfinite(series.before_nT)])
    limit = 1.15 * float(np.percentile(finite, 99.5)) if finite.size else 1.0
    for axis, (axes,) in enumerate(grid):
        for values, name, pale, strong, line in _both(series):
            axes.plot(hours[::step], values[::step, axis], ".", color=pale, markersize=2.0, alpha=0.45)
            axes.plot(*_means(hours, values[:, axis]), color=strong, linewidth=1.3, linestyle=line, label=name)
        style.zero_line(axes)
        axes.set_ylim(-limit, limit)
        style.label(axes, y=f"{'xyz'[axis]} residual [nT]")
    style.legend(grid[0][0], "upper right", columns=2)
    style.label(grid[2][0], x="time from the first sample [h]")
    style.heading(figure, "Residual before and after the named effects" if len(_both(series)) > 1 else "Residual")
    return figure


def draw_spectra(series: GapSeries) -> Figure:
    """Amplitude spectra of the residual before and after, rms over the axes and over bands of frequency."""
    figure, ((axes,),) = style.figure(7.2, 3.2)
    seconds = (series.time - series.time[0]) / np.timedelta64(1, "s")
    for values, name, _, colour, line in _both(series):
        frequency, amplitude = _bands(*_spectrum(seconds, values))
        axes.loglog(1e3 * frequency, amplitude, color=colour, linestyle=line, linewidth=1.3, label=name)
    axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    for ruler in (axes.xaxis, axes.yaxis):
        ruler.set_major_formatter(FormatStrFormatter("%g"))
        ruler.set_minor_formatter(NullFormatter())
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
        middle = [(x[part].mean(), y[part].mean()) for part in _alike_in(x)]
        axes.plot(*np.transpose(middle), "o", color=style.BLACK, markersize=4.5, label="their means")
        ends = np.array([x.min(), x.max()])
        axes.plot(ends, term.slope * ends, color=style.VERMILION, linewidth=1.4, label="the term")
        limit = np.percentile(y, [0.5, 99.5])
        axes.set_ylim(limit[0] - 0.15 * np.ptp(limit), limit[1] + 0.15 * np.ptp(limit))
        style.label(axes, x=term.label, y="partial residual [nT]")
    style.legend(grid[0][0], "best", columns=3)
    style.heading(figure, "The residual without the law, and the law")
    return figure


def _alike_in(values: FloatArray) -> list[NDArray[np.intp]]:
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


def _means(hours: FloatArray, values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Mean in equal stretches of time, NaN where a stretch has no sample, so that the line breaks there."""
    known = np.isfinite(values)
    count = max(2, min(_STRETCHES, hours.size // 4))
    edges = np.linspace(hours[0], hours[-1], count + 1)
    number = np.clip(np.searchsorted(edges, hours[known], side="right") - 1, 0, count - 1)
    samples = np.bincount(number, minlength=count)
    total = np.bincount(number, weights=values[known], minlength=count)
    mean = np.where(samples > 0, total / np.maximum(samples, 1), np.nan)
    return (edges[1:] + edges[:-1]) / 2, mean


def _bands(frequency: FloatArray, amplitude: FloatArray) -> tuple[FloatArray, FloatArray]:
    """rms in even bands of log frequency: a spectrum of noise is a band of spikes, its level is what matters."""
    edges = np.geomspace(frequency[0], frequency[-1] * 1.0001, _BANDS + 1)
    number = np.searchsorted(edges, frequency, side="right") - 1
    samples = np.bincount(number, minlength=_BANDS)[:_BANDS]
    power = np.bincount(number, weights=amplitude**2, minlength=_BANDS)[:_BANDS]
    place = np.bincount(number, weights=frequency, minlength=_BANDS)[:_BANDS]
    filled = samples > 0
    return np.asarray(place[filled] / samples[filled]), np.asarray(np.sqrt(power[filled] / samples[filled]))


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
