"""How much each block of columns explains of a residual, from small Gram matrices.

Everything happens in whitened units with the fitted columns projected out, so that a block is only credited with
what calibration and the named effects cannot do. A block is made, whitened, reduced to its Gram matrix and
forgotten: memory does not grow with the number of blocks.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from fluxtwin.gap.hypotheses.blocks import Block
from fluxtwin.gap.linear.projection import ProjectedResidual, Whitens, explained
from fluxtwin.sim.base.types import BoolArray, FloatArray

_MOST_BYTES = 100e6  # that the whitened columns of a design may take between two questions
_TOGETHER = 8  # blocks that are whitened at once: so many columns fit the cache of a core


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
    _known: dict[bytes, tuple[float, int]] = field(default_factory=dict, init=False)
    """By columns, what they explain."""

    def explained(self, columns: BoolArray | None = None) -> tuple[float, int]:
        """Drop of chi-square by all columns, or by some of them (k,), and the number of parameters that are seen."""
        pick = np.ones(self.moment.size, dtype=np.bool_) if columns is None else columns
        key = pick.tobytes()
        if key not in self._known:
            self._known[key] = self._explained(pick)
        return self._known[key]

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
    """The blocks of a design side by side.

    Blocks are only compared through their own small Gram matrices, so what a residual's basis takes from all of them is one
    product of matrices. What is whitened is kept for the next question under the same noise model; where it takes too much
    room, some blocks are made and whitened at a time, and forgotten.
    """

    def __init__(self, found: Sequence[Block], rows: int, most_bytes: float = _MOST_BYTES) -> None:
        self.found, self.rows = tuple(found), rows
        self.kept = 24 * rows * sum(len(block.axes) for block in self.found) <= most_bytes
        self._latest: tuple[Whitens, _Part] | None = None

    def _white(self, whitener: Whitens) -> Iterator[_Part]:
        """Whitened blocks, all or some at a time."""
        if self._latest is not None and self._latest[0] is whitener:
            yield self._latest[1]
            return
        self._latest, together = None, max(len(self.found), 1) if self.kept else _TOGETHER
        for first in range(0, len(self.found), together):
            part = self._part(self.found[first : first + together], whitener)
            if self.kept:
                self._latest = (whitener, part)
            yield part

    def _part(self, blocks: Sequence[Block], whitener: Whitens) -> _Part:
        ends = np.cumsum([0, *(len(block.axes) for block in blocks)]).tolist()
        if len(blocks) <= _TOGETHER:
            white = _whitened(blocks, whitener)
        else:
            white = np.empty((3 * self.rows, ends[-1]))
            for first in range(0, len(blocks), _TOGETHER):
                last = min(first + _TOGETHER, len(blocks))
                white[:, ends[first] : ends[last]] = _whitened(blocks[first:last], whitener)
        slices = [slice(*pair) for pair in pairwise(ends)]
        return _Part(blocks, white, slices, [white[:, one].T @ white[:, one] for one in slices])

    def fits(self, left: ProjectedResidual) -> list[BlockFit]:
        """`fit` for each block."""
        return self.fits_each([left])[0]

    def fits_each(self, lefts: Sequence[ProjectedResidual]) -> list[list[BlockFit]]:
        """`fits` for each of some residuals that were whitened alike."""
        found: list[list[BlockFit]] = [[] for _ in lefts]
        for part in self._white(lefts[0].whitener):
            for left, fits in zip(lefts, found, strict=True):
                along = part.white.T @ np.column_stack([left.basis, left.residual])
                for block, here, gram in zip(part.blocks, part.slices, part.grams, strict=True):
                    basis, moment = along[here, :-1], along[here, -1]
                    fits.append(BlockFit(block, gram - basis @ basis.T, moment, np.diag(gram), left.least_share))
        return found


def _whitened(blocks: Sequence[Block], whitener: Whitens) -> FloatArray:
    """(3N, k) columns of some blocks."""
    made = np.concatenate([block.make() for block in blocks], axis=2)
    return whitener.apply(made).reshape(-1, made.shape[2])


class _Part(NamedTuple):
    """Some blocks of a design."""

    blocks: Sequence[Block]
    white: FloatArray
    """(3N, k) their columns, whitened."""
    slices: list[slice]
    """Where each of them stands."""
    grams: list[FloatArray]
