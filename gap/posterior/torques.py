"""Which effects turn the body, beside what the readings have found: the search on the balance of the momentum."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from fluxtwin.gap.channels.momentum import (
    DYNAMICS,
    MomentumChannel,
    ahead_km,
    gained,
    momentum_channel,
    orbit_of,
    ruled_out,
)
from fluxtwin.gap.channels.momentum_arcs import Craft, Windows, arcs, windows
from fluxtwin.gap.detectors.residual_structure import Structure
from fluxtwin.gap.held_out.held_out import BLOCKS, Prediction
from fluxtwin.gap.hypotheses.blocks import Block, fit
from fluxtwin.gap.linear.projection import projected
from fluxtwin.gap.noise.whitening import Whitener
from fluxtwin.gap.posterior.explanations import ROUNDS, likeliest, weighed
from fluxtwin.gap.problem.problem import Problem
from fluxtwin.gap.records.diagnosis import Detectable, FoundEffect, MomentumGap, Ranked
from fluxtwin.gap.selection.criterion import THRESHOLD, still_known, worth
from fluxtwin.gap.selection.detectable import smallest
from fluxtwin.gap.selection.forward import Search, begin, run
from fluxtwin.gap.selection.refit import Fit, covariance_of, moving
from fluxtwin.gap.selection.search import SearchResult, axis_of, found_effect, ranking, support
from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.effects.chain import Active
from fluxtwin.sim.spacecraft.dynamics.vehicle import Vehicle

_NAMES = {effect.name for effect in DYNAMICS}
_NOTHING = Structure(0.0, 0.0, "none", "")


@dataclass(frozen=True, eq=False)
class Momentum:
    """What the balance of the momentum says; `gap` is None where there is no balance."""

    named: tuple[FoundEffect, ...] = ()
    known: float = 1.0
    """Probability that nothing, or what is named, is all that turns the body."""
    left: Structure = _NOTHING
    """Torques that no effect makes."""
    untestable: Mapping[str, str] = field(default_factory=dict)
    ranking: tuple[Ranked, ...] = ()
    isolability: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    minimum_detectable: Mapping[str, Detectable] = field(default_factory=dict)
    gap: MomentumGap | None = None
    ahead_km: tuple[float, float] | None = None
    """How far the reported position is ahead along the orbit, and sigma; None where torques do not show it."""
    ruled_out: Mapping[str, str] = field(default_factory=dict)
    """Names that the readings would accept and the torques do not: why."""

    @property
    def standing(self) -> tuple[FoundEffect, ...]:
        """Named effects that stand: one of few that would do, and nothing unknown is likelier."""
        refuted = self.known < 0.5 or any(one.too_many_alike for one in self.named)
        return () if refuted else self.named

    @property
    def unexplained(self) -> bool:
        """Whether something is there that no effect explains."""
        return (bool(self.named) or self.left.structured) and not self.standing

    @property
    def incomplete(self) -> bool:
        """Whether the named effects stand and something smaller is left."""
        return bool(self.standing) and self.left.structured


def absent(reason: str) -> Momentum:
    """No balance: why the effects on the dynamics cannot be tested."""
    return Momentum(untestable=dict.fromkeys((effect.name for effect in DYNAMICS), reason))


def balanced(
    problem: Problem, craft: Craft | None, whitener: Whitener, result: SearchResult, fitted_nT: FloatArray
) -> Momentum:
    """The balance beside the finished search of the magnetometer's channel.

    fitted_nT: (N, 3, c) Jacobian of what that channel fits: what is modelled, its named effects, and others after them.
    """
    if craft is None:
        return absent('no scenario with attitude mode "dynamics" says what the body is and which torques turn it')
    flown = arcs(problem, craft, orbit_of(problem, [*problem.frozen, *result.modelled, *result.chosen]))
    cut = flown if isinstance(flown, str) else windows(flown)
    if isinstance(cut, str):
        return absent(cut)
    found = _about_the_motion(problem, cut, whitener, result, fitted_nT)
    if found.left.structured or found.ahead_km is None:
        return found  # where something else turns the body it is no witness
    return replace(found, ruled_out=ruled_out(result, whitener, found.ahead_km))


def _about_the_motion(
    problem: Problem, cut: Windows, whitener: Whitener, result: SearchResult, fitted_nT: FloatArray
) -> Momentum:
    """The search about the motion that the balance makes, and where something is found about a better one.

    A large effect turns the body far from the balance as modelled. Then a slow torque brings the motion near enough to
    name it, and the last word has the motion of the vehicle that has it: a fitted torque has the errors of the attitude
    in it.
    """
    found, vehicle = _searched(problem, cut.followed().followed(), whitener, result, fitted_nT)
    if not found.named and not found.left.structured:
        return found
    found, vehicle = _searched(problem, cut.followed(slow=True).followed(slow=True), whitener, result, fitted_nT)
    for _ in range(ROUNDS):
        if not found.named:
            break
        before = [one.name for one in found.named]
        moved = Windows(cut.arcs.of(vehicle), cut.windows).followed().followed()
        momentum_N = moved.arcs.momentum_of(cut.arcs.craft.vehicle)
        again = Windows(cut.arcs.but(track=moved.arcs.track, momentum_N=momentum_N), cut.windows)
        found, vehicle = _searched(problem, again, whitener, result, fitted_nT)
        if [one.name for one in found.named] == before:
            break
    return found


def _searched(
    problem: Problem, cut: Windows, whitener: Whitener, result: SearchResult, fitted_nT: FloatArray
) -> tuple[Momentum, Vehicle]:
    """What the balance about this motion says, and the vehicle with the named effects."""
    channel, untestable, torques = momentum_channel(problem, cut, whitener, result, fitted_nT)
    search = begin(channel, list(channel.causes), tested_before=result.tested)
    path = run(search)
    lefts = [_left(search, fitted, torques) for fitted, _ in path]
    found = len(path) > 1 or lefts[0].structured
    explanations = weighed(
        search, path, lefts, [gained(channel, fitted.chosen, problem.budget) if found else 0.0 for fitted, _ in path]
    )
    best, known, _ = likeliest(explanations, search.one_cause)
    chosen = explanations[best]
    seen, hidden = smallest(search.first, search.tested)
    gap, log_ratio = _how_far(channel, chosen.fit)
    known = still_known(known, log_ratio) if chosen.fit.chosen else known
    momentum = Momentum(
        named=_named(search, chosen.fit, chosen.beside.variance, known),
        known=known,
        left=chosen.left if chosen.fit.chosen or known < 0.5 else _NOTHING,
        untestable={**untestable, **{name: why for name, why in hidden.items() if name in _NAMES}},
        ranking=tuple(line for line in ranking(search) if line.name in _NAMES),
        isolability=search.first.isolability,
        minimum_detectable={name: one.shows() for name, one in seen.items() if name in _NAMES},
        gap=gap,
        ahead_km=ahead_km(channel, chosen.fit, result),
    )
    return momentum, channel.vehicle(chosen.fit.chosen)[0]


def _left(
    search: Search[MomentumChannel], fitted: Fit, torques: Mapping[tuple[str | None, str], FloatArray]
) -> Structure:
    """The plain torque of most worth beside the effects of a fit."""
    channel = search.channel
    rest = projected(channel, channel.raw(fitted.chosen), channel.every(fitted.chosen))
    tried, clues = float(np.log(len(torques))), []
    for (condition, frame), columns in torques.items():
        own = partial(np.asarray, columns)
        block = Block({"dynamics": 1.0}, condition, frame, condition or "", " " * columns.shape[2], own)
        drop, rank = fit(block, rest).explained()
        what = "steady torques" if condition is None else f"torques that follow {condition.replace('_', ' ')}"
        words, value = f"{what} in {frame} axes", worth(drop, rank, search.samples, tried)
        clues.append(Structure(value, drop, "block", words, condition, frame, rank=rank, log_tried=tried))
    best = max(clues, key=lambda clue: clue.worth)
    return best if best.worth > THRESHOLD else _NOTHING


def _named(search: Search[MomentumChannel], fitted: Fit, variance: float, known: float) -> tuple[FoundEffect, ...]:
    """The chosen effects with their support, most significant first."""
    found = []
    # A value at its limit has its sigma too: the balance hardly sees some of them.
    covariance, seen, _ = covariance_of(fitted.jacobian, moving(fitted.jacobian))
    for number, (part, (effect, theta)) in enumerate(zip(fitted.slices(), fitted.chosen, strict=True)):
        backing = support(search, fitted, number, variance)
        backing = backing._replace(probability=backing.probability * known)
        energy = np.mean(search.channel.signal(effect, theta) ** 2, axis=0)
        whole = seen[part, None] & seen[None, part]
        own = np.where(whole, covariance[part, part] * max(variance, 1.0), np.nan)
        setting, sigma = search.channel.windows.arcs.problem.setting, np.sqrt(np.diag(own))
        found.append(found_effect(effect, theta, sigma, setting, backing, axis_of(energy), covariance=own))
    return tuple(sorted(found, key=lambda one: one.significance))


def _how_far(channel: MomentumChannel, fit: Fit) -> tuple[MomentumGap, float]:
    """How far the balance closes on windows that the parameters have not seen, and the log of the Bayes factor that
    what is left there gives the named effects. The start of each window comes from itself."""
    windows, plain = channel.windows, channel.balance.by_attitude
    before, after = (plain.left(_held_out(channel, chosen)) for chosen in ((), fit.chosen))
    floor = plain.floor_rad(channel.balance.noise)
    # In rad where other channels have nT: the share that is closed has no unit.
    prediction = Prediction(before, after, np.ones(len(before), dtype=bool), floor, floor)
    far = prediction.shrinkage(bool(fit.chosen))
    value, sigma = channel.estimate(fit)
    at = slice(channel.fitted.shape[2] - 3, channel.fitted.shape[2])
    errors = {
        axis: (float(np.degrees(value)), float(np.degrees(sigma)))
        for axis, value, sigma in zip("xyz", value[at], sigma[at], strict=True)
        if sigma < np.radians(5.0)
    }
    before_deg, after_deg, floor_deg = (float(np.degrees(one)) for one in (far.before_nT, far.after_nT, floor))
    longest = max(float(w.seconds[-1] - w.seconds[0]) for w in windows.windows)
    sizes, noise = (before_deg, after_deg, floor_deg), channel.balance.noise.words
    gap = MomentumGap(*sizes, far.closed, far.interval, len(windows.windows), longest, noise, errors)
    return gap, prediction.log_ratio


def _held_out(channel: MomentumChannel, chosen: Sequence[Active]) -> FloatArray:
    """(M, 3) [rad] what is left of each window with the parameters that four fifths of the others give."""
    windows, raw, residual = channel.windows, channel.below(channel.every(chosen)), channel.below(channel.raw(chosen))
    white, target, out = channel.balance.apply(raw), channel.balance.apply(residual), np.array(residual)
    for part in np.array_split(np.arange(len(windows.windows)), min(BLOCKS, len(windows.windows))):
        held = np.concatenate([np.arange(windows.rows.size)[windows.windows[n].place] for n in part])
        train = np.setdiff1d(np.arange(windows.rows.size), held)
        design = white[train].reshape(3 * train.size, -1)
        length = np.maximum(np.linalg.norm(design, axis=0), 1e-300)
        theta = np.linalg.lstsq(design / length, target[train].reshape(-1), rcond=1e-6)[0] / length
        out[held] = residual[held] - raw[held] @ np.where(moving(white), theta, 0.0)
    return out
