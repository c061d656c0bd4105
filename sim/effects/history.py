"""Answers that depend on what came before: relaxation, low-pass, and the play of a hysteresis loop.

All run along the rows once, in kernels that are compiled when first used.
"""

from __future__ import annotations

import numpy as np

from fluxtwin.sim.base.types import BoolArray, FloatArray

_GAP = 5.0


def restarts(seconds: FloatArray) -> BoolArray:
    """(N,) True in the first row and after each gap (more than five times the usual spacing)."""
    steps = np.diff(seconds)
    usual = float(np.median(steps)) if steps.size else 1.0
    return np.concatenate([[True], steps > _GAP * usual])


def relax(seconds: FloatArray, goal: FloatArray, time_constant_s: float, *, start: float) -> FloatArray:
    """(N,) what follows `goal` (N,) with a time constant; between stamps the goal is the mean of both ends."""
    from fluxtwin.sim.base.recursion_kernels import recursion

    keep = np.exp(-np.diff(seconds, prepend=seconds[0]) / time_constant_s)
    between = 0.5 * (goal + np.concatenate([goal[:1], goal[:-1]]))
    first = np.zeros(seconds.size, dtype=np.bool_)
    first[0] = True
    followed: FloatArray = recursion(keep, ((1.0 - keep) * between)[:, None], np.full((seconds.size, 1), start), first)
    return followed[:, 0]


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
    answer: FloatArray = recursion(keep, driven, start, restart)
    return answer


def play(signal: FloatArray, half_width: float, neutral: FloatArray) -> FloatArray:
    """Play operator (N, k): the output stays where it is until the input pushes it, half_width away.

    y_t = min(max(y_(t-1), x_t - w), x_t + w) (Visintin 1994, Differential Models of Hysteresis, section III.2),
    from y = neutral (k,) before the first row.
    """
    from fluxtwin.sim.base.recursion_kernels import played

    moved: FloatArray = played(np.ascontiguousarray(signal), half_width, np.asarray(neutral, dtype=np.float64))
    return moved
