"""How well each block of columns explains a residual: F statistics and evidences, from small Gram matrices.

Everything happens in whitened units with the fitted columns projected out, so that a block is only credited with
what calibration and the named effects cannot do. A block is made, whitened, reduced to its Gram matrix and
forgotten: memory does not grow with the number of blocks.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import overload

import numpy as np

from fluxtwin.gap.hypotheses.blocks import Block
from fluxtwin.gap.linear.leftover import Leftover, Whitens, log10_sf_f
from fluxtwin.sim.base.types import BoolArray, FloatArray

_RANK_TOLERANCE = 1e-7
_MOST_BYTES = 400e6  # that all columns of a design may take at once
_LOG_SIZES = np.linspace(np.log(0.01), np.log(100.0), 19)
"""Prior of a discrepancy's size against the noise of a reading: even in its logarithm."""


@dataclass(frozen=True, eq=False)
class Fit:
    """A block against a leftover: its Gram matrix and moments, scaled to one noise unit a reading."""

    block: Block
    gram: FloatArray
    moment: FloatArray
    size: FloatArray
    """(k,) squared sizes of the scaled columns before the projection: what rank is judged against."""
    least_share: float = _RANK_TOLERANCE

    def modes(self, columns: BoolArray | None = None) -> tuple[FloatArray, FloatArray]:
        """Squared singular values d^2 and squared projections q^2 of the residual, of the live modes."""
        return self._all_modes if columns is None else self._modes(columns)

    @cached_property
    def _all_modes(self) -> tuple[FloatArray, FloatArray]:
        return self._modes(np.ones(self.moment.size, dtype=np.bool_))

    def _modes(self, pick: BoolArray) -> tuple[FloatArray, FloatArray]:
        pick = pick & (np.diag(self.gram) > max(1e-6, self.least_share) * self.size)
        if not pick.any():
            return np.zeros(0), np.zeros(0)
        value, vector = np.linalg.eigh(self.gram[np.ix_(pick, pick)])
        live = value > self.least_share * self.size[pick].max()
        projected = vector[:, live].T @ self.moment[pick]
        return value[live], projected**2 / value[live]

    def f_test(self, left: Leftover) -> tuple[float, float, int]:
        """p-value (log10), explained energy and rank."""
        _, explained = self.modes()
        rank = explained.size
        if not rank or left.degrees <= rank + 5:
            return 0.0, 0.0, 0
        gain = float(explained.sum())
        spare = left.degrees - rank
        ratio = (gain / rank) / max((left.energy - gain) / spare, 1e-300)
        return float(log10_sf_f(ratio, rank, spare)), gain, rank

    def log_evidence(self, left: Leftover, columns: BoolArray | None = None) -> float:
        """Log Bayes factor against "nothing", the unknown noise level and the block's size integrated out.

        Normal coefficients of standard deviation s noise units, s even in log; Jeffreys' prior of the noise level.
        """
        squared, explained = self.modes(columns)
        if not squared.size:
            return -np.inf
        scaled = np.exp(2 * _LOG_SIZES)[:, None] * squared
        shrunk = np.sum(explained * scaled / (1 + scaled), axis=1)
        rest = np.log1p(-np.minimum(shrunk / left.energy, 1 - 1e-12))
        logs = -0.5 * np.log1p(scaled).sum(axis=1) - 0.5 * left.degrees * rest
        return float(np.logaddexp.reduce(logs) - np.log(_LOG_SIZES.size))


def fit(block: Block, left: Leftover) -> Fit:
    """Make a block, whiten it, project it, and keep what counts."""
    free, size = _scaled(block, left)
    return Fit(block, free.T @ free, free.T @ left.residual, size, left.least_share)


def _scaled(block: Block, left: Leftover) -> tuple[FloatArray, FloatArray]:
    free, size = left.project(block.make())
    scale = np.sqrt(size.sum() / max(size.size * left.residual.size, 1))
    scale = scale if scale > 0 else 1.0
    return free / scale, size / scale**2


