"""Another channel of a diagnosis: the balance of the momentum, beside the magnetometer.

Attitude, wheels and torquers say how the body's momentum went on; the torques of the vehicle as modelled say how it
should have. Windows of the record (`momentum_windows`) are compared attitude by attitude; what is left is searched for
effects on the dynamics with the scores of the magnetometer's channel.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import cast

import numpy as np

from fluxtwin.gap.channels import momentum_causes as causes
from fluxtwin.gap.channels.momentum_arcs import Craft, arcs
from fluxtwin.gap.channels.momentum_held_out import how_far
from fluxtwin.gap.channels.momentum_noise import MomentumWhitener, choose_noise
from fluxtwin.gap.channels.momentum_orbit import ahead_km, estimate, ruled_out
from fluxtwin.gap.channels.momentum_search import Balance, Beside, Refit, named, refitted, significant_left, sought
from fluxtwin.gap.channels.momentum_windows import MOST_NODES, WINDOW_S, Windows, windows
from fluxtwin.gap.hypotheses.candidates import Candidate
from fluxtwin.gap.noise.whitening import Whitener
from fluxtwin.gap.problem.problem import Problem
from fluxtwin.gap.records.diagnosis import Detectable, FoundEffect, MomentumGap, Ranked
from fluxtwin.gap.selection.detectable import noncentrality
from fluxtwin.gap.selection.groups import isolability, shares_by_name
from fluxtwin.gap.selection.named import SearchResult
from fluxtwin.gap.selection.score import Board
from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.effects.base import SignalEffect
from fluxtwin.sim.spacecraft.dynamics.vehicle import Vehicle

_LEFT_P = 0.001
_AGAIN = 2
CARRIED = 0.9
"""Share of the structured energy that the named effects must carry where structure is left."""
_NO_SCENARIO = 'no scenario with attitude mode "dynamics" says what the body is and which torques turn it'


@dataclass(frozen=True, eq=False)
class Momentum:
    """What the balance of the momentum says; `gap` is None where there is no balance."""

    named: tuple[FoundEffect, ...] = ()
    untestable: Mapping[str, str] = field(default_factory=dict)
    ranking: tuple[Ranked, ...] = ()
    isolability: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    minimum_detectable: Mapping[str, Detectable] = field(default_factory=dict)
    structured: bool = False
    """Whether torques are left that no effect makes."""
    explained_share: float | None = None
    left_condition: str | None = None
    left_frame: str | None = None
    words: str = ""
    gap: MomentumGap | None = None
    ahead_km: tuple[float, float] | None = None
    """How far the reported position is ahead along the orbit, and sigma; None where torques do not show it."""
    ruled_out: Mapping[str, str] = field(default_factory=dict)
    """Names that the readings would accept and the torques do not: why."""

    @property
    def standing(self) -> tuple[FoundEffect, ...]:
        """Named effects that stand: one of few that would do, and either nothing is left or little beside them."""
        carried = self.explained_share is not None and self.explained_share >= CARRIED
        few = not any(one.too_many_alike for one in self.named)
        return self.named if few and (not self.structured or carried) else ()

    @property
    def unexplained(self) -> bool:
        """Whether something is there that no effect explains."""
        return (bool(self.named) or self.structured) and not self.standing

    @property
    def incomplete(self) -> bool:
        """Whether the named effects stand and something smaller is left."""
        return bool(self.standing) and self.structured


def absent(reason: str) -> Momentum:
    """No balance: why the effects on the dynamics cannot be tested."""
    return Momentum(untestable={effect.name: reason for effect in causes.DYNAMICS})


def balanced(
    problem: Problem, craft: Craft | None, whitener: Whitener, result: SearchResult, fitted_nT: FloatArray
) -> Momentum:
    """The balance beside the finished search of the magnetometer's channel.

    fitted_nT: (N, 3, c) Jacobian of what that channel fits: what is modelled, its named effects, and others after them.
    """
    if craft is None:
        return absent(_NO_SCENARIO)
    orbit = causes.orbit_of(problem, [*problem.frozen, *result.modelled, *result.chosen])
    flown = arcs(problem, craft, WINDOW_S / MOST_NODES, orbit)
    if isinstance(flown, str):
        return absent(flown)
    cut = windows(flown)
    if isinstance(cut, str):
        return absent(cut)
    found = _about_the_motion(problem, cut, whitener, result, fitted_nT)
    if found.structured or found.ahead_km is None:
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
    if vehicle is None and not found.structured:
        return found
    found, vehicle = _searched(problem, cut.followed(slow=True).followed(slow=True), whitener, result, fitted_nT)
    for _ in range(_AGAIN):
        if vehicle is None:
            break
        before = [one.name for one in found.named]
        moved = Windows(cut.arcs.of(vehicle), cut.windows).followed().followed()
        momentum_N = moved.arcs.momentum_of(cut.arcs.craft.vehicle)
        again = Windows(cut.arcs.along(moved.arcs.track, momentum_N), cut.windows)
        found, vehicle = _searched(problem, again, whitener, result, fitted_nT)
        if [one.name for one in found.named] == before:
            break
    return found


def _searched(
    problem: Problem, cut: Windows, whitener: Whitener, result: SearchResult, fitted_nT: FloatArray
) -> tuple[Momentum, Vehicle | None]:
    """What the balance about this motion says, and the vehicle with the named effects, if there are any."""
    dynamic, untestable = causes.dynamics_causes(cut)
    there = [*problem.frozen, *result.modelled, *result.chosen]
    on = causes.on_attitude(there)
    turning = causes.shared_candidates(cut, _others(result), there)
    residual = cut.residual(problem.chain.signal(on).R_BN if on else None)
    nuisance = _nuisance(cut, problem, result, fitted_nT)
    blocks = causes.plain_torques(cut)
    everything = [nuisance, *(c.jacobian for c in (*dynamic, *turning)), *blocks.values()]
    noise = choose_noise(cut, residual, np.concatenate(everything, axis=2), problem.budget)
    images = [np.zeros(0)] * len(dynamic) + [_reading_image(result, whitener, c) for c in turning]
    beside = Beside(
        whitener.apply(result.residual_nT), whitener.apply(fitted_nT), images, whitener.measured, result.tested
    )
    balance = Balance(cut, MomentumWhitener(cut, noise), residual, nuisance, [*dynamic, *turning], beside)
    return _told(balance, blocks, untestable, result)


def _told(
    balance: Balance,
    blocks: Mapping[tuple[str, str], FloatArray],
    untestable: Mapping[str, str],
    result: SearchResult,
) -> tuple[Momentum, Vehicle | None]:
    first = balance.board(balance.residual)
    chosen, tested = sought(balance, first)
    fit = refitted(balance, first, chosen) if chosen else None
    left = significant_left(balance, fit, blocks)
    (condition, frame), p_value = min(left.items(), key=lambda pair: pair[1])
    structured = p_value < _LEFT_P
    detected, hidden = _detectable(first)
    momentum = Momentum(
        named=named(balance, first, chosen, fit, tested) if fit is not None else (),
        untestable={**untestable, **hidden},
        ranking=_ranking(first, tested),
        isolability=isolability(shares_by_name(first)),
        minimum_detectable=detected,
        structured=structured,
        explained_share=_share(first, chosen),
        left_condition=None if condition == "none" else condition,
        left_frame=frame,
        words=f"torques that follow {condition.replace('_', ' ')} in {frame} axes (p {p_value:.1g})"
        if structured
        else "",
        gap=how_far(balance, fit, balance.whitener.noise.words, _standing(balance, fit)),
        ahead_km=ahead_km(balance, fit, chosen, result),
    )
    return momentum, None if fit is None else fit.vehicle


def _nuisance(cut: Windows, problem: Problem, result: SearchResult, fitted_nT: FloatArray) -> FloatArray:
    """(M, 3, c + p) what is always fitted: what the magnetometer's channel has, wheels and torquers between the rows, an
    attitude error that stands still."""
    further = np.zeros((cut.rows.size, 3, fitted_nT.shape[2]))
    shared = _shared(cut, problem, result)
    further[:, :, : shared.shape[2]] = shared
    return np.concatenate([further, causes.unresolved(cut), causes.standing(cut)], axis=2)


def _others(result: SearchResult) -> list[Candidate]:
    """What the readings have not found. An error along the orbit only where they cannot tell it from what they have:
    elsewhere they know it far better than torques do, and it would only take up what is left of another cause."""
    taken = {effect.name for effect, _ in (*result.chosen, *result.modelled)}
    alike = {name for one in result.named for name in (*one.group, *(rival for rival, _ in one.rivals))}
    return [c for c in result.candidates if c.name not in taken and (c.effect.stage != "orbit" or c.name in alike)]


def _shared(cut: Windows, problem: Problem, result: SearchResult) -> FloatArray:
    """(M, 3, c + p) image of what the magnetometer's channel fits, in its order; zero where attitude and orbit stay."""
    there = [*problem.frozen, *result.modelled, *result.chosen]
    parts = [
        causes.image_of(cut, cast(SignalEffect, effect), there, theta)
        for effect, theta in (*result.modelled, *result.chosen)
    ]
    return np.concatenate(parts, axis=2) if parts else np.zeros((cut.rows.size, 3, 0))


