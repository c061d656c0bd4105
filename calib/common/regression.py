"""Weighted linear regression of three components on shared regressors, stable and in bounded memory.

    y_k = M x_k + c + residual,   minimise sum a_k |residual_k|^2,   sum a_k = 1

This is journal eqs. 4-9 with [I+S T] = M and b = c when y = A B0 and x = [B; D]. The explicit inverses of eq. 8
are never formed. `gram`: one pass accumulates the centred covariance matrix and, at the same time, the
gradient at a start found from a sample of the rows; the step from that start is the refinement that makes it
agree with QR (1e-9, tested). `qr`: blocked Householder QR of the centred rows, used where the columns are so
nearly dependent that the Gram matrix would lose digits.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import solve_triangular

from fluxtwin.calib.common.moments import BLOCK_ROWS, blocks, paired
from fluxtwin.sim.base.types import FloatArray

_START_ROWS = 4096
_PASSES = 4
_LOSS = 1e-12  # largest relative rounding error that the Gram route may leave


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
    rows: int
    solver: str
    """`gram` or `qr`: which route was taken."""


@dataclass
class _Sums:
    x: FloatArray
    r: FloatArray
    xx: FloatArray
    xr: FloatArray
    rr: FloatArray


def regress(
    y: FloatArray, x_parts: Sequence[FloatArray], weights: FloatArray | None = None, *, solver: str = "gram"
) -> Regression:
    """Fit y (N, 3) by the columns of `x_parts` (each (N, k)) and a constant.

    weights: (N,) not negative, any scale; None for equal. Columns must be independent: see `observability`.
    """
    a = None if weights is None else np.asarray(weights, dtype=np.float64) / np.sum(weights)
    parts = [np.ascontiguousarray(part) for part in x_parts]
    y = np.ascontiguousarray(y)
    if solver == "gram":
        found = _by_gram(y, parts, a)
        if found is not None:
            return found
    return _by_qr(y, parts, a)


def residuals(y: FloatArray, x_parts: Sequence[FloatArray], M: FloatArray, c: FloatArray) -> FloatArray:
    """(N, 3) y - M x - c."""
    out = np.empty_like(y)
    turned = np.ascontiguousarray(M.T)
    offset = np.tile(c, (min(BLOCK_ROWS, len(y)), 1))  # as a block: broadcasting over three columns is slow
    for rows, x in blocks(x_parts, len(y)):
        np.subtract(y[rows], x @ turned, out=out[rows])
        out[rows] -= offset[: len(x)]
    return out


def _by_gram(y: FloatArray, parts: list[FloatArray], a: FloatArray | None) -> Regression | None:
    """The Gram route, or None where it would lose digits."""
    M, c = _start(y, parts, a)
    for _ in range(_PASSES):
        sums = _pass(y, parts, a, M, c)
        xx = sums.xx - np.outer(sums.x, sums.x)
        xr = sums.xr - np.outer(sums.x, sums.r)
        scale = np.sqrt(np.diag(sums.xx))
        if not (np.diag(xx) > 0).all() or not np.isfinite(M).all():
            return None
        values, vectors = np.linalg.eigh(xx / np.outer(scale, scale))
        if not values[0] > 1e-11:
            return None
        step = ((vectors / values) @ vectors.T @ (xr / scale[:, None])).T / scale
        offset = sums.r - step @ sums.x
        rr = _after_step(sums, step, offset)
        M, c = M + step, c + offset
        lost = np.finfo(float).eps / values[0] * np.abs(step * scale).max() / max(np.abs(M * scale).max(), 1e-300)
        if lost < _LOSS:
            return Regression(M, c, sums.x, xx, rr, len(y), "gram")
    return None


def _start(y: FloatArray, parts: list[FloatArray], a: FloatArray | None) -> tuple[FloatArray, FloatArray]:
    """Least squares on a sample of the rows: near enough for one step to finish."""
    every = slice(None, None, max(1, len(y) // _START_ROWS))
    root = np.ones(len(y[every])) if a is None else np.sqrt(a[every])
    x = np.hstack([part[every] for part in parts])
    scale = np.maximum(np.sqrt((x**2).mean(axis=0)), 1e-300)
    rows = np.hstack([x / scale, np.ones((len(x), 1))])
    solution = np.linalg.lstsq(rows * root[:, None], y[every] * root[:, None], rcond=None)[0]
    return solution[:-1].T / scale, solution[-1]


def _pass(y: FloatArray, parts: list[FloatArray], a: FloatArray | None, M: FloatArray, c: FloatArray) -> _Sums:
    m = M.shape[1]
    sums = _Sums(np.zeros(m), np.zeros(3), np.zeros((m, m)), np.zeros((m, 3)), np.zeros((3, 3)))
    offset = np.tile(c, (min(BLOCK_ROWS, len(y)), 1))
    turned = np.ascontiguousarray(M.T)
    for at, x in blocks(parts, len(y)):
        r = y[at] - x @ turned
        r -= offset[: len(r)]
        if a is None:
            _add(sums, x, x, r, r)
        else:
            _add(sums, x, x * a[at, None], r, r * a[at, None])
    if a is None:
        for name in ("x", "r", "xx", "xr", "rr"):
            setattr(sums, name, getattr(sums, name) / len(y))
    return sums


def _add(sums: _Sums, x: FloatArray, ax: FloatArray, r: FloatArray, ar: FloatArray) -> None:
    ones = np.ones(len(x))
    sums.x += ones @ ax
    sums.r += ones @ ar
    sums.xr += ax.T @ r
    sums.xx += paired(ax, x)
    sums.rr += paired(ar, r)


def _after_step(sums: _Sums, step: FloatArray, offset: FloatArray) -> FloatArray:
    """sum a r r' once the residual has moved by -(step x + offset)."""
    mean = step @ sums.x
    cross = step @ sums.xr + np.outer(offset, sums.r)
    moved = step @ sums.xx @ step.T + np.outer(mean, offset) + np.outer(offset, mean + offset)
    return np.asarray(sums.rr - cross - cross.T + moved)


def _by_qr(y: FloatArray, parts: list[FloatArray], a: FloatArray | None) -> Regression:
    rows = len(y)
    weight = np.full(rows, 1.0 / rows) if a is None else a
    mean_x = np.concatenate([weight @ part for part in parts])
    mean_y = weight @ y
    m = mean_x.size
    triangle = np.zeros((0, m + 3))
    for at, x in blocks(parts, rows):
        block = np.hstack([x - mean_x, y[at] - mean_y]) * np.sqrt(weight[at])[:, None]
        triangle = np.asarray(np.linalg.qr(np.vstack([triangle, block]), mode="r"), dtype=np.float64)
    triangle = np.vstack([triangle, np.zeros((max(0, m + 3 - len(triangle)), m + 3))])
    R, Q_y, rest = triangle[:m, :m], triangle[:m, m:], triangle[m:, m:]
    M = solve_triangular(R, Q_y).T
    return Regression(M, mean_y - M @ mean_x, mean_x, R.T @ R, rest.T @ rest, rows, "qr")
