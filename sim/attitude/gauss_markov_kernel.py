"""The recursion of Gauss-Markov noise, compiled."""

from __future__ import annotations

from fluxtwin.sim.base.kernel_cache import kernel
from fluxtwin.sim.base.types import FloatArray


@kernel(nogil=True)
def follow(factor: FloatArray, driven: FloatArray, out: FloatArray) -> None:
    """out[i + 1] = factor[i] out[i] + driven[i], column by column, from out[0] on; shapes (N - 1,), (N - 1, C), (N, C)."""
    for i in range(factor.shape[0]):
        for column in range(driven.shape[1]):
            out[i + 1, column] = factor[i] * out[i, column] + driven[i, column]
