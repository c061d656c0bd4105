"""With what probability a diagnosis of a design would give the right answer.

A cause that makes the signal u is distinguished from another when |(I - P[N, X_b]) u|^2 is large, N what is re-estimated
and X_b the image of the other: optimal discrimination (Atkinson & Fedorov 1975, Biometrika 62, 57). What that is worth is
up to the criterion of the diagnosis, which weighs all candidates at once: so noise is drawn in the span of all of them,
where it is white, and its own rules are applied to each draw.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.stats import chi2, norm

from fluxtwin.gap.hypotheses.blocks import Carrier, always, conditions
from fluxtwin.gap.hypotheses.candidates import Candidate, candidate_of, candidates
from fluxtwin.gap.linear.projection import least_share, orthonormal, projected
from fluxtwin.gap.noise.choice import NoiseModel, whitener_of
from fluxtwin.gap.noise.whitening import Whitener
from fluxtwin.gap.problem.problem import Problem
from fluxtwin.gap.selection.criterion import IN_GROUP, LOG_FURTHER, SHAPE, penalty, samples_of, stands_out, weight_of
from fluxtwin.gap.selection.detectable import smallest
from fluxtwin.gap.selection.refit import Readings, limits, refit
from fluxtwin.gap.selection.score import Board, board, whitened
from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.effects.base import GOES_ON, SignalEffect

_DRAWS = 400
"""A power of 0.9 is then good to 0.015."""
_SEED = 18
FRAMES = ("body", "orbital", "inertial", "earth")


@dataclass(frozen=True, eq=False)
class Cause:
    """What may be behind a gap: an effect with its settings and size."""

    effect: SignalEffect
    theta: FloatArray
    also: tuple[FloatArray, ...] = ()
    """What its parameters may as well be."""

    @property
    def name(self) -> str:
        return self.effect.name

    @property
    def over(self) -> bool:
        """Whether a later flight has it no more, as a step; a drift goes on."""
        return self.effect.bound not in (None, GOES_ON)

    @cached_property
    def each(self) -> tuple[Cause, ...]:
        """The cause with each of these."""
        return tuple(Cause(self.effect, theta) for theta in (self.theta, *self.also))


@dataclass(frozen=True, eq=False)
class Placed:
    """Structure that nothing in the catalogue explains: what it follows, and how large it is."""

    condition: str | None
    sizes: dict[str, FloatArray]
    """By frame in which it may be steady (k,): of each column of it, by itself, nT."""


class Flown:
    """A design as a diagnosis of it would see it: all candidates, whitened."""

    def __init__(self, problem: Problem, noise: NoiseModel) -> None:
        self.problem = problem
        self.whitener: Whitener = whitener_of(problem, noise, None)
        self.found, self.untestable = candidates(problem)
        self._white = whitened(self.found, self.whitener, problem.rows)
        self._nuisance = self.whitener.apply(problem.nuisance)
        self._in_frames: dict[str | None, dict[str, FloatArray]] = {}
        self._shown: dict[int, dict[str, float]] = {}
        self._signals: dict[Cause, tuple[list[Candidate], FloatArray, FloatArray]] = {}

    @cached_property
    def same(self) -> dict[str, tuple[str, ...]]:
        """Names that imitate each other here, {name: names, its own first}."""
        return self.board(self.found, self._white, np.zeros((self.problem.rows, 3))).same

    def board(self, found: Sequence[Candidate], white: FloatArray, signal: FloatArray) -> Board:
        """The tests of a whitened signal (M, 3) on the first rows alone; whitening looks back only, so it is that of the
        longer record."""
        rows = len(signal)
        measured, white = int((self.whitener.weights[:rows] > 0).sum()), np.ascontiguousarray(white[:rows])
        return board(found, white, signal, self._nuisance[:rows], measured, least_share(self.whitener))

    def shown(self, rows: int) -> dict[str, float]:
        """{name: probability that its typical size is seen}; what is not there cannot be tested."""
        if rows not in self._shown:
            scored, power = self.board(self.found, self._white, np.zeros((rows, 3))), {}
            tested = max(int((scored.rank > 0).sum()), 1)
            for name, one in smallest(scored, tested)[0].items():
                power[name] = one.rule.power(one.rule.noncentrality / one.relative**2)
            self._shown[rows] = power
        return self._shown[rows]

    def distinguishing(self, cause: Cause, names: Sequence[str], rows: int) -> float:
        """Probability that a diagnosis of the first rows names `cause`, which is there, and none of the others with it."""
        others = {*names} - {cause.name}
        if cause.name in self.untestable or others & {*self.same.get(cause.name, ())}:
            return 0.0
        power = []
        for one in cause.each:
            found, white, signal = self._bent(one)
            power.append(probability_of(cause.name, others, self.board(found, white, signal[:rows])))
        return float(np.mean(power))

    def imitating(self, cause: Cause, name: str) -> Cause | None:
        """Another effect with the setting and size that look most like a cause here; None where it cannot be tested."""
        return self._best(Readings(self._with(cause), self.whitener), [name])

    def likeliest(self, names: Sequence[str]) -> Cause | None:
        """The one of these effects that the record itself suggests most; None where none can be tested."""
        return self._best(Readings(self.problem, self.whitener), names)

    def _best(self, readings: Readings, names: Sequence[str]) -> Cause | None:
        """By the criterion, at its refit."""
        best, least = None, np.inf
        base, samples = refit(readings).chi2, samples_of(readings.measured)
        for candidate in self.found:
            if candidate.name in names:
                fit = refit(readings, [(candidate.effect, np.zeros(candidate.live.size))])
                cost = fit.chi2 + float(penalty(fit.rank_chosen, base - fit.chi2, samples))
                if cost < least:
                    best, least = Cause(candidate.effect, fit.chosen[0][1]), cost
        return None if best is None else self.plausible(best)

    def plausible(self, cause: Cause) -> Cause:
        """The cause as it may well be, given what these data say of its parameters.

        They are taken as alike in their typical sizes, with the common size that is likeliest (empirical Bayes), and drawn
        from what is then known of them, a few times: what is badly seen here would else be nothing elsewhere, or too much.
        By one draw a manoeuvre may look better than it is, and the one that does is chosen.
        """
        scale = np.array([parameter.scale for parameter in cause.effect.parameters])
        if scale.size == 1:
            return cause
        image = candidate_of(self.problem, cause.effect, modelled=self.problem.modelled_active).jacobian * scale
        left = projected(self.whitener, image[:, :, 0], self.problem.nuisance).project(image)[0]
        values, vectors = np.linalg.eigh(left.T @ left)
        values = np.maximum(values, 0.0)
        along = vectors.T @ (cause.theta / scale)
        sizes = np.geomspace(1e-3, 1e3, 121)[:, None]
        spread = 1.0 + sizes**2 * values
        likely = -0.5 * np.sum(np.log(spread) + values * along**2 / spread, axis=1)
        number = int(np.argmax(likely))
        normal = np.random.default_rng(_SEED).standard_normal((4, scale.size))
        drawn = along * (1.0 - 1.0 / spread[number]) + sizes[number] / np.sqrt(spread[number]) * normal
        low, high = limits([(cause.effect, cause.theta)])
        first, *also = np.clip(drawn @ vectors.T * scale, low, high)
        return Cause(cause.effect, first, tuple(also))

    def placed(self, place: Placed, frame: str, rows: int) -> float:
        """Probability that structure in the axes of a frame is distinguished from that in others, on the first rows.

        Each of its columns alone has the size that place says; the two that are compared have as many parameters, so what
        counts is how much less the other explains.
        """
        images = self._images(place.condition)
        if frame not in images:
            return 0.0
        nuisance = self._nuisance[:rows]
        power = []
        for number in np.flatnonzero(place.sizes[frame]):  # what is re-estimated makes up the others
            size = place.sizes[frame][number]
            column = images[frame][:rows, :, number : number + 1] * size
            left = []
            for other in place.sizes:
                if other != frame:
                    beside = orthonormal(np.concatenate([nuisance, images[other][:rows]], axis=2))
                    flat = column.reshape(-1)
                    left.append(float(np.sum((flat - beside @ (beside.T @ flat)) ** 2)))
            # The drops differ by what the other leaves, with twice its root as standard deviation.
            worse = min(left)
            power.append(float(norm.sf((LOG_FURTHER - worse) / (2.0 * np.sqrt(max(worse, 1e-12))))))
        return float(np.mean(power)) if power else 0.0

    def place(self, condition: str | None, frames: Sequence[str], energy: float) -> Placed | None:
        """Structure that has so much energy over the noise in this record, in any of these axes; None where it has not the
        condition."""
        images = self._images(condition)
        if not images:
            return None
        basis, sizes = orthonormal(self._nuisance), {}
        for frame in frames:
            flat = images[frame].reshape(-1, images[frame].shape[2])
            seen = np.sum((flat - basis @ (basis.T @ flat)) ** 2, axis=0)
            live = seen > 0.01 * np.sum(flat**2, axis=0)
            sizes[frame] = np.where(live, np.sqrt(energy / np.where(live, seen, 1.0)), 0.0)
        return Placed(condition, sizes)

    def _images(self, condition: str | None) -> dict[str, FloatArray]:
        """{frame: (M, 3, k) whitened} of a field that follows a condition; none where this design has it not."""
        if condition not in self._in_frames:
            setting = self.problem.design.setting
            known = [always(setting)] if condition is None else [c for c in conditions(setting) if c.name == condition]
            carrier = Carrier(self.problem) if known else None
            self._in_frames[condition] = {
                frame: self.whitener.apply(carrier.additive(known[0], frame)) for frame in FRAMES if carrier is not None
            }
        return self._in_frames[condition]

    def _with(self, cause: Cause) -> Problem:
        """The problem with noise-free readings in which the cause is."""
        on = [*self.problem.frozen, *self.problem.modelled_active, (cause.effect, cause.theta)]
        readings = self.problem.telemetry.replace(mag_B_nT=self.problem.chain.reading_nT(on))
        return dataclasses.replace(self.problem, telemetry=readings)

    def _bent(self, cause: Cause) -> tuple[list[Candidate], FloatArray, FloatArray]:
        """Candidates, their whitened columns (M, 3, P) and the whitened signal (M, 3) of a cause.

        Large effects are not linear, and some have one sign only: the images of the cause and of what looks most like it
        are secants to the size that they take on when they are refitted, as the diagnosis would refit them.
        """
        if cause in self._signals:
            return self._signals[cause]
        readings = Readings(self._with(cause), self.whitener)
        signal = self.whitener.apply(readings.problem.residual_nT)
        found, white = list(self.found), self._white
        if all(c.effect != cause.effect for c in found):
            found.append(candidate_of(self.problem, cause.effect, modelled=self.problem.modelled_active))
            own = self.whitener.apply(found[-1].jacobian[:, :, found[-1].live])
            white = np.concatenate([white, own], axis=2)
        scored = self.board(found, white, signal)
        drop = scored.statistic
        worse = (drop.max() - drop) / (1.0 + SHAPE * drop.max())
        # Noise makes up for half of 40 once in a thousand draws, sd 2 sqrt(40).
        near = [int(n) for n in np.argsort(worse) if worse[n] < 40.0 and scored.rank[n] > 0][:5]
        first = next(n for n, c in enumerate(found) if c.effect == cause.effect)
        white = np.array(white)
        for number in dict.fromkeys([first, *near]):
            if number == first:
                theta, made, columns = cause.theta, signal, readings.jacobian([(cause.effect, cause.theta)])
            else:
                fit = refit(readings, [(found[number].effect, np.zeros(len(found[number].scale)))])
                theta, made, columns = fit.chosen[0][1], signal - fit.residual, fit.jacobian[:, :, fit.slices()[0]]
            white[:, :, scored.owner == number] = _secant(columns, theta, made)[:, :, found[number].live]
        self._signals[cause] = found, white, signal
        return self._signals[cause]


def _secant(columns: FloatArray, theta: FloatArray, made: FloatArray) -> FloatArray:
    """Columns (M, 3, p) at theta (p,), with one in place of which they add up to what theta has made (M, 3); none where
    theta is at the edge of its range, at nothing."""
    size = np.linalg.norm(columns.reshape(-1, theta.size), axis=0) * np.abs(theta)
    if not size.any():
        return np.zeros_like(columns)
    most, bent = int(np.argmax(size)), np.array(columns)
    bent[:, :, most] = made / theta[most]
    return bent


def probability_of(name: str, others: Collection[str], scored: Board) -> float:
    """That the rules of the search name it, with none of the others in its group, where the residual is its signal."""
    names = [candidate.name for candidate in scored.candidates]
    if not any(scored.rank[n] for n, one in enumerate(names) if one == name):
        return 0.0
    values, vectors = np.linalg.eigh(scored.unit_gram)
    noise = np.random.default_rng(_SEED).standard_normal((values.size, _DRAWS))
    score = scored.score[:, None] + (vectors * np.sqrt(np.maximum(values, 0.0))) @ noise
    rank = scored.rank[:, None].astype(float)
    drop = np.zeros((len(names), _DRAWS))
    np.add.at(drop, scored.block.astype(int), score**2)
    samples, tested = samples_of(scored.measured), max(int((scored.rank > 0).sum()), 1)
    price = penalty(rank, drop, samples)
    cost = np.where(rank > 0, price - drop, np.inf)
    best, draw = np.argmin(cost, axis=0), np.arange(_DRAWS)
    own, least = drop[best, draw], cost[best, draw]
    p_value = tested * chi2.sf(drop, np.maximum(rank, 1.0)).min(axis=0, where=rank > 0, initial=1.0)
    seen = stands_out(p_value, -least - 2.0 * np.log(tested))
    worse = (own - drop) / (1.0 + SHAPE * own) + price - price[best, draw]
    weight = np.where(rank > 0, weight_of(worse), 0.0)
    mine = np.array([one == name for one in names])
    total = weight.sum(axis=0)
    beside = np.zeros(_DRAWS)
    for other in others:
        beside = np.maximum(beside, weight[[one == other for one in names]].sum(axis=0))
    return float(np.mean(seen & mine[best] & (beside < IN_GROUP * total)))
