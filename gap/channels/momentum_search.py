"""Which effects turn the body: scores beside the magnetometer's, small sets, refits with the vehicle itself.

Errors of the two channels are independent, so their evidences add up: the rows of both stand in one table of scores,
each channel whitened by its own noise. An effect on the dynamics leaves the readings as they are, so it has no image
there; one on the recorded attitude has an image in both.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from itertools import combinations
from typing import cast

import numpy as np

from fluxtwin.gap.channels.momentum_noise import MomentumWhitener
from fluxtwin.gap.channels.momentum_windows import Windows
from fluxtwin.gap.hypotheses.candidates import Candidate
from fluxtwin.gap.linear.leftover import orthonormal
from fluxtwin.gap.records.diagnosis import FoundEffect
from fluxtwin.gap.selection.detectable import GATE
from fluxtwin.gap.selection.forward import LARGEST
from fluxtwin.gap.selection.groups import alike, shares_by_name
from fluxtwin.gap.selection.named import axis_of, found_effect, parameters_of
from fluxtwin.gap.selection.score import Board, board
from fluxtwin.sim.base.errors import BadInput
from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.effects.base import DynamicsEffect
from fluxtwin.sim.spacecraft.dynamics.vehicle import Vehicle

_IN_GROUP = 0.05
_WORTH_SAYING = 0.001
_MOST = 0.995
_REFITS = 3
_WHOLLY = 0.99
_QUIETEST = 0.25
_LEAST_LEFT = 1e-3
"""Of its energy that an image must have beside the nuisance and others: the rest of fainter ones is mostly what is left
out in making images."""
_BEYOND = 3.0
"""Sigma by which a parameter may lie outside of its physical range; it is then taken to be at the limit."""


@dataclass(frozen=True, eq=False)
class Beside:
    """What the magnetometer's channel brings: M1 rows."""

    residual: FloatArray
    """(M1, 3) whitened, at its refit."""
    nuisance: FloatArray
    """(M1, 3, c) whitened: what is modelled or named there."""
    images: Sequence[FloatArray]
    """Of each candidate (M1, 3, live) whitened; no rows where it has none."""
    measured: int
    tested: int


@dataclass(frozen=True, eq=False)
class Balance:
    """What is to be explained in the balance of the momentum: M nodes."""

    windows: Windows
    whitener: MomentumWhitener
    residual: FloatArray
    """(M, 3) [rad]."""
    nuisance: FloatArray
    """(M, 3, c + 3) [rad per unit] of what the magnetometer's channel has (zero where it leaves the attitude alone), and
    of an attitude error that stands still."""
    candidates: Sequence[Candidate]
    beside: Beside

    def board(self, residual: FloatArray, chosen: Sequence[FloatArray] = ()) -> Board:
        """Scores of all candidates; chosen: further columns (M, 3, p) that are projected out of the balance."""
        apart = self.beside.nuisance.shape[2]
        own = self.whitener.apply(np.concatenate([self.nuisance, *chosen], axis=2))
        top = np.zeros((len(self.beside.residual), 3, own.shape[2]))
        top[:, :, :apart] = self.beside.nuisance
        white = []
        for candidate, image in zip(self.candidates, self.beside.images, strict=True):
            mine = self.whitener.apply(candidate.jacobian[:, :, candidate.live])
            above = image if image.size else np.zeros((len(top), 3, mine.shape[2]))
            white.append(np.concatenate([above, mine]))
        return board(
            self.candidates,
            np.concatenate(white, axis=2),
            np.concatenate([self.beside.residual, self.whitener.apply(residual)]),
            np.concatenate([top, own]),
            self.beside.measured + self.whitener.measured,
            _LEAST_LEFT,
        )


def sought(balance: Balance, first: Board) -> tuple[list[int], int]:
    """Numbers of the candidates that explain the balance best, at most three, and how many were tested in all."""
    tested = balance.beside.tested + int((first.rank > 0).sum())
    forbidden: set[int] = set()
    while True:
        chosen = _grown(balance, first, tested, forbidden)
        wild = _unphysical(first, chosen)
        if not wild:
            return chosen, tested
        forbidden |= wild


def _grown(balance: Balance, first: Board, tested: int, forbidden: set[int]) -> list[int]:
    """Sets of one, two, three effects, each the cheapest of its size, while one more is significant and worth it."""
    usable = [n for n in range(len(first.candidates)) if first.rank[n] > 0 and n not in forbidden]
    same = alike(shares_by_name(first))
    chosen: list[int] = []
    for size in range(1, LARGEST + 1):
        sets = [list(one) for one in combinations(usable, size) if _apart(first, one, same)]
        if not sets:
            break
        best = min(sets, key=lambda one: cost(first, one, tested))
        gain, rank = _drop(first, best)
        before, fewer = _drop(first, chosen)
        significant = tested * first.p_value(gain - before, max(rank - fewer, 1)) < GATE
        if not significant or cost(first, best, tested) >= cost(first, chosen, tested):
            break
        chosen = best
    return chosen


