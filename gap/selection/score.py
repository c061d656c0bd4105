"""Score tests of all causes, alone and together, from one Gram matrix.

Everything is whitened first and projected off the nuisance (what is modelled, and effects already named), so a score
is the exact drop of chi-square in the linear model. math: Rao's score test; F = (T / rank) / variance.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import f as f_distribution

from fluxtwin.gap.hypotheses.candidates import Candidate, settings_of
from fluxtwin.gap.linear.projection import SHARE_LEFT, Whitens, explained, orthonormal, projected_out
from fluxtwin.gap.noise.choice import NOISE_LOG_SD
from fluxtwin.gap.records.diagnosis import Score
from fluxtwin.sim.base.types import BoolArray, FloatArray
from fluxtwin.sim.effects.base import Effect

ALIKE = 0.98
"""Two effects that each imitate this share of the other are one group."""
_QUIETEST = 0.25
TRUSTED = round(0.5 / NOISE_LOG_SD**2)
"""Degrees of freedom that the noise model is worth by itself: its size is trusted to 10 %."""


@dataclass(frozen=True, eq=False)
class Board:
    """Whitened candidates beside a nuisance, ready for tests; M rows, P live columns of K candidates."""

    candidates: Sequence[Candidate]
    gram: FloatArray
    """(P, P) inner products of the columns, whitened, projected off the nuisance, each of unit length before that."""
    pull: FloatArray
    """(P,) inner products of the columns with the residual."""
    lengths: FloatArray
    """(P,) lengths before the projection, per unit of the parameter."""
    owner: FloatArray
    """(P,) number of the candidate that a column belongs to."""
    place: FloatArray
    """(P,) number of the parameter within its effect."""
    chi2: float
    """Of the residual beside the nuisance."""
    fitted: int
    """Directions of the nuisance."""
    measured: int
    """Scalar measurements that are not cut."""
    share_left: float = SHARE_LEFT
    """Of its energy that a column, or a combination of columns, must have beside the nuisance and other columns."""

    @cached_property
    def left(self) -> FloatArray:
        """(P,) share of each column's energy that the nuisance leaves."""
        return np.diag(self.gram)

    @cached_property
    def turn(self) -> FloatArray:
        """(P, R) to an orthonormal basis of each candidate's block; directions that the nuisance eats are left out."""
        blocks = [np.zeros((len(self.left), 0))]
        for number in range(len(self.candidates)):
            here = np.flatnonzero((self.owner == number) & (self.left > self.share_left))
            values, vectors = np.linalg.eigh(self.gram[np.ix_(here, here)])
            good = values > self.share_left
            block = np.zeros((len(self.left), int(good.sum())))
            block[here] = vectors[:, good] / np.sqrt(values[good])
            blocks.append(block)
        return np.concatenate(blocks, axis=1)

    @cached_property
    def block(self) -> FloatArray:
        """(R,) number of the candidate that each orthonormal direction belongs to."""
        which = np.argmax(self.turn != 0, axis=0) if self.turn.size else np.zeros(self.turn.shape[1], dtype=int)
        return np.asarray(self.owner[which])

    @cached_property
    def rank(self) -> NDArray[np.intp]:
        """(K,) directions of each candidate that can be seen."""
        return np.bincount(self.block.astype(int), minlength=len(self.candidates)).astype(np.intp)

    @cached_property
    def unit_gram(self) -> FloatArray:
        """(R, R) Gram matrix in the orthonormal bases: unit blocks on the diagonal."""
        return np.asarray(self.turn.T @ self.gram @ self.turn)

    @cached_property
    def score(self) -> FloatArray:
        """(R,) residual along each orthonormal direction."""
        return np.asarray(self.turn.T @ self.pull)

    @cached_property
    def statistic(self) -> FloatArray:
        """(K,) drop of chi-square by each candidate alone."""
        drops = np.bincount(self.block.astype(int), weights=self.score**2, minlength=len(self.candidates))
        return np.asarray(drops, dtype=np.float64)

    @cached_property
    def saturated(self) -> tuple[float, int]:
        """Drop of chi-square by all candidates together, and their joint rank."""
        return explained(self.unit_gram, self.score, self.share_left)

    @cached_property
    def freedom(self) -> int:
        """Degrees of freedom left by nuisance and all candidates."""
        return max(self.measured - self.fitted - self.saturated[1], 1)

    @property
    def trusted(self) -> int:
        """Degrees of freedom that the size of the noise is known from, by the budget at the least."""
        return max(self.freedom, TRUSTED)

    @cached_property
    def variance(self) -> float:
        """Of whitened rows about the saturated fit; 1 if the noise model is right, and where too few rows say.

        Never below a quarter: data much quieter than their noise model must not turn rounding into causes.
        """
        if self.freedom < TRUSTED:
            return 1.0
        return max(_QUIETEST, (self.chi2 - self.saturated[0]) / self.freedom)

    def p_value(self, drop: float, rank: int) -> float:
        """Of a drop of chi-square by `rank` directions, before any price."""
        return float(self._upper_tail(max(drop, 0.0), rank)) if rank else 1.0

    @cached_property
    def p_values(self) -> FloatArray:
        """(K,) of each candidate alone, before any price; 1 of one that cannot be seen, which explains nothing."""
        return np.asarray(self._upper_tail(self.statistic, np.maximum(self.rank, 1)))

    def _upper_tail(self, drop: Any, rank: Any) -> Any:
        return f_distribution.sf(drop / rank / self.variance, rank, self.trusted)

    @cached_property
    def shares(self) -> FloatArray:
        """(K, K) share of candidate k's signal (row; beside the nuisance) that candidate l (column) can imitate.

        S_kl = ||P_l X_k||**2 / ||X_k||**2 with the parameters of k in their typical sizes.
        """
        count, owner = len(self.candidates), self.owner.astype(int)
        size = np.concatenate([c.scale[c.live] for c in self.candidates] or [np.zeros(0)]) * self.lengths
        power = np.bincount(owner, weights=np.diag(self.gram) * size**2, minlength=count)
        imitated = (self.turn.T @ (self.gram * size)) ** 2
        by_direction, both = np.zeros((count, imitated.shape[1])), np.zeros((count, count))
        np.add.at(by_direction, self.block.astype(int), imitated)
        np.add.at(both, owner, by_direction.T)
        return np.asarray(np.clip(both / np.where(power > 0, power, np.inf)[:, None], 0.0, 1.0))

    @cached_property
    def shares_by_name(self) -> dict[str, dict[str, float]]:
        """{a: {b: share of a that b can imitate}}, the largest over alternatives of both; effects that are seen only."""
        seen = np.flatnonzero(self.rank > 0).tolist()
        names = list(dict.fromkeys(self.candidates[k].name for k in seen))
        number = np.array([names.index(self.candidates[k].name) for k in seen], dtype=np.intp)
        table = np.zeros((len(names), len(names)))
        np.maximum.at(table, (number[:, None], number), self.shares[np.ix_(seen, seen)])
        pairs = zip(names, table.tolist(), strict=True)
        return {one: {b: share for b, share in zip(names, row, strict=True) if b != one} for one, row in pairs}

    @property
    def isolability(self) -> dict[str, dict[str, float]]:
        """The shares worth saying: 0.5 and more, largest first."""
        ordered = {name: sorted(row.items(), key=lambda pair: -pair[1]) for name, row in self.shares_by_name.items()}
        large = {name: {other: share for other, share in row if share >= 0.5} for name, row in ordered.items()}
        return {name: row for name, row in large.items() if row}

    @property
    def same(self) -> dict[str, tuple[str, ...]]:
        """{name: names, its own first, that each imitate 0.98 of the other}."""
        table = self.shares_by_name
        return {
            name: (name, *(other for other, share in row.items() if min(share, table[other][name]) >= ALIKE))
            for name, row in table.items()
        }

    def alike_to(self, effect: Effect) -> tuple[str, ...]:
        """The effect's name, and those that have a setting which imitates 0.98 of it, and it of that one: of it in the form
        that it has here (an axis, a course), whatever the numbers among its settings."""

        def form(one: Effect) -> tuple[str, dict[str, object]]:
            return one.name, {key: value for key, value in settings_of(one).items() if isinstance(value, str)}

        own = [k for k, one in enumerate(self.candidates) if self.rank[k] > 0 and form(one.effect) == form(effect)]
        both = np.minimum(self.shares, self.shares.T)[own].max(axis=0, initial=0.0)
        others = [self.candidates[k].name for k in np.flatnonzero((self.rank > 0) & (both >= ALIKE)).tolist()]
        return tuple(dict.fromkeys([effect.name, *others]))

    def of(self, numbers: Sequence[int]) -> Board:
        """The board of some of its candidates, by their numbers in ascending order."""
        kept = np.isin(self.owner, numbers)
        products = (self.gram[np.ix_(kept, kept)], self.pull[kept], self.lengths[kept])
        places = (np.searchsorted(numbers, self.owner[kept]).astype(np.float64), self.place[kept])
        some = tuple(self.candidates[number] for number in numbers)
        return Board(some, *products, *places, self.chi2, self.fitted, self.measured, self.share_left)

    def scores(self) -> list[Score]:
        """Score and information of every candidate, in the units of its parameters."""
        pull = self.pull * self.lengths
        found = []
        for number, candidate in enumerate(self.candidates):
            mine = np.flatnonzero(self.owner == number)
            at, size = self.place[mine].astype(int), len(candidate.effect.parameters)
            score, information = np.zeros(size), np.zeros((size, size))
            score[at] = pull[mine] / self.variance
            scaled = self.gram[np.ix_(mine, mine)] * np.outer(self.lengths[mine], self.lengths[mine])
            information[np.ix_(at, at)] = scaled / self.variance
            found.append(Score(candidate.label, candidate.effect, score, information))
        return found

    def _modes(self, numbers: Sequence[int]) -> tuple[BoolArray, FloatArray, FloatArray]:
        """(R,) directions of these candidates; what can be seen of all of them together, values (r,) and vectors."""
        inside = np.isin(self.block, numbers)
        values, vectors = np.linalg.eigh(self.unit_gram[np.ix_(inside, inside)])
        good = values > self.share_left
        return inside, values[good], vectors[:, good]

    def given(self, numbers: Sequence[int]) -> tuple[FloatArray, NDArray[np.intp]]:
        """(K,) further drop of chi-square by each candidate once those of `numbers` are in, and its rank then."""
        inside, values, vectors = self._modes(numbers)
        basis = vectors / np.sqrt(values)
        mixed = basis.T @ self.unit_gram[inside]
        score = self.score - mixed.T @ (basis.T @ self.score[inside])
        return self._drops(mixed, score, np.asarray(numbers))

    def _drops(self, mixed: FloatArray, score: FloatArray, numbers: FloatArray) -> tuple[FloatArray, NDArray[np.intp]]:
        drop, rank = np.zeros(len(self.candidates)), np.zeros(len(self.candidates), dtype=np.intp)
        start = np.concatenate([[0], np.cumsum(self.rank)])[:-1]
        for size in np.unique(self.rank):
            members = np.flatnonzero((self.rank == size) & ~np.isin(np.arange(len(drop)), numbers))
            index = start[members][:, None] + np.arange(size)
            part = mixed[:, index].transpose(1, 0, 2)
            left = np.eye(size) - part.transpose(0, 2, 1) @ part
            values, vectors = np.linalg.eigh(left)
            along = np.einsum("kij,ki->kj", vectors, score[index])
            seen = values > self.share_left
            drop[members] = np.where(seen, along**2 / np.where(seen, values, 1.0), 0.0).sum(axis=1)
            rank[members] = seen.sum(axis=1)
        return drop, rank

    def estimate(self, numbers: Sequence[int]) -> list[FloatArray]:
        """Linear estimate of the parameters of the candidates in `numbers`, jointly; zero where nothing is seen."""
        inside, values, vectors = self._modes(numbers)
        along = vectors @ ((vectors.T @ self.score[inside]) / values)
        scaled = self.turn[:, inside] @ along / self.lengths
        estimates = []
        for number in numbers:
            theta = np.zeros(len(self.candidates[number].effect.parameters))
            mine = self.owner == number
            theta[self.place[mine].astype(int)] = scaled[mine]
            estimates.append(theta)
        return estimates


