"""Whether the same parameters hold over the whole record, as those of a cause do.

Effects of many parameters, and several effects together, can follow what they are not; but then each part of the record
wants parameters of its own. The effects' columns are cut at equal numbers of rows, and an F test asks whether parameters
of their own for each part explain more than noise does (Chow 1960, Econometrica 28, 591, for two parts).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from fluxtwin.gap.evidence import orthonormal
from fluxtwin.gap.named import SearchResult
from fluxtwin.sim.base.types import FloatArray

MANY = 9
"""Parameters: a matrix and less are bound to one condition, the polynomials (18, 30) to none."""
FALSE_ALARM = 0.01
"""Probability that true causes are found inconstant, over all parts and names."""
_PARTS = (2, 5)
_LEAST_LEFT = 1e-6  # of its energy that a direction must have beside what is fitted


def constant(found: SearchResult) -> bool:
    """Whether the named effects of a search keep their parameters from part to part of the record.

    Asked where it can be otherwise: of several names, or of one with more than `MANY` parameters.
    """
    named = found.named
    if len(named) < 2 and not pliable(found):
        return True
    widths = [len(one.effect.parameters) for one in named]
    values = list(p_values(found.residual_white, found.jacobian_white, widths))
    return min(values) * len(values) >= FALSE_ALARM


def pliable(found: SearchResult) -> bool:
    """Whether an effect is named that has more than `MANY` parameters."""
    return any(len(one.effect.parameters) > MANY for one in found.named)


def p_values(residual: FloatArray, columns: FloatArray, widths: Sequence[int]) -> Iterator[float]:
    """Of each effect alone and, if there are several, of all together; for each number of parts.

    residual (M, 3) and columns (M, 3, c + p) of everything fitted, whitened; widths: the parameters of each effect, the
    last ones of the columns in turn. Rows that are zero in all columns do not count.
    """
    rest = residual.reshape(-1)
    basis = orthonormal(columns.reshape(rest.size, -1))
    rest = rest - basis @ (basis.T @ rest)
    measured = int(np.count_nonzero(np.any(columns != 0.0, axis=2)))
    ends = columns.shape[2] - np.cumsum([0, *reversed(widths)])[::-1]
    slices = [slice(int(start), int(end)) for start, end in pairwise(ends)]
    if len(slices) > 1:
        slices.append(slice(int(ends[0]), int(ends[-1])))
    for part in slices:
        for count in _PARTS:
            yield _p_value(columns[:, :, part], rest, basis, measured, count)


def _p_value(columns: FloatArray, rest: FloatArray, basis: FloatArray, measured: int, count: int) -> float:
    """Of the F test that the columns (M, 3, p) need parameters of their own in each of `count` parts."""
    cut = np.concatenate([_only(columns, rows) for rows in np.array_split(np.arange(len(columns)), count)[:-1]], axis=1)
    size = np.linalg.norm(cut, axis=0)
    cut = cut[:, size > 0] / size[size > 0]
    for _ in range(2):  # the second pass removes the rounding of the first
        cut = cut - basis @ (basis.T @ cut)
    values, vectors = np.linalg.eigh(cut.T @ cut)
    live = values > _LEAST_LEFT
    gain = float(np.sum((vectors[:, live].T @ (cut.T @ rest)) ** 2 / values[live]))
    rank = int(live.sum())
    free = measured - basis.shape[1] - rank
    if rank == 0 or free < 1:
        return 1.0
    return float(stats.f.sf(gain / rank / max((rest @ rest - gain) / free, 1e-300), rank, free))


def _only(columns: FloatArray, rows: NDArray[np.intp]) -> FloatArray:
    """(3M, p) the columns with nothing outside some rows."""
    part = np.zeros_like(columns)
    part[rows] = columns[rows]
    return part.reshape(-1, columns.shape[2])
