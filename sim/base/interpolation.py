"""Slow functions of time, splined on a coarse grid: a long series is summed a few times, not a million."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

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
    from scipy.interpolate import CubicSpline  # here: it takes a fifth of a second to load

    return np.asarray(CubicSpline(grid, function(grid))(days))
