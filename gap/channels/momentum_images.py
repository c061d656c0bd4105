"""What may turn the body, or the recorded attitude: images of all causes in the balance of the momentum.

An effect on the dynamics has its image from the same vehicle that the simulation flies; one on the recorded attitude
turns the attitudes that the balance is compared with; one on the reported orbit has the torques act elsewhere.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import cast

import numpy as np
from scipy.ndimage import uniform_filter1d

from fluxtwin.gap.channels.momentum_arcs import Windows
from fluxtwin.gap.hypotheses.candidates import Candidate, made
from fluxtwin.gap.problem.problem import Problem
from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.earth.orbit import argument_of_latitude
from fluxtwin.sim.effects.base import DynamicsEffect, SignalEffect
from fluxtwin.sim.effects.calibration import TurningStep
from fluxtwin.sim.effects.catalogue import CATALOGUE
from fluxtwin.sim.effects.chain import Active
from fluxtwin.sim.spacecraft.dynamics.vehicle import Vehicle

_DEAD_RAD = 1e-9
"""A parameter of its typical size that turns no node by more is not there."""

_SPANS = (3, 9)
"""Rows over which the quick part of wheels is separated from the slow one."""

DYNAMICS: tuple[DynamicsEffect, ...] = tuple(e for e in CATALOGUE if isinstance(e, DynamicsEffect))


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


def _derivative(
    effect: SignalEffect, theta: FloatArray, between: Callable[[FloatArray, FloatArray], FloatArray]
) -> FloatArray:
    """(M, k, p) central differences by the parameters, one-sided at the end of a range; between: what two sets of them
    differ by, (M, k)."""
    columns = []
    for number, parameter in enumerate(effect.parameters):
        up, down = np.array(theta, dtype=np.float64), np.array(theta, dtype=np.float64)
        up[number] = min(up[number] + parameter.scale, parameter.high)
        down[number] = max(down[number] - parameter.scale, parameter.low)
        columns.append(between(up, down) / (up[number] - down[number]))
    return np.stack(columns, axis=2)


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
        there = (arcs.elsewhere(orbit_of(arcs.problem, [*others, (effect, value)])) for value in (up, down))
        high, low = (one.flown(arcs.craft.vehicle) for one in there)
        return high - low

    if effect.stage == "attitude":
        return _derivative(effect, theta, turned)
    if effect.stage == "orbit":
        return windows.chained(_derivative(effect, theta, elsewhere))
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
        for span in _SPANS:
            known = np.nan_to_num(arcs.wheels_B)
            quick = known - uniform_filter1d(known, span, axis=0, mode="nearest")
            parts += [arcs.flown(vehicle, wheels_B=quick * axis) - arcs.base for axis in axes if np.any(quick * axis)]
        moved = np.any(np.diff(arcs.dipole_B_Am2, axis=0) != 0.0, axis=0)
        parts += [arcs.holding(axis).flown(vehicle) - arcs.base for axis in range(3) if moved[axis]]
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
