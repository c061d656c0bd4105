"""The estimating equations of a linear fit, cell by cell: what the rows add up to and what the errors put into them.

A row contributes the score a r [z], z = [x - <x>, 1], stacked axis by axis, (3 (m+1),). An error of the attitude about
axis j puts in a (U e_j) [z], a slow error of the field a h [z], white noise the same row by row.

What is fitted and what came out: the rows at work and the solution of one linear calibration.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from fluxtwin.calib.common.covariance import CELLS, cell_starts, observed_s, responses, segments
from fluxtwin.calib.common.design import Design, of_turns
from fluxtwin.calib.common.error_model import LikelihoodCells, Posterior
from fluxtwin.calib.common.noise import ReadingNoise
from fluxtwin.calib.common.options import LinearOptions
from fluxtwin.calib.common.records import Calibration, seconds_of
from fluxtwin.calib.common.regression import BLOCK_ROWS, Regression
from fluxtwin.sim.base.types import BoolArray, FloatArray


@dataclass(frozen=True)
class LinearProblem:
    """The rows at work."""

    design: Design
    options: LinearOptions
    fired: np.ndarray
    """Torquer axes that are fitted."""
    weights: FloatArray
    """(N,) a_k of journal eq. 4, sum 1; outliers have none."""
    kept: BoolArray
    """(N,) rows that are no outliers."""
    noise: ReadingNoise

    @property
    def effective(self) -> float:
        """Effective number of rows, 1 / sum a_k^2."""
        return 1.0 / float((self.weights**2).sum())

    def mean_square(self, r: FloatArray, power: int = 1) -> FloatArray:
        """(3, 3) mean of r r' with weights a_k^power, divided by sum a_k^power."""
        w = self.weights**power
        return np.asarray((r * w[:, None]).T @ r / w.sum())

    @property
    def dipole(self) -> list[FloatArray]:
        """The columns of the dipole that are fitted, in a list of one, or of none."""
        D = self.design.D_Am2
        return [] if D is None or not self.fired.size else [D[:, self.fired]]

    @cached_property
    def driver_rms(self) -> FloatArray:
        """(J,) rms of each column that a field follows."""
        return np.array([float(np.sqrt((values**2).mean())) for values in self.design.columns.values()])

    @cached_property
    def drivers(self) -> list[FloatArray]:
        """These columns, each over its rms, in a list of one, or of none."""
        values = list(self.design.columns.values())
        return [np.stack(values, axis=1) / self.driver_rms] if values else []

    @property
    def fits_S(self) -> bool:
        """Whether the field is a regressor."""
        return self.options.parameters != "b"

    @property
    def linear(self) -> bool:
        """The reading stands on the right side, beside a slope that is fitted."""
        return self.options.method == "linear" and self.fits_S

    @property
    def forward(self) -> bool:
        """The reference field does."""
        return self.options.method == "forward" and self.fits_S

    @property
    def sides(self) -> tuple[FloatArray, list[FloatArray]]:
        """(N, 3) what is fitted, and the m regressors: none for b alone, without drivers."""
        B, H = self.design.B_nT, self.design.H_nT
        if not self.fits_S:
            return H - B, self.drivers
        return (H, [B, *self.dipole, *self.drivers]) if self.linear else (B, [H, *self.dipole, *self.drivers])

    @property
    def noise_xx(self) -> FloatArray:
        """(m, m) Sigma_x of the regressors [B; D; drivers]; zero where it is not corrected for."""
        field = float(self.options.corrects) * self.noise.variance_nT2 if self.fits_S else np.zeros(0)
        others = self.fired.size * self.fits_S + len(self.design.columns)
        return np.diag(np.concatenate([field, np.zeros(others)]))


@dataclass(frozen=True)
class Solution:
    """Slopes, calibration and residuals."""

    fit: Regression
    M: FloatArray  # (3, m) slopes in the fitted direction
    c: FloatArray
    calibration: Calibration
    residual_nT: FloatArray  # true-field side
    own_residual_nT: FloatArray  # side of the fitted direction
    eiv_shift: FloatArray


_LIKELY_CELLS = 160
_TURN = 0.35  # rad that the field may turn in the body within a cell of the likelihood
_STRETCHES = 5
_RUNNING = 9
_APART_S = 1e13


