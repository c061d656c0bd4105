"""How far: the gap before and after the named effects, on samples that the parameters have not seen.

Five contiguous blocks; what is modelled, and the effects' parameters, are estimated on four with a guard of the
smaller of 300 s and 2 % of the span, and predict the fifth. Estimation is linear about the refitted parameters, from
Gram matrices of whitened rows, so a block costs one small solve. Where the others do not determine what a block needs,
so that the prediction is less sure than the noise is large, there is no prediction to speak of; where that is so of
half of the record, the figures are those of the fit itself, and say so.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fluxtwin.gap.problem.row_axes import RowAxes
from fluxtwin.gap.records.diagnosis import Shrinkage
from fluxtwin.sim.base.types import BoolArray, FloatArray

BLOCKS = 5
_FINE_BLOCKS = 40
_DRAWS = 400


@dataclass(frozen=True)
class Prediction:
    """Held-out residuals, N rows, in the axes in which they are judged (body axes where the attitude is known)."""

    before_nT: FloatArray
    """(N, 3) with what is modelled re-estimated on the other blocks."""
    after_nT: FloatArray
    """(N, 3) with the named effects re-estimated too."""
    of: str = "blocks"
    """`blocks` held out, `one_step` ahead, or the `fit` itself."""
    known: BoolArray | None = None
    """(N,) rows that were predicted; None: all."""


def guard_s(span_s: float) -> float:
    """Rows this near to the held-out block are used for neither."""
    return min(300.0, 0.02 * span_s)


def predict_blocks(
    seconds: FloatArray,
    kept: BoolArray,
    raw: tuple[FloatArray, FloatArray, FloatArray, FloatArray],
    white: tuple[FloatArray, FloatArray, FloatArray, FloatArray],
    noise_nT: float,
) -> Prediction:
    """Predict each block from the others.

    seconds, kept: (N,) time and rows that are not cut. raw: residual of the baseline (N, 3), nuisance Jacobian
    (N, 3, C), residual after the named effects (N, 3), and the Jacobian of their parameters (N, 3, P; P may be 0).
    white: the same four, whitened. noise_nT: rms per component of noise and attitude error.
    """
    before, after, known = raw[0].copy(), raw[2].copy(), kept.copy()
    every = np.concatenate([raw[1], raw[3]], axis=2)
    block = _block_numbers(seconds, kept)
    guard = guard_s(float(seconds[-1] - seconds[0]))
    for number in range(BLOCKS):
        held = block == number
        if not held.any():
            continue
        start, end = seconds[held].min() - guard, seconds[held].max() + guard
        train = kept & ~((seconds >= start) & (seconds <= end))
        c, _ = _solve(white[0][train], white[1][train])
        both = np.concatenate([white[1], white[3]], axis=2)
        d, root = _solve(white[2][train], both[train])
        before[held] = raw[0][held] - raw[1][held] @ c
        after[held] = raw[2][held] - every[held] @ d
        known[held] &= float(np.mean(np.sum((every[held] @ root) ** 2, axis=2))) < noise_nT**2
    if 2 * known.sum() < kept.sum():
        return Prediction(raw[0], raw[2], "fit")
    return Prediction(before, after, known=known)


def one_step(
    residual_nT: FloatArray, seconds: FloatArray, kept: BoolArray, rate: float, noise_nT: float
) -> tuple[FloatArray, float]:
    """What is left (N, 3) when each row's bias is predicted from the rows before it, and how unsure that is [nT].

    rate: of the walk, nT/sqrt(s); noise_nT: of a reading. The Kalman filter of a local level (Harvey 1989, section
    2.2), from an unknown level; its second row is the first that is predicted.
    """
    left, level, variance = residual_nT.copy(), np.zeros(3), 1e6 * noise_nT**2
    unsure = []
    for row, since in enumerate(np.diff(seconds, prepend=seconds[0])):
        variance += rate**2 * since
        left[row] = residual_nT[row] - level
        if not kept[row]:
            continue
        if variance < 1e3 * noise_nT**2:
            unsure.append(variance)
        gain = variance / (variance + noise_nT**2)
        level = level + gain * left[row]
        variance *= 1.0 - gain
    return left, float(np.sqrt(np.mean(unsure))) if unsure else 0.0


def one_step_seen(
    residual_nT: FloatArray, axes: RowAxes, seconds: FloatArray, kept: BoolArray, rate: float, noise_nT: float
) -> tuple[FloatArray, float]:
    """As `one_step`, for residuals (N, 3) in the rows' own axes, of which some components only are measured."""
    left, level, P = residual_nT.copy(), np.zeros(3), 1e6 * noise_nT**2 * np.eye(3)
    unsure = []
    for row, since in enumerate(np.diff(seconds, prepend=seconds[0])):
        P = P + rate**2 * since * np.eye(3)
        seen = axes.measured[row]
        H = axes.turn[row][seen]
        left[row, seen] -= H @ level
        if not kept[row]:
            continue
        spread = H @ P @ H.T
        if np.trace(spread) < 1e3 * noise_nT**2 * seen.sum():
            unsure.append(float(np.trace(spread)) / int(seen.sum()))
        gain = np.linalg.solve(spread + noise_nT**2 * np.eye(len(H)), H @ P).T
        level = level + gain @ left[row, seen]
        P = P - gain @ H @ P
    return left, float(np.sqrt(np.mean(unsure))) if unsure else 0.0


