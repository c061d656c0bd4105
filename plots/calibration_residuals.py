"""What a calibration leaves over: each component along the record, and its distribution beside the normal law."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from fluxtwin.plots import style
from fluxtwin.sim.base.types import BoolArray, FloatArray, TimeArray

_LONGEST_CLOCK_DAYS = 2.0  # beyond, the samples are counted instead: days without data would squeeze the rest
_HISTOGRAM_SIGMAS = 4.0
_EDGE = 1.08  # of the largest residual that counts: where the axes end


@dataclass(frozen=True)
class CalibrationResiduals:
    """Residuals A B0 - [(I+S) B + b + T D] of N samples, body axes; or of |B|, one column."""

    time: TimeArray
    """(N,) UTC."""
    residual_B_nT: FloatArray
    """(N, 3), or (N, 1) for residuals of |B|."""
    aside: BoolArray | None = None
    """(N,) rows set aside as outliers: marked, and without a say in the axes and the rms."""


def draw_calibration_residuals(record: CalibrationResiduals, *, title: str) -> Figure:
    """One row a component: the series on the left, its histogram and the normal law of the same rms on the right.

    Rows set aside are crosses; one beyond the axes is an arrow at its edge.
    """
    rows = record.residual_B_nT.shape[1]
    height = 0.9 + 1.5 * rows
    figure, grid = style.figure(7.2, height, rows=rows, cols=2, share_x=True, width_ratios=[3, 1])
    aside = np.zeros(record.time.size, dtype=bool) if record.aside is None else record.aside
    kept = ~aside if (~aside).any() else np.ones_like(aside)
    style.heading(figure, title + (f"; {int(aside.sum())} rows set aside" if aside.any() else ""))
    along, name = _abscissa(record.time)
    for axis, (left, right) in enumerate(grid):
        series = record.residual_B_nT[:, axis]
        style.zero_line(left)
        left.plot(along[kept], series[kept], ".", markersize=3, color=style.AXIS_COLOURS[axis])
        if aside.any():
            _outliers(left, along[aside], series[aside], _EDGE * max(float(np.abs(series[kept]).max()), 1e-9))
        quantity = "|B|" if rows == 1 else "xyz"[axis]
        style.label(left, y=f"{quantity} [nT]", x=name if axis == rows - 1 else None)
        _histogram(right, series[kept], style.AXIS_COLOURS[axis])
        style.note(right, f"rms {np.sqrt(np.mean(series[kept] ** 2)):.3g} nT")
    style.label(grid[-1][1], x="residual [nT]")
    return figure


def _outliers(axes: Axes, along: FloatArray, series: FloatArray, edge: float) -> None:
    """Crosses inside the axes, which end at +-edge; arrows at the edge for what lies beyond."""
    axes.set_ylim(-edge, edge)
    inside = np.abs(series) <= edge
    axes.plot(along[inside], series[inside], "x", markersize=5, color=style.BLACK)
    for sign, marker in ((1.0, "^"), (-1.0, "v")):
        beyond = ~inside & (sign * series > 0)
        place = np.full(int(beyond.sum()), 0.94 * sign * edge)
        axes.plot(along[beyond], place, marker, markersize=5, color=style.BLACK)


def _abscissa(time: TimeArray) -> tuple[FloatArray, str]:
    hours = (time - time[0]).astype("timedelta64[ns]").astype(np.float64) / 3.6e12
    if hours[-1] <= 24 * _LONGEST_CLOCK_DAYS:
        return hours, f"hours since {np.datetime_as_string(time[0], unit='m')} UTC [h]"
    return np.arange(1.0, time.size + 1.0), "sample [1]"


def _histogram(axes: Axes, series: FloatArray, colour: str) -> None:
    sigma_nT = float(np.sqrt(np.mean(series**2))) if series.size else 0.0
    half = _HISTOGRAM_SIGMAS * max(sigma_nT, 1e-9)
    edges = np.linspace(-half, half, 25)
    axes.hist(np.clip(series, -half, half), bins=list(edges), density=True, color=colour, alpha=0.6)
    if sigma_nT > 0:
        x = np.linspace(-half, half, 201)
        axes.plot(x, np.exp(-0.5 * (x / sigma_nT) ** 2) / (sigma_nT * np.sqrt(2 * np.pi)), color=style.BLACK, lw=1)
    axes.set_ylim(top=1.3 * axes.get_ylim()[1])
    axes.set_yticks([])
