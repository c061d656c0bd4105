"""Fast spinners without attitude that carry a gauss of their own, of which S and b were never fitted.

Only |B| is in such a record, the spin is folded by the sampling, and the body field is larger than the Earth's. Half of
them spin about one axis for so few minutes that |B| leaves b open; the others nutate, and |B| determines all of it,
though far from where a linear fit without S and b begins. What a record does not determine must not be named; a refusal
in words is a right answer, an exception of another kind never.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from fluxtwin.sim.attitude import record as attitude
from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.earth import epoch
from fluxtwin.sim.telemetry.record import Telemetry
from withheld_cases import chain, spacecraft
from withheld_cases.chain import Truth
from withheld_cases.draft import direction
from withheld_cases.worlds import Motion, World, between, draw_world

GAUSS_NT = 1e5
OPEN_NT = 1000.0
"""From this sigma of its worst direction on, 2 % of the Earth's field, b is not determined."""
_REFERENCE_DEGC = 10.0
_TRIES = 200


def draw(rng: np.random.Generator) -> tuple[World, tuple[Truth, ...], str]:
    """The world, what drifts in it, and a label. The drift is sealed beside the truths, of which there are none.

    Raises RuntimeError if no world in many leaves b open (or, of those that nutate, determines it).
    """
    open_, drifts = bool(rng.random() < 0.5), bool(rng.random() < 0.5)
    label = (
        f"{'b open' if open_ else 'b determined by |B|'}, {'drifting with the temperature' if drifts else 'no drift'}"
    )
    for _ in range(_TRIES):
        world = _spinner(rng, one_axis=open_)
        if (weakest(world)[0] > OPEN_NT) == open_:
            drift = between(rng, 10.0, 200.0) * direction(rng)
            return world, (_drifting(drift),) if drifts else (), label
    raise RuntimeError(f"undetermined ({label}): no world like that")


def _spinner(rng: np.random.Generator, *, one_axis: bool) -> World:
    """A world without attitude; one that spins about one axis is short."""
    world = draw_world(rng, "spin")
    step = round(between(rng, 1.0, 10.0), 1)
    minutes = between(rng, 10.0, 20.0 if one_axis else 60.0)
    time = epoch.add_seconds(world.orbit.epoch_utc, step * np.arange(round(60.0 * minutes / step)))
    axis, turn = rng.standard_normal(3), np.radians(between(rng, 20.0, 100.0))
    inertia = np.array([10.0, 10.0, float(rng.uniform(10.5, 16.0))])
    nutation = np.radians(between(rng, 0.02, 0.3) if one_axis else between(rng, 0.5, 20.0))
    phase, start = float(rng.uniform(0, 2 * np.pi)), np.datetime64(time[0], "ns")
    recorded = world.recorded - {"rate_B_rad_s", "temperature_degC", "dipole_B_Am2"}
    recorded |= {name for name in ("rate_B_rad_s", "temperature_degC") if rng.random() < 0.5}
    return dataclasses.replace(
        world,
        time=time,
        motion=_spinning(inertia, axis, float(turn), float(nutation), phase, start),
        b_nT=GAUSS_NT * float(rng.uniform(1.0, 2.0)) * direction(rng) / np.sqrt(3.0),
        S=float(rng.uniform(0.01, 0.05)) * rng.standard_normal((3, 3)),
        recorded=recorded,
        missing=np.ones(time.size, dtype=bool),
        sensors=None,
    )


def weakest(world: World) -> tuple[float, float]:
    """What |B| leaves of b [nT] and of S, 1 sigma of the worst determined direction of each, all of them free at once.

    Linear in b and in a symmetric S (its turn never shows in |B|), at the truth, with the noise and step of the reading
    as white noise: d|A B0| = u . (db + dS B), u the direction of the field in the body.
    """
    reading = chain.noise_free(world, ()).reading_nT
    ambient = reading @ (np.eye(3) + world.S).T + world.b_nT
    u = ambient / np.linalg.norm(ambient, axis=1)[:, None]
    pairs = [(i, j) for i in range(3) for j in range(i, 3)]
    by_S = [u[:, i] * reading[:, j] + (u[:, j] * reading[:, i] if i != j else 0.0) for i, j in pairs]
    J = np.column_stack([u, np.stack(by_S, axis=1) / GAUSS_NT])
    noise = np.hypot(world.budget.noise_nT, world.budget.lsb_nT / np.sqrt(12.0))
    covariance = noise**2 * np.linalg.pinv(J.T @ J, rcond=1e-14, hermitian=True)
    of_b, of_S = covariance[:3, :3], covariance[3:, 3:] / GAUSS_NT**2
    return float(np.sqrt(np.linalg.eigvalsh(of_b)[-1])), float(np.sqrt(np.linalg.eigvalsh(of_S)[-1]))


def fly(world: World, truths: tuple[Truth, ...]) -> Telemetry:
    """The telemetry, without a column of attitude."""
    return chain.fly(world, truths).replace(q_NB=None)


def _spinning(
    inertia: FloatArray, axis: FloatArray, rate: float, nutation: float, phase: float, start: np.datetime64
) -> Motion:
    return lambda t, r, v: attitude.spin(t, inertia, axis, rate, nutation_rad=nutation, phase_rad=phase, epoch=start)


def _drifting(slope_nT_per_K: FloatArray) -> Truth:
    def correction(world: World, time: np.ndarray) -> tuple[FloatArray, FloatArray]:
        warmer = spacecraft.temperature_degC(world, time) - _REFERENCE_DEGC
        return np.zeros((time.size, 3, 3)), np.outer(warmer, slope_nT_per_K)

    return Truth("thermal_bias_drift", "sensor", {"slope_nT_per_K": slope_nT_per_K.tolist()}, correction=correction)
