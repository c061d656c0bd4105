"""Sun and nadir as sun-sensor heads and a horizon scanner measure them: the record's second channel.

Neither the reported attitude nor the magnetometer enters: true directions in the body, the sensors' own errors, and what
a truth does to a sensor. The reported attitude keeps its own random error, that of a filter over many readings.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from fluxtwin.sim.base.random_streams import stream
from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.earth import epoch
from withheld_cases import spacecraft

if TYPE_CHECKING:
    from withheld_cases.chain import Truth
    from withheld_cases.worlds import World

SHARE = 0.5
"""Of the worlds that point to the Earth: where else would a horizon scanner look?"""


@dataclass(frozen=True)
class AttitudeSensors:
    """Errors of the sensors, each per angle, 1 sigma."""

    sun_noise_rad: float
    sun_lsb_rad: float
    nadir_noise_rad: float
    nadir_wander_rad: float
    """Radiance of the horizon: correlated over `nadir_tau_s`."""
    nadir_tau_s: float
    nadir_lsb_rad: float


def draw_sensors(key: int) -> AttitudeSensors:
    """From a stream of their own, so that no other draw of the world is moved."""
    rng = stream(key, "attitude sensors")

    def size(low_deg: float, high_deg: float) -> float:
        return float(np.radians(np.exp(rng.uniform(np.log(low_deg), np.log(high_deg)))))

    return AttitudeSensors(
        sun_noise_rad=size(0.01, 0.1),
        sun_lsb_rad=size(0.02, 0.5),
        nadir_noise_rad=size(0.02, 0.15),
        nadir_wander_rad=size(0.01, 0.1),
        nadir_tau_s=float(rng.uniform(5.0, 600.0)),
        nadir_lsb_rad=size(0.005, 0.1),
    )


def fitted(key: int, regime: str) -> AttitudeSensors | None:
    """What a world has, if its record has these vectors at all."""
    has = regime == "nadir" and stream(key, "second channel").random() < SHARE
    return draw_sensors(key) if has else None


def vectors(world: World, truths: Sequence[Truth]) -> tuple[FloatArray, FloatArray]:
    """Measured unit vectors in B to the sun, NaN where no head sees it, and to nadir; (N, 3) each."""
    assert world.sensors is not None
    sensors, time = world.sensors, world.time
    sun_B, heads = clean_sun(world, truths), spacecraft.head_in_use(world, time)
    noise = stream(world.key, "sun sensor").standard_normal((time.size, 2))
    measured = np.full((time.size, 3), np.nan)
    for number, boresight in enumerate(world.craft.heads_B, start=1):
        used = heads == number
        measured[used] = _read(sun_B[used], boresight, sensors.sun_noise_rad * noise[used], sensors.sun_lsb_rad)
    angles = clean_roll_pitch(world, truths)
    rng = stream(world.key, "horizon scanner")
    wander = wandering(epoch.seconds_since(time, world.start), sensors.nadir_tau_s, rng)
    angles = angles + sensors.nadir_wander_rad * wander + sensors.nadir_noise_rad * rng.standard_normal(angles.shape)
    return measured, nadir(sensors.nadir_lsb_rad * np.rint(angles / sensors.nadir_lsb_rad))


def clean_sun(world: World, truths: Sequence[Truth]) -> FloatArray:
    """(N, 3) direction to the sun as the heads would have it without noise and rounding, seen or not."""
    sun_B: FloatArray = world.attitude(world.time).R_BN.apply(world.sun(world.time)[0])
    for truth in truths:
        if truth.sun is not None:
            sun_B = truth.sun(world, world.time, sun_B)
    return sun_B


def clean_roll_pitch(world: World, truths: Sequence[Truth]) -> FloatArray:
    """(N, 2) roll and pitch as the scanner would have them without noise and rounding."""
    r_N_km, _ = world.where(world.time)
    x, y, z = world.attitude(world.time).R_BN.apply(-r_N_km).T
    angles: FloatArray = np.stack([np.arctan2(y, np.hypot(x, z)), np.arctan2(-x, z)], axis=1)
    for truth in truths:
        if truth.nadir is not None:
            angles = angles + truth.nadir(world, world.time)
    return angles


def nadir(angles: FloatArray) -> FloatArray:
    """(N, 3) unit vectors in B from roll and pitch (N, 2): yaw first, then roll, then pitch."""
    roll, pitch = angles.T
    return np.stack([-np.cos(roll) * np.sin(pitch), np.sin(roll), np.cos(roll) * np.cos(pitch)], axis=1)


def _read(sun_B: FloatArray, boresight_B: FloatArray, noise_rad: FloatArray, lsb_rad: float) -> FloatArray:
    """What a two-axis head makes of it: an angle to either side of its boresight, with noise, rounded."""
    across = np.roll(np.abs(boresight_B), 1)  # boresights lie along body axes
    along = np.cross(boresight_B, across)
    ahead = sun_B @ boresight_B
    angles = np.stack([np.arctan2(sun_B @ across, ahead), np.arctan2(sun_B @ along, ahead)], axis=1) + noise_rad
    one, other = np.tan(lsb_rad * np.rint(angles / lsb_rad)).T
    seen = boresight_B + one[:, None] * across + other[:, None] * along
    unit: FloatArray = seen / np.linalg.norm(seen, axis=1)[:, None]
    return unit


def wandering(seconds: FloatArray, tau_s: float, rng: np.random.Generator) -> FloatArray:
    """(N, 2) stationary Gauss-Markov sequences of rms 1 at any stamps."""
    keep = np.exp(-np.diff(seconds) / tau_s)
    fresh = np.sqrt(1.0 - keep**2)
    draws = rng.standard_normal((seconds.size, 2))
    rows = [draws[0]]
    for a, b, draw in zip(keep, fresh, draws[1:], strict=True):
        rows.append(a * rows[-1] + b * draw)
    return np.array(rows)
