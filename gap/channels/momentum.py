"""The balance of the momentum as a channel, beside the readings of the magnetometer.

Attitude, wheels and torquers say how the body's momentum went on; the torques of the vehicle as modelled say how it
should have. Errors of the two channels are independent, so their rows stand in one channel, each whitened by its own
noise. An effect on the dynamics leaves the readings as they are and has no image there; one on the recorded attitude or on
the reported orbit has an image in both: the first turns the attitudes that the balance is compared with, the second has the
torques act elsewhere. Images of the dynamics come from the same vehicle that the simulation flies.

The attitude's error is a first-order Gauss-Markov process or white. Torquers and wheels change between rows: that is a
white torque and a white rate beside the modelled ones. Their sizes are those of the largest restricted likelihood with
every possible cause in the design, so that no cause can pass for noise (Patterson & Thompson 1971, Biometrika 58:545).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cache, cached_property
from typing import cast

import numpy as np
from scipy.linalg import cholesky, qr, qr_multiply, solve_triangular
from scipy.ndimage import uniform_filter1d
from scipy.stats import norm

from fluxtwin.calib.common.criterion import FALSE_ALARM
from fluxtwin.gap.channels.momentum_arcs import Windows
from fluxtwin.gap.hypotheses.candidates import Candidate, made
from fluxtwin.gap.noise.choice import CLOSE, NoisePrior, prior_of
from fluxtwin.gap.noise.whitening import Whitener
from fluxtwin.gap.problem.problem import Budget, Problem
from fluxtwin.gap.selection.refit import Channel, Fit
from fluxtwin.gap.selection.search import SearchResult
from fluxtwin.sim.base.errors import BadInput
from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.earth.orbit import argument_of_latitude
from fluxtwin.sim.effects.base import DynamicsEffect, Effect, Parameter, SignalEffect
from fluxtwin.sim.effects.calibration import TurningStep
from fluxtwin.sim.effects.catalogue import CATALOGUE
from fluxtwin.sim.effects.chain import Active, derivative
from fluxtwin.sim.effects.clock_and_orbit import AlongTrackError, TimeTagOffset
from fluxtwin.sim.effects.response import SensorLag
from fluxtwin.sim.spacecraft.dynamics.vehicle import Vehicle

_RATIOS = (0.0, *np.geomspace(1e-4, 1e4, 17))
"""Variance at the nodes by a white torque, or rate, over that of the attitude's error."""
_FINEST_RAD = float(np.radians(0.002))
"""No attitude is taken to be better: what wheels do between rows, and short arcs, are not known better."""
_DEAD_RAD = 1e-9
"""A parameter of its typical size that turns no node by more is not there."""

DYNAMICS: tuple[DynamicsEffect, ...] = tuple(e for e in CATALOGUE if isinstance(e, DynamicsEffect))
_AHEAD = AlongTrackError.name
_LATE = (TimeTagOffset.name, SensorLag.name)
"""What moves the readings as an error along the orbit does, and no torque."""
_AGAINST, _FOR = (float(norm.isf(0.5 * level)) for level in (FALSE_ALARM**2, FALSE_ALARM))
"""Sigma: beyond the first a value is not there, within the second it may be."""


@dataclass(frozen=True)
class MomentumNoise:
    """sigma is that of the recorded attitude [rad]."""

    sigma_rad: float
    tau_s: float
    torque: float = 0.0
    """Ratio of variances, as above."""
    rate: float = 0.0

    @property
    def words(self) -> str:
        """For the provenance."""
        tau = "white" if self.tau_s == 0.0 else f"time constant {self.tau_s:.3g} s"
        extra = [
            f"{name} that moves nodes by {np.degrees(self.sigma_rad * np.sqrt(ratio)):.2g} deg"
            for name, ratio in (("white torque", self.torque), ("white rate", self.rate))
            if ratio
        ]
        return "; ".join([f"attitude error {np.degrees(self.sigma_rad):.3g} deg, {tau}", *extra])


