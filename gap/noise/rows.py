"""Fewer rows for the choice of the noise: means over short stretches, and stretches left out where that is not enough."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from fluxtwin.gap.noise.reml import Data
from fluxtwin.sim.base.types import BoolArray, FloatArray

IndexArray = NDArray[np.intp]

LONGEST_MEAN_S = 30.0
_COHERENT = 0.99  # share of the field's mean square that the square of its mean keeps
_STRETCH = 200  # rows of a stretch that is kept whole


def stretches(rows: int, limit: int) -> IndexArray:
    """Indices of at most about `limit` of `rows` rows: whole stretches, evenly over the record."""
    if rows <= limit:
        return np.arange(rows)
    kept = max(limit // _STRETCH, 1)
    starts = np.linspace(0, rows - _STRETCH, kept).astype(int)
    return np.unique((starts[:, None] + np.arange(_STRETCH)[None, :]).clip(0, rows - 1))


def condensed(
    residual_nT: FloatArray,
    designs: Sequence[FloatArray],
    image_nT: FloatArray,
    seconds: FloatArray,
    segment: FloatArray,
    weights: FloatArray,
    limit: int,
    longest_mean_s: float = LONGEST_MEAN_S,
    measured: BoolArray | None = None,
) -> Data:
    """At most about `limit` rows for the likelihood: as they are, or means over short stretches, or some of them.

    residual, weights (N, 3); image (N, 3, 3) of a turn; designs (N, 3, P) each; seconds, segment (N,). A mean is
    weighted per component; the likelihood knows how many readings are in it and how an attitude error averages.
    measured (N, 3): components that there are; rows that differ in them are not averaged.
    """
    rows = seconds.size
    if rows <= limit:
        ones = np.ones(rows)
        whole = np.concatenate(list(designs), axis=2)
        return Data(residual_nT, whole, image_nT, seconds, segment, weights, ones, np.zeros(rows))
    alike = segment
    if measured is not None:
        alike = segment + np.concatenate([[0], np.cumsum(np.any(measured[1:] != measured[:-1], axis=1))])
    starts = _starts(seconds, alike, image_nT, limit, longest_mean_s)
    chosen = stretches(starts.size, limit)
    count = np.diff(np.append(starts, rows))[chosen].astype(float)
    take = np.repeat(np.isin(np.arange(starts.size), chosen), np.diff(np.append(starts, rows)))
    index = np.flatnonzero(take)
    first = np.concatenate([[0.0], np.cumsum(count)[:-1]]).astype(int)
    w = weights[index]
    total = np.add.reduceat(w, first, axis=0)
    per = 1.0 / np.where(total > 0, total, 1.0)

    def mean(values: FloatArray) -> FloatArray:
        return np.asarray(np.add.reduceat(w * values[index], first, axis=0) * per)

    columns = [mean(design[:, :, p]) for design in designs for p in range(design.shape[2])]
    whole = np.stack(columns, axis=2) if columns else np.zeros((first.size, 3, 0))
    last = first + count.astype(int) - 1
    when = seconds[index]
    spacing = (when[last] - when[first]) / np.maximum(count - 1.0, 1.0)
    image = np.add.reduceat(image_nT[index], first, axis=0) / count[:, None, None]
    middle = np.add.reduceat(when, first) / count
    return Data(mean(residual_nT), whole, image, middle, segment[index][first], total, count, spacing)


def _starts(
    seconds: FloatArray, segment: FloatArray, image_nT: FloatArray, limit: int, longest_mean_s: float
) -> IndexArray:
    """First rows of the stretches to be averaged: so short that the field hardly turns within one."""
    spacing = float(np.median(np.diff(seconds)))
    length = min(np.ceil(seconds.size / limit) * spacing, longest_mean_s)
    while length >= 2.0 * spacing:
        cell = np.floor((seconds - seconds[0]) / length + 1e-6)
        starts = np.concatenate([[0], np.flatnonzero((np.diff(cell) > 0) | (np.diff(segment) != 0)) + 1])
        count = np.diff(np.append(starts, seconds.size))
        mean = np.add.reduceat(image_nT, starts, axis=0) / count[:, None, None]
        square = np.add.reduceat(np.sum(image_nT**2, axis=(1, 2)), starts) / count
        kept = np.where(square > 0, np.sum(mean**2, axis=(1, 2)) / np.maximum(square, 1e-30), 1.0)
        if float(np.median(kept)) > _COHERENT:
            return starts
        length /= 2.0
    return np.arange(seconds.size)
