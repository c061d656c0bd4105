"""Forward models of the sensor and telemetry stages."""

from __future__ import annotations

import dataclasses
from functools import lru_cache
from itertools import combinations_with_replacement

import numpy as np

from fluxtwin.sim.base.random_streams import stream
from fluxtwin.sim.base.types import FloatArray, TimeArray
from fluxtwin.sim.earth import epoch
from withheld_cases import spacecraft
from withheld_cases.chain import Ambient, Truth, ambient, noise_free
from withheld_cases.draft import Draft, direction, followed, listed, share
from withheld_cases.visible import noise_rms_nT
from withheld_cases.worlds import World, shift

_REFERENCE_DEGC = 10.0
_REFERENCE_NT = 5e4


def _plain_b(world: World, time: TimeArray, b_nT: FloatArray) -> tuple[FloatArray, FloatArray]:
    return np.zeros((time.size, 3, 3)), b_nT


def bias(world: World, rng: np.random.Generator) -> Draft:
    """b of equation 1, in a world where it is asked for and not re-estimated."""
    world = dataclasses.replace(world, b_nT=np.zeros(3), modelled=("scale_misalignment",))
    b = direction(rng)

    def at(size: float) -> Truth:
        return Truth(
            "bias",
            "sensor",
            {"b_nT": listed(size * b)},
            correction=lambda w, t: _plain_b(w, t, np.tile(size * b, (t.size, 1))),
        )

    return Draft(world, at, 3.0, 20000.0, 100.0)


def scale_misalignment(world: World, rng: np.random.Generator) -> Draft:
    """S of equation 1, in a world where it is asked for and not re-estimated."""
    world = dataclasses.replace(world, S=np.zeros((3, 3)), modelled=("bias",))
    shape = direction(rng, 9).reshape(3, 3)
    kind = str(rng.choice(["all", "scale", "turn"]))
    if kind == "scale":
        shape = np.diag(direction(rng))
    if kind == "turn":
        x, y, z = direction(rng)
        shape = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])

    def at(size: float) -> Truth:
        return Truth(
            "scale_misalignment",
            "sensor",
            {"S": listed(size * shape), "kind": kind},
            correction=lambda w, t: (np.tile(size * shape, (t.size, 1, 1)), np.zeros((t.size, 3))),
        )

    return Draft(world, at, 1e-5, 0.1, 2e-3)


def thermal_bias_drift(world: World, rng: np.random.Generator) -> Draft | None:
    """Equation 1's b follows the temperature."""
    if not 0.15 < share(world.sun(world.time)[1] > 0.5) < 0.93:
        return None
    slope = direction(rng)

    def at(size: float) -> Truth:
        def correction(w: World, time: TimeArray) -> tuple[FloatArray, FloatArray]:
            warmer = spacecraft.temperature_degC(w, time) - _REFERENCE_DEGC
            return _plain_b(w, time, np.outer(warmer, size * slope))

        parameters = {"slope_nT_per_K": listed(size * slope), "tau_s": world.craft.temperature_tau_s}
        return Truth("thermal_bias_drift", "sensor", parameters, correction=correction)

    return Draft(world, at, 0.05, 300.0, 5.0)


def thermal_scale_drift(world: World, rng: np.random.Generator) -> Draft | None:
    """The diagonal of equation 1's S follows the temperature."""
    if not 0.15 < share(world.sun(world.time)[1] > 0.5) < 0.93:
        return None
    slope = direction(rng)

    def at(size: float) -> Truth:
        def correction(w: World, time: TimeArray) -> tuple[FloatArray, FloatArray]:
            warmer = spacecraft.temperature_degC(w, time) - _REFERENCE_DEGC
            return warmer[:, None, None] * np.diag(size * slope), np.zeros((time.size, 3))

        parameters = {"slope_per_K": listed(size * slope), "tau_s": world.craft.temperature_tau_s}
        return Truth("thermal_scale_drift", "sensor", parameters, correction=correction)

    return Draft(world, at, 1e-6, 0.01, 2e-4)


def bias_step(world: World, rng: np.random.Generator) -> Draft:
    """Equation 1's b jumps once."""
    jump, share_of_span = direction(rng), float(rng.uniform(0.2, 0.8))
    instant = shift(world.time[:1], share_of_span * world.span_s)[0]

    def at(size: float) -> Truth:
        return Truth(
            "bias_step",
            "sensor",
            {"at": str(instant), "jump_nT": listed(size * jump)},
            correction=lambda w, t: _plain_b(w, t, np.outer(t >= instant, size * jump)),
        )

    return Draft(world, at, 2.0, 5000.0, 100.0)