class MomentumWhitener:
    """Makes the noise of all nodes white with variance 1, beside the free starts of the windows."""

    def __init__(self, windows: Windows, noise: MomentumNoise) -> None:
        self.windows, self.noise = windows, noise
        self.log_determinant = 0.0
        self.roots: list[FloatArray] = []
        self.starts: list[FloatArray] = []
        for number, window in enumerate(windows.windows):
            root = np.asarray(cholesky(self._covariance(number, noise), lower=True, check_finite=False))
            start = windows.starts[number].reshape(3 * window.size, 6)
            start = start / np.linalg.norm(start, axis=0)
            white = solve_triangular(root, start, lower=True, check_finite=False)
            Q, R, _ = qr(white / np.linalg.norm(white, axis=0), mode="economic", pivoting=True)
            size = np.abs(np.diag(R))
            self.log_determinant += 2.0 * float(np.log(np.diag(root)).sum())
            self.log_determinant += 2.0 * float(np.log(np.maximum(size, 1e-12)).sum())
            self.log_determinant += 2.0 * float(np.log(np.linalg.norm(white, axis=0)).sum())
            self.roots.append(root)
            self.starts.append(Q[:, size > 1e-9])

    @property
    def measured(self) -> int:
        """Scalar measurements less what the starts take."""
        return 3 * int(self.windows.rows.size) - sum(int(start.shape[1]) for start in self.starts)

    def apply(self, columns: FloatArray) -> FloatArray:
        """Columns (M, 3) or (M, 3, P), whitened, beside the best start of each window."""
        flat = columns[:, :, None] if columns.ndim == 2 else columns
        out = np.empty(flat.shape)
        for window, root, start in zip(self.windows.windows, self.roots, self.starts, strict=True):
            part = flat[window.place].reshape(3 * window.size, flat.shape[2])
            white = solve_triangular(root, part, lower=True, check_finite=False)
            white -= start @ (start.T @ white)
            out[window.place] = white.reshape(window.size, 3, flat.shape[2])
        return np.asarray(out.reshape(columns.shape))

    def left(self, columns: FloatArray) -> FloatArray:
        """The same in radians: columns less the best start of each window."""
        white = self.apply(columns)
        out = np.empty(columns.shape)
        for window, root in zip(self.windows.windows, self.roots, strict=True):
            part = white[window.place]
            out[window.place] = (root @ part.reshape(3 * window.size, -1)).reshape(part.shape)
        return np.asarray(out.reshape(columns.shape))

    @cached_property
    def by_attitude(self) -> MomentumWhitener:
        """Weights of the attitude's error alone: for figures, in which a wandering torque must not be taken for granted."""
        return MomentumWhitener(self.windows, replace(self.noise, torque=0.0, rate=0.0))

    def floor_rad(self, noise: MomentumNoise) -> float:
        """rms per component that a noise leaves beside the best starts by these weights."""
        total = 0.0
        for number, (root, start) in enumerate(zip(self.roots, self.starts, strict=True)):
            inner = solve_triangular(root, self._covariance(number, noise), lower=True, check_finite=False)
            inner = solve_triangular(root, inner.T, lower=True, check_finite=False)
            kept = np.eye(len(root)) - start @ start.T
            total += float(np.trace(root @ kept @ inner @ kept @ root.T))
        return float(np.sqrt(total / (3 * self.windows.rows.size)))

    def _covariance(self, number: int, noise: MomentumNoise) -> FloatArray:
        window = self.windows.windows[number]
        apart = np.abs(window.seconds[:, None] - window.seconds)
        same = np.eye(window.size) if noise.tau_s == 0.0 else np.exp(-apart / noise.tau_s)
        torque, rate = self.windows.wander[number]
        whole = noise.torque * torque + noise.rate * rate
        for axis in range(3):  # the attitude's errors about the three axes are independent
            whole[axis::3, axis::3] += same + 1e-9 * np.eye(window.size)
        return np.asarray(noise.sigma_rad**2 * whole)


def choose_noise(windows: Windows, residual: FloatArray, saturated: FloatArray, budget: Budget) -> MomentumNoise:
    """The noise of the largest restricted likelihood; residual (M, 3), saturated (M, 3, P): every possible cause."""
    prior, tau = prior_of(budget), budget.attitude_tau_s
    taus = sorted({15.0, 30.0, 60.0, 120.0, 250.0, 500.0, 1000.0, 2000.0, tau or 0.0})
    starts = [min(taus, key=lambda value: abs(value - near)) for near in ((60.0, 1000.0) if tau is None else (tau,))]

    @cache
    def seen(noise: MomentumNoise) -> tuple[float, float]:
        return _likelihood(windows, residual, saturated, noise, prior)

    found = [MomentumNoise(1.0, start) for start in starts]
    for name, grid in (("torque", _RATIOS), ("rate", _RATIOS), ("tau_s", taus)) * 3:
        found = [_climbed(one, name, grid, seen) for one in found]
    best = max(found, key=lambda one: seen(one)[0])
    sigma = max(seen(best)[1], _FINEST_RAD)
    share = (seen(best)[1] / sigma) ** 2
    return replace(best, sigma_rad=sigma, torque=share * best.torque, rate=share * best.rate)


