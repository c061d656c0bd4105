"""Fits in the nonlinear chain: damped Gauss-Newton for chosen effects together with everything that is modelled.

What is fitted is a channel: readings of the magnetometer (`Readings`), or others that offer the same. Readings also propose
what no column reports: when a field that was on for one stretch began and ended, and when an attitude jumped.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np
from scipy.stats import chi2

from fluxtwin.calib.common.criterion import FALSE_ALARM, THRESHOLD, worth
from fluxtwin.gap.hypotheses.blocks import in_body
from fluxtwin.gap.hypotheses.candidates import Candidate, PerturbedDesign, candidate_of
from fluxtwin.gap.linear.projection import SHARE_LEFT, Whitens, least_share, orthonormal
from fluxtwin.gap.noise.whitening import Whitener
from fluxtwin.gap.problem.problem import Problem, calibrated, realigned
from fluxtwin.gap.selection.criterion import SHAPE
from fluxtwin.sim.base.types import BoolArray, FloatArray, IntArray, TimeArray
from fluxtwin.sim.earth import epoch
from fluxtwin.sim.effects.base import SignalEffect
from fluxtwin.sim.effects.chain import Active, jacobian
from fluxtwin.sim.effects.signal import Setting
from fluxtwin.sim.effects.switched_field import SwitchedField

_RCOND = 0.1 * float(np.sqrt(SHARE_LEFT))
_STEPS = 24
_CLOSER = 8
"""By this factor the edges of an interval are looked for more finely, until they are known to the row."""
WHOLLY = 0.99  # of a parameter's direction


class Channel(Whitens, Protocol):
    """A measurement as the selection of effects sees it: a residual and images, whitened; M rows."""

    @property
    def modelled(self) -> Sequence[Active]:
        """What is re-estimated in every fit, with starting values."""

    @property
    def share_left(self) -> float:
        """Of its energy that an image must have beside others."""

    @property
    def setting(self) -> Setting | None:
        """In which settings of effects between those tried are looked for; None: they are not."""
        return None

    def residual(self, active: Sequence[Active]) -> FloatArray:
        """(M, 3) whitened, with these effects on."""

    def jacobian(self, active: Sequence[Active]) -> FloatArray:
        """(M, 3, sum of parameters) whitened images of these effects, in their order, all of them on."""

    def candidate(self, effect: SignalEffect, modelled: Sequence[Active]) -> Candidate:
        """One more alternative, linearised beside what is modelled."""

    def blur(self, active: Active, modelled: Sequence[Active]) -> tuple[FloatArray, FloatArray] | None:
        """(M, 3) whitened, what one more error of the attitude, as large as it is taken to be, adds to the image of an
        effect of this size, and that image (M, 3, p); None where its image is not made of attitudes."""
        return None

    def jumps(self, base: Fit) -> Sequence[str]:
        """Moments (ISO 8601 UTC) at which the residual of a fit without any effect jumps."""
        return ()

    def proposed(self, base: Fit) -> Sequence[SignalEffect]:
        """Alternatives that the residual of a fit without any effect suggests."""
        return ()


@dataclass(frozen=True, eq=False)
class Fit:
    """Modelled and chosen effects at their best parameters; M rows, c + p parameters."""

    modelled: tuple[Active, ...]
    chosen: tuple[Active, ...]
    chi2: float
    """Of the whitened residual."""
    residual: FloatArray
    """(M, 3) whitened."""
    jacobian: FloatArray
    """(M, 3, c + p) whitened derivative of the reading, parameters of `modelled`, then of `chosen`."""
    free: BoolArray
    """(c + p,) parameters that move something and are not at a limit."""

    @cached_property
    def _known(self) -> tuple[FloatArray, BoolArray, int]:
        return covariance_of(self.jacobian, self.free)

    @property
    def covariance(self) -> FloatArray:
        """(c + p, c + p) for unit variance; parameters that are not seen (or at a limit) have none: NaN."""
        return self._known[0]

    @property
    def seen(self) -> BoolArray:
        """(c + p,) parameters of which every part is seen: none lies along a direction that moves nothing."""
        return self._known[1]

    @cached_property
    def basis(self) -> FloatArray:
        """(3M, r) orthonormal, of the Jacobian."""
        return orthonormal(self.jacobian)

    @property
    def active(self) -> list[Active]:
        """All that is on, apart from frozen effects."""
        return [*self.modelled, *self.chosen]

    @cached_property
    def rank_chosen(self) -> int:
        """Directions that the chosen effects add to those that are seen of the modelled ones."""
        alone = self.jacobian[:, :, : sum(len(theta) for _, theta in self.modelled)]
        return self._known[2] - covariance_of(alone, moving(alone))[2]

    def others(self, number: int) -> list[Active]:
        """The chosen effects but one."""
        return [*self.chosen[:number], *self.chosen[number + 1 :]]

    def slices(self) -> list[slice]:
        """Where the parameters of each chosen effect stand."""
        start, found = sum(len(theta) for _, theta in self.modelled), []
        for _, theta in self.chosen:
            found.append(slice(start, start + len(theta)))
            start += len(theta)
        return found


def refit(
    channel: Channel,
    chosen: Sequence[Active] = (),
    *,
    modelled: Sequence[Active] | None = None,
    near: Sequence[Active] = (),
    guess: FloatArray | None = None,
) -> Fit:
    """Minimise the whitened chi-square over the parameters of all modelled and chosen effects, within their ranges.

    chosen, modelled: effects with starting values (modelled: the channel's own by default). near: where another fit has
    some of them; begun from there, without the others, unless none of the chosen is better still. guess (M, 3, c + p):
    about the whitened Jacobian there, along which all else is first moved to meet what begins elsewhere. A Jacobian whose
    step did what it promised is used once more; the last one is recomputed.
    """
    modelled = channel.modelled if modelled is None else modelled
    count, active = len(modelled), [*modelled, *chosen]
    low, high = limits(active)
    start = np.clip(_packed(active), low, high)
    vector = start.copy()
    vector[sum(len(theta) for _, theta in modelled) :] = 0.0
    residual = channel.residual(_unpacked(active, vector))
    chi2 = float(np.sum(residual**2))
    if near:
        there = _packed([(effect, _of(near, effect, np.full(len(theta), np.nan))) for effect, theta in active])
        begin = np.clip(np.where(np.isnan(there), vector, there), low, high)
        rest = channel.residual(_unpacked(active, begin))
        if (chi2_there := float(np.sum(rest**2))) < chi2:
            vector, residual, chi2 = begin, rest, chi2_there
            start = np.where(np.isnan(there), start, begin)
    if (start != vector).any():
        if guess is not None:
            start = _met(channel, active, start, guess, start == vector, (low, high), chi2)
        # From nothing, so that no fit ends worse than without: a clip is anything but linear.
        better = _search_line(channel, active, vector, start - vector, (low, high), chi2)
        vector, residual, chi2 = better or (vector, residual, chi2)
    else:
        guess = None  # where a fit ended a Jacobian of another place does not serve
    jacobian = channel.jacobian(_unpacked(active, vector)) if guess is None else guess
    exact = guess is None
    for _ in range(_STEPS):
        free = _free(jacobian, residual, vector, low, high)
        step = _step(jacobian, residual, free)
        image = _flat(jacobian) @ step
        promised = 2 * float(residual.reshape(-1) @ image) - float(image @ image)
        # A hundredth of chi-square is far below anything a decision turns on.
        found = _search_line(channel, active, vector, step, (low, high), chi2) if promised >= 0.01 else None
        if found is None and exact:
            break
        kept = False
        if found is not None:
            kept = chi2 - found[2] > 0.9 * promised
            vector, residual, chi2 = found
        exact = not kept
        if exact:
            jacobian = channel.jacobian(_unpacked(active, vector))
    active = _unpacked(active, vector)
    free = _free(jacobian, residual, vector, low, high)
    return Fit(tuple(active[:count]), tuple(active[count:]), chi2, residual, jacobian, free)


def settled(problem: Problem) -> Problem:
    """The problem, linear about a first fit of what is modelled (a raw magnetometer may be off by thousands of nT).

    Plain least squares with the weight of large residuals limited (Huber), from three robust sigma on, so that single wrong
    readings do not pull it. S, b and T become the magnetometer's own. Rows without attitude point where the reading does as
    it is then calibrated.
    """
    problem = realigned(problem)
    if not problem.modelled:
        return problem
    current = problem
    for _ in range(4):
        residual = current.in_row_axes(current.residual_nT)
        size = np.linalg.norm(residual, axis=1)
        limit = 3.0 * max(float(np.median(size)) / 1.54, 1e-9)
        weight = np.sqrt(np.minimum(1.0, limit / np.maximum(size, 1e-12)))[:, None]
        vector = _packed(current.modelled_active)
        low, high = limits(current.modelled_active)
        jacobian = current.in_row_axes(current.nuisance) * weight[:, :, None]
        step = _step(jacobian, residual * weight, moving(jacobian))
        moved = _unpacked(current.modelled_active, np.clip(vector + step, low, high))
        current = realigned(dataclasses.replace(current, modelled_theta=tuple(theta for _, theta in moved)))
        if np.sqrt(np.mean((jacobian @ step) ** 2)) < 1e-3 * limit:
            break
    return calibrated(current, current.modelled_active)


@dataclass(frozen=True, eq=False)
class Readings:
    """The channel of the magnetometer's readings."""

    problem: Problem
    whitener: Whitener

    @property
    def modelled(self) -> Sequence[Active]:
        return self.problem.modelled_active

    @property
    def measured(self) -> int:
        return self.whitener.measured

    @property
    def share_left(self) -> float:
        return least_share(self.whitener)

    @property
    def setting(self) -> Setting:
        return self.problem.setting

    def apply(self, columns: FloatArray) -> FloatArray:
        return self.whitener.apply(columns)

    def residual(self, active: Sequence[Active]) -> FloatArray:
        return self.whitener.apply(self.problem.residual_of(active))

    def jacobian(self, active: Sequence[Active]) -> FloatArray:
        return self.whitener.apply(self.problem.derivatives(active))

    def candidate(self, effect: SignalEffect, modelled: Sequence[Active]) -> Candidate:
        return candidate_of(self.problem, effect, modelled=modelled)

    def blur(self, active: Active, modelled: Sequence[Active]) -> tuple[FloatArray, FloatArray] | None:
        """By the noise model of the whitener."""
        if self._perturbed.chain is None:
            return None
        on = [*self.problem.frozen, *modelled]
        first, again = (
            chain.reading_nT([*on, active]) - chain.reading_nT(on)
            for chain in (self.problem.design, self._perturbed.chain)
        )
        effect, theta = active
        assert isinstance(effect, SignalEffect)
        image = jacobian(self.problem.design, effect, on, theta)
        return self.whitener.apply(again - first), self.whitener.apply(image)

    @cached_property
    def _perturbed(self) -> PerturbedDesign:
        noise = self.whitener.noise
        return PerturbedDesign(self.problem, [(noise.theta_rad, noise.tau_s)])

    def jumps(self, base: Fit) -> list[str]:
        """The likeliest, if there is one."""
        return likeliest_jump(self.problem.time, base.residual, self.whitener.weights)

    def proposed(self, base: Fit) -> list[SignalEffect]:
        """A field that was on for one stretch of the record."""
        interval = likeliest_interval(self.problem, self.whitener, base.residual, base.jacobian)
        return [] if interval is None else [interval]


def _packed(active: Sequence[Active]) -> FloatArray:
    return np.concatenate([np.asarray(theta, dtype=np.float64) for _, theta in active] or [np.zeros(0)])


def _unpacked(active: Sequence[Active], vector: FloatArray) -> list[Active]:
    ends = np.cumsum([len(theta) for _, theta in active])
    return [
        (effect, np.array(vector[end - len(theta) : end])) for (effect, theta), end in zip(active, ends, strict=True)
    ]


def _of(active: Sequence[Active], wanted: object, otherwise: FloatArray) -> FloatArray:
    return next((theta for effect, theta in active if effect == wanted), otherwise)


def limits(active: Sequence[Active]) -> tuple[FloatArray, FloatArray]:
    """Lowest and highest values of all parameters of these effects."""
    parameters = [parameter for effect, _ in active for parameter in effect.parameters]
    low = np.array([parameter.low for parameter in parameters])
    high = np.array([parameter.high for parameter in parameters])
    return low, high


def _free(
    jacobian: FloatArray, residual: FloatArray, vector: FloatArray, low: FloatArray, high: FloatArray
) -> BoolArray:
    """Parameters that move something and do not push against a limit."""
    pull = _flat(jacobian).T @ residual.reshape(-1)
    stuck = ((vector <= low) & (pull < 0)) | ((vector >= high) & (pull > 0))
    return np.asarray(~stuck & moving(jacobian))


def _step(jacobian: FloatArray, residual: FloatArray, free: BoolArray) -> FloatArray:
    """Gauss-Newton step; directions that the data do not see are not moved."""
    step = np.zeros(free.size)
    if free.any():
        length, values, vectors, good = _modes(jacobian, free)
        pull = vectors.T @ ((_flat(jacobian).T @ residual.reshape(-1))[free] / length)
        step[free] = vectors[:, good] @ (pull[good] / values[good]) / length
    return step


def moving(jacobian: FloatArray) -> BoolArray:
    """(p,) parameters that move something, by more than rounding does."""
    flat = _flat(jacobian)
    length = np.sqrt(np.einsum("ij,ij->j", flat, flat))
    return np.asarray(length > np.finfo(np.float64).eps * length.max(initial=0.0))


def covariance_of(jacobian: FloatArray, free: BoolArray) -> tuple[FloatArray, BoolArray, int]:
    """(p, p) covariance for unit variance, NaN where a parameter is not estimated; (p,) wholly seen; the rank."""
    covariance, seen = np.full((free.size, free.size), np.nan), np.zeros(free.size, dtype=np.bool_)
    if not free.any():
        return covariance, seen, 0
    length, values, vectors, good = _modes(jacobian, free)
    covariance[np.ix_(free, free)] = (vectors[:, good] / values[good]) @ vectors[:, good].T / np.outer(length, length)
    seen[free] = np.sum(vectors[:, good] ** 2, axis=1) > WHOLLY
    return covariance, seen, int(good.sum())


def _met(
    channel: Channel,
    active: Sequence[Active],
    start: FloatArray,
    jacobian: FloatArray,
    stays: BoolArray,
    limits: tuple[FloatArray, FloatArray],
    wanted: float,
) -> FloatArray:
    """The start, with the parameters that were left where they are moved along their images to meet those that were moved,
    until chi-square is below what is wanted or falls no further.

    A lag turns the field of a spinner by many degrees, and so does its calibration: neither is better without the other.
    """
    residual = channel.residual(_unpacked(active, start))
    found: tuple[FloatArray, FloatArray, float] | None = start, residual, float(np.sum(residual**2))
    for _ in range(_STEPS):
        if found is None or found[2] < wanted:
            break
        start, residual, chi2 = found
        step = _step(jacobian, residual, stays & moving(jacobian))
        found = _search_line(channel, active, start, step, limits, chi2)
    return start if found is None else found[0]


def _modes(jacobian: FloatArray, free: BoolArray) -> tuple[FloatArray, FloatArray, FloatArray, BoolArray]:
    """Of the free columns (f,): their lengths, eigenvalues and vectors (f, f) of their Gram matrix at unit length, and which
    directions are seen. Of one that is hardly seen half of the digits are left, which are enough."""
    flat = _flat(jacobian)
    gram = (flat.T @ flat)[np.ix_(free, free)]
    length = np.sqrt(np.diag(gram))
    values, vectors = np.linalg.eigh(gram / np.outer(length, length))
    return length, values, vectors, values > _RCOND**2 * values[-1]


def _flat(jacobian: FloatArray) -> FloatArray:
    """(3M, p) of (M, 3, p)."""
    return jacobian.reshape(3 * len(jacobian), jacobian.shape[2])


def _search_line(
    channel: Channel,
    active: Sequence[Active],
    vector: FloatArray,
    step: FloatArray,
    limits: tuple[FloatArray, FloatArray],
    chi2: float,
) -> tuple[FloatArray, FloatArray, float] | None:
    """The longest of the step, its half, its quarter, ... that makes the residual smaller."""
    for halving in range(6):
        trial = np.clip(vector + step / 2**halving, *limits)
        try:
            residual = channel.residual(_unpacked(active, trial))
        except np.linalg.LinAlgError:  # a matrix at the edge of its range that has no inverse
            continue
        found = float(np.sum(residual**2))
        if np.isfinite(found) and found < chi2:
            return trial, residual, found
    return None


def likeliest_interval(
    problem: Problem, whitener: Whitens, residual: FloatArray, nuisance: FloatArray
) -> SwitchedField | None:
    """The interval in which a constant field explains most of a whitened residual (M, 3), beside the nuisance (M, 3, c).

    None where one step does as well, within noise and its shape error. Each pair of edges is a difference of two steps, so
    all pairs follow from one Gram matrix of the steps.
    """
    rows, edges = problem.rows, 64
    if rows < 4 * edges:
        return None
    basis = orthonormal(nuisance)

    def explained(at: IntArray, first: IntArray, last: IntArray) -> tuple[FloatArray, FloatArray]:
        """What a step at each row of `at` (K,) explains, and each pair of its steps, by their places (P,)."""
        steps = (np.arange(rows)[:, None] >= at[None, :]).astype(np.float64)
        white = whitener.apply(in_body(steps)).reshape(residual.size, -1)
        white = white - basis @ (basis.T @ white)
        gram = (white.T @ white).reshape(at.size, 3, at.size, 3)
        moment = (white.T @ residual.reshape(-1)).reshape(at.size, 3)
        own = np.stack([gram[k, :, k, :] for k in range(at.size)])
        mixed = gram[first, :, last, :]
        both = own[first] + own[last] - mixed - np.transpose(mixed, (0, 2, 1))
        return _explained(own, moment), _explained(both, moment[first] - moment[last])

    at = np.linspace(0, rows, edges + 1).astype(int)[1:-1]
    share = 0.05  # of the record, inside and on either side: shorter ones are spikes, or a step
    first, last = np.triu_indices(at.size, k=int(share * edges))
    inside = (at[first] > share * rows) & (at[last] < (1.0 - share) * rows)
    first, last = first[inside], last[inside]
    single, double = explained(at, first, last)
    best = int(np.argmax(double))
    further = (double[best] - single.max()) / (1.0 + SHAPE * single.max())
    if worth(further, 1, rows, float(np.log(at.size))) < THRESHOLD:
        return None
    begin, end, spacing = int(at[first[best]]), int(at[last[best]]), -(-rows // edges)
    while spacing > 1:  # to the row: of a strong field a few rows on the wrong side are structure
        closer = -(-spacing // _CLOSER)
        near = np.arange(-spacing, spacing + 1, closer)
        at, spacing = np.clip(np.concatenate([begin + near, end + near]), 1, rows - 1), closer
        first, last = (places.ravel() for places in np.meshgrid(np.arange(near.size), near.size + np.arange(near.size)))
        ordered = at[first] < at[last]
        first, last = first[ordered], last[ordered]
        best = int(np.argmax(explained(at, first, last)[1]))
        begin, end = int(at[first[best]]), int(at[last[best]])
    from_utc, to_utc = (epoch.iso(problem.time[edge], "ms") for edge in (begin, end))
    return SwitchedField("interval", from_utc, to_utc)


def likeliest_jump(time: TimeArray, residual: FloatArray, weights: FloatArray) -> list[str]:
    """The moment (ISO 8601 UTC) of the row that a whitened residual (N, 3) says least of beforehand; none where chance does.

    weights (N, 3): zero in rows that are set aside; just before that row they belong to the jump. One where there is
    none costs two more candidates. Where the attitude's error has a memory, a jump of the attitude is all in the
    innovation of one row: a moment that is off by a row misses it.
    """
    energy = np.sum(residual**2, axis=1)
    row = int(np.argmax(energy))
    if row == 0 or chi2.sf(energy[row], 3) * energy.size > FALSE_ALARM:
        return []
    while row > 1 and not weights[row - 1].any():
        row -= 1
    return [epoch.iso(time[row], "ms")]


def _explained(gram: FloatArray, moment: FloatArray) -> FloatArray:
    """(K,) drop of chi-square by the columns of each Gram matrix (K, 3, 3) with its moment (K, 3)."""
    ridge = 1e-9 * np.trace(gram, axis1=1, axis2=2)[:, None, None] * np.eye(3) + 1e-300 * np.eye(3)
    solved = np.linalg.solve(gram + ridge, moment[:, :, None])[:, :, 0]
    return np.asarray(np.einsum("ki,ki->k", moment, solved))
