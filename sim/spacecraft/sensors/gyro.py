"""Rate gyro: body rate with bias, bias random walk and noise."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fluxtwin.sim.base.errors import BadInput
from fluxtwin.sim.base.section_types import ZERO3, NonNegative, Vector3
from fluxtwin.sim.base.types import FloatArray, TimeArray
from fluxtwin.sim.earth import epoch as clock
from fluxtwin.sim.spacecraft.sensors.base import SensorSection, Surroundings


@dataclass(frozen=True)
class Gyro:
    """A three-axis rate gyro (Farrenkopf's error model, with the noise given per reading)."""

    bias_rad_s: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Bias at the first stamp, body axes."""
    noise_rad_s: float = 0.0
    """White noise of a single reading, 1 sigma per axis."""
    random_walk_rad_s_per_sqrt_s: float = 0.0
    """Growth of the bias: after t seconds its change has the standard deviation this times sqrt t."""

    def __post_init__(self) -> None:
        if not (self.noise_rad_s >= 0 and self.random_walk_rad_s_per_sqrt_s >= 0):
            raise BadInput(f"{self}", where="gyro", wanted="noise and random walk >= 0")

    def measure(self, time: TimeArray, rate_B_rad_s: FloatArray, rng: np.random.Generator) -> FloatArray:
        """Measured rates (N, 3) in rad/s from the true ones (N, 3); stamps may be uneven."""
        rate = np.atleast_2d(np.asarray(rate_B_rad_s, dtype=np.float64))
        stamps = clock.as_times(time)
        step = np.diff(clock.seconds_since(stamps, stamps[0]), prepend=0.0)
        noise = self.noise_rad_s * rng.standard_normal(rate.shape)
        change = self.random_walk_rad_s_per_sqrt_s * np.sqrt(step)[:, None] * rng.standard_normal(rate.shape)
        measured: FloatArray = rate + self.bias_rad_s + np.cumsum(change, axis=0) + noise
        return measured


class GyroSection(SensorSection):
    """Body rate with a constant bias, white noise and a bias that wanders."""

    bias_deg_h: Vector3 = ZERO3
    noise_deg_s: NonNegative = 0.0
    random_walk_deg_h_per_sqrt_h: NonNegative = 0.0

    def measure(self, around: Surroundings, rng: np.random.Generator) -> dict[str, FloatArray]:
        """rate_B_rad_s (N, 3)."""
        x, y, z = (float(np.radians(rate) / 3600.0) for rate in self.bias_deg_h)
        gyro = Gyro(
            bias_rad_s=(x, y, z),
            noise_rad_s=float(np.radians(self.noise_deg_s)),
            random_walk_rad_s_per_sqrt_s=float(np.radians(self.random_walk_deg_h_per_sqrt_h) / 3600.0 / 60.0),
        )
        return {"rate_B_rad_s": gyro.measure(around.time, around.rate_B_rad_s, rng)}