@lru_cache(maxsize=8)
def _walk(world: World) -> FloatArray:
    """(N, 3) Brownian paths of 1 nT/sqrt(s) at the stamps, from zero."""
    seconds = epoch.seconds_since(world.time, world.start)
    steps = np.sqrt(np.diff(seconds, prepend=0.0))[:, None] * stream(world.key, "walk").standard_normal(
        (len(seconds), 3)
    )
    return np.cumsum(steps, axis=0)


def bias_random_walk(world: World, rng: np.random.Generator) -> Draft:
    """Equation 1's b wanders."""

    def at(size: float) -> Truth:
        def correction(w: World, time: TimeArray) -> tuple[FloatArray, FloatArray]:
            seconds, now = epoch.seconds_since(w.time, w.start), epoch.seconds_since(time, w.start)
            path = np.stack([np.interp(now, seconds, _walk(w)[:, k]) for k in range(3)], axis=1)
            return _plain_b(w, time, size * path)

        return Truth("bias_random_walk", "sensor", {"rate_nT_per_sqrt_s": size}, correction=correction)

    return Draft(world, at, 0.01, 200.0, 3.0)


def products(reading_nT: FloatArray, order: int) -> FloatArray:
    """(N, K) products of two (6) or three (10) components over their value at 50,000 nT."""
    x = reading_nT / _REFERENCE_NT
    columns = [np.prod(x[:, list(which)], axis=1) for which in combinations_with_replacement(range(3), order)]
    return np.stack(columns, axis=1)


def _nonlinearity(name: str, order: int, world: World, rng: np.random.Generator) -> Draft:
    count = {2: 6, 3: 10}[order]
    c = rng.standard_normal((3, count))
    kind = str(rng.choice(["all", "own", "one"]))
    own = [list(combinations_with_replacement(range(3), order)).index((k,) * order) for k in range(3)]
    if kind == "own":  # each axis bends by itself
        keep = np.zeros_like(c)
        keep[range(3), own] = c[range(3), own]
        c = keep
    if kind == "one":
        axis = int(rng.integers(0, 3))
        c[[k for k in range(3) if k != axis]] = 0.0
    c = c / np.sqrt(np.mean(c**2))

    def at(size: float) -> Truth:
        return Truth(
            name,
            "sensor",
            {"c_nT": listed(size * c), "kind": kind},
            sense=lambda w, t, m, perfect: m + products(m, order) @ (size * c).T,
        )

    return Draft(world, at, 1.0, 8000.0, 300.0)


def quadratic_nonlinearity(world: World, rng: np.random.Generator) -> Draft:
    """The reading gains products of two components."""
    return _nonlinearity("quadratic_nonlinearity", 2, world, rng)


def cubic_nonlinearity(world: World, rng: np.random.Generator) -> Draft:
    """The reading gains products of three components."""
    return _nonlinearity("cubic_nonlinearity", 3, world, rng)


@lru_cache(maxsize=8)
def history(world: World) -> tuple[FloatArray, FloatArray] | None:
    """Seconds and field in body axes on a grid fine enough to see every turn; None where that would be too long."""
    step = min(world.turn_period_s() / 60.0, 15.0, max(world.step_s, 0.5))
    seconds = np.arange(-min(6000.0, 3.0 * max(world.turn_period_s(), 600.0)), world.span_s + 60.0, step)
    if seconds.size > 90000:
        return None
    return seconds, ambient(world, (), epoch.add_seconds(world.start, seconds))


@lru_cache(maxsize=8)
def stop_state(world: World, width_nT: float) -> tuple[FloatArray, FloatArray]:
    """Seconds and state -1..1 of a stop of that half-width on each axis: it follows the field until it slips."""
    grown = history(world)
    assert grown is not None
    seconds, x = grown
    held = np.empty_like(x)
    spot = x[0].copy()
    for row in range(len(x)):
        spot = np.minimum(np.maximum(spot, x[row] - width_nT), x[row] + width_nT)
        held[row] = spot
    return seconds, (x - held) / width_nT


def hysteresis(world: World, rng: np.random.Generator) -> Draft | None:
    """Remanence that follows the field until it saturates, and keeps the memory of the last turn."""
    grown = history(world)
    if grown is None:
        return None
    swing = float(np.min(np.ptp(grown[1], axis=0)))
    width = round(float(rng.uniform(0.05, 0.25)) * swing, 1)
    if width < 500.0:
        return None
    axis = direction(rng)

    def at(size: float) -> Truth:
        def sense(w: World, time: TimeArray, m: FloatArray, perfect: Ambient) -> FloatArray:
            seconds, z = stop_state(w, width)
            now = epoch.seconds_since(time, w.start)
            state = np.stack([np.interp(now, seconds, z[:, k]) for k in range(3)], axis=1)
            return m + size * axis * state

        return Truth("hysteresis", "sensor", {"h_nT": listed(size * axis), "half_width_nT": width}, sense=sense)

    return Draft(world, at, 2.0, 5000.0, 100.0)