def _climbed(
    noise: MomentumNoise, name: str, grid: Sequence[float], seen: Callable[[MomentumNoise], tuple[float, float]]
) -> MomentumNoise:
    """The best along one axis of the grid, or the first that is as good: coarse first, then beside the best."""
    places = sorted({*range(0, len(grid), 4), grid.index(getattr(noise, name)), len(grid) - 1})
    while True:
        heights = [seen(replace(noise, **{name: grid[place]}))[0] for place in places]
        best = min(place for place, height in zip(places, heights, strict=True) if height >= max(heights) - CLOSE)
        beside = [place for place in (best - 1, best + 1) if 0 <= place < len(grid) and place not in places]
        if not beside:
            return replace(noise, **{name: grid[best]})
        places = [*places, *beside]


def _likelihood(
    windows: Windows, residual: FloatArray, saturated: FloatArray, noise: MomentumNoise, prior: NoisePrior
) -> tuple[float, float]:
    """Restricted log likelihood with the best size of all noise, and that size [rad]; noise: of size one."""
    log_determinant, chi2, free = _restricted(windows, residual, saturated, noise)
    sigma = float(np.sqrt(chi2 / free))
    value = -0.5 * (log_determinant + free * np.log(chi2 / free) + free)
    return float(value) + _prior_log(replace(noise, sigma_rad=sigma), prior), sigma


def _restricted(
    windows: Windows, residual: FloatArray, saturated: FloatArray, noise: MomentumNoise
) -> tuple[float, float, int]:
    """Log determinant, chi-square and degrees of freedom of a balance (M, 3) with columns (M, 3, P) fitted."""
    whitener = MomentumWhitener(windows, noise)
    white = whitener.apply(residual).reshape(-1)
    design = whitener.apply(saturated).reshape(white.size, saturated.shape[2])
    design /= np.maximum(np.linalg.norm(saturated.reshape(white.size, saturated.shape[2]), axis=0), 1e-300)
    # Only what Q makes of one vector is wanted, not Q: half the time.
    along, R, _ = qr_multiply(design, white, mode="right", pivoting=True)
    size = np.abs(np.diag(R))
    # Images are differences of two flights, right to 1e-8: a combination of them with less is not known to a thousandth.
    kept = size > 1e-5 * max(float(size.max(initial=0.0)), 1e-300)
    whole = float(white @ white)
    chi2 = max(whole - float(along[kept] @ along[kept]), 1e-14 * whole, 1e-300)  # not less than rounding
    free = max(whitener.measured - int(kept.sum()), 1)
    return whitener.log_determinant + 2.0 * float(np.log(size[kept]).sum()), chi2, free


def _prior_log(noise: MomentumNoise, prior: NoisePrior) -> float:
    # A decade costs a half: where the data do not say, little moves the body unrecorded.
    ratios = sum(np.log10(ratio / _RATIOS[1]) for ratio in (noise.torque, noise.rate) if ratio)
    return float(prior.log_density(prior.sigma_nT, noise.sigma_rad, noise.tau_s) - 0.5 * ratios)


def gained(channel: MomentumChannel, chosen: Sequence[Active], budget: Budget) -> float:
    """Twice the log likelihood that a balance with these effects, and nothing else, wins by a noise of its own."""
    about = (channel.windows, channel.below(channel.raw(chosen)), channel.below(channel.every(chosen)))
    prior, noises = prior_of(budget), (channel.balance.noise, choose_noise(*about, budget))
    logs = []
    for noise in noises:
        log_determinant, chi2, _ = _restricted(*about, noise)
        logs.append(_prior_log(noise, prior) - 0.5 * (log_determinant + chi2))
    return 2.0 * max(logs[1] - logs[0], 0.0)


