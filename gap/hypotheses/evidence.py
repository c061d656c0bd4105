"""How much each block of columns explains of a residual, from small Gram matrices.

Everything happens in whitened units with the fitted columns projected out, so that a block is only credited with
what calibration and the named effects cannot do. A block is made, whitened, reduced to its Gram matrix and
forgotten: memory does not grow with the number of blocks.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from fluxtwin.gap.hypotheses.blocks import Block
from fluxtwin.gap.linear.projection import ProjectedResidual, Whitens, explained
from fluxtwin.sim.base.types import BoolArray, FloatArray

_MOST_BYTES = 400e6  # that all columns of a design may take at once
_TOGETHER = 32  # blocks that are whitened at once: so many columns fit the cache of a core


@dataclass(frozen=True, eq=False)
class BlockFit:
    """A block against a residual: what its projected columns explain of it."""

    block: Block
    gram: FloatArray
    """(k, k) of the whitened columns with the fitted ones out of them."""
    moment: FloatArray
    """(k,) of these columns with the residual."""
    size: FloatArray
    """(k,) squared lengths of the whitened columns before the projection: what rank is measured against."""
    least_share: float
    searched: int = 0
    """Parameters that no column has: a moment, a frequency."""

    def explained(self, columns: BoolArray | None = None) -> tuple[float, int]:
        """Drop of chi-square by all columns, or by some of them (k,), and the number of parameters that are seen."""
        return self._whole if columns is None else self._explained(columns)

    @cached_property
    def _whole(self) -> tuple[float, int]:
        return self._explained(np.ones(self.moment.size, dtype=np.bool_))

    def _explained(self, pick: BoolArray) -> tuple[float, int]:
        pick = pick & (np.diag(self.gram) > self.least_share * self.size)
        if not pick.any():
            return 0.0, 0
        least = self.least_share * float(self.size[pick].max())
        drop, rank = explained(self.gram[np.ix_(pick, pick)], self.moment[pick], least)
        return drop, rank + self.searched


def fit(block: Block, left: ProjectedResidual) -> BlockFit:
    """Make a block, whiten it, project it, and keep what counts."""
    free, size = left.project(block.make())
    return BlockFit(block, free.T @ free, free.T @ left.residual, size, left.least_share)


def fit_all(found: Sequence[Block], left: ProjectedResidual) -> list[BlockFit]:
    """`fit` for each."""
    return [fit(block, left) for block in found]


class Dictionary:
    """The blocks of a design side by side, whitened once for each noise model.

    Blocks are only compared through their own small Gram matrices, so what a residual's basis takes from all of them
    is one product of matrices. Where the rows are too many for that, blocks are made and whitened in turn.
    """

    def __init__(self, found: Sequence[Block], rows: int) -> None:
        self.found, self.rows = tuple(found), rows
        ends = np.cumsum([len(block.axes) for block in self.found])
        self.slices = [slice(int(end) - len(b.axes), int(end)) for b, end in zip(self.found, ends, strict=True)]
        self.width = int(ends[-1]) if self.found else 0
        self.small = 24 * rows * self.width <= _MOST_BYTES
        self._latest: tuple[Whitens, FloatArray, list[FloatArray]] | None = None

    def white(self, whitener: Whitens) -> tuple[FloatArray, list[FloatArray]]:
        """(3N, K) whitened columns, and the Gram matrix of each block."""
        if self._latest is None or self._latest[0] is not whitener:
            flat = self._latest[1] if self._latest else np.empty((3 * self.rows, self.width))  # there is room for one
            for first in range(0, len(self.found), _TOGETHER):
                blocks = self.found[first : first + _TOGETHER]
                made = np.concatenate([block.make() for block in blocks], axis=2)
                part = slice(self.slices[first].start, self.slices[first].start + made.shape[2])
                flat[:, part] = whitener.apply(made).reshape(len(flat), -1)
            self._latest = (whitener, flat, [flat[:, part].T @ flat[:, part] for part in self.slices])
        return self._latest[1], self._latest[2]

    def fits(self, left: ProjectedResidual) -> list[BlockFit]:
        """`fit` for each block."""
        if not self.small or not self.found:
            return fit_all(self.found, left)
        white, grams = self.white(left.whitener)
        along = white.T @ np.concatenate([left.basis, left.residual[:, None]], axis=1)
        fits = []
        for block, gram, part in zip(self.found, grams, self.slices, strict=True):
            products = along[part]
            free = gram - products[:, :-1] @ products[:, :-1].T
            fits.append(BlockFit(block, free, products[:, -1], np.diag(gram), left.least_share))
        return fits