def board(
    candidates: Sequence[Candidate],
    white: FloatArray,
    residual: FloatArray,
    nuisance: FloatArray,
    measured: int,
    share_left: float = SHARE_LEFT,
    gram: FloatArray | None = None,
) -> Board:
    """Set up the tests.

    white: whitened live columns (M, 3, P) of the candidates in turn (see `whitened`). residual: (M, 3) whitened.
    nuisance: (M, 3, c) whitened, or its orthonormal basis (3M, c); whatever is in it is projected out. measured: scalar
    measurements not cut. gram: (P, P) inner products of `white`, if at hand.
    """
    basis = orthonormal(nuisance) if nuisance.ndim == 3 else nuisance
    owner = np.concatenate([np.full(int(c.live.sum()), n) for n, c in enumerate(candidates)] or [np.zeros(0, int)])
    place = np.concatenate([np.flatnonzero(c.live) for c in candidates] or [np.zeros(0, int)])
    flat = white.reshape(3 * len(white), white.shape[2])
    gram = flat.T @ flat if gram is None else gram
    lengths = np.sqrt(np.diag(gram))
    lengths = np.where(lengths > 0, lengths, 1.0)
    # Rounding of these products is far below the share that a column must have left.
    along, rest = (basis.T @ flat) / lengths, projected_out(basis, residual.reshape(-1))
    beside = gram / np.outer(lengths, lengths) - along.T @ along
    products = (beside, (flat.T @ rest) / lengths, lengths, owner, place, float(rest @ rest))
    return Board(tuple(candidates), *products, basis.shape[1], measured, share_left)


def whitened(candidates: Sequence[Candidate], whitener: Whitens, rows: int) -> FloatArray:
    """(M, 3, P) whitened live columns of all candidates in turn; M rows."""
    ends = np.cumsum([0, *(int(candidate.live.sum()) for candidate in candidates)])
    white = np.empty((rows, 3, int(ends[-1])))
    for candidate, first, end in zip(candidates, ends, ends[1:], strict=False):
        white[:, :, first:end] = whitener.apply(candidate.jacobian[:, :, candidate.live])
    return white
