"""Slow functions of time, splined on a coarse grid: a long series is summed a few times, not a million."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.linalg import solve_banded

from fluxtwin.sim.base.types import FloatArray

_MARGIN = 3  # nodes beyond each end, so that the end condition of the spline does not reach the data


def on_grid(days: FloatArray, function: Callable[[FloatArray], FloatArray], step_days: float) -> FloatArray:
    """`function(days)`, shape (N, K), by a cubic spline on a grid of `step_days`.

    days: (N,) in any order. function: (M,) -> (M, K), smooth over a few steps. Where the grid would not
    save work (few rows, or rows far apart) the function itself is called.
    """
    first, last = float(days.min()), float(days.max())
    nodes = int(np.ceil((last - first) / step_days)) + 1 + 2 * _MARGIN
    if days.size <= 2 * nodes:
        return function(days)
    grid: FloatArray = first + step_days * (np.arange(nodes, dtype=np.float64) - _MARGIN)
    return spline(first - _MARGIN * step_days, step_days, function(grid), days)


def spline(first: float, step: float, values: FloatArray, wanted: FloatArray) -> FloatArray:
    """(N, K) the cubic spline through values (M, K) at equal steps from `first` on, M >= 4; not-a-knot ends.

    The same as scipy's CubicSpline, without a fifth of a second to load what else is in scipy.interpolate.
    """
    # Continuous second derivatives make a tridiagonal system of the slopes d (per step); not-a-knot (a continuous third
    # derivative at the second knot) closes it: d0 + 2 d1 = (5 rise0 + rise1) / 2, and the same from the other end.
    count, rise = len(values), np.diff(values, axis=0)
    right = np.empty_like(values)
    right[1:-1] = 3.0 * (rise[:-1] + rise[1:])
    right[0] = 0.5 * (5.0 * rise[0] + rise[1])
    right[-1] = 0.5 * (5.0 * rise[-1] + rise[-2])
    bands = np.ones((3, count))
    bands[1, 1:-1] = 4.0
    bands[0, 1] = bands[2, -2] = 2.0
    slope = solve_banded((1, 1), bands, right)
    place = (wanted - first) / step
    knot = np.clip(place.astype(np.intp), 0, count - 2)
    t = (place - knot)[:, None]
    bend, turn = slope[:-1] - rise, rise - slope[1:]
    # y0 + t rise + t (1 - t) ((1 - t) bend + t turn) is the cubic with these ends and slopes.
    return np.asarray(values[knot] + t * rise[knot] + t * (1.0 - t) * ((1.0 - t) * bend[knot] + t * turn[knot]))
