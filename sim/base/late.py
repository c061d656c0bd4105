"""A column that changes, and one that acts late: some time after it was recorded, behind a first-order lag, or both."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fluxtwin.sim.base.types import BoolArray, FloatArray

_TRIED_S = (1.0, 3.0, 10.0, 30.0, 100.0, 300.0, 1000.0)
"""Delays and lags that a search tries; it moves them by up to a factor of two to either side."""
_SHARES = (0.0, 0.25, 0.5, 0.75, 1.0)
_MOVED = 1.25
_LONGEST = 0.1
"""Of the record: a delay or lag must pass several times."""
_ROUNDING_S = 1e-6
_GAP = 5.0  # usual spacings without a row: nothing is fitted across
_FORGOTTEN = 0.01
"""Of a lag's memory, that may be of values which nobody knows: the field of a unit is hardly known better than to 1 %."""


def varies(column: FloatArray, least: float = 1e-6) -> bool:
    """Whether a column moves by more than a millionth of its largest value (or of one unit)."""
    return bool(np.ptp(column) > least * max(1.0, float(np.abs(column).max())))


def lateness_tried(seconds: FloatArray) -> list[tuple[float, float]]:
    """Delays and lags [s] that rows at these moments (N,) can show, none first."""
    step_s, whole_s = float(np.median(np.diff(seconds, prepend=0.0))), float(seconds[-1])
    tried = [s for s in _TRIED_S if 0.5 * step_s < s < _LONGEST * whole_s]
    return [(0.0, 0.0), *((s, 0.0) for s in tried), *((0.0, s) for s in tried)]


def lateness_near(delay_s: float, lag_s: float) -> list[tuple[float, float]]:
    """Delays and lags [s] as late in all, or 1.25 times more or less, with other shares of both; of none, none."""
    whole_s = delay_s + lag_s
    parts = [(share, whole_s * size) for share in _SHARES for size in (1.0, _MOVED, 1.0 / _MOVED)]
    return [(share * late_s, (1.0 - share) * late_s) for share, late_s in parts] if whole_s else []


def late(seconds: FloatArray, column: FloatArray, delay_s: float | FloatArray, lag_s: float) -> FloatArray:
    """(N,) a column (N,) that has a value somewhere, `delay_s` (or (N,)) before, then behind a first-order lag.

    Between its samples a column of two values holds the last one, any other is a straight line. What it was before
    the first row, or in a gap of the rows, is what it was after; the lag starts in balance there. Where values are missing
    it is bridged: which rows hang on that says `bridged`.
    """
    if not np.any(delay_s) and not lag_s and np.isfinite(column).all():
        return column
    known = np.isfinite(column)
    moments, samples, values = _moments(seconds, delay_s), seconds[known], column[known]
    if np.unique(values).size <= 2:
        values = values[np.maximum(np.searchsorted(samples, moments + _ROUNDING_S, side="right") - 1, 0)]
    else:
        values = np.interp(moments, samples, values)
    return low_pass(seconds, values[:, None], lag_s, restarts(seconds))[:, 0]


def bridged(seconds: FloatArray, column: FloatArray, delay_s: float, lag_s: float) -> BoolArray:
    """(N,) rows in which `late` has to invent what the column (N,) was.

    That is where a value is missing, so that samples are two or more of their usual distances apart in rows, and as long as
    a lag remembers it.
    """
    samples = np.flatnonzero(np.isfinite(column))
    if samples.size in (0, column.size):
        return np.full(column.size, not samples.size, dtype=np.bool_)
    apart = np.diff(samples, prepend=-1, append=column.size)
    unknown = apart >= 2.0 * np.median(np.diff(samples)) if samples.size > 1 else apart > 1
    moments, stamps = _moments(seconds, delay_s), seconds[samples]
    after = np.searchsorted(stamps, moments + _ROUNDING_S, side="right")
    on_sample = (after > 0) & (moments - stamps[np.maximum(after - 1, 0)] <= _ROUNDING_S)
    share = (unknown[after] & ~on_sample).astype(np.float64)
    return np.asarray(low_pass(seconds, share[:, None], lag_s, restarts(seconds))[:, 0] > _FORGOTTEN)


def _moments(seconds: FloatArray, delay_s: float | FloatArray) -> FloatArray:
    """(N,) when a column was what it is felt as `delay_s` later; no earlier than the stretch without gaps begins."""
    stretch = stretches(seconds)
    return np.maximum(seconds - delay_s, seconds[np.searchsorted(stretch, stretch)])


def stretches(time_s: FloatArray) -> NDArray[np.intp]:
    """(N,) number of the stretch without gaps that a stamp belongs to."""
    steps = np.diff(time_s)
    usual = float(np.median(steps)) if steps.size else 1.0
    return np.concatenate([[0], np.cumsum(steps > _GAP * usual)]).astype(np.intp)


def restarts(seconds: FloatArray) -> BoolArray:
    """(N,) True in the first row and after each gap (more than five times the usual spacing)."""
    return np.diff(stretches(seconds), prepend=-1) > 0


def low_pass(
    seconds: FloatArray,
    signal: FloatArray,
    tau_s: float,
    restart: BoolArray,
    slope: FloatArray | None = None,
    start: FloatArray | None = None,
) -> FloatArray:
    """First-order low-pass tau y' + y = x of a signal (N, k) known at uneven stamps.

    Between stamps x is a straight line, or, with its slope (N, k) at the stamps, the cubic that has these
    values and slopes. The answer to that is exact: the particular solution that a cubic has, the sum of
    (-tau)^n times its n-th derivative, and a decaying exponential. Each stretch starts with `start` (N, k), or in
    balance, or, with slopes, with the delay of a steady one.
    """
    from fluxtwin.sim.base.recursion_kernels import recursion

    if tau_s <= 0.0 or seconds.size < 2:
        return signal
    step = np.diff(seconds)[:, None]
    rise = (signal[1:] - signal[:-1]) / step
    before, after = (rise, rise) if slope is None else (slope[:-1], slope[1:])
    second = 2.0 * (3.0 * rise - 2.0 * before - after) / step  # at the left end
    third = 6.0 * (before + after - 2.0 * rise) / step**2
    left = signal[:-1] - tau_s * before + tau_s**2 * second - tau_s**3 * third
    right = signal[1:] - tau_s * after + tau_s**2 * (second + step * third) - tau_s**3 * third
    keep = np.concatenate([[0.0], np.exp(-step[:, 0] / tau_s)])
    driven = np.zeros_like(signal)
    driven[1:] = right - keep[1:, None] * left
    if start is None:
        start = signal if slope is None else signal - tau_s * slope
    return np.asarray(recursion(keep, driven, start, restart))