def _apart(first: Board, numbers: Sequence[int], same: dict[str, tuple[str, ...]]) -> bool:
    names = [first.candidates[n].name for n in numbers]
    return all(a != b and b not in same.get(a, ()) for a, b in combinations(names, 2))


def cost(first: Board, numbers: Sequence[int], tested: int) -> float:
    """As `Search.cost` has it, from the linear drop of chi-square."""
    drop, rank = _drop(first, numbers)
    samples = max(first.measured / 3.0, 2.0)
    return -drop / first.variance + rank * float(np.log(samples)) + 2 * len(numbers) * float(np.log(tested))


def _drop(first: Board, numbers: Sequence[int]) -> tuple[float, int]:
    if not numbers:
        return 0.0, 0
    inside = np.isin(first.block, numbers)
    values, vectors = np.linalg.eigh(first.unit_gram[np.ix_(inside, inside)])
    good = values > 1e-6
    return float(np.sum((vectors[:, good].T @ first.score[inside]) ** 2 / values[good])), int(good.sum())


def _unphysical(first: Board, chosen: Sequence[int]) -> set[int]:
    """Chosen candidates with a parameter that lies far outside of its range."""
    found = set()
    for number, theta in zip(chosen, first.estimate(chosen) if chosen else [], strict=True):
        candidate = first.candidates[number]
        sigma = np.zeros(theta.size)
        sigma[candidate.live] = np.sqrt(np.diag(np.linalg.pinv(_curvature(first, number))))
        low = np.array([parameter.low for parameter in candidate.effect.parameters])
        high = np.array([parameter.high for parameter in candidate.effect.parameters])
        if (theta < low - _BEYOND * sigma).any() or (theta > high + _BEYOND * sigma).any():
            found.add(number)
    return found


def _curvature(first: Board, number: int) -> FloatArray:
    mine = first.owner == number
    return np.asarray(first.gram[np.ix_(mine, mine)] * np.outer(first.lengths[mine], first.lengths[mine]))


@dataclass(frozen=True, eq=False)
class Refit:
    """The chosen effects at their best parameters."""

    thetas: tuple[FloatArray, ...]
    covariances: tuple[FloatArray, ...]
    vehicle: Vehicle
    """With the effects on the dynamics in it."""
    residual: FloatArray
    """(M, 3) [rad] beside the effects."""
    columns: tuple[FloatArray, ...]
    """(M, 3, p) each."""


def refitted(balance: Balance, first: Board, chosen: Sequence[int]) -> Refit:
    """Gauss-Newton with the vehicle that has the effects in it; what turns the recorded attitude stays linear."""
    causes = [balance.candidates[n] for n in chosen]
    thetas = [_within(c, theta) for c, theta in zip(causes, first.estimate(chosen), strict=True)]
    columns = tuple(c.jacobian for c in causes)
    residual, vehicle = _residual(balance, causes, thetas)
    for _ in range(_REFITS):
        moves = balance.board(residual).estimate(chosen)
        thetas = [_within(c, theta + move) for c, theta, move in zip(causes, thetas, moves, strict=True)]
        residual, vehicle = _residual(balance, causes, thetas)
    return Refit(tuple(thetas), tuple(_covariances(balance, first, chosen)), vehicle, residual, columns)


def _within(candidate: Candidate, theta: FloatArray) -> FloatArray:
    low = np.array([parameter.low for parameter in candidate.effect.parameters])
    high = np.array([parameter.high for parameter in candidate.effect.parameters])
    return np.asarray(np.clip(theta, low, high))


def _residual(
    balance: Balance, causes: Sequence[Candidate], thetas: Sequence[FloatArray]
) -> tuple[FloatArray, Vehicle]:
    """(M, 3) beside the effects, and the vehicle that has them; a body that cannot be has them in proportion."""
    vehicle, residual = balance.windows.arcs.craft.vehicle, balance.residual
    for cause, theta in zip(causes, thetas, strict=True):
        moved = None
        if isinstance(cause.effect, DynamicsEffect):
            with suppress(BadInput):
                moved = cast(DynamicsEffect, cause.effect).on(vehicle, theta)
        if moved is None:
            residual = residual - cause.jacobian @ theta
        else:
            vehicle = moved
    return np.asarray(residual - balance.windows.image(vehicle)), vehicle


