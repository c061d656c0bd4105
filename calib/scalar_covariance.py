"""The covariance of an estimate without attitude, from the scores of its rows.

The error of the estimate is slope^-1 times the sum of the scores. `white`: rows independent, each with its own score
(White 1980). `blocks`: errors hang together within a block; every block is left out once, by one Newton step each
(the delete-one-block jackknife), where there are at least two blocks a parameter; a shorter record has the white
covariance widened by the integrated correlation of its residual.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fluxtwin.calib.covariance import (
    Blocks,
    batch_widening,
    correlation_time_s,
    make_blocks,
    observed_s,
    segments,
    small_sample,
)
from fluxtwin.calib.scalar_ml import Solved
from fluxtwin.calib.scalar_model import ScalarData, blocks, terms
from fluxtwin.calib.slow_errors import cells, kernel_moments
from fluxtwin.sim.types import FloatArray, TimeArray

_CELLS = 2000
_FEWEST_BLOCKS = 8


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


def scores_of(solved: Solved, data: ScalarData, a: FloatArray | None, sharpness: float) -> Scores:
    """Of the maximum-likelihood estimate; near enough for TWOSTEP, whose rows weigh the same."""
    rows = np.empty((len(data.H), data.size))
    slopes = np.empty((len(data.H), data.size))
    half = np.empty((len(data.H), data.size))
    for at, part in blocks(data):
        of = terms(solved.p, part)
        w = (1.0 if a is None else a[at]) / of.q
        rows[at] = w[:, None] * (of.g * of.r[:, None] - sharpness * of.shared)
        slopes[at] = w[:, None] * of.g
        half[at] = np.sqrt(sharpness * w)[:, None] * of.g
    return Scores(rows - rows.mean(axis=0), sharpness * solved.sums.information, slopes, half)


def white_covariance(scores: Scores) -> FloatArray:
    """(p, p), with n/(n-p)."""
    rows, size = scores.rows.shape
    inverse = np.linalg.inv(scores.slope)
    meat = scores.rows.T @ scores.rows * rows / max(rows - size, 1)
    return np.asarray(inverse @ meat @ inverse.T)


def stated_scalar_covariance(
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
                "covariance: white; the residuals hang together in time, so that these sigmas are too small by up to "
                f"{np.sqrt(widening):.1f}: covariance blocks (--covariance blocks) allows for it"
            )
        return white, "covariance: white"
    memory_s = correlation_time_s(time, residual[:, None], segment)
    grouped = make_blocks(time, memory_s, passes, block_s)
    if grouped.count >= max(_FEWEST_BLOCKS, 2 * scores.rows.shape[1]):
        return _jackknife(scores, grouped), f"covariance: jackknife over {grouped.count} blocks ({grouped.words})"
    covered_s = observed_s(time, segment)
    return widening * white, (
        f"covariance: only {grouped.count} blocks ({grouped.words}) in {covered_s:.0f} s; white, the variances "
        f"multiplied by {widening:.2f}, the integrated correlation of the residual"
    )


def _jackknife(scores: Scores, grouped: Blocks) -> FloatArray:
    order = np.argsort(grouped.of_row, kind="stable")
    edges = np.searchsorted(grouped.of_row[order], np.arange(grouped.count + 1))
    moved = np.empty((grouped.count, scores.rows.shape[1]))
    for block in range(grouped.count):
        rows = order[edges[block] : edges[block + 1]]
        left = scores.slope - scores.half[rows].T @ scores.half[rows]
        moved[block] = np.linalg.lstsq(left, scores.rows[rows].sum(axis=0), rcond=1e-12)[0]
    deviation = moved - moved.mean(axis=0)
    factor = small_sample(grouped.count) ** 2 * (grouped.count - 1) / grouped.count
    return np.asarray(factor * deviation.T @ deviation)


def field_error_covariance(scores: Scores, time: TimeArray, field_error: float, radian_s: float) -> FloatArray:
    """(p, p) from an error of the model's |H|, rms `field_error`, Gauss-Markov with a memory of `radian_s`."""
    equal = np.full(len(time), 1.0 / len(time))
    seen = cells(time, segments(time), [scores.derivative], equal, most=_CELLS)
    moments = kernel_moments(seen, np.array([radian_s]))[0] * len(time) ** 2
    inverse = np.linalg.inv(scores.slope)
    return np.asarray(field_error**2 * inverse @ moments @ inverse.T)