def dynamics_causes(windows: Windows) -> tuple[list[Candidate], dict[str, str]]:
    """All alternatives of all effects on the dynamics, and why others cannot be tested."""
    vehicle, setting = windows.arcs.craft.vehicle, windows.arcs.problem.setting
    found: list[Candidate] = []
    untestable: dict[str, str] = {}
    for effect in DYNAMICS:
        alternatives = [one for one in effect.alternatives(setting) if isinstance(one, DynamicsEffect)]
        reasons = [one.idle(vehicle) for one in alternatives]
        causes = (cause(windows, vehicle, one) for one, no in zip(alternatives, reasons, strict=True) if no is None)
        live = [one for one in causes if one.live.any()]
        found += live
        if not live:
            nothing = "nothing in these data excites it: at its typical size it would not turn the body"
            untestable[effect.name] = next((reason for reason in reasons if reason), nothing)
    return found, untestable


def cause(windows: Windows, vehicle: Vehicle, effect: DynamicsEffect) -> Candidate:
    """One effect with its image: (M, 3, p) turn of the nodes [rad] per unit of each parameter."""
    steps = effect.step(vehicle)
    images = [windows.image(effect.on(vehicle, step)) for step in np.diag(steps)]
    return made(cast(SignalEffect, effect), np.stack(images, axis=2) / steps, _DEAD_RAD)


def orbit_of(problem: Problem, active: Sequence[Active]) -> tuple[FloatArray, FloatArray]:
    """(N, 3) position [km] and velocity [km/s] with these effects on the reported orbit taken out of it."""
    on = [pair for pair in active if pair[0].stage == "orbit"]
    if not on:
        return problem.setting.given[:2]
    signal = problem.design.signal(on)
    return signal.r_N_km, signal.v_N_km_s


def image_of(windows: Windows, effect: SignalEffect, on: Sequence[Active], theta: FloatArray) -> FloatArray:
    """(M, 3, p) of any effect that the readings have too, per unit of each parameter; zero where it leaves attitude and
    orbit alone. One on the reported orbit has gravity gradient, field and light where the body really was.

    on: all effects that are there.
    """
    arcs, others = windows.arcs, [pair for pair in on if pair[0] is not effect and pair[0].stage == effect.stage]

    def turned(up: FloatArray, down: FloatArray) -> FloatArray:
        signals = (arcs.problem.design.signal([*others, (effect, value)]) for value in (up, down))
        high, low = (signal.R_BN[windows.rows] for signal in signals)
        return np.asarray(-(high * low.inv()).as_rotvec())

    def elsewhere(up: FloatArray, down: FloatArray) -> FloatArray:
        there = (arcs.but(orbit=orbit_of(arcs.problem, [*others, (effect, value)])) for value in (up, down))
        high, low = (one.flown(arcs.craft.vehicle) for one in there)
        return high - low

    if effect.stage == "attitude":
        return derivative(effect, theta, turned)
    if effect.stage == "orbit":
        return windows.chained(derivative(effect, theta, elsewhere))
    return np.zeros((windows.rows.size, 3, len(theta)))


def unresolved(windows: Windows) -> FloatArray:
    """(M, 3, p) turns by what wheels and torquers may have done between the rows: more or less of the wheels' quick part,
    and dipoles that hold instead of going straight to the next row.

    The momentum that a jittering wheel has between rows is drawn too smooth; body and wheel jitter against each other,
    so this looks like another inertia. Nothing where rows are as close as the ticks.
    """
    arcs = windows.arcs
    parts: list[FloatArray] = []
    if not arcs.resolved:
        vehicle, axes = arcs.craft.vehicle, np.eye(3)
        for span in (3, 9):  # rows over which their quick part is separated from the slow one
            known = np.nan_to_num(arcs.wheels_B)
            quick = known - uniform_filter1d(known, span, axis=0, mode="nearest")
            parts += [arcs.flown(vehicle, wheels_B=quick * axis) - arcs.base for axis in axes if np.any(quick * axis)]
        moved = np.any(np.diff(arcs.dipole_B_Am2, axis=0) != 0.0, axis=0)
        held = [arcs.held | (np.arange(3) == axis) for axis in np.flatnonzero(moved)]
        parts += [arcs.but(held=one).flown(vehicle) - arcs.base for one in held]
    parts = [one for one in parts if np.max(np.abs(one), initial=0.0) > _DEAD_RAD]  # less is rounding
    if not parts:
        return np.zeros((windows.rows.size, 3, 0))
    return windows.chained(np.stack(parts, axis=2))