def _covariances(balance: Balance, first: Board, chosen: Sequence[int]) -> list[FloatArray]:
    """(p, p) of each chosen effect, NaN for parameters of which some part is not seen."""
    inside = np.isin(first.block, chosen)
    turn = first.turn[:, inside]
    whole = turn @ np.linalg.pinv(first.unit_gram[np.ix_(inside, inside)], rcond=1e-9) @ turn.T
    whole *= max(first.variance, 1.0) / np.outer(first.lengths, first.lengths)
    found = []
    for number in chosen:
        mine = np.flatnonzero(first.owner == number)
        directions = np.linalg.qr(first.turn[np.ix_(mine, first.block == number)])[0]
        seen = mine[np.sum(directions**2, axis=1) > _WHOLLY]
        places = first.place[seen].astype(int)
        size = len(balance.candidates[number].effect.parameters)
        covariance = np.full((size, size), np.nan)
        covariance[np.ix_(places, places)] = whole[np.ix_(seen, seen)]
        found.append(covariance)
    return found


def named(balance: Balance, first: Board, chosen: Sequence[int], fit: Refit, tested: int) -> tuple[FoundEffect, ...]:
    """The chosen effects with their support, best supported first."""
    table = alike(shares_by_name(first))
    found = []
    for place, number in enumerate(chosen):
        candidate = balance.candidates[number]
        others = [n for n in chosen if n != number]
        gain, rank = _drop(first, chosen)
        before, fewer = _drop(first, others)
        p_value = min(1.0, tested * first.p_value(gain - before, max(rank - fewer, 1)))
        group, rivals, inside = _support(first, number, others, table.get(candidate.name, (candidate.name,)), tested)
        signal = candidate.jacobian @ fit.thetas[place]
        energy = np.mean(balance.whitener.by_attitude.left(signal) ** 2, axis=0)
        effect, theta, covariance = candidate.effect, fit.thetas[place], fit.covariances[place]
        found.append(
            found_effect(
                effect,
                parameters_of(effect, theta, np.sqrt(np.diag(covariance))),
                balance.windows.arcs.problem.setting,
                p_value=p_value,
                probability=min(_MOST, inside * (1.0 - min(p_value, 1.0))),
                group=group,
                rivals=rivals,
                axis=axis_of(energy),
                covariance=covariance,
            )
        )
    return tuple(sorted(found, key=lambda one: one.significance))


def _support(
    first: Board, number: int, others: Sequence[int], same: tuple[str, ...], tested: int
) -> tuple[tuple[str, ...], tuple[tuple[str, float], ...], float]:
    """Group, rivals, and the probability inside the group: what would stand in its place, by its cost."""
    own = cost(first, [*others, number], tested)
    taken = {first.candidates[n].name for n in others}
    weights: dict[str, float] = {}
    for rival, candidate in enumerate(first.candidates):
        if first.rank[rival] and candidate.name not in taken:
            worse = np.clip(cost(first, [*others, rival], tested) - own, -100.0, 1400.0)
            weights[candidate.name] = weights.get(candidate.name, 0.0) + float(np.exp(-0.5 * worse))
    total, name = sum(weights.values()), first.candidates[number].name
    posterior = {key: value / total for key, value in weights.items()}
    ordered = sorted(posterior.items(), key=lambda pair: -pair[1])
    group = tuple(dict.fromkeys([name, *same, *(key for key, p in ordered if p >= _IN_GROUP)]))
    rivals = tuple((key, p) for key, p in ordered if key not in group and p >= _WORTH_SAYING)
    return group, rivals, sum(posterior.get(key, 0.0) for key in group)


def significant_left(
    balance: Balance, fit: Refit | None, blocks: Mapping[tuple[str, str], FloatArray]
) -> dict[tuple[str, str], float]:
    """{(condition, frame): p-value corrected for the number of tests} of torques that no effect makes."""
    residual = balance.residual if fit is None else fit.residual
    white = balance.whitener.apply(residual).reshape(-1)
    columns = [balance.nuisance, *(() if fit is None else fit.columns)]
    basis = orthonormal(balance.whitener.apply(np.concatenate(columns, axis=2)))
    rest = white - basis @ (basis.T @ white)
    found = {}
    for key, block in blocks.items():
        own = orthonormal(_beside(basis, balance.whitener.apply(block)))
        drop = float(np.sum((own.T @ rest) ** 2))
        free = max(balance.whitener.measured - basis.shape[1] - own.shape[1], 1)
        from_f = _f_tail(drop, own.shape[1], max(_QUIETEST, (float(rest @ rest) - drop) / free), free)
        found[key] = min(1.0, len(blocks) * from_f)
    return found


def _beside(basis: FloatArray, columns: FloatArray) -> FloatArray:
    flat = columns.reshape(-1, columns.shape[2])
    length = np.linalg.norm(flat, axis=0)
    left = flat - basis @ (basis.T @ flat)
    kept = np.linalg.norm(left, axis=0) > 1e-3 * np.maximum(length, 1e-300)
    count = int(kept.sum())
    return np.asarray((left[:, kept] / np.maximum(length[kept], 1e-300)).reshape(len(columns), 3, count))


def _f_tail(drop: float, rank: int, variance: float, free: int) -> float:
    from scipy.stats import f as f_distribution

    return 1.0 if rank == 0 else float(f_distribution.sf(drop / rank / variance, rank, free))