def _reading_image(result: SearchResult, whitener: Whitener, candidate: Candidate) -> FloatArray:
    raw = next(c for c in result.candidates if c.effect is candidate.effect)
    return whitener.apply(raw.jacobian[:, :, candidate.live])


def _share(first: Board, chosen: Sequence[int]) -> float | None:
    """Of the energy that all candidates and plain torques explain: the part of the chosen ones."""
    whole, rank = first.saturated
    inside = np.isin(first.block, chosen)
    if not inside.any():
        return None
    values, vectors = np.linalg.eigh(first.unit_gram[np.ix_(inside, inside)])
    good = values > 1e-6
    own = float(np.sum((vectors[:, good].T @ first.score[inside]) ** 2 / values[good]))
    structured = whole - first.variance * rank
    return None if structured <= 0 else (own - first.variance * int(good.sum())) / structured


def _ranking(first: Board, tested: int) -> tuple[Ranked, ...]:
    best: dict[str, Ranked] = {}
    for number, candidate in enumerate(first.candidates):
        if first.rank[number] == 0 or candidate.effect.stage != "dynamics":
            continue
        p_value = min(1.0, tested * float(first.p_values[number]))
        line = Ranked(candidate.name, float(first.statistic[number]), int(first.rank[number]), p_value)
        if candidate.name not in best or p_value < best[candidate.name].p_value:
            best[candidate.name] = line
    return tuple(best.values())


