"""The common look of all figures: readable in print, safe for colour-blind eyes, units in every label.

Figures are made without pyplot, so nothing global is touched and no window can open. Text that came from
outside (names in files, units) is drawn as it is, never as mathematics: a stray $ cannot break a figure.
Colours: the palette of Okabe and Ito (jfly.uni-koeln.de/color, 2008); series differ in line style as well.
"""

from __future__ import annotations

from functools import cache
from importlib.resources import files
from typing import Any, TypeAlias, cast

import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.dates import AutoDateLocator, ConciseDateFormatter
from matplotlib.figure import Figure
from matplotlib.legend import Legend
from matplotlib.text import Text
from matplotlib.ticker import FormatStrFormatter, LogLocator, MaxNLocator, NullFormatter

from fluxtwin.sim.base.types import FloatArray, TimeArray

AxesGrid: TypeAlias = list[list[Axes]]
"""Axes of a figure, row by row: `grid[row][column]`."""

BLACK = "#000000"
BLUE = "#0072B2"
ORANGE = "#E69F00"
GREEN = "#009E73"
VERMILION = "#D55E00"
SKY = "#56B4E9"
PURPLE = "#CC79A7"
GREY = "#767676"
PALE = "#D9D9D9"

CYCLE = (BLUE, VERMILION, GREEN, PURPLE, ORANGE, SKY, BLACK)
"""Colours of series without a meaning of their own, in order."""
AXIS_COLOURS = (BLUE, VERMILION, GREEN)
"""Colours of the three components of a vector, in order."""
PAPER = VERMILION
"""The published number or curve beside ours."""

SIGNED_MAP = "PuOr"
"""Diverging colour map for residuals, centred on zero; orange and purple differ for every kind of eye."""

FULL_WIDTH_IN = 7.2
"""Width of a page [inch]."""

NO_TIME = np.timedelta64(0, "ns")
_PAUSE = 8.0  # usual steps: a pause of that length breaks a line

TITLE_PT, LABEL_PT, TICK_PT, NOTE_PT = 10.0, 9.0, 8.0, 8.0


def figure(
    width_in: float = FULL_WIDTH_IN,
    height_in: float = 4.0,
    rows: int = 1,
    cols: int = 1,
    *,
    share_x: bool = False,
    share_y: bool = False,
) -> tuple[Figure, AxesGrid]:
    """A figure in the common look and its axes, `grid[row][column]` even for one panel.

    The layout keeps labels from overlapping; a pale grid lies behind the data.
    width_in, height_in: size of the whole [inch].
    share_x: one time or latitude axis per column; share_y: one value axis per row.
    """
    made = Figure(figsize=(width_in, height_in), layout="constrained", facecolor="white")
    shared: dict[str, Any] = {"sharex": "col" if share_x else False, "sharey": "row" if share_y else False}
    panels = made.subplots(rows, cols, squeeze=False, **shared)
    for axes in panels.flat:
        axes.spines[["top", "right"]].set_visible(False)
        axes.spines[["left", "bottom"]].set_linewidth(0.8)
        axes.set_axisbelow(True)
        axes.grid(True, color=PALE, linewidth=0.6)
        axes.tick_params(labelsize=TICK_PT, width=0.8, length=3.0)
        axes.set_prop_cycle(color=list(CYCLE))
    return made, [list(row) for row in panels]


def label(axes: Axes, *, x: str | None = None, y: str | None = None, title: str | None = None) -> None:
    """Name the axes; the unit is in square brackets, as `east residual [nT]`. Text is drawn as it is."""
    if x is not None:
        _plain(axes.set_xlabel(x, fontsize=LABEL_PT))
    if y is not None:
        _plain(axes.set_ylabel(y, fontsize=LABEL_PT))
    if title is not None:
        _plain(axes.set_title(title, fontsize=TITLE_PT, loc="left"))


def heading(made: Figure, text: str) -> None:
    """One heading over the whole figure, drawn as it is."""
    _plain(made.suptitle(text, fontsize=TITLE_PT + 1.0, fontweight="bold", x=0.01, ha="left"))


def legend(axes: Axes, location: str = "best", *, columns: int = 1) -> Legend:
    """A legend of the labelled series on a white ground, drawn as it is."""
    look: dict[str, Any] = {"framealpha": 0.9, "edgecolor": PALE, "handlelength": 2.6}
    made: Legend = axes.legend(loc=cast(Any, location), ncols=columns, fontsize=NOTE_PT, **look)
    _plain(*made.get_texts())
    return made


def legend_below(made: Figure, axes: Axes, *, columns: int = 3, frame: bool = True) -> None:
    """One legend under all panels, of the series of one of them, drawn as it is."""
    below: dict[str, Any] = {"loc": "outside lower center", "ncols": columns, "fontsize": NOTE_PT, "frameon": frame}
    _plain(*made.legend(*axes.get_legend_handles_labels(), **below).get_texts())


def legend_beside(axes: Axes) -> None:
    """A legend to the right of the panel, outside of it, drawn as it is."""
    look: dict[str, Any] = {"frameon": False, "handlelength": 1.2, "borderaxespad": 0.2, "markerscale": 2.0}
    _plain(*axes.legend(loc="upper left", bbox_to_anchor=(1.0, 1.05), fontsize=NOTE_PT, **look).get_texts())


