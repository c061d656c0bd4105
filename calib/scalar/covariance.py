"""The covariance of an estimate without attitude, from the scores of its rows.

The error of the estimate is slope^-1 times the sum of the scores. `white`: rows independent, each with its own score
(White 1980). `blocks`: errors are correlated within a block; where there are at least two blocks a parameter, the scatter of
the blocks, corrected for their leverage, is shrunk towards the white covariance (`shrinkage`); a shorter record has the
white covariance widened by the integrated correlation of its residual.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from fluxtwin.calib.common.covariance import (
    FEWEST_BLOCKS,
    batch_widening,
    cells,
    groupings,
    kernel_moments,
    observed_s,
    segments,
)
from fluxtwin.calib.common.shrinkage import grown
from fluxtwin.calib.scalar.model import ScalarData, Solved, blocks, terms
from fluxtwin.sim.base.types import FloatArray, TimeArray

_CELLS = 2000
_MOST_SHARE = 0.99  # of the slope in one block: a block cannot test what it alone determines


class Scores(NamedTuple):
    """What the rows say of the error of an estimate."""

    rows: FloatArray
    """(N, p) scores; mean zero."""
    slope: FloatArray
    """(p, p)."""
    derivative: FloatArray
    """(N, p) change of a row's score for an error of |H| of one."""
    half: FloatArray
    """(N, p) h whose products h h' add up to the slope."""


def scores_of(solved: Solved, data: ScalarData, a: FloatArray) -> Scores:
    """Of the maximum-likelihood estimate; near enough for TWOSTEP, whose rows weigh the same."""
    rows = np.empty((len(data.H), data.size))
    slopes = np.empty((len(data.H), data.size))
    half = np.empty((len(data.H), data.size))
    for at, part in blocks(data):
        of = terms(solved.p, part)
        w = a[at] / of.q
        rows[at] = w[:, None] * (of.g * of.r[:, None] - of.shared)
        slopes[at] = w[:, None] * of.g
        half[at] = np.sqrt(w)[:, None] * of.g
    return Scores(rows - rows.mean(axis=0), solved.sums.information, slopes, half)


def white_covariance(scores: Scores) -> FloatArray:
    """(p, p), with n/(n-p)."""
    rows, size = scores.rows.shape
    inverse = np.linalg.inv(scores.slope)
    meat = scores.rows.T @ scores.rows * rows / max(rows - size, 1)
    return np.asarray(inverse @ meat @ inverse.T)


def scalar_covariance(
    scores: Scores,
    residual: FloatArray,
    time: TimeArray,
    kind: str,
    *,
    passes: np.ndarray | None = None,
    block_s: float | None = None,
) -> tuple[FloatArray, str]:
    """(p, p) and how it was found. residual: (N,)."""
    white = white_covariance(scores)
    segment = segments(time)
    widening = batch_widening(residual[:, None], segment)
    if kind == "white":
        if widening > 1.44:
            return white, (
                "covariance: white; the residuals are correlated in time, so that these sigmas are too small by up to "
                f"{np.sqrt(widening):.1f}: covariance blocks (--covariance blocks) allows for it"
            )
        return white, "covariance: white"
    covered_s, size = observed_s(time, segment), scores.rows.shape[1]
    found = grown(_deviations(scores, white, time, segment, passes, block_s, max(FEWEST_BLOCKS, 2 * size)))
    if found is None:
        return widening * white, (
            f"covariance: too few blocks in {covered_s:.0f} s; white, the variances multiplied by {widening:.2f}, the "
            "integrated correlation of the residual"
        )
    W, misfit, words = found
    half = np.linalg.cholesky(white)
    return half @ W @ half.T, (
        f"covariance: white, with variances multiplied by {misfit:.2g} on average, to agree with the scatter of {words}"
    )


def _deviations(
    scores: Scores,
    white: FloatArray,
    time: TimeArray,
    segment: np.ndarray,
    passes: np.ndarray | None,
    block_s: float | None,
    fewest: int,
) -> Iterator[tuple[FloatArray, str]]:
    """(G, p) of every grouping with enough blocks: what each block adds to the error of the estimate, in white sigmas."""
    half = np.linalg.cholesky(white)
    for of_row, words in groupings(time, segment, passes, block_s):
        count = int(of_row.max()) + 1
        if count >= fewest:
            moved = _moved(scores, of_row, count) * np.sqrt(count)
            yield np.linalg.solve(half, moved.T).T, f"{count} blocks ({words})"


def _moved(scores: Scores, of_row: np.ndarray, count: int) -> FloatArray:
    """(G, p) what each block adds to the error of the estimate, about the mean.

    Corrected for leverage (CR2 of Bell & McCaffrey 2002, Survey Methodology 28, 169): in units in which the slope is one,
    the scores of a block have the covariance A (1 - A), A being its share of the slope. Leaving blocks out one at a time
    (A / (1 - A)) makes sigmas 18 % too wide, because blocks differ in information.
    """
    order = np.argsort(of_row, kind="stable")
    edges = np.searchsorted(of_row[order], np.arange(count + 1))
    down = np.linalg.inv(np.linalg.cholesky(scores.slope))
    moved = np.empty((count, scores.rows.shape[1]))
    for block in range(count):
        rows = order[edges[block] : edges[block + 1]]
        half = scores.half[rows] @ down.T
        share, vector = np.linalg.eigh(half.T @ half)
        freed = vector / np.sqrt(1.0 - np.clip(share, 0.0, _MOST_SHARE))
        moved[block] = down.T @ (freed @ (vector.T @ (down @ scores.rows[rows].sum(axis=0))))
    return np.asarray(moved - moved.mean(axis=0))


def field_error_covariance(scores: Scores, time: TimeArray, field_error: float, radian_s: float) -> FloatArray:
    """(p, p) from an error of the model's |H|, rms `field_error`, Gauss-Markov with a memory of `radian_s`."""
    equal = np.full(len(time), 1.0 / len(time))
    seen = cells(time, segments(time), [scores.derivative], equal, most=_CELLS)
    moments = kernel_moments(seen, np.array([radian_s]))[0] * len(time) ** 2
    inverse = np.linalg.inv(scores.slope)
    return np.asarray(field_error**2 * inverse @ moments @ inverse.T)
