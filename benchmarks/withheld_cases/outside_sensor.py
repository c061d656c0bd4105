"""Outside the catalogue: what a clock, a sensor and its electronics do. `outside` has the table and says why not."""

from __future__ import annotations

import numpy as np

from fluxtwin.sim.base.types import FloatArray, TimeArray
from fluxtwin.sim.earth import epoch
from withheld_cases import of_place, spacecraft
from withheld_cases.chain import Ambient, Truth
from withheld_cases.draft import Draft, direction, listed, share
from withheld_cases.worlds import World, shift


def counter_resets(world: World, rng: np.random.Generator) -> Draft:
    """The counter behind the stamps is set anew now and then, each time with another error."""
    begins = np.sort(rng.uniform(0.0, world.span_s, int(rng.integers(4, 10))))
    offsets = direction(rng, begins.size + 1)

    def at(size: float) -> Truth:
        def clock(w: World, time: TimeArray) -> FloatArray:
            return size * offsets[np.searchsorted(begins, epoch.seconds_since(time, w.start), side="right")]

        return Truth("counter_resets", "time", {"offsets_s": listed(size * offsets)}, clock=clock)

    most = of_place.latest_s(world)
    return Draft(world, at, 1e-4, most, min(5.0, 0.2 * most))


def delayed_crosstalk(world: World, rng: np.random.Generator) -> Draft:
    """A shield's magnetic after-effect: one axis has in it what another one saw a tenth of a turn ago."""
    into, from_ = rng.permutation(3)[:2]
    late_s = float(rng.uniform(0.08, 0.2)) * min(world.turn_period_s(), 7000.0)

    def at(size: float) -> Truth:
        def sense(w: World, time: TimeArray, m: FloatArray, perfect: Ambient) -> FloatArray:
            more = np.zeros_like(m)
            more[:, into] = size * perfect(shift(time, -late_s))[:, from_]
            return m + more

        parameters = {"share": size, "late_s": late_s, "from": int(from_), "into": int(into)}
        return Truth("delayed_crosstalk", "sensor", parameters, sense=sense)

    return Draft(world, at, 1e-5, 0.3, 5e-3)


def thermal_shear(world: World, rng: np.random.Generator) -> Draft | None:
    """The angle between two axes follows the temperature."""
    if not 0.15 < share(world.sun(world.time)[1] > 0.5) < 0.93:
        return None
    one, other = rng.permutation(3)[:2]
    shear = np.zeros((3, 3))
    shear[one, other] = shear[other, one] = 1.0

    def at(size: float) -> Truth:
        def correction(w: World, time: TimeArray) -> tuple[FloatArray, FloatArray]:
            warmer = spacecraft.temperature_degC(w, time) - 10.0
            return size * warmer[:, None, None] * shear, np.zeros((time.size, 3))

        parameters = {"shear_per_K": size, "axes": [int(one), int(other)]}
        return Truth("thermal_shear", "sensor", parameters, correction=correction)

    return Draft(world, at, 1e-7, 0.01, 1e-4)


def spin_gain(world: World, rng: np.random.Generator) -> Draft | None:
    """The gains follow the square of the body's rate, as those of a sensor that is pulled by it."""

    def square(w: World, time: TimeArray) -> FloatArray:
        return np.sum(w.attitude(time).rate_B_rad_s ** 2, axis=1)

    now = square(world, world.time)
    if now.std() < 0.05 * now.mean():
        return None
    axes, typical = direction(rng), float(now.mean())

    def at(size: float) -> Truth:
        def correction(w: World, time: TimeArray) -> tuple[FloatArray, FloatArray]:
            return (square(w, time) / typical)[:, None, None] * np.diag(size * axes), np.zeros((time.size, 3))

        parameters = {"scale": listed(size * axes), "at_rate_rad_s": float(np.sqrt(typical))}
        return Truth("spin_gain", "sensor", parameters, correction=correction)

    return Draft(world, at, 1e-6, 0.3, 2e-3)


def shocked_amplifier(world: World, rng: np.random.Generator) -> Draft:
    """After each shock the amplifier is overdriven: its gains are off, and come back within some percent of the record."""
    shocks = np.sort(rng.uniform(0.0, 0.95 * world.span_s, int(rng.integers(4, 9))))
    axes, tau_s = direction(rng), float(rng.uniform(0.02, 0.06)) * world.span_s

    def at(size: float) -> Truth:
        def correction(w: World, time: TimeArray) -> tuple[FloatArray, FloatArray]:
            since = epoch.seconds_since(time, w.start)[:, None] - shocks
            left = np.where(since >= 0.0, np.exp(-np.maximum(since, 0.0) / tau_s), 0.0).max(axis=1)
            return left[:, None, None] * np.diag(size * axes), np.zeros((time.size, 3))

        parameters = {"scale": listed(size * axes), "tau_s": tau_s, "shocks": shocks.size}
        return Truth("shocked_amplifier", "sensor", parameters, correction=correction)

    return Draft(world, at, 1e-5, 0.3, 5e-3)


def converter_sawtooth(world: World, rng: np.random.Generator) -> Draft:
    """The coarse steps of the converter do not fit its fine ones: each axis errs by a sawtooth of its own reading."""
    period_nT, phase = float(rng.uniform(3000.0, 9000.0)), rng.random(3)

    def at(size: float) -> Truth:
        def sense(w: World, time: TimeArray, m: FloatArray, perfect: Ambient) -> FloatArray:
            return m + size * (2.0 * np.mod(m / period_nT + phase, 1.0) - 1.0)

        return Truth("converter_sawtooth", "sensor", {"peak_nT": size, "period_nT": period_nT}, sense=sense)

    return Draft(world, at, 2.0, 0.4 * period_nT, 100.0)


def chirping_line(world: World, rng: np.random.Generator) -> Draft | None:
    """A converter's line of 50 to 400 Hz, folded by the sampling; its frequency follows the temperature."""
    if not 0.15 < share(world.sun(world.time)[1] > 0.5) < 0.93:
        return None
    cosine, sine = direction(rng), direction(rng)
    hertz, per_K = float(rng.uniform(50.0, 400.0)), float(rng.uniform(2e-6, 2e-5))
    nodes = np.arange(0.0, world.span_s + 60.0, 5.0)
    warmer = spacecraft.temperature_degC(world, epoch.add_seconds(world.start, nodes)) - 10.0
    ahead_s = np.r_[0.0, np.cumsum(2.5 * per_K * (warmer[1:] + warmer[:-1]))]

    def at(size: float) -> Truth:
        def stray(w: World, time: TimeArray, field: Ambient) -> FloatArray:
            now = epoch.seconds_since(time, w.start)
            phase = 2.0 * np.pi * hertz * (now + np.interp(now, nodes, ahead_s))
            return size * (np.outer(np.cos(phase), cosine) + np.outer(np.sin(phase), sine))

        parameters = {"size_nT": size, "hertz": hertz, "per_K": per_K}
        return Truth("chirping_line", "spacecraft", parameters, stray=stray)

    return Draft(world, at, 1.0, 5000.0, 80.0)
