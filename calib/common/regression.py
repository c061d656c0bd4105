"""Weighted linear regression of three components on shared regressors, stable and in bounded memory.

    y_k = M x_k + c + residual,   minimise sum a_k |residual_k|^2,   sum a_k = 1

This is journal eqs. 4-9 with [I+S T] = M and b = c when y = A B0 and x = [B; D]. The explicit inverses of eq. 8
are never formed: the centred rows are reduced to a triangle by Householder QR, block by block.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import solve_triangular
from scipy.linalg.lapack import dgeqrf

from fluxtwin.sim.base.types import FloatArray

BLOCK_ROWS = 16384


@dataclass(frozen=True)
class Regression:
    """Solution and moments; m regressors."""

    M: FloatArray
    """(3, m) slopes."""
    c: FloatArray
    """(3,) intercept."""
    mean_x: FloatArray
    """(m,) weighted mean <x>."""
    xx: FloatArray
    """(m, m) weighted covariance <x|x> (journal eq. 7)."""
    rr: FloatArray
    """(3, 3) sum of a_k r_k r_k'."""


def blocks(parts: Sequence[FloatArray], rows: int) -> Iterator[tuple[slice, FloatArray]]:
    """Slices of rows and the columns of all `parts` (each (N, k)) there, side by side; (n, 0) where there are none."""
    for start in range(0, rows, BLOCK_ROWS):
        at = slice(start, min(start + BLOCK_ROWS, rows))
        yield at, np.hstack([np.zeros((at.stop - start, 0)), *(part[at] for part in parts)])


def regress(y: FloatArray, x_parts: Sequence[FloatArray], weights: FloatArray | None = None) -> Regression:
    """Fit y (N, 3) by the columns of `x_parts` (each (N, k)) and a constant.

    weights: (N,) not negative, any scale; None for equal. Columns must be independent: see `observability`.
    """
    a = np.ones(len(y)) if weights is None else np.asarray(weights, dtype=np.float64)
    a = a / a.sum()
    mean_x = np.concatenate([np.zeros(0), *(a @ part for part in x_parts)])
    mean_y = a @ y
    m = mean_x.size
    columns = [part[:, j] for part in (*x_parts, y) for j in range(part.shape[1])]
    means, k = np.concatenate([mean_x, mean_y]), m + 3
    triangle, rows = np.zeros((k, k)), np.empty((0, k))
    for start in range(0, len(y), BLOCK_ROWS):
        at = slice(start, start + BLOCK_ROWS)
        root = np.sqrt(a[at])
        if len(rows) != k + root.size:
            rows = np.empty((k + root.size, k), order="F")
        rows[:k] = triangle
        for j, column in enumerate(columns):  # one by one: numpy is slow along rows of a few numbers
            np.subtract(column[at], means[j], out=rows[k:, j])
            rows[k:, j] *= root
        rows = dgeqrf(rows, overwrite_a=True)[0]
        triangle = np.triu(rows[:k])
    R, Q_y, rest = triangle[:m, :m], triangle[:m, m:], triangle[m:, m:]
    M = solve_triangular(R, Q_y).T
    return Regression(M, mean_y - M @ mean_x, mean_x, R.T @ R, rest.T @ rest)


def residuals(y: FloatArray, x_parts: Sequence[FloatArray], M: FloatArray, c: FloatArray) -> FloatArray:
    """(N, 3) y - M x - c."""
    return np.concatenate([y[at] - x @ M.T - c for at, x in blocks(x_parts, len(y))])


def solve_scaled(matrix: FloatArray, vector: FloatArray, damping: float = 0.0, rcond: float = 1e-13) -> FloatArray:
    """matrix^-1 vector of a symmetric matrix in scaled columns, with Marquardt's damping; directions that are not there are
    left out."""
    scale = np.sqrt(np.maximum(np.diag(matrix), 1e-300))
    scaled = matrix / np.outer(scale, scale) + damping * np.eye(len(scale))
    return np.asarray(np.linalg.lstsq(scaled, vector / scale, rcond=rcond)[0] / scale)
