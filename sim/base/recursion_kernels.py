"""Kernels of series whose every row depends on the rows before."""

from __future__ import annotations

import numpy as np

from fluxtwin.sim.base.kernel_cache import kernel
from fluxtwin.sim.base.types import BoolArray, FloatArray


@kernel()
def recursion(keep: FloatArray, driven: FloatArray, start: FloatArray, restart: BoolArray) -> FloatArray:
    """y_t = keep_t y_(t-1) + driven_t, or start_t where restart_t. keep (N,), driven and start (N, k)."""
    rows, width = driven.shape
    answer = np.empty((rows, width))
    for row in range(rows):
        for column in range(width):
            if restart[row]:
                answer[row, column] = start[row, column]
            else:
                answer[row, column] = keep[row] * answer[row - 1, column] + driven[row, column]
    return answer


@kernel()
def played(signal: FloatArray, half_width: float, neutral: FloatArray) -> FloatArray:
    """The play operator along the rows of signal (N, k), from neutral (k,)."""
    rows, width = signal.shape
    answer = np.empty((rows, width))
    for column in range(width):
        output = neutral[column]
        for row in range(rows):
            output = min(max(output, signal[row, column] - half_width), signal[row, column] + half_width)
            answer[row, column] = output
    return answer