def mark_beyond(axes: Axes, x: FloatArray | TimeArray, y: FloatArray, *, colour: str, size: float = 5.0) -> None:
    """A triangle at the edge of the panel, pointing out, for each point (x, y) above or below it; limits are left alone.

    x, y: (N,) in data coordinates; NaN is no point.
    """
    low, high = axes.get_ylim()
    look: dict[str, Any] = {"linestyle": "", "markersize": size, "color": colour, "scalex": False, "clip_on": False}
    for beyond, edge, marker in ((y > high, 1.0, 6), (y < low, 0.0, 7)):  # caretup, caretdown: the tip is the point
        if beyond.any():
            at = np.full(int(beyond.sum()), edge)
            axes.plot(x[beyond], at, marker=marker, transform=axes.get_xaxis_transform(), **look)


def utc(axes: Axes, time: TimeArray, *, most: int = 9) -> None:
    """A time axis in UTC, with the date at its end and `most` ticks. time: (N,) stamps, to which it reaches."""
    axes.xaxis.axis_date()
    locator = AutoDateLocator(minticks=2, maxticks=most)  # type: ignore[no-untyped-call]
    axes.xaxis.set_major_locator(locator)
    days = ["", "%Y", "%Y-%m", *["%Y-%m-%d"] * 3]
    axes.xaxis.set_major_formatter(ConciseDateFormatter(locator, offset_formats=days))  # type: ignore[no-untyped-call]
    margin = (time[-1] - time[0]) // 50 + np.timedelta64(1, "s")
    axes.set_xlim(cast(Any, time[0] - margin), cast(Any, time[-1] + margin))
    axes.xaxis.get_offset_text().set_fontsize(TICK_PT)
    label(axes, x="UTC")
    axes.xaxis.label.set(x=0.0, ha="left")  # clear of the date at the other end


def squeezed_s(time: TimeArray) -> FloatArray:
    """(N,) seconds along an axis on which no pause is longer than a fiftieth of what the record covers: for passes."""
    step = np.diff(time) / np.timedelta64(1, "s")
    usual = _PAUSE * float(np.median(step)) if step.size else 0.0
    most = max(usual, 0.02 * float(step[step <= usual].sum()))
    return np.concatenate([[0.0], np.cumsum(np.minimum(step, most))])


def utc_squeezed(axes: Axes, time: TimeArray, along_s: FloatArray) -> None:
    """As `utc`, of an axis on which pauses are shortened: along_s (N,) by `squeezed_s`."""
    stamps = time.astype("datetime64[s]").astype(np.float64)

    def words(place: float, _: object) -> str:
        at = np.datetime64(round(float(np.interp(place, along_s, stamps))), "s")
        return str(at)[5:16].replace("T", "\n")

    axes.xaxis.set_major_locator(MaxNLocator(8))
    axes.xaxis.set_major_formatter(words)
    axes.set_xlim(float(along_s[0]), float(along_s[-1]))
    label(axes, x=f"UTC, {str(time[0])[:4]}; pauses are shortened")


def log_ruler(ruler: Axis) -> None:
    """Ticks of a logarithmic axis that can be read: 1, 2, 5 times powers of ten, as plain numbers."""
    ruler.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    ruler.set_major_formatter(FormatStrFormatter("%g"))
    ruler.set_minor_formatter(NullFormatter())


def broken(time: TimeArray, values: FloatArray, least: np.timedelta64 = NO_TIME) -> tuple[TimeArray, FloatArray]:
    """The same with a NaN put in where the record pauses for `_PAUSE` usual steps and `least`, so that no line crosses the
    pause."""
    step = np.diff(time)
    pauses = np.flatnonzero(step > max(_PAUSE * np.median(step), least)) + 1 if step.size else np.zeros(0, dtype=int)
    return np.insert(time, pauses, time[pauses]), np.insert(values, pauses, np.nan)


def limit(axes: Axes, values: FloatArray, spread: float = 1.0) -> None:
    """Limits around all values that are numbers, wider by `spread`."""
    known = values[np.isfinite(values)]
    if known.size:
        low, high = float(known.min()), float(known.max())
        room = 0.5 * spread * max(high - low, 1e-9 * max(abs(low), abs(high), 1.0))
        axes.set_ylim(0.5 * (low + high) - room, 0.5 * (low + high) + room)


def coast(axes: Axes) -> None:
    """The coastline of the world behind the data of a map in longitude and latitude [deg]."""
    axes.plot(*coastline_deg().T, color=GREY, linewidth=0.5, zorder=0.6, scalex=False, scaley=False)


@cache
def coastline_deg() -> FloatArray:
    """(N, 2) longitude and latitude; NaN between lines. Source: data/README.md."""
    with (files("fluxtwin.plots") / "data" / "coastline.csv").open(encoding="utf-8") as opened:
        return np.genfromtxt(opened, delimiter=",", skip_header=1)


def zero_line(axes: Axes) -> None:
    """A thin line at zero, behind the data."""
    axes.axhline(0.0, color=GREY, linewidth=0.8, zorder=0.5)


def _plain(*texts: Text) -> None:
    for text in texts:
        text.set_parse_math(False)
