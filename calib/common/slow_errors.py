"""Sums over pairs of rows whose errors are correlated in time: what a Gauss-Markov error adds to estimating equations.

Long records are summed into cells first, so that a day costs no more than an orbit.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from fluxtwin.calib.common.records import seconds_of
from fluxtwin.sim.base.types import FloatArray, TimeArray

CELLS = 400


class PairedCells(NamedTuple):
    """Consecutive rows taken together: K cells."""

    seconds: FloatArray
    """(K,) mean time."""
    weight: FloatArray
    """(K,) sum of a_k, total 1."""
    columns: FloatArray
    """(K, q) weighted means of the columns."""


def cells(
    time: TimeArray, segment: np.ndarray, parts: Sequence[FloatArray], a: FloatArray, most: int = CELLS
) -> PairedCells:
    """Average the columns of `parts` (each (N, k)) with weights a (N,) over about `most` cells, none across a gap."""
    seconds = seconds_of(time)
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
    return PairedCells(when, weight, total / weight[:, None])


def kernel_moments(seen: PairedCells, tau_s: FloatArray) -> FloatArray:
    """(len(tau), q, q) sum over pairs of cells of w_k w_l z_k z_l' exp(-|t_k - t_l|/tau): one recursion in time."""
    weighted = seen.columns * seen.weight[:, None]
    half = np.einsum("kg,ktf->tgf", weighted, _before(seen.seconds, weighted, tau_s), optimize=True)
    return np.asarray(half + half.transpose(0, 2, 1) + weighted.T @ weighted)


def responses(seconds: FloatArray, weighted: FloatArray, tau_s: FloatArray, power: FloatArray) -> FloatArray:
    """(K, q): at each cell the sum over all cells of w_l z_l times sum over tau of power exp(-|t_k - t_l|/tau).

    weighted: (K, q) w z. tau_s, power: (n,).
    """
    before = _before(seconds, weighted, tau_s)
    after = _before(-seconds[::-1], weighted[::-1], tau_s)[::-1]
    return np.asarray(np.einsum("t,ktf->kf", power, before + after) + power.sum() * weighted)


def _before(seconds: FloatArray, weighted: FloatArray, tau_s: FloatArray) -> FloatArray:
    """(K, len(tau), q): the same over earlier cells alone."""
    from fluxtwin.calib.common.error_kernels import correlated_before

    before = np.empty((len(weighted), tau_s.size, weighted.shape[1]))
    correlated_before(np.ascontiguousarray(seconds), np.ascontiguousarray(weighted), tau_s, before)
    return before
