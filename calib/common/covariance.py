"""The covariance of the calibration.

`white`: errors independent from row to row, but not alike: an error of the reference attitude turns the field and
has no component along it, so the plain formula of least squares is right on average and wrong by direction. The
sandwich (White 1980, Econometrica 48, 817; with the leverage of MacKinnon & White 1985, HC2) takes each row's own
residual, and with it what the correction for noise in the reading adds. Under ten rows a parameter of one axis there
is too little for it and the plain formula stands: Cov(rows i, j of M) = R_ij <x|x>^-1 / N, R the residual covariance,
plus what the correction adds (Fuller 1987, Measurement Error Models, section 2.2, known error covariance).

`blocks`: correlated in time; see `covariance_report`. What a Gauss-Markov error adds to estimating equations are sums over
pairs of rows; long records are summed into cells first, so that a day costs no more than an orbit.

Slopes here are stacked axis by axis: (row i of M, c_i) for i = x, y, z, with m + 1 numbers each.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from scipy.special import ndtr, stdtrit

from fluxtwin.calib.common.records import seconds_of
from fluxtwin.calib.common.regression import Regression, blocks
from fluxtwin.sim.base.types import FloatArray, TimeArray

FEWEST_BLOCKS = 8
BLOCKS = (192, 128, 96, 64, 48, 32, 24, 16, 12, 8)
"""How many blocks a record is cut into, in turn; with the first, sigma is known to 5 %."""
_MOST_BLOCKS, _MOST_ASKED = 200, 1000
_FEWEST_BATCHES = 20
_STRETCHES = 10
CELLS = 400


def plain_covariance(
    fit: Regression, slopes: FloatArray, rr: FloatArray, effective_rows: float, noise_xx: FloatArray
) -> FloatArray:
    """(3(m+1), 3(m+1)) covariance of stacked slopes, all rows alike.

    slopes: (3, m) M as corrected. rr: (3, 3) residual covariance. noise_xx: (m, m) noise covariance of the
    regressors that the slopes were corrected for, else 0.
    """
    m = fit.xx.shape[0]
    inverse = np.linalg.inv(fit.xx - noise_xx)
    pull = inverse @ noise_xx @ slopes.T
    out = np.zeros((3, m + 1, 3, m + 1))
    out[:, :m, :, :m] = np.einsum("ij,fg->ifjg", rr, inverse @ fit.xx @ inverse) + np.einsum("fj,gi->ifjg", pull, pull)
    out[:, m, :, m] = rr
    out /= effective_rows
    return uncentred(out.reshape(3 * (m + 1), 3 * (m + 1)), fit.mean_x)


def sandwich_covariance(
    residual: FloatArray,
    parts: Sequence[FloatArray],
    fit: Regression,
    slopes: FloatArray,
    a: FloatArray,
    noise_xx: FloatArray,
) -> FloatArray:
    """(3(m+1), 3(m+1)) covariance of stacked slopes, each row with its own residual (HC2); one pass in blocks.

    residual: (N, 3). parts: the regressors. a: (N,) weights of sum 1; the rest as `plain_covariance`. The score of a row
    is r_i x + Sigma_x M_i, whose mean vanishes at the corrected slopes.
    """
    m = fit.xx.shape[0]
    leverage = bread_of(fit, np.zeros_like(noise_xx))
    shift = np.pad(slopes @ noise_xx, ((0, 0), (0, 1)))
    meat = np.zeros((3 * (m + 1), 3 * (m + 1)))
    for at, x in blocks(parts, len(residual)):
        z = np.vstack([(x - fit.mean_x).T, np.ones((1, len(x)))])  # in columns of rows: contiguous products
        held = np.einsum("fk,fk->k", leverage @ z, z) * a[at]
        r = residual[at].T / np.sqrt(1.0 - np.minimum(held, 0.99))
        score = (r[:, None, :] * z + shift[:, :, None]).reshape(3 * (m + 1), -1) * a[at]
        meat += score @ score.T
    whole = np.kron(np.eye(3), bread_of(fit, noise_xx))
    return uncentred(whole @ meat @ whole.T, fit.mean_x)


def bread_of(fit: Regression, noise_xx: FloatArray) -> FloatArray:
    """(m+1, m+1) what turns the mean of r [x - <x>, 1] into an error of (M_i, c_i + M_i <x>)."""
    m = fit.xx.shape[0]
    bread = np.eye(m + 1)
    bread[:m, :m] = np.linalg.inv(fit.xx - noise_xx)
    return bread


def uncentred(stacked: FloatArray, mean_x: FloatArray) -> FloatArray:
    """The covariance of (M_i, c_i) from that of (M_i, c_i + M_i <x>)."""
    m = mean_x.size
    back = np.eye(m + 1)
    back[m, :m] = -mean_x
    whole = np.kron(np.eye(3), back)
    out = whole @ stacked @ whole.T
    return np.asarray(0.5 * (out + out.T))


def small_sample(count: float) -> float:
    """t/2: what sigma from `count` blocks must be multiplied by so that two sigma hold 95.4 %."""
    return float(stdtrit(float(count) - 1.0, float(ndtr(2.0)))) / 2.0


def make_blocks(time: TimeArray, memory_s: float) -> np.ndarray:
    """(N,) block of each row: what lies between gaps in time where there are at least eight such stretches, else pieces of
    four times `memory_s`."""
    segment = segments(time, 1.5 * memory_s)
    if int(segment[-1]) + 1 >= FEWEST_BLOCKS:
        return segment
    return _cut(time, segment, max(4.0 * memory_s, observed_s(time, segment) / _MOST_BLOCKS))


def groupings(
    time: TimeArray, segment: np.ndarray, passes: np.ndarray | None = None, block_s: float | None = None
) -> Iterator[tuple[np.ndarray, str]]:
    """(N,) block of each row and what a block is, from short blocks to long ones; as asked where it is."""
    if passes is not None:
        yield np.unique(passes, return_inverse=True)[1], "passes as given"
    elif block_s is not None:
        length = max(block_s, observed_s(time, segment) / _MOST_ASKED)
        yield _cut(time, segment, length), f"stretches of {length:.6g} s, as asked"
    else:
        covered_s = observed_s(time, segment)
        for count in BLOCKS:
            of_row = _cut(time, segment, covered_s / count)
            if 0 < int(segment[-1]) == int(of_row.max()):
                break  # longer than every pass
            yield of_row, f"stretches of {covered_s / count:.0f} s"
        if int(segment[-1]) + 1 >= FEWEST_BLOCKS:
            yield segment, "passes separated by gaps in time"


def _cut(time: TimeArray, segment: np.ndarray, length_s: float) -> np.ndarray:
    """(N,) numbers of pieces of that length, none across a change of segment."""
    starts = cell_starts(seconds_of(time), segment, length_s)
    return np.repeat(np.arange(len(starts)), np.diff(np.append(starts, len(time))))


def cell_starts(seconds: FloatArray, label: np.ndarray, length_s: float) -> np.ndarray:
    """First rows of cells of at most that length, none across a change of label (N,); of no length each row is one."""
    new = np.concatenate([[True], np.diff(label) != 0])
    if not length_s > 0:
        return np.arange(len(seconds))
    first = np.flatnonzero(new)
    since = seconds - seconds[first][np.cumsum(new) - 1]
    within = np.floor(since / length_s + 1e-9).astype(np.int64)
    return np.flatnonzero(new | np.concatenate([[True], np.diff(within) != 0]))


def observed_s(time: TimeArray, segment: np.ndarray) -> float:
    """Time that the rows cover, gaps left out [s]."""
    step_s = np.diff(time).astype("int64") * 1e-9
    return float(step_s[np.diff(segment) == 0].sum()) + float(np.median(step_s)) if step_s.size else 1.0


def segments(time: TimeArray, least_gap_s: float = 0.0) -> np.ndarray:
    """(N,) number of the stretch that each row belongs to.

    A new one begins after a gap of more than five median steps that is also longer than `least_gap_s`.
    """
    step = np.diff(time).astype("int64")
    if step.size == 0:
        return np.zeros(len(time), dtype=int)
    return np.concatenate([[0], np.cumsum(step > max(5.0 * float(np.median(step)), least_gap_s * 1e9))])


def stretches(rows: int, most: int = 50_000) -> np.ndarray:
    """Indices of at most `most` rows in ten stretches of consecutive rows, spread over the record."""
    if rows <= most:
        return np.arange(rows)
    length = most // _STRETCHES
    starts = np.linspace(0, rows - length, _STRETCHES).astype(int)
    return np.unique((starts[:, None] + np.arange(length)).ravel())


def autocorrelation(residual_nT: FloatArray, segment: np.ndarray, lags: Sequence[int]) -> FloatArray:
    """(K,) correlation of residuals `lags` samples apart within segments, mean over the axes."""
    r = residual_nT - residual_nT.mean(axis=0)
    variance = (r**2).mean(axis=0)

    def at(lag: int) -> float:
        same = segment[lag:] == segment[: len(segment) - lag]
        if lag == 0 or not same.any() or not (variance > 0).all():
            return float(lag == 0)
        products = np.einsum("ij,ij,i->j", r[lag:], r[:-lag], same.astype(np.float64)) / same.sum()
        return float((products / variance).mean())

    return np.array([at(lag) for lag in lags])


def correlation_time_s(time: TimeArray, residual_nT: FloatArray, segment: np.ndarray) -> float:
    """Time at which the autocorrelation of the residual first falls below 1/e, at least one step [s].

    Lags grow by a fifth from one to the next, so that a long correlation costs no more than a short one.
    """
    if len(time) < 2:
        return 0.0
    step_s = float(np.median(np.diff(time).astype("int64"))) * 1e-9
    longest = max(1, len(time) // 4)
    lag = 1
    while lag < longest and autocorrelation(residual_nT, segment, [lag])[0] >= np.exp(-1.0):
        lag = min(longest, max(lag + 1, lag * 6 // 5))
    return step_s * lag


def batch_widening(residual_nT: FloatArray, segment: np.ndarray) -> float:
    """1 + 2 sum rho, the integrated effect of correlation on a variance, from means over batches of rows.

    L Var(mean of L rows) / Var(row) is 1 for white errors of any L and grows to 1 + 2 sum rho where L passes the
    memory; a correlation far too weak to be seen from row to row is seen there. L doubles while 20 batches are left
    (the ratio is then known to 18 %); what is not three sigma above 1 counts as 1.
    """
    r = residual_nT - residual_nT.mean(axis=0)
    power = float((r**2).mean())
    edges = np.flatnonzero(np.diff(segment)) + 1
    lengths = np.diff(np.concatenate([[0], edges, [len(r)]]))
    starts = np.concatenate([[0], edges])
    total = np.concatenate([np.zeros((1, r.shape[1])), np.cumsum(r, axis=0)])
    worst, length = 1.0, 2
    while power > 0 and int((lengths // length).sum()) >= _FEWEST_BATCHES:
        at = np.concatenate([s + length * np.arange(n // length) for s, n in zip(starts, lengths, strict=True)])
        sums = total[at + length] - total[at]
        ratio = float((sums**2).mean()) / length / power
        if ratio > 1.0 + 3.0 * np.sqrt(2.0 / sums.size):
            worst = max(worst, ratio)
        length *= 2
    return worst


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
    covered_s = float((seconds[last] - seconds[first]).sum())
    starts = cell_starts(seconds, segment, covered_s / most if len(seconds) > most else 0.0)
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
