"""Scalar maximum likelihood: the residual of |B| itself is minimised, a quadratic cost where TWOSTEP's is quartic.

    minimise sum a_k r_k^2 / q_k                     r, q as in `model`

by Levenberg's and Marquardt's method, then steps to where the adjusted score vanishes.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fluxtwin.calib.common.regression import solve_scaled
from fluxtwin.calib.scalar.model import ScalarData, blocks, corrected, own_noise, residual, terms, unpack
from fluxtwin.sim.base.types import FloatArray

_ROUNDS = 60
_ADJUSTMENTS = 50
_SETTLED = 1e-8  # of the squared step in sigmas of the residual


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
        p = p + step
        now = add_up(p, data, a)
        rounds += 1
        if _settled(step, now, data):
            break
    else:
        converged = converged and not adjusted
    return Solved(p, now, converged and _proper(p, data), rounds)


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
