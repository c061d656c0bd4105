"""The model of |B|, y = (I+D)(B - sum_j s_j I_j) - b and |y| = |H|, with what the noise of B does to it; its likelihood.

D is symmetric; this is Alonso & Shuster's form, with Springmann & Cutler's (2012) fields that follow a column I_j of
telemetry. All numbers here are free of units: B, H, b in parts of the rms field, I_j in parts of its own rms.

The residual of a row, to second order in the noise eps of B with covariance Sigma, P = I+D, u = y/|y|,

    r = |y| - |H| - (tr PSP - u'PSPu) / (2|H|),    variance q = u'PSPu                                   (S = Sigma)

has mean zero, but it is correlated with its own derivative g, which is made of the same noisy B: E[g r] is not zero.
Least squares would be biased by about (sigma/|H|)^2, one sigma at ten thousand rows. The score here has that term
taken off, so that its mean vanishes at the truth (an adjusted score, as in Kukush, Markovsky & Van Huffel 2004 for
the ellipsoid).

Maximum likelihood minimises the residual of |B| itself, a quadratic cost where TWOSTEP's is quartic,

    sum a_k r_k^2 / q_k

by Levenberg's and Marquardt's method, then steps to where the adjusted score vanishes.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from fluxtwin.calib.common.conventions import PAIRS, six_of, symmetric
from fluxtwin.calib.common.regression import solve_scaled
from fluxtwin.calib.common.robust import rows_to_keep
from fluxtwin.sim.base.types import FloatArray

_BLOCK_ROWS = 32768
_ROUNDS = 60
_ADJUSTMENTS = 50
_SETTLED = 1e-8  # of the squared step in sigmas of the residual


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


class Sums(NamedTuple):
    """What the rows add up to at some parameters."""

    score: FloatArray
    """(p,) sum a g r / q."""
    shared: FloatArray
    """(p,) sum a shared / q: the mean of the score from noise alone."""
    information: FloatArray
    """(p, p) sum a g g' / q."""
    from_noise: FloatArray
    """(p, p) the part of it that noise of B gives."""
    cost: float
    """sum a r^2 / q."""


class Solved(NamedTuple):
    """Where the search ended."""

    p: FloatArray
    sums: Sums
    converged: bool
    rounds: int


def add_up(p: FloatArray, data: ScalarData, a: FloatArray | None = None, *, noise: bool = False) -> Sums:
    """Sums over the rows; a: (N,) weights of any scale, None for one each. `from_noise` is zero unless asked for."""
    size = data.size
    score, shared = np.zeros(size), np.zeros(size)
    information, from_noise, cost = np.zeros((size, size)), np.zeros((size, size)), 0.0
    for at, part in blocks(data):
        of = terms(p, part)
        w = (1.0 if a is None else a[at]) / of.q
        weighted = of.g * w[:, None]
        score += weighted.T @ of.r
        shared += w @ of.shared
        information += weighted.T @ of.g
        cost += float((w * of.r) @ of.r)
        if noise:
            own = own_noise(p, part)
            turned = np.einsum("nik,kl->nil", own, data.Sigma)
            from_noise += np.einsum("nik,njk->ij", turned * w[:, None, None], own)
    return Sums(score, shared, information, 0.5 * (from_noise + from_noise.T), cost)


def solve(
    p: FloatArray,
    data: ScalarData,
    a: FloatArray | None = None,
    *,
    adjusted: bool = True,
) -> Solved:
    """Search from p. a: (N,) weights. adjusted False stops at plain least squares."""
    now, rounds, converged = add_up(p, data, a), 0, False
    damping = 1e-3
    while rounds < _ROUNDS and damping < 1e10 and not converged:
        rounds += 1
        step = -solve_scaled(now.information, now.score, damping)
        # The variances stay as they are for the comparison: a larger q must not pay for a larger r.
        if _cost(p + step, data, _variances(p, data, a)) <= now.cost:
            p, damping = p + step, max(damping * 0.1, 1e-12)
            now = add_up(p, data, a)
            converged = _settled(step, now, data)
        else:
            converged = _settled(step, now, data) and damping < 1.0
            damping *= 10.0
    for _ in range(_ADJUSTMENTS if adjusted and converged else 0):
        step = -solve_scaled(now.information, now.score - now.shared)
        if not _proper(p + step, data):
            converged = False  # no cost bounds these steps: where columns hardly show, they may run away
            break
        p = p + step
        now = add_up(p, data, a)
        rounds += 1
        if _settled(step, now, data):
            break
    else:
        converged = converged and not adjusted
    return Solved(p, now, converged and _proper(p, data), rounds)


def without_outliers(p: FloatArray, data: ScalarData, start: FloatArray, kind: str) -> tuple[FloatArray, np.ndarray]:
    """A solution before the noise is known, and the rows (N,) that are no outliers; start and kind as of `rows_to_keep`."""

    def refit(weights: FloatArray) -> FloatArray:
        nonlocal p
        p = solve(p, data, weights, adjusted=False).p
        return residual(p, data)[:, None]

    kept = rows_to_keep(start, refit, kind)
    return p, kept


def _settled(step: FloatArray, now: Sums, data: ScalarData) -> bool:
    return float(step @ now.information @ step) < _SETTLED * max(1.0, now.cost / len(data.H))


def _variances(p: FloatArray, data: ScalarData, a: FloatArray | None) -> FloatArray:
    """(N,) a / q."""
    P, _, y = corrected(p, data)
    q = ((y @ (P @ data.Sigma @ P)) * y).sum(axis=1) / (y**2).sum(axis=1)
    return np.asarray((1.0 if a is None else a) / q)


def _cost(p: FloatArray, data: ScalarData, weight: FloatArray) -> float:
    """sum of weight r^2, infinite where I + D is not positive."""
    if not _proper(p, data):
        return float("inf")
    return float((weight * residual(p, data) ** 2).sum())


def _proper(p: FloatArray, data: ScalarData) -> bool:
    """Finite, and I + D positive: the same |y| has a twin for every axis turned over."""
    return bool(np.isfinite(p).all()) and float(np.linalg.eigvalsh(np.eye(3) + unpack(p, data)[0])[0]) > 0.0
