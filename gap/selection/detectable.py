"""The smallest size of each effect that a design would show: nine times in ten, by the rules by which a name is given.

A cause that explains D of chi-square beside the right noise explains less when it is sought: the noise is chosen without
it first, and takes a part of it up. Of the noise models that data and budget allow, model j costs c_j of twice the log
likelihood, and leaves D_j of chi-square; its sigma, known as from f degrees of freedom, takes a part of that. Chosen is
the one of the least T_j = c_j + f log(1 + D_j / f). The first test sees D_j, as it has the
variance beside all causes for its unit, and the criterion weighs T_j (both are exact where sigma alone is not known). The
least D is that from which on both are passed (`criterion.stands_out`).

Over its rank r, D is a noncentral F with r and g degrees of freedom, where 2 / g is the variance of log D over the noise
models. The noncentrality scatters as much, as the noise is not known any better where the size is worked out.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from typing import NamedTuple

import numpy as np
from numpy.polynomial.hermite_e import hermegauss
from scipy.optimize import brentq
from scipy.special import fdtrc, ncfdtr

from fluxtwin.gap.linear.projection import Whitens, orthonormal, projected_out
from fluxtwin.gap.records.diagnosis import Detectable
from fluxtwin.gap.selection.criterion import penalty, samples_of, stands_out
from fluxtwin.gap.selection.score import Board
from fluxtwin.sim.base.types import BoolArray, FloatArray
from fluxtwin.sim.effects.base import Parameter

MISS = 0.10
_KNOWN = 1e6
"""Degrees of freedom of a noise that is known."""
_AT, _WEIGHTS = (each / by for each, by in zip(hermegauss(9), (1.0, np.sqrt(2.0 * np.pi)), strict=True))


@dataclass(frozen=True)
class Rule:
    """What it takes to be named: for `rank` directions, one of `tested` alternatives, in `samples` rows."""

    rank: int
    tested: int
    samples: float
    freedom: float = _KNOWN
    """Degrees of freedom that sigma is known from (f)."""
    scatter: float = 0.0
    """Variance of log D over the other numbers of the noise model."""
    hidden: tuple[tuple[float, float], ...] = ((0.0, 1.0),)
    """For each noise model its cost c_j, and D_j / D."""

    @cached_property
    def least_drop(self) -> float:
        """D from which on a cause is named."""
        drops = np.geomspace(4.0, 4e4, 500)
        for _ in range(2):  # the second time between two neighbours
            missed = np.flatnonzero(~self._named(drops))
            last = int(missed[-1]) if missed.size else 0
            drops = np.linspace(drops[last], drops[min(last + 1, drops.size - 1)], drops.size)
        return float(drops[-1])

    def _named(self, drops: FloatArray) -> BoolArray:
        """Whether a cause is that explains so much."""
        cost, share = np.array(self.hidden).T[:, :, None]
        left = share * drops
        weighed = cost + self.freedom * np.log1p(left / self.freedom)
        chosen = np.argmin(weighed, axis=0), np.arange(drops.size)
        p_value = self.tested * fdtrc(self.rank, self.freedom, left[chosen] / self.rank)
        charged = penalty(self.rank, drops, self.samples) + 2.0 * np.log(self.tested)
        return stands_out(p_value, weighed[chosen] - charged)

    def power(self, noncentrality: float) -> float:
        """Probability of being named, where the cause explains so much on average (beside its rank), as far as is known."""
        variance = self.scatter + 2.0 / self.freedom
        each = noncentrality * np.exp(np.sqrt(variance) * _AT)
        return float(1.0 - _WEIGHTS @ ncfdtr(self.rank, 2.0 / variance, each, self.least_drop / self.rank))

    @cached_property
    def noncentrality(self) -> float:
        """At which a cause is named nine times in ten."""
        low, high = 1e-3, self.least_drop
        while self.power(high) < 1.0 - MISS:
            low, high = high, 2.0 * high
        return float(brentq(lambda at: self.power(at) - (1.0 - MISS), low, high))


@cache
def noncentrality(rank: int, tested: int, samples: float, freedom: float = _KNOWN) -> float:
    """That of a `Rule` for noise of which sigma alone is not known."""
    return Rule(rank, tested, samples, freedom).noncentrality


class Smallest(NamedTuple):
    """The smallest size of an effect that shows, and how it shows."""

    relative: float
    """Over the typical one."""
    parameter: Parameter
    owner: int
    """Number of the candidate."""
    place: int
    """Of the parameter in the effect."""
    rule: Rule

    @property
    def value(self) -> float:
        return self.relative * self.parameter.scale

    def shows(self, unit_nT: float = 0.0) -> Detectable:
        """As a record. unit_nT: what is visible of one unit, rms per component."""
        return Detectable(self.parameter.name, self.value, self.parameter.unit, self.value * unit_nT)


def smallest(board: Board, tested: int) -> tuple[dict[str, Smallest], dict[str, str]]:
    """For each effect the parameter (in its typical size) that shows best, one of `tested` alternatives, and the smallest
    size of it alone, under one noise model; and why others do not show."""
    best = _best_columns(board, tested)
    every = dict.fromkeys(candidate.name for candidate in board.candidates)
    reasons = {name: why for name in every if (why := _reason(best.get(name))) is not None}
    return {name: choice for name, choice in best.items() if name not in reasons}, reasons


def detectable(
    seen: Mapping[str, Smallest],
    images_nT: FloatArray,
    nuisance_nT: FloatArray,
    noises: Sequence[tuple[Whitens, float, float]],
) -> dict[str, Detectable]:
    """The sizes of `smallest` where the noise model is not known either.

    images_nT (N, 3, k): of one unit of each, in their order; nuisance_nT (N, 3, c): what is re-estimated; noises: the one
    that was chosen, then all over what data and budget allow, with probability, and cost in twice the log likelihood.
    """
    white, beside = (noises[0][0].apply(columns) for columns in (images_nT, nuisance_nT))
    visible = visible_part(images_nT, white, nuisance_nT, beside)
    unit_nT = np.sqrt(np.mean(visible**2, axis=(0, 1)))
    probability, cost = np.array([one[1:] for one in noises]).T
    logs = np.stack([2.0 * np.log(_length(one.apply(images_nT), one.apply(nuisance_nT))) for one, *_ in noises])
    mean = probability @ logs
    scatter = probability @ (logs - mean) ** 2
    found = {}
    for number, (name, one) in enumerate(seen.items()):
        share = np.exp(logs[:, number] - mean[number])
        hidden = tuple(zip(cost.tolist(), share.tolist(), strict=True))
        rule = Rule(one.rule.rank, one.rule.tested, one.rule.samples, one.rule.freedom, float(scatter[number]), hidden)
        value = float(np.sqrt(rule.noncentrality / np.exp(mean[number])))
        found[name] = one._replace(relative=value / one.parameter.scale).shows(float(unit_nT[number]))
    return found


def _length(white: FloatArray, white_nuisance: FloatArray) -> FloatArray:
    """(k,) of whitened columns (M, 3, k) beside a nuisance (M, 3, c)."""
    left = projected_out(orthonormal(white_nuisance), white.reshape(-1, white.shape[2]))
    return np.asarray(np.linalg.norm(left, axis=0))


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


def _best_columns(board: Board, tested: int) -> dict[str, Smallest]:
    """By name, in the parameters of an effect's first form: the rate of a clock says nothing of a clock that is late."""
    plain = {one.name: {p.name for p in one.effect.parameters} for one in reversed(board.candidates)}
    samples, freedom = samples_of(board.measured), float(board.trusted)
    best: dict[str, Smallest] = {}
    for column in np.flatnonzero(board.left > board.share_left):
        owner = int(board.owner[column])
        candidate = board.candidates[owner]
        rank = int(board.rank[owner])
        curvature = board.left[column] * board.lengths[column] ** 2
        value = np.sqrt(noncentrality(rank, tested, samples, freedom) / curvature)
        place = int(board.place[column])
        if candidate.effect.parameters[place].name not in plain[candidate.name]:
            continue
        relative = float(value / candidate.scale[place])
        if candidate.name not in best or relative < best[candidate.name].relative:
            rule = Rule(rank, tested, samples, freedom)
            best[candidate.name] = Smallest(relative, candidate.effect.parameters[place], owner, place, rule)
    return best


def _reason(best: Smallest | None) -> str | None:
    if best is None:
        return "on this orbit and attitude the re-estimated calibration can imitate it completely"
    one, size = best.parameter, best.value
    # At a thousand times the typical size no flight would show it.
    if best.relative > 1000.0 or size > max(abs(one.low), abs(one.high)):
        return f"only {one.name} above {size:.3g} {one.unit} would show, which is beyond what is physical"
    return None
