"""A whitened residual with fitted columns out of it, and the algebra that treats other columns alike."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy import stats
from scipy.linalg import blas, lapack
from scipy.special import fdtrc

from fluxtwin.sim.base.types import FloatArray

SHARE_LEFT = 1e-6
"""Of its energy that a column, or a combination of columns, must have left after projection to count as a direction."""
SHARE_PICKED = 1e-8
"""The same beside columns that were picked before it, in `span_of`."""


class Whitens(Protocol):
    """What turns nT into independent unit noise."""

    @property
    def measured(self) -> int:
        """Number of scalar measurements that are not cut."""

    def apply(self, columns: FloatArray) -> FloatArray:
        """Whiten (N, 3) or (N, 3, P); rows that are cut come back as zeros."""


@dataclass(frozen=True, eq=False)
class ProjectedResidual:
    """A whitened residual with the fitted columns out of it, and what is needed to treat columns alike."""

    whitener: Whitens
    residual: FloatArray
    """(3N,) whitened, orthogonal to `basis`."""
    basis: FloatArray
    """(3N, q) orthonormal: the whitened fitted columns."""
    degrees: int
    """Degrees of freedom that are left."""

    @property
    def least_share(self) -> float:
        """Of its energy that an image must have beside the fitted columns."""
        return least_share(self.whitener)

    @property
    def energy(self) -> float:
        """Residual sum of squares in units of the noise variance."""
        return float(self.residual @ self.residual)

    def project(self, columns: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Columns (N, 3, k) whitened and freed of the basis, (3N, k), and their squared sizes before, (k,)."""
        white = self.whitener.apply(np.ascontiguousarray(columns)).reshape(self.residual.size, -1)
        size = np.einsum("ij,ij->j", white, white)
        return white - self.basis @ (self.basis.T @ white), size


def projected(whitener: Whitens, residual_nT: FloatArray, fitted: FloatArray) -> ProjectedResidual:
    """Whiten a residual (N, 3) and project the fitted columns (N, 3, q), in nT, out of it."""
    white = whitener.apply(residual_nT)
    return projected_white(whitener, white, whitener.apply(np.ascontiguousarray(fitted)).reshape(white.size, -1))


def projected_white(whitener: Whitens, white: FloatArray, columns: FloatArray) -> ProjectedResidual:
    """The same for what is whitened already: a residual (N, 3) and columns (3N, q), or (N, 3, q)."""
    flat, basis = white.reshape(-1), orthonormal(columns)
    rest = flat - basis @ (basis.T @ flat)
    return ProjectedResidual(whitener, rest, basis, max(whitener.measured - basis.shape[1], 1))


def left_beside(whitener: Whitens, white: FloatArray, columns: FloatArray, likely: FloatArray) -> ProjectedResidual:
    """As `projected_white`, less the likeliest combination of further columns (N, 3, p), whose coefficients have a prior
    standard deviation of 1, beside unit noise."""
    left = projected_white(whitener, white, columns)
    free = projected_out(left.basis, likely.reshape(left.residual.size, -1))
    size = np.linalg.solve(free.T @ free + np.eye(free.shape[1]), free.T @ left.residual)
    return ProjectedResidual(whitener, left.residual - free @ size, left.basis, left.degrees)


def orthonormal(columns: FloatArray) -> FloatArray:
    """(M, r) orthonormal basis of the span of columns (M, k), or (N, 3, k) with M = 3N; dead and dependent ones fall out."""
    flat = columns.reshape(int(np.prod(columns.shape[:-1])), columns.shape[-1])
    size = np.sqrt(np.einsum("ij,ij->j", flat, flat))
    unit = flat[:, size > 0] / size[size > 0]
    value, vector = np.linalg.eigh(unit.T @ unit)
    seen = value > SHARE_LEFT**2
    basis = unit @ (vector[:, seen] / np.sqrt(value[seen]))
    # Once more: the square root of the tolerance is all that one pass gives.
    q, _ = np.linalg.qr(basis)
    return np.asarray(q)


def projected_out(basis: FloatArray, columns: FloatArray) -> FloatArray:
    """Columns (M, k) or (M,) with an orthonormal basis (M, q) out of them to rounding, which takes two passes."""
    for _ in range(2):
        columns = columns - basis @ (basis.T @ columns)
    return columns


def explained(gram: FloatArray, moment: FloatArray, least: float) -> tuple[float, int]:
    """Drop of chi-square by columns of a Gram matrix (k, k) and of products (k,) with the residual, and its directions:
    those of more energy than the least."""
    values, vectors = np.linalg.eigh(gram)
    seen = values > least
    return float(np.sum((vectors[:, seen].T @ moment) ** 2 / values[seen])), int(seen.sum())


def explained_in_units(gram: FloatArray, moment: FloatArray) -> tuple[float, int]:
    """The same of columns in any units, each over its length: as `SHARE_LEFT` has it."""
    scale = np.sqrt(np.maximum(np.diag(gram), 0.0))
    scale = np.where(scale > 0, scale, 1.0)
    return explained(gram / np.outer(scale, scale), moment / scale, SHARE_LEFT)


def log10_sf_f(ratio: float, rank: float, spare: float) -> float:
    """log10 of the upper tail of the F law, also where it underflows."""
    p = float(fdtrc(rank, spare, ratio))
    if p > 1e-280:
        return float(np.log10(p))
    # Leading term of the tail: I_x(spare/2, rank/2) with x -> 0 (Abramowitz & Stegun 26.5.4).
    x = spare / (spare + rank * ratio)
    a, b = spare / 2, rank / 2
    log_beta = float(stats.beta.logpdf(0.5, a, b)) - (a + b - 2) * np.log(0.5)
    return float((a * np.log(x) + (b - 1) * np.log1p(-x) + log_beta - np.log(a)) / np.log(10))


def least_share(whitener: object) -> float:
    """`share_of_errors` for what a whitener takes the attitude error to be, or for one without a noise model."""
    noise = getattr(whitener, "noise", None)
    return share_of_errors(None if noise is None else noise.theta_rad, SHARE_LEFT)


def share_of_errors(theta_rad: float | None, least: float) -> float:
    """Share of its energy that an image must have left beside others to be more than attitude error.

    An image made with attitudes that are off by theta is off by theta of its length. Where others make up all but a
    share of theta**2 of it, what is left is that error, which the residual has too: such directions are passed over.
    The factor covers errors that smoothing leaves in many rows.
    """
    return least if theta_rad is None else float(np.clip(50.0 * theta_rad**2, least, 0.05))


@dataclass(frozen=True, eq=False)
class Span:
    """The independent ones among many columns, and what turns them into an orthonormal basis."""

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
        return np.asarray(blas.dtrsm(1.0, self.factor, picked.T, lower=1, overwrite_b=1).T)

    def coefficients(self, along: FloatArray, count: int) -> FloatArray:
        """(count,) coefficients of all columns that make up what has coordinates `along` (r,) in the basis."""
        found = np.zeros(count)
        if self.rank:
            found[self.number] = blas.dtrsv(self.factor, along, lower=1, trans=1) / self.size
        return found


def span_of(columns: FloatArray, share_left: float = SHARE_PICKED) -> Span:
    """The span of columns (M, P) in any units; dead ones are never picked.

    A pivoted Cholesky factor of the Gram matrix (LAPACK's dpstrf) picks, one after the other, the column of which most is
    left beside those already picked, until no column has more than a share of its energy left.
    """
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