def saturation(world: World, rng: np.random.Generator) -> Draft:
    """Readings beyond a level stay there."""
    top = float(np.abs(noise_free(world, ()).reading_nT).max())

    def at(size: float) -> Truth:
        level = top - size
        return Truth(
            "saturation",
            "sensor",
            {"depth_nT": size, "level_nT": level},
            hidden={"clip_nT": level},
            sense=lambda w, t, m, perfect: np.clip(m, -level, level),
        )

    return Draft(world, at, 50.0, 0.6 * top, 1500.0)


def sensor_lag(world: World, rng: np.random.Generator) -> Draft:
    """A first-order low-pass."""

    def at(size: float) -> Truth:
        return Truth("sensor_lag", "sensor", {"tau_s": size}, lag_s=size)

    most = min(30.0, world.turn_period_s() / 24.0)
    return Draft(followed(world), at, 1e-4, most, min(3.0, 0.2 * most))


def excess_noise(world: World, rng: np.random.Generator) -> Draft:
    """White noise beyond the declared, on all axes or on one."""
    axis = str(rng.choice(["all", "all", "x", "y", "z"]))
    on = np.array([axis in ("all", k) for k in "xyz"], dtype=np.float64)

    def at(size: float) -> Truth:
        return Truth(
            "excess_noise",
            "sensor",
            {"noise_nT": size, "axis": axis},
            signal=False,
            noise=lambda w, rng: size * on * rng.standard_normal((w.time.size, 3)),
        )

    def measure(w: World, truth: Truth) -> float:
        return float(truth.parameters["noise_nT"] * np.sqrt(on.mean()) / noise_rms_nT(w))

    return Draft(world, at, 1.0, 2000.0, 100.0, measure)


def coarse_quantization(world: World, rng: np.random.Generator) -> Draft:
    """The readings' step is larger than declared: as if low bits were lost, or by any ratio."""
    lsb = world.budget.lsb_nT
    whole = bool(rng.random() < 0.6)

    def at(size: float) -> Truth:
        step = lsb * (max(2, round(size)) if whole else size)
        return Truth("coarse_quantization", "sensor", {"lsb_nT": step, "declared_nT": lsb}, lsb_nT=step, signal=False)

    def measure(w: World, truth: Truth) -> float:
        more = (truth.parameters["lsb_nT"] ** 2 - lsb**2) / 12.0
        return float(np.sqrt(more) / noise_rms_nT(w))

    return Draft(world, at, 1.3, 100.0, 3.0, measure)


def bit_errors(world: World, rng: np.random.Generator) -> Draft | None:
    """One bit of single readings is flipped (or found stuck), at random."""
    stuck = None if rng.random() < 0.7 else int(rng.integers(0, 2))
    noise = noise_rms_nT(world)
    lowest = int(np.ceil(np.log2(4.0 * noise / world.budget.lsb_nT)))
    bit = lowest + int(rng.integers(0, 4))
    if 2**bit * world.budget.lsb_nT > 30000.0:
        return None

    def at(size: float) -> Truth:
        def codes(w: World, rng: np.random.Generator, reading: FloatArray, lsb_nT: float) -> FloatArray:
            return with_bad_bits(rng, reading, lsb_nT, size, bit, stuck)

        return Truth(
            "bit_errors", "telemetry", {"rate": size, "bit": bit, "stuck_at": stuck}, codes=codes, signal=False
        )

    def measure(w: World, truth: Truth) -> float:
        # Expected, and none below four errors: fewer are no effect that a record could show.
        effective = truth.parameters["rate"] * (1.0 if stuck is None else 0.5)
        if effective * w.time.size * 3 < 6.0:
            return 0.0
        return float(2**bit * w.budget.lsb_nT * np.sqrt(effective) / noise)

    return Draft(world, at, 5e-4, 0.06, 0.02, measure)


def with_bad_bits(
    rng: np.random.Generator, reading_nT: FloatArray, lsb_nT: float, rate: float, bit: int, stuck: int | None
) -> FloatArray:
    """Readings whose offset-binary code has that bit flipped, or set to `stuck`, with that rate per component."""
    code = np.rint(reading_nT / lsb_nT).astype(np.int64) + (1 << 24)
    hit = rng.random(code.shape) < rate
    mask = np.int64(1 << bit)
    bad = code ^ mask if stuck is None else (code | mask if stuck else code & ~mask)
    changed: FloatArray = (np.where(hit, bad, code) - (1 << 24)) * lsb_nT
    return changed
