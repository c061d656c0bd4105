"""Rate gyro: body rate with bias, bias random walk and noise."""

from __future__ import annotations

import numpy as np

from fluxtwin.sim.base.section_types import ZERO3, NonNegative, Vector3
from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.earth import epoch
from fluxtwin.sim.spacecraft.sensors.base import SensorSection, Surroundings


class GyroSection(SensorSection):
    """A three-axis rate gyro (Farrenkopf's error model, with the noise given per reading)."""

    bias_deg_h: Vector3 = ZERO3
    """At the first stamp, body axes."""
    noise_deg_s: NonNegative = 0.0
    """White noise of a single reading, 1 sigma per axis."""
    random_walk_deg_h_per_sqrt_h: NonNegative = 0.0
    """Growth of the bias: after t hours its change has the standard deviation this times sqrt t."""

    def measure(self, around: Surroundings, rng: np.random.Generator) -> dict[str, FloatArray]:
        """rate_B_rad_s (N, 3); stamps may be uneven."""
        rate = around.rate_B_rad_s
        walk_rad_s_per_sqrt_s = float(np.radians(self.random_walk_deg_h_per_sqrt_h) / 3600.0 / 60.0)
        step = np.diff(epoch.seconds_since(around.time, around.time[0]), prepend=0.0)
        noise = float(np.radians(self.noise_deg_s)) * rng.standard_normal(rate.shape)
        change = walk_rad_s_per_sqrt_s * np.sqrt(step)[:, None] * rng.standard_normal(rate.shape)
        bias = np.radians(self.bias_deg_h) / 3600.0
        return {"rate_B_rad_s": rate + bias + np.cumsum(change, axis=0) + noise}