def plain_torques(windows: Windows) -> dict[tuple[str | None, str], FloatArray]:
    """{(condition, frame): (M, 3, p)} turns by torques that no effect makes: with sunlight, orbit and time."""
    arcs = windows.arcs
    problem, rows = arcs.problem, arcs.rows[:, 0]
    r, v, _ = problem.setting.given
    u = argument_of_latitude(problem.time, r, v)[rows]
    t = problem.setting.seconds[rows]
    t = (t - t.mean()) / max(float(np.ptp(t)), 1.0)
    light = (problem.setting.illumination[rows] > 0.5).astype(np.float64)
    courses: dict[str | None, list[FloatArray]] = {
        None: [np.ones(rows.size)],
        "orbit_phase": [f(k * u) for k in (1, 2) for f in (np.cos, np.sin)],
        "time": [t, t**2],
        "sunlit": [light - light.mean()],
    }
    frames = {
        "body": arcs.track[rows].inv().as_matrix(),
        "orbital": problem.setting.R_ON[rows].inv().as_matrix(),
        "inertial": np.tile(np.eye(3), (rows.size, 1, 1)),
    }
    found: dict[tuple[str | None, str], FloatArray] = {}
    for condition, values in courses.items():
        for frame, axes in frames.items():
            impulse = np.concatenate([axes * (value * arcs.seconds)[:, None, None] for value in values], axis=2)
            found[condition, frame] = windows.chained(arcs.pushed(slice(None), impulse))
    return found


def shared_candidates(windows: Windows, candidates: Sequence[Candidate], on: Sequence[Active]) -> list[Candidate]:
    """The candidates of the readings that turn the recorded attitude or move the orbit, with their image in the balance.

    But for steps: a few of them make up the turn by any slow torque, and the readings alone say when one was.
    """
    found = []
    for candidate in candidates:
        if candidate.effect.stage in ("attitude", "orbit") and not isinstance(candidate.effect, TurningStep):
            zero = np.zeros(len(candidate.effect.parameters))
            image = made(candidate.effect, image_of(windows, candidate.effect, on, zero), _DEAD_RAD)
            found.append(Candidate(candidate.effect, image.jacobian, image.live & candidate.live))
    return [one for one in found if one.live.any()]


@dataclass(frozen=True)
class Always(Effect):
    """Columns that are fitted in every test, as an effect with so many parameters without limits."""

    count: int

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        return (Parameter("", "1", 1.0),) * self.count