@dataclass(frozen=True, eq=False)
class Prepared:
    """Blocks made, whitened and projected once, for many residuals on one design with one noise model."""

    found: Sequence[Block]
    columns: Sequence[FloatArray]
    """(3N, k) each, scaled to one noise unit a reading."""
    sizes: Sequence[FloatArray]

    def fits(self, left: Leftover) -> list[Fit]:
        """As `fit_all`; `left` must have the whitening and the basis of the preparation."""
        return [
            Fit(block, gram, free.T @ left.residual, size, left.least_share)
            for block, gram, free, size in zip(self.found, self._grams, self.columns, self.sizes, strict=True)
        ]

    @cached_property
    def _grams(self) -> list[FloatArray]:
        return [free.T @ free for free in self.columns]


def prepare(found: Sequence[Block], left: Leftover) -> Prepared:
    """Do the part of `fit_all` that does not depend on the residual; takes memory for all columns."""
    columns, sizes = zip(*(_scaled(block, left) for block in found), strict=True)
    return Prepared(found, columns, sizes)


def fit_all(found: Sequence[Block], left: Leftover) -> list[Fit]:
    """`fit` for each."""
    return found.fits(left) if isinstance(found, Dictionary) else [fit(block, left) for block in found]


class Dictionary(Sequence[Block]):
    """The blocks of a design side by side, whitened once for each noise model.

    Blocks are only compared through their own small Gram matrices, so what a leftover's basis takes from all of them
    is one product of matrices. Where the rows are too many for that, blocks are made and whitened in turn.
    """

    def __init__(self, found: Sequence[Block], rows: int) -> None:
        self.found = tuple(found)
        ends = np.cumsum([len(block.axes) for block in self.found])
        self.slices = [slice(int(end) - len(b.axes), int(end)) for b, end in zip(self.found, ends, strict=True)]
        self.width = int(ends[-1]) if self.found else 0
        self.small = 24 * rows * self.width <= _MOST_BYTES
        self._latest: tuple[Whitens, FloatArray, list[FloatArray]] | None = None

    def __len__(self) -> int:
        return len(self.found)

    @overload
    def __getitem__(self, index: int) -> Block: ...
    @overload
    def __getitem__(self, index: slice) -> Sequence[Block]: ...
    def __getitem__(self, index: int | slice) -> Block | Sequence[Block]:
        return self.found[index]

    @cached_property
    def columns(self) -> FloatArray:
        """(N, 3, K) all blocks' columns in turn, in nT per unit."""
        made = self.found[0].make()
        out = np.empty((*made.shape[:2], self.width))
        for block, part in zip(self.found, self.slices, strict=True):
            out[:, :, part] = block.make()
        return out

    def white(self, whitener: Whitens) -> tuple[FloatArray, list[FloatArray]]:
        """(3N, K) whitened columns, and the Gram matrix of each block."""
        if self._latest is None or self._latest[0] is not whitener:
            flat = whitener.apply(self.columns).reshape(-1, self.width)
            self._latest = (whitener, flat, [flat[:, part].T @ flat[:, part] for part in self.slices])
        return self._latest[1], self._latest[2]

    def products(self, left: Leftover, other: FloatArray) -> Iterator[FloatArray]:
        """For each block (k, m): products of its whitened columns with others (3N, m)."""
        if self.small:
            whole = self.white(left.whitener)[0].T @ other
            yield from (whole[part] for part in self.slices)
            return
        for block in self.found:
            white = left.whitener.apply(np.ascontiguousarray(block.make()))
            yield white.reshape(other.shape[0], -1).T @ other

    def fits(self, left: Leftover) -> list[Fit]:
        """`fit` for each block."""
        if not self.small or not self.found:
            return [fit(block, left) for block in self.found]
        _, grams = self.white(left.whitener)
        along = self.products(left, np.concatenate([left.basis, left.residual[:, None]], axis=1))
        return [_fit_of(*each, left) for each in zip(self.found, grams, along, strict=True)]


def _fit_of(block: Block, gram: FloatArray, along: FloatArray, left: Leftover) -> Fit:
    """A fit from a block's whitened Gram matrix (k, k) and its products (k, q + 1) with basis and residual."""
    size = np.diag(gram)
    scale = np.sqrt(size.sum() / max(size.size * left.residual.size, 1))
    scale = scale if scale > 0 else 1.0
    free = gram - along[:, :-1] @ along[:, :-1].T
    return Fit(block, free / scale**2, along[:, -1] / scale, size / scale**2, left.least_share)
