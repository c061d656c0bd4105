"""Series along one record, panels above each other: drawn as a figure, and handed to the page's script as data.

The figure stands by itself, in print and without scripts. Of long records the rows with the lowest and the highest value of
each series in every stretch are kept, so that no outlier is lost.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from fluxtwin.plots import style
from fluxtwin.sim.base.types import BoolArray, FloatArray, IntArray, TimeArray

_MOST_VALUES = 32_000  # of a figure: a quarter of a megabyte as text; a page of two magnetometers has four
_DIGITS = 6  # significant ones in the data of the script
_COVERED = 0.5  # of the span: with less, pauses are shortened
_SPREAD = 1.12  # of the largest value: where the axes end


@dataclass(frozen=True)
class Line:
    """One series of a panel."""

    name: str
    values: FloatArray
    """(N,); NaN is no point."""
    colour: str
    look: str = "dots"
    """dots, line, or cross: rows set aside, which have no say in the axes."""


@dataclass(frozen=True)
class Panel:
    """One pair of axes."""

    label: str
    """With the unit, as `x [nT]`."""
    lines: Sequence[Line]


@dataclass(frozen=True)
class TimeSeries:
    """Panels over one time axis."""

    title: str
    time: TimeArray
    """(N,) UTC, ascending."""
    panels: Sequence[Panel]
    pause: np.timedelta64 = style.NO_TIME
    """A longer step, and one of eight usual ones, breaks a line."""

    @property
    def squeezed_s(self) -> FloatArray | None:
        """(N,) seconds along an axis on which pauses are shortened; None where they are less than half of the span."""
        along_s = style.squeezed_s(self.time)
        span_s = (self.time[-1] - self.time[0]) / np.timedelta64(1, "s")
        return along_s if along_s[-1] < _COVERED * span_s else None

    def thinned(self) -> TimeSeries:
        """With as many rows as a page can carry, the extremes of every series among them."""
        lines = [line for panel in self.panels for line in panel.lines]
        full = sum(line.look != "cross" for line in lines)  # the others have few values
        rows = extremes(np.transpose([line.values for line in lines]), _MOST_VALUES // max(full, 1))
        if rows.size == self.time.size:
            return self
        pause = 4 * np.max(np.diff(rows)) * np.median(np.diff(self.time))  # stretches beside each other stay joined
        panels = [
            Panel(one.label, [Line(n.name, n.values[rows], n.colour, n.look) for n in one.lines]) for one in self.panels
        ]
        return TimeSeries(self.title, self.time[rows], panels, pause)

    def to_dict(self) -> dict[str, Any]:
        """For the script: stamps [ms since 1970, UTC] as steps from one to the next, and values."""
        shown = self.thinned()
        stamps = shown.time.astype("datetime64[ms]").astype(np.int64)
        panels = [{"label": one.label, "lines": [_line(line) for line in one.lines]} for one in shown.panels]
        pause_ms = shown.pause / np.timedelta64(1, "ms")
        return {
            "rows": self.time.size,
            "steps_ms": np.diff(stamps, prepend=0).tolist(),
            "pause_ms": pause_ms,
            "knots": self._knots(),
            "panels": panels,
        }

    def _knots(self) -> list[list[float]]:
        """Stamps [ms since 1970] and where they stand on the axis [ms], from one end of a pause to the next."""
        stamps = self.time.astype("datetime64[ms]").astype(np.float64)
        along = self.squeezed_s
        if along is None:
            rows, along_ms = np.array([0, -1]), stamps
        else:
            along_ms = 1e3 * along
            pauses = np.flatnonzero(np.diff(stamps) - np.diff(along_ms) > 1.0)
            rows = np.unique([0, *pauses, *(pauses + 1), stamps.size - 1])
        return [[float(stamps[row]), float(along_ms[row])] for row in rows]


def extremes(values: FloatArray, most: int) -> IntArray:
    """Rows (M,) of values (N, K), M up to about `most`: the lowest and the highest of each column in stretches of equal
    count."""
    n, k = values.shape
    if n <= most:
        return np.arange(n)
    size = -(-n * 2 * k // most)
    count = -(-n // size)
    cut = np.concatenate([values, np.full((count * size - n, k), np.nan)]).reshape(count, size, k)
    starts = np.arange(count)[:, None] * size
    low = starts + np.where(np.isnan(cut), np.inf, cut).argmin(axis=1)
    high = starts + np.where(np.isnan(cut), -np.inf, cut).argmax(axis=1)
    return np.unique([low, high])


def draw_time_series(series: TimeSeries) -> Figure:
    """A panel below the other; rows set aside are crosses, arrows at the edge where they lie beyond it."""
    shown = series.thinned()
    figure, grid = style.figure(7.2, 0.9 + 1.5 * len(shown.panels), rows=len(shown.panels), share_x=True)
    style.heading(figure, series.title)
    squeezed = series.squeezed_s

    def place(stamps: TimeArray) -> Any:
        if squeezed is None:
            return stamps
        return np.interp(stamps.astype(np.int64), series.time.astype(np.int64), squeezed)

    along = place(shown.time)
    for panel, (axes,) in zip(shown.panels, grid, strict=True):
        kept = [line.values for line in panel.lines if line.look != "cross"]
        style.limit(axes, np.concatenate(kept), _SPREAD)
        for line in panel.lines:
            if line.look == "line":
                known = np.isfinite(line.values)
                stamps, values = style.broken(shown.time[known], line.values[known], shown.pause)
                axes.plot(place(stamps), values, color=line.colour, linewidth=1.1, label=line.name)
            elif np.isfinite(line.values).any():
                mark, size = ("x", 5.0) if line.look == "cross" else (".", 3.0)
                axes.plot(along, line.values, mark, markersize=size, color=line.colour, label=line.name)
                style.mark_beyond(axes, along, line.values, colour=line.colour)
        style.label(axes, y=panel.label)
        style.legend_beside(axes)
    if squeezed is not None:
        style.utc_squeezed(grid[-1][0], series.time, squeezed)
    else:
        style.utc(grid[-1][0], shown.time)
    return figure


def residual_panels(
    residual_nT: FloatArray, names: Sequence[str], aside: BoolArray, *, before_nT: FloatArray | None = None
) -> list[Panel]:
    """Residuals (N, K), a panel a component, rows `aside` (N,) as crosses; above them all of `before_nT` (N, K) in one.

    A line without a name is not in the legend.
    """
    panels = []
    colours = style.AXIS_COLOURS
    if before_nT is not None:
        lines = []
        for name, part, colour in zip(names, before_nT.T, colours, strict=False):
            lines.append(Line(name, np.where(aside, np.nan, part), colour))
            if aside.any():
                lines.append(Line("", np.where(aside, part, np.nan), colour, "cross"))
        panels.append(Panel("before [nT]", lines))
    for name, part, colour in zip(names, residual_nT.T, colours, strict=False):
        lines = [Line("after" if before_nT is not None else "residual", np.where(aside, np.nan, part), colour)]
        if aside.any():
            lines.append(Line("set aside", np.where(aside, part, np.nan), style.BLACK, "cross"))
        panels.append(Panel(f"{name} [nT]", lines))
    return panels


def field_panels(
    measured_nT: FloatArray, predicted_nT: FloatArray | None, aside: BoolArray | None = None
) -> list[Panel]:
    """|B| and, of vectors, the components, (N, 3) or (N, 1), measured and predicted, body axes; rows `aside` (N,) as
    crosses."""
    panels = []
    out = np.zeros(len(measured_nT), dtype=bool) if aside is None else aside
    kept_nT, out_nT = (np.where(rows[:, None], measured_nT, np.nan) for rows in (~out, out))
    for name in ("|B|", *"xyz")[: 4 if measured_nT.shape[1] == 3 else 1]:
        lines = []
        for words, field, colour, look in (
            ("measured", kept_nT, style.BLUE, "dots"),
            ("predicted", predicted_nT, style.VERMILION, "line"),
            ("set aside", out_nT if out.any() else None, style.BLACK, "cross"),
        ):
            if field is not None and (name == "|B|" or field.shape[1] == 3):
                part = np.linalg.norm(field, axis=1) if name == "|B|" else field[:, "xyz".index(name)]
                lines.append(Line(words, part, colour, look))
        panels.append(Panel(f"{name} [nT]", lines))
    return panels


def _line(line: Line) -> dict[str, Any]:
    """Values that are there; where some are not, with their rows or those of the others, whichever are fewer."""
    known = np.isfinite(line.values)
    few = {"rows": known} if 2 * known.sum() < known.size else {"missing": ~known}
    sparse = {} if known.all() else {key: np.flatnonzero(rows).tolist() for key, rows in few.items()}
    values = [float(f"{value:.{_DIGITS}g}") for value in line.values[known].tolist()]
    return {"name": line.name, "look": line.look, "colour": line.colour, "values": values, **sparse}
