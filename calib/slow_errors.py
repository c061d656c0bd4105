"""Errors that hang together in time: how much of the residual they are, and what they add to the covariance.

Model: the residual of each axis is white noise plus a first-order Gauss-Markov error of memory tau,

    Cov(r(t), r(t')) = C [(1-share) delta + share exp(-|t-t'|/tau)],   C (3, 3) between the axes.

tau and share are not known, and the fit itself has eaten part of the slow error; so both are weighed on a grid by the
restricted likelihood (Patterson & Thompson 1971, Biometrika 58, 545), which allows for what was fitted, computed by
a Kalman filter for all of the grid at once.

Reading and reference both carry errors. If what is regressed on shares them with the residual r, the likelihood gives
up part of the slopes and takes the smooth field itself for a slow error. Between the dependent variable y and the fit
y - r lies a mixture y - w r without r's errors; w is not known, a wrong one can only seem to explain more, so of
w = 0, 1/4 ... 1 the one with the lowest largest likelihood is taken. What the fit has eaten is given an rms like the
residual's own, not a free size. The covariance of ordinary least squares under correlated errors,
(X'X)^-1 X' V X (X'X)^-1, is then averaged over the grid. The prior is flat in log tau up to half of the longest
stretch, and on the shares listed below.

Long records are averaged into cells first: what is shorter than a cell is white for this purpose.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from fluxtwin.calib.covariance import small_sample
from fluxtwin.sim.types import FloatArray, TimeArray

_CELLS = 400
_MEMORIES = 12
_SHARES = np.array([0.0, 0.03, 0.08, 0.16, 0.3, 0.45, 0.6, 0.75, 0.88, 0.95, 0.98, 0.995])
_MIXTURES = (0.0, 0.25, 0.5, 0.75, 1.0)
_FEWEST_FREEDOM = 3.0
_SPARE = 8  # degrees of freedom that must be left to judge by


class Cells(NamedTuple):
    """Consecutive rows averaged: K cells."""

    seconds: FloatArray
    """(K,) mean time."""
    weight: FloatArray
    """(K,) sum of a_k, total 1."""
    columns: FloatArray
    """(K, q) weighted means of the columns."""
    length_s: float


class SlowErrors(NamedTuple):
    """The slow part of the residual, weighed over tau and share."""

    memory_s: float
    """Mean tau of the slow part [s]; 0 where there is too little to judge by."""
    share: float
    """Of the variance of the residual, mean."""
    slow: FloatArray
    """(3, q, 3, q) sum of C share (x) K(tau), averaged; K = sum_kl a_k a_l z_k z_l' exp(-|t_k - t_l|/tau)."""
    white_part: float
    """Mean share of the variance of single rows that is white."""


def cells(
    time: TimeArray, segment: np.ndarray, parts: Sequence[FloatArray], a: FloatArray, most: int = _CELLS
) -> Cells:
    """Average the columns of `parts` (each (N, k)) with weights a (N,) over about `most` cells, none across a gap."""
    seconds = (time - time[0]).astype("int64") * 1e-9
    first = np.concatenate([[0], np.flatnonzero(np.diff(segment)) + 1])
    last = np.concatenate([first[1:], [len(seconds)]]) - 1
    observed_s = float((seconds[last] - seconds[first]).sum())
    length = observed_s / most if len(seconds) > most else 0.0
    if length > 0:
        within = np.floor((seconds - seconds[first][segment]) / length).astype(np.int64)
        edge = np.flatnonzero((np.diff(segment) != 0) | (np.diff(within) != 0)) + 1
        starts = np.concatenate([[0], edge])
    else:
        starts = np.arange(len(seconds))
    weight = np.add.reduceat(a, starts)
    kept = weight > 0
    columns = [np.add.reduceat(part[:, f] * a, starts)[kept] for part in parts for f in range(part.shape[1])]
    total = np.stack(columns, axis=1)
    weight = weight[kept]
    when = np.add.reduceat(seconds * a, starts)[kept] / weight
    step = float(np.median(np.diff(when))) if when.size > 1 else 1.0
    return Cells(when, weight, total / weight[:, None], step)


def kernel_moments(seen: Cells, tau_s: FloatArray) -> FloatArray:
    """(len(tau), q, q) sum over pairs of cells of w_k w_l z_k z_l' exp(-|t_k - t_l|/tau): one recursion in time."""
    weighted = seen.columns * seen.weight[:, None]
    before = np.zeros((len(weighted), tau_s.size, weighted.shape[1]))
    fade = np.exp(-np.diff(seen.seconds)[:, None] / tau_s)[:, :, None]
    for k in range(1, len(weighted)):
        before[k] = fade[k - 1] * (before[k - 1] + weighted[k - 1])
    half = np.einsum("kg,ktf->tgf", weighted, before, optimize=True)
    return np.asarray(half + half.transpose(0, 2, 1) + weighted.T @ weighted)