@dataclass(frozen=True, eq=False)
class MomentumChannel(Channel):
    """N readings at their refit and the M nodes of the balance; columns have the unit nT above and rad below.

    Torques have no settings that are tried at a few values only; the noise of the balance has the attitude's error in it.
    """

    windows: Windows
    readings: Whitener
    balance: MomentumWhitener
    bare: FloatArray
    """(N + M, 3) residual of the readings with all that is named there, and of the balance as modelled."""
    fitted: FloatArray
    """(N + M, 3, c) what is always fitted: what the readings have; in the balance what wheels and torquers did between the
    rows; an attitude error that stands still (the last three)."""
    causes: Sequence[Candidate]

    share_left = 1e-3
    """The rest of fainter images is mostly what is left out in making them."""

    @property
    def measured(self) -> int:
        return self.readings.measured + self.balance.measured

    @cached_property
    def modelled(self) -> Sequence[Active]:
        count = self.fitted.shape[2]
        return [(Always(count), np.zeros(count))]

    def apply(self, columns: FloatArray) -> FloatArray:
        """Columns (N + M, 3) or (N + M, 3, P), whitened."""
        above, below = np.split(columns, [len(columns) - self.windows.rows.size])
        return np.concatenate([self.readings.apply(above), self.balance.apply(below)])

    def below(self, columns: FloatArray) -> FloatArray:
        """The rows of the balance."""
        return columns[len(columns) - self.windows.rows.size :]

    def raw(self, active: Sequence[Active]) -> FloatArray:
        """(N + M, 3) residual with these effects on; a body that cannot be has its effect in proportion."""
        vehicle, others = self.vehicle(active)
        rest = np.array(self.bare)
        for effect, theta in others:
            rest -= self.columns(effect) @ theta
        if vehicle is not self.windows.arcs.craft.vehicle:
            self.below(rest)[:] -= self.windows.image(vehicle)
        return rest

    def vehicle(self, active: Sequence[Active]) -> tuple[Vehicle, list[Active]]:
        """The vehicle with effects on the dynamics; and those that are no such effects, or make a body that cannot be."""
        vehicle, others = self.windows.arcs.craft.vehicle, []
        for effect, theta in active:
            moved = None
            if isinstance(effect, DynamicsEffect):
                with suppress(BadInput):
                    moved = effect.on(vehicle, theta)
            if moved is None:
                others.append((effect, theta))
            vehicle = moved or vehicle
        return vehicle, others

    def residual(self, active: Sequence[Active]) -> FloatArray:
        return self.apply(self.raw(active))

    def jacobian(self, active: Sequence[Active]) -> FloatArray:
        """(N + M, 3, p) whitened images, about a vehicle without any effect: a motion that is far from the vehicle's own is
        made anew (see `Windows.followed`)."""
        for effect, _ in active:
            if effect not in self._white:
                self._white[effect] = self.apply(self.columns(effect))
        return np.concatenate([self._white[effect] for effect, _ in active], axis=2)

    def candidate(self, effect: SignalEffect, modelled: Sequence[Active]) -> Candidate:
        return next(cause for cause in self.causes if cause.effect == effect)

    @cached_property
    def _white(self) -> dict[Effect, FloatArray]:
        return {}

    def columns(self, effect: Effect) -> FloatArray:
        """(N + M, 3, p) image of a cause, or what is always fitted, as it is."""
        if isinstance(effect, Always):
            return self.fitted
        return next(cause.jacobian for cause in self.causes if cause.effect == effect)

    def estimate(self, fit: Fit, *further: FloatArray) -> tuple[FloatArray, FloatArray]:
        """By the balance alone: best values and sigma of what is always fitted, of the named effects and of further
        columns (N + M, 3, p), all at once; infinite sigma where there is nothing."""
        columns = self.balance.apply(self.below(np.concatenate([self.every(fit.chosen), *further], axis=2)))
        return solved(columns, self.balance.apply(self.below(self.raw(fit.chosen))))

    def every(self, chosen: Sequence[Active]) -> FloatArray:
        """(N + M, 3, c + p) all that is fitted with these effects named, as it is."""
        return np.concatenate([self.fitted, *(self.columns(effect) for effect, _ in chosen)], axis=2)

    def signal(self, effect: Effect, theta: FloatArray) -> FloatArray:
        """(M, 3) [rad] of an effect in the balance, beside the free starts."""
        return self.balance.by_attitude.left(self.below(self.columns(effect)) @ theta)


def momentum_channel(
    problem: Problem, windows: Windows, readings: Whitener, result: SearchResult, fitted_nT: FloatArray
) -> tuple[MomentumChannel, dict[str, str], dict[tuple[str | None, str], FloatArray]]:
    """The channel about a motion; why effects on the dynamics cannot be tested; torques that no effect makes, by condition
    and frame, (N + M, 3, p).

    result, fitted_nT: the finished search of the readings, and the Jacobian (N, 3, c) of all that it fits.
    """
    there = [*problem.frozen, *result.modelled, *result.chosen]
    dynamic, untestable = dynamics_causes(windows)
    turning = shared_candidates(windows, _others(result), there)
    blocks = plain_torques(windows)
    on = [pair for pair in there if pair[0].stage == "attitude"]
    residual = windows.residual(problem.chain.signal(on).R_BN if on else None)
    further = np.zeros((windows.rows.size, 3, fitted_nT.shape[2]))
    shared = [
        image_of(windows, cast(SignalEffect, effect), there, theta)
        for effect, theta in (*result.modelled, *result.chosen)
    ]
    if shared:
        columns = np.concatenate(shared, axis=2)
        further[:, :, : columns.shape[2]] = columns
    standing = np.tile(np.eye(3), (windows.rows.size, 1, 1))  # an attitude error that stands still leans the momentum
    own = np.concatenate([unresolved(windows), standing], axis=2)
    everything = [further, own, *(c.jacobian[:, :, c.live] for c in (*dynamic, *turning)), *blocks.values()]
    noise = choose_noise(windows, residual, np.concatenate(everything, axis=2), problem.budget)

    def alone(columns: FloatArray) -> FloatArray:
        return np.concatenate([np.zeros((len(fitted_nT), *columns.shape[1:])), columns])

    causes = [Candidate(c.effect, alone(c.jacobian), c.live) for c in dynamic]
    for c in turning:
        seen = next(one.jacobian for one in result.candidates if one.effect is c.effect)
        causes.append(Candidate(c.effect, np.concatenate([np.where(c.live, seen, 0.0), c.jacobian]), c.live))
    channel = MomentumChannel(
        windows,
        readings,
        MomentumWhitener(windows, noise),
        np.concatenate([result.residual_nT, residual]),
        np.concatenate([np.concatenate([fitted_nT, further]), alone(own)], axis=2),
        causes,
    )
    return channel, untestable, {key: alone(block) for key, block in blocks.items()}


