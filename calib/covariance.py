"""The covariance of the calibration.

`white`: of ordinary least squares, Cov(rows i, j of M) = R_ij <x|x>^-1 / N and so on for c, with the full
residual covariance R between the axes (N - m - 1 degrees of freedom), plus what the correction for noise in the
reading adds (Fuller 1987, Measurement Error Models, section 2.2, known error covariance).

`blocks`: the delete-one-block jackknife. A block is a pass, or a stretch of a pass that is long against the
memory of the errors; errors that are constant or smooth within a block widen the covariance as they should. With
fewer than eight blocks there is too little to see, and the white covariance is widened by N/N_eff,
N_eff = N (1-rho)/(1+rho), rho the correlation of neighbouring residuals.

Slopes here are stacked axis by axis: (row i of M, c_i) for i = x, y, z, with m + 1 numbers each.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from fluxtwin.calib.moments import stretches
from fluxtwin.calib.regression import Regression
from fluxtwin.sim.types import FloatArray, TimeArray

FEWEST_BLOCKS = 8
_PASSES_ENOUGH = 12  # gap segments; also the fewest stretches that a record is cut into
_MOST_BLOCKS = 200  # sigma is then known to 5 %; more would only cost time
_ROWS = 50_000  # of a longer record, stretches that add up to this give the correlation time


@dataclass(frozen=True)
class Blocks:
    """How rows were grouped for a covariance that allows for correlated errors."""

    of_row: np.ndarray
    """(N,) block number of each row, 0 to count - 1, in any order."""
    count: int
    words: str
    """What a block is."""


def white_covariance(
    fit: Regression, slopes: FloatArray, rr: FloatArray, effective_rows: float, noise_xx: FloatArray | None
) -> FloatArray:
    """(3(m+1), 3(m+1)) covariance of stacked slopes.

    slopes: (3, m) M as corrected. rr: (3, 3) residual covariance. noise_xx: (m, m) noise covariance of the
    regressors when the slopes were corrected for it, else None.
    """
    m = fit.xx.shape[0]
    clean = fit.xx if noise_xx is None else fit.xx - noise_xx
    inverse = np.linalg.inv(clean)
    pull = np.zeros((m, 3)) if noise_xx is None else inverse @ (-noise_xx @ slopes.T)
    spread = inverse @ fit.xx @ inverse
    out = np.zeros((3, m + 1, 3, m + 1))
    for i in range(3):
        for j in range(3):
            block = (rr[i, j] * spread + np.outer(pull[:, j], pull[:, i])) / effective_rows
            out[i, :m, j, :m] = block
            out[i, :m, j, m] = -block @ fit.mean_x
            out[i, m, j, :m] = -fit.mean_x @ block
            out[i, m, j, m] = rr[i, j] / effective_rows + fit.mean_x @ block @ fit.mean_x
    flat = out.reshape(3 * (m + 1), 3 * (m + 1))
    return np.asarray(0.5 * (flat + flat.T))


def jackknife_covariance(
    y: FloatArray,
    x: FloatArray,
    a: FloatArray,
    blocks: Blocks,
    solve: Callable[[FloatArray, FloatArray, FloatArray, FloatArray], tuple[FloatArray, FloatArray]],
) -> FloatArray:
    """(3(m+1), 3(m+1)) covariance of stacked slopes: every block left out once.

    y: (N, 3), x: (N, m), a: (N,) weights of sum 1; `solve(xx, yx, mean_x, mean_y)` gives (M, c).
    """
    centre_x, centre_y = a @ x, a @ y
    m = x.shape[1]
    total = np.zeros((blocks.count, 1 + m + 3, 1 + m + 3))
    order = np.argsort(blocks.of_row, kind="stable")
    edges = np.searchsorted(blocks.of_row[order], np.arange(blocks.count + 1))
    for block in range(blocks.count):
        at = order[edges[block] : edges[block + 1]]
        z = np.hstack([np.ones((at.size, 1)), x[at] - centre_x, y[at] - centre_y])
        total[block] = (z * a[at, None]).T @ z
    everything = total.sum(axis=0)
    estimates = []
    for block in range(blocks.count):
        left = everything - total[block]
        left = left / left[0, 0]
        mean_x, mean_y = left[0, 1 : m + 1], left[0, m + 1 :]
        xx = left[1 : m + 1, 1 : m + 1] - np.outer(mean_x, mean_x)
        yx = left[m + 1 :, 1 : m + 1] - np.outer(mean_y, mean_x)
        M, c = solve(xx, yx, mean_x, mean_y)
        estimates.append(np.hstack([M, (c + centre_y - M @ centre_x)[:, None]]).ravel())
    deviation = np.array(estimates) - np.mean(estimates, axis=0)
    return np.asarray((blocks.count - 1) / blocks.count * deviation.T @ deviation)


def make_blocks(
    time: TimeArray, residual_nT: FloatArray, passes: np.ndarray | None = None, block_s: float | None = None
) -> Blocks:
    """Group rows: by the passes given; else by gaps in time, cut to stretches of `block_s`.

    Without `block_s`, gap segments are kept whole when there are at least twelve of them, and cut to four
    times the memory of the residual otherwise (see `_block_length_s`).
    """
    if passes is not None:
        _, of_row = np.unique(passes, return_inverse=True)
        return Blocks(of_row, int(of_row.max()) + 1, "passes as given")
    seconds = (time - time[0]).astype("int64") * 1e-9
    memory_s = memory_of_residual_s(time, residual_nT)
    segment = segments(time, 1.5 * memory_s)
    count = int(segment[-1]) + 1
    if block_s is None and count >= _PASSES_ENOUGH:
        return Blocks(segment, count, "passes separated by gaps in time")
    length = _block_length_s(time, segment, memory_s) if block_s is None else block_s
    start = np.concatenate([[0.0], seconds[1:][np.diff(segment) > 0]])[segment]
    piece = np.floor((seconds - start) / length).astype(int)
    _, of_row = np.unique(segment * (int(piece.max()) + 1) + piece, return_inverse=True)
    kind = "as asked" if block_s is not None else "from the memory of the residual"
    words = f"stretches of {length:.0f} s, {kind}"
    return Blocks(of_row, int(of_row.max()) + 1, words)


def memory_of_residual_s(time: TimeArray, residual_nT: FloatArray) -> float:
    """Time after which the residual has forgotten itself [s].

    Where the autocorrelation sinks into its own noise, not where it passes 1/e: a weak slow error under strong
    white noise passes 1/e at the first lag, and widens the covariance all the same.
    """
    some = stretches(len(time), _ROWS)
    floor = max(0.05, 2.0 / np.sqrt(3.0 * len(some)))
    return correlation_time_s(time[some], residual_nT[some], segments(time[some]), floor)


def _block_length_s(time: TimeArray, segment: np.ndarray, memory_s: float) -> float:
    """Four times the memory of the residual, less where that would leave under 12 blocks, but never under 1.5."""
    step_s = np.diff(time).astype("int64") * 1e-9
    observed_s = float(step_s[np.diff(segment) == 0].sum()) + float(np.median(step_s)) if step_s.size else 1.0
    return max(min(4.0 * memory_s, observed_s / _PASSES_ENOUGH), 1.5 * memory_s, observed_s / _MOST_BLOCKS)


def segments(time: TimeArray, least_gap_s: float = 0.0) -> np.ndarray:
    """(N,) number of the stretch that each row belongs to.

    A new one begins after a gap of more than five median steps that is also longer than `least_gap_s`.
    """
    step = np.diff(time).astype("int64")
    if step.size == 0:
        return np.zeros(len(time), dtype=int)
    return np.concatenate([[0], np.cumsum(step > max(5.0 * float(np.median(step)), least_gap_s * 1e9))])


def autocorrelation(residual_nT: FloatArray, segment: np.ndarray, lags: Sequence[int]) -> FloatArray:
    """(K,) correlation of residuals `lags` samples apart within segments, mean over the axes."""
    r = residual_nT - residual_nT.mean(axis=0)
    variance = (r**2).mean(axis=0)
    if not (variance > 0).all():
        return np.array([1.0 if lag == 0 else 0.0 for lag in lags])
    return np.array([_one_lag(r, segment, lag, variance) for lag in lags])


def _one_lag(r: FloatArray, segment: np.ndarray, lag: int, variance: FloatArray) -> float:
    if lag == 0:
        return 1.0
    same = segment[lag:] == segment[:-lag]
    if not same.any():
        return 0.0
    products = np.einsum("ij,ij,i->j", r[lag:], r[:-lag], same.astype(np.float64)) / same.sum()
    return float((products / variance).mean())


def correlation_time_s(
    time: TimeArray, residual_nT: FloatArray, segment: np.ndarray, level: float = float(np.exp(-1.0))
) -> float:
    """Time at which the autocorrelation of the residual first falls below `level`, at least one step [s].

    Lags grow by a fifth from one to the next, so that a long correlation costs no more than a short one.
    """
    if len(time) < 2:
        return 0.0
    step_s = float(np.median(np.diff(time).astype("int64"))) * 1e-9
    longest = max(1, len(time) // 4)
    lag = 1
    while lag < longest and autocorrelation(residual_nT, segment, [lag])[0] >= level:
        lag = min(longest, max(lag + 1, lag * 6 // 5))
    return step_s * lag


def widening(residual_nT: FloatArray, segment: np.ndarray) -> float:
    """N/N_eff = (1+rho)/(1-rho), at least 1, from neighbouring residuals."""
    rho = min(float(autocorrelation(residual_nT, segment, [1])[0]), 0.99)
    return max(1.0, (1.0 + rho) / (1.0 - rho))