class RowSums(NamedTuple):
    """K cells, p = 3 (m+1)."""

    seconds: FloatArray
    length_s: float
    """Of a cell; 0 where each row is one."""
    step_s: float
    """Between rows."""
    first: np.ndarray
    """(K,) first row."""
    z: FloatArray
    """(K, m+1) sum of a z."""
    theta: FloatArray
    """(K, 3, p) of a (U e_j) [z]."""
    score: FloatArray
    """(K, p) of a r [z]."""
    slope: FloatArray
    """(K, m+1, m+1) of a z z', the noise of the regressors off it."""
    white_z: FloatArray
    """(K, m+1, m+1) of a^2 z z'."""
    white_theta: FloatArray
    """(K, p, p) of a^2 (U e_j) [z] (U e_j)' [z]', over j."""


def images(problem: LinearProblem, solution: Solution, rows: np.ndarray | slice) -> FloatArray:
    """(n, 3, 3) U [nT/rad]: columns e_j x B0, seen from the side that is fitted."""
    U = of_turns(problem.design.H_nT[rows])
    return np.asarray(solution.M[:, :3] @ U) if problem.forward else U


def white_of(problem: LinearProblem, solution: Solution) -> FloatArray:
    """(3, 3) covariance of the noise of a reading in the residual."""
    floor = 1e-6 * float(np.trace(problem.mean_square(solution.own_residual_nT))) / 3.0
    W = np.diag(np.maximum(problem.noise.variance_nT2, max(floor, 1e-12)))
    return np.asarray(solution.M[:, :3] @ W @ solution.M[:, :3].T) if problem.linear else W


def turned_rad2(problem: LinearProblem, residual_nT: FloatArray, *, measured: bool = False) -> FloatArray:
    """(N,) mean square turn about an axis in each row: the residual across the field, without what noise adds to it.

    residual_nT: (N, 3) on the side of the true field. measured: the noise is as large as the residual along the field is,
    where a turn does nothing; else as declared or found.
    """
    H, variance = problem.design.H_nT, problem.noise.variance_nT2
    size2 = np.maximum((H**2).sum(axis=1), 1e-6)
    along2 = np.einsum("ij,ij->i", residual_nT, H) ** 2 / size2
    noise_along = (H**2 @ variance) / size2
    noise = variance.sum() - noise_along
    if measured:
        noise = noise * float(problem.weights @ along2) / max(float(problem.weights @ noise_along), 1e-12)
    return np.asarray(((residual_nT**2).sum(axis=1) - along2 - noise) / (2.0 * size2))


def evidence(problem: LinearProblem, solution: Solution, kept: np.ndarray) -> LikelihoodCells:
    """Cells for the likelihood, in which the field hardly turns; of a long record stretches. kept: (N,) rows."""
    rows, length_s = _looked_at(problem, np.flatnonzero(kept))
    time = problem.design.time[rows]
    seconds = seconds_of(time)
    segment = segments(time)
    starts = cell_starts(seconds, segment, length_s)
    count = np.diff(np.concatenate([starts, [len(seconds)]])).astype(np.float64)

    def mean(values: FloatArray) -> FloatArray:
        return np.asarray(np.add.reduceat(values, starts, axis=0) / count.reshape(-1, *[1] * (values.ndim - 1)))

    step_s = float(np.median(np.diff(seconds))) if len(seconds) > 1 else 1.0
    one = np.ones((len(seconds), 1))
    design = mean(one)
    others = [mean(part[rows]) for part in problem.sides[1][int(problem.fits_S) :]]
    if problem.fits_S:
        H = mean(problem.design.H_nT[rows]) - _smooth(mean(solution.residual_nT[rows]), segment[starts])
        others = [H - H.mean(axis=0), *others]
    design = np.hstack([*others, design])
    edges = np.flatnonzero(np.diff(segment)) + 1
    first, last = np.concatenate([[0], edges]), np.concatenate([edges, [len(seconds)]]) - 1
    return LikelihoodCells(
        mean(seconds),
        mean(solution.own_residual_nT[rows]),
        design,
        mean(images(problem, solution, rows)),
        white_of(problem, solution),
        count,
        np.where(count > 1, count, 0.0) * step_s,
        float((seconds[last] - seconds[first]).max()),
    )