def _others(result: SearchResult) -> list[Candidate]:
    """What the readings have not found. An error along the orbit only where they cannot tell it from what they have:
    elsewhere they know it far better than torques do, and it would only take up what is left of another cause."""
    taken = {effect.name for effect, _ in (*result.chosen, *result.modelled)}
    alike = {name for one in result.named for name in (*one.group, *(rival for rival, _ in one.rivals))}
    return [c for c in result.candidates if c.name not in taken and (c.effect.stage != "orbit" or c.name in alike)]


def solved(columns: FloatArray, target: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Best values (p,) and sigma of whitened columns (M, 3, p) in a residual (M, 3); infinite sigma for dead columns."""
    flat = columns.reshape(-1, columns.shape[2])
    length = np.linalg.norm(flat, axis=0)
    live = length > 0
    unit = flat[:, live] / length[live]
    gram = np.linalg.pinv(unit.T @ unit, rcond=1e-12)
    value, sigma = np.zeros(length.size), np.full(length.size, np.inf)
    value[live] = gram @ (unit.T @ target.reshape(-1)) / length[live]
    sigma[live] = np.sqrt(np.maximum(np.diag(gram), 0.0)) / length[live]
    return value, sigma


def ahead_km(channel: MomentumChannel, fit: Fit, result: SearchResult) -> tuple[float, float] | None:
    """How far the reported position is ahead of the true one, by the balance alone, and sigma [km].

    A magnetometer that is sampled late leaves the torques where they are. A body that is behind its reported place has the
    field, the nadir and the light of that other place to work against. None where no error along the orbit can be seen.
    """
    at, applied, width = None, 0.0, 0
    for first, active in ((0, (*result.modelled, *result.chosen)), (channel.fitted.shape[2], fit.chosen)):
        width = first
        for effect, theta in active:
            if effect.name == _AHEAD:
                at, applied = width, float(theta[0])
            width += len(theta)
    further = [] if at is not None else [one.jacobian for one in channel.causes if one.name == _AHEAD]
    if at is None and not further:
        return None
    at = width if at is None else at
    value, sigma = channel.estimate(fit, *further)
    return (applied + float(value[at]), float(sigma[at])) if np.isfinite(sigma[at]) else None


def ruled_out(result: SearchResult, whitener: Whitener, ahead: tuple[float, float]) -> dict[str, str]:
    """{name: why} of causes that the readings would accept and the torques do not. ahead: as `ahead_km` has it."""
    for place, one in enumerate(result.named):
        alike = {one.name, *one.group, *(name for name, _ in one.rivals)}
        if _AHEAD not in alike or not alike & set(_LATE):
            continue
        wanted, unsure = _by_readings_km(result, whitener, place)
        value, sigma = ahead
        none, whole = abs(value) / sigma, abs(value - wanted) / float(np.hypot(sigma, unsure))
        found = f"the momentum balance puts the position {value:.1f} ± {sigma:.1f} km ahead"
        if none > _AGAINST and whole < _FOR:
            return {name: f"{found}, which a clock error does not cause" for name in _LATE if name in alike}
        if whole > _AGAINST and none < _FOR:
            return {_AHEAD: f"{found}, not the {wanted:.1f} km that would explain the readings"}
    return {}


def _by_readings_km(result: SearchResult, whitener: Whitener, place: int) -> tuple[float, float]:
    """The error along the orbit that would do in place of a named effect, and its sigma [km]."""
    effect, theta = result.chosen[place]
    if effect.name == _AHEAD:
        return float(theta[0]), float(result.named[place].sigma[0])
    image, fit = next(c.jacobian for c in result.candidates if c.name == _AHEAD), result.fit
    own = next(part for part, (one, _) in zip(fit.slices(), fit.chosen, strict=True) if one is effect)
    target = fit.residual + fit.jacobian[:, :, own] @ theta
    rest = np.delete(fit.jacobian, np.r_[own], axis=2)
    value, sigma = solved(np.concatenate([rest, whitener.apply(image)], axis=2), target)
    return float(value[-1]), float(sigma[-1])