def shrinkage(
    prediction: Prediction,
    kept: BoolArray,
    floor_nT: float,
    floor_with_effects_nT: float,
    *,
    seed: int,
    named: bool,
    shape_incomplete: bool = False,
    axes: RowAxes | None = None,
) -> Shrinkage:
    """The figures of the contract, over what is measured. Without a named effect, after is before.

    axes: where rows have no attitude; what is seen along the field counts for each body axis by its share in it.
    """
    kept = kept if prediction.known is None else kept & prediction.known
    before = prediction.before_nT[kept]
    after = prediction.after_nT[kept] if named else before
    groups = np.array_split(np.arange(len(before)), min(_FINE_BLOCKS, len(before)))
    count = np.full(len(before), 3) if axes is None else axes.measured[kept].sum(axis=1)
    b2, a2 = _draws(before, after, count, groups, seed)
    rms_before, rms_after = (float(np.sqrt(np.sum(values**2) / count.sum())) for values in (before, after))
    below = rms_before**2 - floor_nT**2
    measurable = named and below > 2.0 * float(b2.std())
    closed: float | None = None
    interval: tuple[float, float] | None = None
    if measurable:
        closed = _closed(rms_before**2, rms_after**2, floor_nT, floor_with_effects_nT)
        spread = [_closed(b, a, floor_nT, floor_with_effects_nT) for b, a in zip(b2, a2, strict=True)]
        low, high = np.percentile(spread, [5.0, 95.0])
        interval = (float(min(low, closed)), float(max(high, closed)))
    sizes = [_by_axis(values, kept, axes) for values in (before, after)]
    per_axis = {axis: {"before_nT": sizes[0][k], "after_nT": sizes[1][k]} for k, axis in enumerate("xyz")}
    return Shrinkage(
        before_nT=rms_before,
        after_nT=rms_after,
        floor_nT=floor_nT,
        floor_with_effects_nT=floor_with_effects_nT,
        closed=closed,
        interval=interval,
        prediction=prediction.of,
        shape_incomplete=shape_incomplete,
        per_axis=per_axis,
        worse=named and prediction.of == "blocks" and bool((a2 - b2).mean() > 3.0 * (a2 - b2).std()),
    )


def _draws(
    before: FloatArray, after: FloatArray, count: FloatArray, groups: Sequence[NDArray[np.intp]], seed: int
) -> tuple[FloatArray, FloatArray]:
    """Mean squares before and after, (draws,) each, as other noise would have made them: a bootstrap of stretches.

    What the effects explain, s = before - after, belongs to the design and stays as it is (a clip acts in a few
    stretches only, and is measured none the less); before^2 = s^2 + (2 before after - after^2), and the bracket is
    drawn anew.
    """
    parts = (2.0 * before * after - after**2, after**2)
    sums = np.array([[*(np.sum(part[g]) for part in parts), np.sum(count[g])] for g in groups])
    rng = np.random.default_rng(seed)
    drawn = sums[rng.integers(0, len(sums), size=(_DRAWS, len(sums)))].sum(axis=1)
    explained = float(np.sum((before - after) ** 2) / count.sum())
    return explained + drawn[:, 0] / drawn[:, 2], drawn[:, 1] / drawn[:, 2]


def _by_axis(left_nT: FloatArray, kept: BoolArray, axes: RowAxes | None) -> list[float]:
    """rms along each body axis of residuals (n, 3) at the rows that are kept."""
    if axes is None:
        return [float(np.sqrt(np.mean(component**2))) for component in left_nT.T]
    share = axes.turn[kept] ** 2 * axes.measured[kept][:, :, None]
    energy = np.einsum("nki,nk->i", share, left_nT**2)
    return [float(value) for value in np.sqrt(energy / np.maximum(share.sum(axis=(0, 1)), 1e-300))]


def floor_rms_nT(field_nT: FloatArray, sigma_nT: float, theta_rad: float, measured: BoolArray | None = None) -> float:
    """rms per component that white noise and an attitude error theta per axis leave: theta x B has two components.

    field_nT (N, 3) that the error acts on; measured (N, 3), in the same axes: components that count, default all.
    """
    reached = np.sum(field_nT**2, axis=1)[:, None] - field_nT**2
    mean = np.mean(reached if measured is None else reached[measured])
    return float(np.sqrt(sigma_nT**2 + theta_rad**2 * mean))


def _closed(before2: float, after2: float, floor: float, floor_with: float) -> float:
    below = before2 - floor**2
    if below <= 0:
        return 0.0
    return float(np.clip(1.0 - max(after2 - floor_with**2, 0.0) / below, 0.0, 1.0))


def _block_numbers(seconds: FloatArray, kept: BoolArray) -> FloatArray:
    """(N,) block of each row: equal counts of kept rows, contiguous."""
    place = np.cumsum(kept) - 1
    return np.clip(np.floor(place * BLOCKS / max(int(kept.sum()), 1)), 0, BLOCKS - 1)


def _solve(y: FloatArray, x: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Least squares of y (n, 3) on x (n, 3, P), both of unit noise, by the scaled Gram matrix: estimate (P,) and a root
    (P, P) of its covariance. Directions that say nothing get zero, and a covariance that is as good as infinite."""
    if x.shape[2] == 0:
        return np.zeros(0), np.zeros((0, 0))
    flat = x.reshape(-1, x.shape[2])
    size = np.sqrt(np.mean(flat**2, axis=0))
    scale = np.where(size > 0, size, 1.0) * np.sqrt(len(flat))
    values, vectors = np.linalg.eigh((flat.T @ flat) / np.outer(scale, scale))
    least = 1e-12 * values[-1]
    live = values > least
    moment = vectors[:, live].T @ ((flat.T @ y.reshape(-1)) / scale)
    root = vectors / np.sqrt(np.maximum(values, least)) / scale[:, None]
    return np.asarray((vectors[:, live] @ (moment / values[live])) / scale), np.asarray(root)
