"""The smallest size of each effect that a design would show: nine times in ten, at the gate that a name has to pass.

An effect is seen when its score, chi-square with r degrees of freedom and non-centrality d, exceeds the level that
noise alone passes with probability GATE / K, K being the number of alternatives tested. The size is the d at which
that happens nine times in ten (noncentral chi-square, exact). A name has to pass under every noise model that the data do
not rule out, so d is that of the noise model that hides the effect best.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cache
from typing import NamedTuple

import numpy as np
from scipy.optimize import brentq
from scipy.stats import chi2, ncx2

from fluxtwin.gap.linear.projection import Whitens, orthonormal, projected_out
from fluxtwin.gap.records.diagnosis import Detectable
from fluxtwin.gap.selection.score import Board
from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.effects.base import Parameter

GATE = 0.002
"""Probability that a perfect simulation gets any name."""
MISS = 0.10
_ABSURD = 1000.0  # times the typical size: no flight would show it


@cache
def noncentrality(rank: int, tested: int) -> float:
    """The non-centrality that a test with `rank` degrees of freedom, one of `tested`, finds nine times in ten."""
    level = float(chi2.isf(GATE / tested, rank))
    return float(brentq(lambda d: ncx2.cdf(level, rank, d) - MISS, 1e-3, 20.0 * level + 100.0))


def detectable(
    board: Board, white: FloatArray, raw_nuisance: FloatArray, white_nuisance: FloatArray
) -> tuple[dict[str, Detectable], FloatArray, dict[str, str]]:
    """For each effect, the parameter (in its typical size) that is seen best, and the smallest size of it alone.

    white: (M, 3, P) whitened columns of the board. raw_nuisance, white_nuisance: (M, 3, c) what is re-estimated, as
    it is and whitened. Returns ({name: Detectable}, (M, 3, k) image of each, nT per unit, {name: why it is untestable}).
    """
    seen, reasons = smallest(board)
    raw = [board.candidates[one.owner].jacobian[:, :, int(board.place[one.column])] for one in seen.values()]
    images = np.stack(raw, axis=-1) if raw else np.zeros((*white.shape[:2], 0))
    visible = visible_part(images, white[:, :, [one.column for one in seen.values()]], raw_nuisance, white_nuisance)
    rms = [float(np.sqrt(np.mean(visible[:, :, number] ** 2))) for number in range(len(seen))]
    return {name: one.shows(size) for (name, one), size in zip(seen.items(), rms, strict=True)}, images, reasons


class Smallest(NamedTuple):
    """The smallest size of an effect that shows."""

    relative: float
    """Over the typical one."""
    parameter: Parameter
    owner: int
    """Number of the candidate."""
    column: int

    @property
    def value(self) -> float:
        return self.relative * self.parameter.scale

    def shows(self, unit_nT: float = 0.0) -> Detectable:
        """As a record. unit_nT: what is visible of one unit, rms per component."""
        return Detectable(self.parameter.name, self.value, self.parameter.unit, self.value * unit_nT)


def smallest(board: Board) -> tuple[dict[str, Smallest], dict[str, str]]:
    """For each effect that shows the smallest size; and why others do not show."""
    best = _best_columns(board)
    every = dict.fromkeys(candidate.name for candidate in board.candidates)
    reasons = {name: why for name in every if (why := _reason(best.get(name))) is not None}
    return {name: choice for name, choice in best.items() if name not in reasons}, reasons


def under_all(
    smallest: Mapping[str, Detectable], images_nT: FloatArray, nuisance_nT: FloatArray, noises: Sequence[Whitens]
) -> dict[str, Detectable]:
    """The same sizes, enlarged to what the last of several noise models lets through.

    images_nT (M, 3, k), in the order of `smallest`; nuisance_nT (M, 3, c); noises: the one that the sizes hold under
    first.
    """
    if len(noises) == 1 or not smallest:
        return dict(smallest)
    seen = np.array([_length(noise.apply(images_nT), noise.apply(nuisance_nT)) for noise in noises])
    worse = seen[0] / seen.min(axis=0)
    return {
        name: replace(one, value=one.value * factor, visible_nT=one.visible_nT * factor)
        for (name, one), factor in zip(smallest.items(), worse.tolist(), strict=True)
    }


def _length(white: FloatArray, white_nuisance: FloatArray) -> FloatArray:
    """(k,) of whitened columns (M, 3, k) beside a nuisance (M, 3, c)."""
    return np.asarray(
        np.linalg.norm(projected_out(orthonormal(white_nuisance), white.reshape(-1, white.shape[2])), axis=0)
    )


def visible_part(
    raw: FloatArray, white: FloatArray, raw_nuisance: FloatArray, white_nuisance: FloatArray
) -> FloatArray:
    """(M, 3, k) what is left of columns (raw and whitened) after the best re-estimation of the nuisance, nT."""
    if not raw_nuisance.shape[2]:
        return raw
    flat = white_nuisance.reshape(-1, white_nuisance.shape[2])
    length = np.linalg.norm(flat, axis=0)
    length = np.where(length > 0, length, 1.0)
    weights = np.linalg.lstsq(flat / length, white.reshape(flat.shape[0], -1), rcond=1e-9)[0] / length[:, None]
    return np.asarray(raw - raw_nuisance @ weights)


def _best_columns(board: Board) -> dict[str, Smallest]:
    """By name, in the parameters of an effect's first form: the rate of a clock says nothing of a clock that is late."""
    tested = max(int((board.rank > 0).sum()), 1)
    plain = {one.name: {p.name for p in one.effect.parameters} for one in reversed(board.candidates)}
    best: dict[str, Smallest] = {}
    for column in np.flatnonzero(board.left > board.share_left):
        owner = int(board.owner[column])
        candidate = board.candidates[owner]
        if board.rank[owner] == 0:
            continue
        curvature = board.left[column] * board.lengths[column] ** 2
        value = np.sqrt(noncentrality(int(board.rank[owner]), tested) / curvature)
        place = int(board.place[column])
        if candidate.effect.parameters[place].name not in plain[candidate.name]:
            continue
        relative = float(value / candidate.scale[place])
        if candidate.name not in best or relative < best[candidate.name].relative:
            best[candidate.name] = Smallest(relative, candidate.effect.parameters[place], owner, int(column))
    return best


def _reason(best: Smallest | None) -> str | None:
    if best is None:
        return "on this orbit and attitude the re-estimated calibration can imitate it completely"
    one, size = best.parameter, best.value
    if best.relative > _ABSURD or size > max(abs(one.low), abs(one.high)):
        return f"only {one.name} above {size:.3g} {one.unit} would show, which is beyond what is physical"
    return None
