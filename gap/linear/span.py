"""The independent ones among many columns, and an orthonormal basis of what they span.

A pivoted Cholesky factor of the Gram matrix (LAPACK's dpstrf) picks, one after the other, the column of which most is
left beside those already picked, until no column has more than a hundred millionth of its energy left. What is picked
first spans most, so the leading part of the basis is a coarser basis of the same columns.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import blas, lapack

from fluxtwin.sim.base.types import FloatArray

SHARE_LEFT = 1e-8
"""Of its energy that a column may have left beside the picked ones."""


@dataclass(frozen=True, eq=False)
class Span:
    """Which columns were picked, and what turns them into an orthonormal basis."""

    number: NDArray[np.intp]
    """(r,) of the picked columns, in the order in which they were picked."""
    size: FloatArray
    """(r,) their lengths."""
    factor: FloatArray
    """(r, r) lower triangular: columns over their lengths are the basis times its transpose."""

    @property
    def rank(self) -> int:
        return int(self.number.size)

    def basis(self, columns: FloatArray) -> FloatArray:
        """(M, r) orthonormal basis, from the columns (M, P) that the span was found in."""
        picked = columns[:, self.number] / self.size
        if not self.rank:
            return picked
        return np.asarray(blas.dtrsm(1.0, self.factor, picked.T, lower=1, overwrite_b=1).T)

    def coefficients(self, along: FloatArray, count: int) -> FloatArray:
        """(count,) coefficients of all columns that make up what has coordinates `along` (r,) in the basis."""
        found = np.zeros(count)
        if self.rank:
            found[self.number] = blas.dtrsv(self.factor, along, lower=1, trans=1) / self.size
        return found


def span_of(columns: FloatArray, share_left: float = SHARE_LEFT) -> Span:
    """The span of columns (M, P) in any units; dead ones are never picked."""
    size = np.sqrt(np.einsum("ij,ij->j", columns, columns))
    live = np.flatnonzero(size > 0)
    if not live.size:
        return Span(np.zeros(0, dtype=np.intp), np.zeros(0), np.zeros((0, 0)))
    unit = columns if live.size == columns.shape[1] else columns[:, live]
    scale = 1.0 / size[live]
    gram = (unit.T @ unit) * scale * scale[:, None]
    factor, pivots, rank, _ = lapack.dpstrf(gram.T, tol=share_left, lower=1, overwrite_a=1)
    picked = pivots[:rank] - 1
    return Span(live[picked], size[live[picked]], np.asfortranarray(np.tril(factor[:rank, :rank])))