def _looked_at(problem: LinearProblem, rows: np.ndarray) -> tuple[np.ndarray, float]:
    """Rows for the likelihood and the length of a cell [s]; 0: each row is one."""
    time, H = problem.design.time[rows], problem.design.H_nT[rows]
    covered_s = observed_s(time, segments(time))
    length_s = covered_s / _LIKELY_CELLS
    step_s = np.diff(time).astype("int64") * 1e-9
    some = np.flatnonzero(step_s <= 2.0 * np.median(step_s))[:: max(1, len(step_s) // 2000)]
    size = np.linalg.norm(H, axis=1)
    cosine = np.einsum("ij,ij->i", H[some], H[some + 1]) / np.maximum(size[some] * size[some + 1], 1e-9)
    rate = float(np.median(np.arccos(np.clip(cosine, -1.0, 1.0)) / step_s[some])) if some.size else 0.0
    if rate * length_s > _TURN:
        length_s = max(_TURN / rate, float(np.median(step_s)))
        stretch_s = length_s * _LIKELY_CELLS / _STRETCHES
        seconds = seconds_of(time)
        begin = np.linspace(0.0, max(float(seconds[-1]) - stretch_s, 0.0), _STRETCHES)
        inside = (seconds[:, None] >= begin) & (seconds[:, None] <= begin + stretch_s)
        few = np.flatnonzero(inside.any(axis=1))
        if few.size >= 2 * _LIKELY_CELLS // _STRETCHES:
            rows = rows[few]
    return rows, length_s if len(rows) > 2.5 * _LIKELY_CELLS else 0.0


def _smooth(values: FloatArray, label: np.ndarray) -> FloatArray:
    """Running means over `_RUNNING` rows of (K, k), shorter at a change of label."""
    total = np.concatenate([np.zeros((1, values.shape[1])), np.cumsum(values, axis=0)])
    row, edge = np.arange(len(label)), np.flatnonzero(np.diff(label)) + 1
    first = np.concatenate([[0], edge])[np.searchsorted(edge, row, side="right")]
    last = np.concatenate([edge, [len(label)]])[np.searchsorted(edge, row, side="right")]
    low, high = np.maximum(row - _RUNNING // 2, first), np.minimum(row + _RUNNING // 2 + 1, last)
    return np.asarray((total[high] - total[low]) / (high - low)[:, None])


def sums(problem: LinearProblem, solution: Solution, label: np.ndarray) -> RowSums:
    """Of all rows; label (N,): cells do not reach across a change of it."""
    time, a = problem.design.time, problem.weights
    seconds = seconds_of(time)
    length_s = observed_s(time, segments(time)) / CELLS if len(time) > CELLS else 0.0
    starts = cell_starts(seconds, label, length_s)
    ends = np.concatenate([starts[1:], [len(seconds)]])
    m = solution.M.shape[1]
    shift = np.pad(solution.M @ problem.noise_xx, ((0, 0), (0, 1)))
    parts = problem.sides[1]
    out: list[tuple[FloatArray, ...]] = []
    cell = 0
    while cell < len(starts):
        stop = max(int(np.searchsorted(ends, starts[cell] + BLOCK_ROWS)), cell + 1)
        rows = slice(int(starts[cell]), int(ends[stop - 1]))
        local = starts[cell:stop] - starts[cell]
        w = a[rows]
        n = len(w)
        x = np.hstack([np.zeros((n, 0)), *(part[rows] for part in parts)])
        z = np.hstack([x - solution.fit.mean_x, np.ones((n, 1))])
        U = images(problem, solution, rows)
        u = np.einsum("nij,nf->njif", U, z).reshape(n, 3, -1)
        r = solution.own_residual_nT[rows]
        score = (r[:, :, None] * z[:, None, :] + shift).reshape(n, -1)
        zz = z[:, :, None] * z[:, None, :]
        uu = np.einsum("njp,njq->npq", u * (w * w)[:, None, None], u, optimize=True)
        whole = (
            w[:, None] * z,
            w[:, None, None] * u,
            w[:, None] * score,
            w[:, None, None] * zz,
            (w * w)[:, None, None] * zz,
            uu,
            w * seconds[rows],
            w,
        )
        out.append(tuple(np.add.reduceat(part, local, axis=0) for part in whole))
        cell = stop
    z, theta, score, slope, white_z, white_theta, when, weight = (
        np.concatenate([part[k] for part in out]) for k in range(8)
    )
    slope[:, :m, :m] -= weight[:, None, None] * problem.noise_xx
    middle = 0.5 * (seconds[starts] + seconds[ends - 1])
    at = np.where(weight > 0, when / np.where(weight > 0, weight, 1.0), middle)
    step_s = float(np.median(np.diff(seconds))) if len(seconds) > 1 else 1.0
    return RowSums(at, length_s, step_s, starts, z, theta, score, slope, white_z, white_theta)


class Spread(NamedTuple):
    """Covariance of the summed scores under a model of the errors, and what it makes of blocks."""

    sums: RowSums
    total: FloatArray
    """(p, p)."""
    from_all: FloatArray
    """(K, p, p) covariance of a cell's score with the total."""
    white: FloatArray
    """(K, p, p) white part of each cell."""
    nodes_s: FloatArray
    theta_rad2: FloatArray
    """(nodes,) power of the attitude error at each time constant."""
    slow_nT2: FloatArray


def spread_of(added: RowSums, posterior: Posterior, white: FloatArray, shared: FloatArray) -> Spread:
    """white: (3, 3) of a row, before the posterior's factor. shared: (3, m+1) mean product of a component of the noise in
    residual and regressor."""
    K, size = added.score.shape
    # Within a cell an error counts as constant; one that lasts less is white, as strong as its integral over time.
    taus_s = (posterior.tau_s, posterior.slow_tau_s)
    brief = [np.where(tau < added.length_s, 1.0 / np.tanh(0.5 * added.step_s / tau), 0.0) for tau in taus_s]
    theta2, slow2 = posterior.theta_rad**2, posterior.slow_nT**2
    W = white * float((posterior.sigma_nT**2).mean()) + float((slow2 * brief[1]).mean()) * np.eye(3)
    own = np.einsum("ij,kfg->kifjg", W, added.white_z).reshape(K, size, size)
    pull = np.einsum("ig,jf->ifjg", shared, shared).reshape(size, size)
    own = own + added.white_z[:, -1, -1][:, None, None] * pull
    own = own + float((posterior.white_theta_rad**2 + theta2 * brief[0]).mean()) * added.white_theta
    nodes = posterior.nodes_s
    theta = posterior.on_nodes(np.where(brief[0] > 0, 0.0, theta2), posterior.tau_s)
    slow = posterior.on_nodes(np.where(brief[1] > 0, 0.0, slow2), posterior.slow_tau_s)
    from_all = own + _slow_part(added, added.seconds, nodes, theta, slow)
    total = from_all.sum(axis=0)
    return Spread(added, 0.5 * (total + total.T), from_all, own, nodes, theta, slow)


def of_blocks(spread: Spread, block: np.ndarray, count: int) -> tuple[FloatArray, FloatArray]:
    """(G, p) scores of blocks as the fit leaves them and (G, p, p) their covariances. block: (K,) numbers below G."""
    added = spread.sums
    size = added.score.shape[1]
    apart = added.seconds + _APART_S * block
    order = np.argsort(apart, kind="stable")  # rows may return to a block after another
    sorted_cells = added._replace(z=added.z[order], theta=added.theta[order], score=added.score[order])
    inside = spread.white.copy()
    inside[order] += _slow_part(sorted_cells, apart[order], spread.nodes_s, spread.theta_rad2, spread.slow_nT2)

    def by_block(values: FloatArray) -> FloatArray:
        out = np.zeros((count, *values.shape[1:]))
        np.add.at(out, block, values)
        return out

    score, own, cross, slope = (by_block(v) for v in (added.score, inside, spread.from_all, added.slope))
    share = np.linalg.solve(slope.sum(axis=0).T, slope.transpose(0, 2, 1)).transpose(0, 2, 1)
    absorbed = np.einsum("ij,gab->giajb", np.eye(3), share).reshape(count, size, size)
    back = cross @ absorbed.transpose(0, 2, 1)
    left = own - back - back.transpose(0, 2, 1) + absorbed @ spread.total @ absorbed.transpose(0, 2, 1)
    return score - np.einsum("gpq,q->gp", absorbed, score.sum(axis=0)), 0.5 * (left + left.transpose(0, 2, 1))


def _slow_part(
    added: RowSums, seconds: FloatArray, nodes_s: FloatArray, theta: FloatArray, slow: FloatArray
) -> FloatArray:
    """(K, p, p) covariance of each cell's score with that of all cells, from the correlated errors."""
    K, size = added.score.shape
    out = np.zeros((K, size, size))
    for j in range(3):
        seen = responses(seconds, added.theta[:, j], nodes_s, theta)
        out += added.theta[:, j, :, None] * seen[:, None, :]
    seen = responses(seconds, added.z, nodes_s, slow)
    zz = added.z[:, :, None] * seen[:, None, :]
    for i in range(3):
        at = slice(i * added.z.shape[1], (i + 1) * added.z.shape[1])
        out[:, at, at] += zz
    return out