def slow_errors(seen: Cells, m: int, rr: FloatArray, longest_s: float, observed_s: float) -> SlowErrors | None:
    """Weigh tau and share by the restricted likelihood.

    seen: cells of the columns [x - <x> (m), 1, r (3), y - <y> (3)]. rr: (3, 3) covariance of the residual of single
    rows. longest_s: the longest unbroken stretch; observed_s: all of them. None where there are too few cells, or the
    residual is zero.
    """
    z, r = seen.columns[:, : m + 1], seen.columns[:, m + 1 : m + 4]
    if len(z) - m - 1 < _SPARE or not np.trace(rr) > 0:
        return None
    tau = np.geomspace(seen.length_s, max(0.5 * longest_s, 2.0 * seen.length_s), _MEMORIES)
    tau_g, share_g = (part.ravel() for part in np.meshgrid(tau, _SHARES, indexing="ij"))
    rest = z[:, min(m, 3) :]
    columns = np.hstack([r, rest, seen.columns[:, m + 4 :]]) if m else np.hstack([r, z])
    likelihood, C = _restricted_likelihood(seen, columns, rest.shape[1], tau_g, share_g)
    p = np.exp(likelihood - likelihood.max())
    p /= p.sum()
    slow_C = C * share_g[:, None, None]
    of_rows = np.minimum(np.trace(slow_C, axis1=1, axis2=2) / np.trace(rr), 1.0)
    K = kernel_moments(Cells(seen.seconds, seen.weight, z, seen.length_s), tau)
    # A record of 2 tau holds one independent error of memory tau: Student's law, as with blocks.
    K *= np.array([small_sample(1.0 + max(observed_s / (2.0 * t), _FEWEST_FREEDOM)) ** 2 for t in tau])[:, None, None]
    by_tau = (p[:, None, None] * slow_C).reshape(tau.size, _SHARES.size, 3, 3).sum(axis=1)
    slow = np.einsum("tij,tgf->igjf", by_tau, K)
    weight = p * share_g
    memory = float(weight @ tau_g / max(float(weight.sum()), 1e-300))
    return SlowErrors(memory, float(p @ of_rows), slow, 1.0 - float(p @ of_rows))


def _restricted_likelihood(
    seen: Cells, columns: FloatArray, rest: int, tau_s: FloatArray, share: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """(G,) log likelihoods and (G, 3, 3) covariances C, for each tau and share.

    columns: r (3), the `rest` of the regressors, and y (3) where there are slopes.
    """
    rows = len(columns)
    scale = np.maximum(np.sqrt((columns**2).mean(axis=0)), 1e-300)
    gram, logs = _whitened_gram(seen, columns / scale, tau_s, share)
    plain = (columns / scale).T @ (columns / scale) / rows
    best: tuple[FloatArray, FloatArray] | None = None
    for w in _MIXTURES if columns.shape[1] > 3 + rest else (0.0,):
        T = np.eye(columns.shape[1])[:, 3:]
        T[:3, rest:] = -w * np.diag(scale[:3] / scale[3 + rest :]) if T.shape[1] > rest else 0.0
        A = T.T @ (gram + plain) @ T
        B = T.T @ gram[:, :, :3]
        E = gram[:, :3, :3] - B.transpose(0, 2, 1) @ np.linalg.solve(A, B)
        E = E + 1e-12 * np.trace(E, axis1=1, axis2=2)[:, None, None] * np.eye(3)
        likelihood = -0.5 * (3.0 * logs + 3.0 * np.linalg.slogdet(A)[1] + rows * np.linalg.slogdet(E)[1])
        likelihood = likelihood + 1.5 * np.linalg.slogdet(T.T @ plain @ T)[1]
        if best is None or likelihood.max() < best[0].max():
            best = likelihood, E * np.outer(scale[:3], scale[:3]) / rows
    assert best is not None
    return best


def _whitened_gram(
    seen: Cells, columns: FloatArray, tau_s: FloatArray, share: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """(G, q, q) X' V^-1 X and (G,) log |V| of the columns, V in units of C."""
    white = (1.0 - share) * (seen.weight.mean() / seen.weight)[:, None]
    fade = np.ones((len(columns), share.size))
    fade[1:] = np.exp(-np.diff(seen.seconds)[:, None] / tau_s)
    gain, variance = _gains(share, white, fade)
    innovation = np.empty((len(columns), share.size, columns.shape[1]))
    state = np.zeros((share.size, columns.shape[1]))
    for k, row in enumerate(columns):
        state *= fade[k][:, None]
        innovation[k] = row - state
        state += gain[k][:, None] * innovation[k]
    innovation /= np.sqrt(variance)[:, :, None]
    gram = np.matmul(innovation.transpose(1, 2, 0), innovation.transpose(1, 0, 2))
    return gram, np.log(variance).sum(axis=0)


def _gains(share: FloatArray, white: FloatArray, fade: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(K, G) Kalman gains and innovation variances, in units of C."""
    gain, variance = np.empty_like(white), np.empty_like(white)
    known = share.copy()
    for k in range(len(white)):
        known = fade[k] ** 2 * known + (1.0 - fade[k] ** 2) * share
        variance[k] = known + white[k]
        gain[k] = known / variance[k]
        known = known * (1.0 - gain[k])
    return gain, variance
