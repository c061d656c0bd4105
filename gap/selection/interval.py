"""What no column reports: when a field that was on for one stretch began and ended, and when an attitude jumped."""

from __future__ import annotations

import numpy as np
from scipy.stats import chi2

from fluxtwin.calib.common.criterion import FALSE_ALARM, THRESHOLD, worth
from fluxtwin.gap.hypotheses.blocks import in_body
from fluxtwin.gap.linear.projection import Whitens, orthonormal
from fluxtwin.gap.problem.problem import Problem
from fluxtwin.gap.selection.criterion import SHAPE
from fluxtwin.sim.base.types import FloatArray, TimeArray
from fluxtwin.sim.earth import epoch
from fluxtwin.sim.effects.switched_field import SwitchedField

_EDGES = 64
_LEAST_SHARE = 0.05  # of the record, inside and on either side: shorter ones are spikes, or a step


def likeliest_interval(
    problem: Problem, whitener: Whitens, residual: FloatArray, nuisance: FloatArray
) -> SwitchedField | None:
    """The interval in which a constant field explains most of a whitened residual (M, 3), beside the nuisance (M, 3, c).

    None where one step does as well, within noise and its shape error. Each pair of edges is a difference of two steps, so
    all pairs follow from one Gram matrix of the steps.
    """
    rows = problem.rows
    if rows < 4 * _EDGES:
        return None
    at = np.linspace(0, rows, _EDGES + 1).astype(int)[1:-1]
    steps = (np.arange(rows)[:, None] >= at[None, :]).astype(np.float64)
    white = whitener.apply(in_body(steps)).reshape(residual.size, -1)
    basis = orthonormal(nuisance)
    white = white - basis @ (basis.T @ white)
    gram = (white.T @ white).reshape(at.size, 3, at.size, 3)
    moment = (white.T @ residual.reshape(-1)).reshape(at.size, 3)
    own = np.stack([gram[k, :, k, :] for k in range(at.size)])
    single = _explained(own, moment)
    first, last = np.triu_indices(at.size, k=max(int(_LEAST_SHARE * _EDGES), 1))
    inside = (at[first] > _LEAST_SHARE * rows) & (at[last] < (1.0 - _LEAST_SHARE) * rows)
    first, last = first[inside], last[inside]
    mixed = gram[first, :, last, :]
    both = own[first] + own[last] - mixed - np.transpose(mixed, (0, 2, 1))
    double = _explained(both, moment[first] - moment[last])
    best = int(np.argmax(double))
    further = (double[best] - single.max()) / (1.0 + SHAPE * single.max())
    if worth(further, 1, rows, float(np.log(at.size))) < THRESHOLD:
        return None
    begin, end = (epoch.iso(problem.time[at[edge[best]]], "ms") for edge in (first, last))
    return SwitchedField("interval", begin, end)


def likeliest_jump(time: TimeArray, residual: FloatArray, weights: FloatArray) -> list[str]:
    """The moment (ISO 8601 UTC) of the row that a whitened residual (N, 3) says least of beforehand; none where chance does.

    weights (N, 3): zero in rows that are set aside; just before that row they belong to the jump. One where there is
    none costs two more candidates. Where the attitude's error has a memory, a jump of the attitude is all in the
    innovation of one row: a moment that is off by a row misses it.
    """
    energy = np.sum(residual**2, axis=1)
    row = int(np.argmax(energy))
    if row == 0 or chi2.sf(energy[row], 3) * energy.size > FALSE_ALARM:
        return []
    while row > 1 and not weights[row - 1].any():
        row -= 1
    return [epoch.iso(time[row], "ms")]


def _explained(gram: FloatArray, moment: FloatArray) -> FloatArray:
    """(K,) drop of chi-square by the columns of each Gram matrix (K, 3, 3) with its moment (K, 3)."""
    ridge = 1e-9 * np.trace(gram, axis1=1, axis2=2)[:, None, None] * np.eye(3) + 1e-300 * np.eye(3)
    solved = np.linalg.solve(gram + ridge, moment[:, :, None])[:, :, 0]
    return np.asarray(np.einsum("ki,ki->k", moment, solved))
