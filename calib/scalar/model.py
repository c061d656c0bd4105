"""The model of |B|: y = (I+D)(B - sum_j s_j I_j) - b, and |y| = |H|, with what the noise of B does to it.

D is symmetric; this is Alonso & Shuster's form, with Springmann & Cutler's (2012) fields that follow a column I_j of
telemetry. All numbers here are free of units: B, H, b in parts of the rms field, I_j in parts of its own rms.

The residual of a row, to second order in the noise eps of B with covariance Sigma, P = I+D, u = y/|y|,

    r = |y| - |H| - (tr PSP - u'PSPu) / (2|H|),    variance q = u'PSPu                                   (S = Sigma)

has mean zero, but it is correlated with its own derivative g, which is made of the same noisy B: E[g r] is not zero.
Least squares would be biased by about (sigma/|H|)^2, one sigma at ten thousand rows. The score here has that term
taken off, so that its mean vanishes at the truth (an adjusted score, as in Kukush, Markovsky & Van Huffel 2004 for
the ellipsoid).
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from fluxtwin.calib.common.conventions import PAIRS, six_of, symmetric
from fluxtwin.sim.base.types import FloatArray

_BLOCK_ROWS = 32768


class ScalarData(NamedTuple):
    """Rows without units."""

    B: FloatArray
    """(N, 3)."""
    H: FloatArray
    """(N,)."""
    columns: FloatArray
    """(N, J)."""
    Sigma: FloatArray
    """(3, 3) noise covariance of B."""
    with_D: bool

    @property
    def size(self) -> int:
        """Number of parameters: 6 of D, 3 of b, 3 for each column."""
        return (6 if self.with_D else 0) + 3 + 3 * int(self.columns.shape[1])


class Terms(NamedTuple):
    """Residual and derivatives of some rows."""

    r: FloatArray
    """(n,)."""
    g: FloatArray
    """(n, p) dr/dp."""
    q: FloatArray
    """(n,) variance of r."""
    shared: FloatArray
    """(n, p) E[dg r] - g E[dq r]/q: what noise common to weight, derivative and residual adds to the score times q."""


def unpack(p: FloatArray, data: ScalarData) -> tuple[FloatArray, FloatArray, FloatArray]:
    """D (3, 3), b (3,), s (J, 3)."""
    at = 6 if data.with_D else 0
    D = symmetric(p[:6]) if data.with_D else np.zeros((3, 3))
    return D, p[at : at + 3], p[at + 3 :].reshape(-1, 3)


def pack(D: FloatArray, b: FloatArray, data: ScalarData) -> FloatArray:
    """(p,) with s = 0."""
    head = six_of(D) if data.with_D else []
    return np.concatenate([head, b, np.zeros(3 * data.columns.shape[1])])


def blocks(data: ScalarData) -> Iterator[tuple[slice, ScalarData]]:
    """The rows in pieces that stay small."""
    for start in range(0, len(data.H), _BLOCK_ROWS):
        at = slice(start, start + _BLOCK_ROWS)
        yield at, data._replace(B=data.B[at], H=data.H[at], columns=data.columns[at])


def corrected(p: FloatArray, data: ScalarData) -> tuple[FloatArray, FloatArray, FloatArray]:
    """P = I + D (3, 3), the reading x without the fields of columns and y = x P - b, both (N, 3)."""
    D, b, s = unpack(p, data)
    P = np.eye(3) + D
    x = data.B - data.columns @ s
    return P, x, x @ P - b


def residual(p: FloatArray, data: ScalarData) -> FloatArray:
    """(N,) r alone."""
    P, _, y = corrected(p, data)
    size = np.sqrt((y**2).sum(axis=1))
    spread = P @ data.Sigma @ P
    along = ((y @ spread) * y).sum(axis=1) / size**2
    return np.asarray(size - data.H - (np.trace(spread) - along) / (2.0 * data.H))


def terms(p: FloatArray, data: ScalarData) -> Terms:
    """Residual, derivative, variance and what noise does to them, at parameters p."""
    P, x, y = corrected(p, data)
    size = np.sqrt((y**2).sum(axis=1))
    u = y / size[:, None]
    spread = P @ data.Sigma @ P
    turned = u @ spread
    q = (turned * u).sum(axis=1)
    across = (turned - q[:, None] * u) / data.H[:, None]  # E[du r]
    g = _derivative(u, x, P, data)
    shared = _derivative(across, x, P, data)
    if data.with_D:
        shared[:, :6] += _symmetric(u, u @ P @ data.Sigma)
    shared -= g * (2.0 * data.H * (across**2).sum(axis=1) / q)[:, None]
    r = size - data.H - (np.trace(spread) - q) / (2.0 * data.H)
    return Terms(r, g, q, shared)


def _derivative(u: FloatArray, x: FloatArray, P: FloatArray, data: ScalarData) -> FloatArray:
    """(n, p) u'dy/dp."""
    parts = [_symmetric(u, x)] if data.with_D else []
    parts.append(-u)
    parts += [-(u @ P) * data.columns[:, j : j + 1] for j in range(data.columns.shape[1])]
    return np.hstack(parts)


def _symmetric(u: FloatArray, x: FloatArray) -> FloatArray:
    """(n, 6) u'Ux for the six symmetric units U."""
    return np.stack([u[:, i] * x[:, j] + (u[:, j] * x[:, i] if i != j else 0.0) for i, j in PAIRS], axis=1)


def own_noise(p: FloatArray, data: ScalarData) -> FloatArray:
    """(n, p, 3): how each derivative moves with each component of the noise of B."""
    P, x, y = corrected(p, data)
    u = y / np.sqrt((y**2).sum(axis=1))[:, None]
    out = np.empty((len(u), data.size, 3))
    for k in range(3):
        moved = (P[k] - (u @ P[k])[:, None] * u) / data.H[:, None]  # du/d eps_k
        out[:, :, k] = _derivative(moved, x, P, data)
        if data.with_D:
            out[:, :6, k] += _symmetric(u, np.broadcast_to(np.eye(3)[k], u.shape))
    return out
