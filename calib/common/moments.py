"""Long arrays block by block, and stretches that stand for a whole record."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from fluxtwin.sim.base.types import FloatArray

BLOCK_ROWS = 16384
_STRETCHES = 10


def blocks(parts: Sequence[FloatArray], rows: int) -> Iterator[tuple[slice, FloatArray]]:
    """Slices of rows and the columns of all `parts` (each (N, k)) there, side by side; (n, 0) where there are none."""
    for start in range(0, rows, BLOCK_ROWS):
        at = slice(start, min(start + BLOCK_ROWS, rows))
        yield at, np.hstack([np.zeros((at.stop - start, 0)), *(part[at] for part in parts)])


def stretches(rows: int, most: int) -> np.ndarray:
    """Indices of at most `most` rows in ten stretches of consecutive rows, spread over the record."""
    if rows <= most:
        return np.arange(rows)
    length = most // _STRETCHES
    starts = np.linspace(0, rows - length, _STRETCHES).astype(int)
    return np.unique((starts[:, None] + np.arange(length)).ravel())