def _detectable(first: Board) -> tuple[dict[str, Detectable], dict[str, str]]:
    """The smallest size of each effect on the dynamics that this design shows; and names that it cannot show."""
    tested = max(int((first.rank > 0).sum()), 1)
    best: dict[str, tuple[float, Detectable]] = {}
    names = {c.name for c in first.candidates if c.effect.stage == "dynamics"}
    for column in np.flatnonzero(first.left > first.share_left):
        owner = int(first.owner[column])
        candidate = first.candidates[owner]
        if candidate.name not in names or first.rank[owner] == 0:
            continue
        curvature = first.left[column] * first.lengths[column] ** 2
        value = float(np.sqrt(noncentrality(int(first.rank[owner]), tested) / curvature))
        parameter = candidate.effect.parameters[int(first.place[column])]
        if candidate.name not in best or value / parameter.scale < best[candidate.name][0]:
            best[candidate.name] = (value / parameter.scale, Detectable(parameter.name, value, parameter.unit, 0.0))
    hidden = dict.fromkeys(sorted(names - set(best)), "the free starts of the windows can imitate it wholly")
    return {name: found for name, (_, found) in best.items()}, hidden


def _standing(balance: Balance, fit: Refit | None) -> tuple[FloatArray, FloatArray]:
    """Attitude error that stands still in the body (3,) and its sigma (3,) [rad], beside what is named."""
    value, sigma = estimate(balance, fit)
    at = slice(balance.nuisance.shape[2] - 3, balance.nuisance.shape[2])
    return value[at], sigma[at]
