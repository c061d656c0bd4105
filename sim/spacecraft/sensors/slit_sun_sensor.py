"""A slit sun sensor on a spinning body: when the sun crosses the slit, and how high it stands.

The slit lies in a half plane that holds body z, at an azimuth from body x. Once a spin the sun passes through it; the
sensor gives the time of the crossing and the elevation above the x-y plane. One angle of noise serves both: the time is
late or early by it over the rate of the sun's azimuth (and the cosine of the elevation), the elevation is off by it.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from fluxtwin.sim.base.errors import BadInput
from fluxtwin.sim.base.section_types import NonNegative, Section
from fluxtwin.sim.base.types import FloatArray

_NEWTON_STEPS = 3
_STEP_S = 1e-4


class SlitSunSensor(Section):
    """One slit in a half plane that holds body z; one pulse a spin. A section of a scenario."""

    azimuth_deg: float = 0.0
    """Of the half plane, from body x towards y."""
    noise_deg: NonNegative = 0.0
    """White, 1 sigma, across the slit and along it."""

    def crossings(
        self, seconds: FloatArray, sun_B: Callable[[FloatArray], FloatArray], rng: np.random.Generator
    ) -> tuple[FloatArray, FloatArray]:
        """Times (M,) s and unit vectors (M, 3) to the sun in body axes, as measured.

        seconds: (N,) a grid fine enough that the sun's azimuth turns by less than half a turn a step. sun_B: true unit
        vectors (n, 3) at any seconds (n,). Raises BadInput for a grid that is too coarse.
        """
        azimuth = np.unwrap(self._azimuth(sun_B(seconds)))
        steps = np.diff(azimuth)
        if steps.size == 0 or np.abs(steps).max() > 0.75 * np.pi:
            raise BadInput(
                "the grid of times is too coarse for the spin", where="slit sun sensor", wanted="a finer one"
            )
        turn = np.floor(azimuth / (2.0 * np.pi))
        at = np.flatnonzero(np.diff(turn) != 0)
        level = 2.0 * np.pi * np.maximum(turn[at], turn[at + 1])
        t = seconds[at] + (level - azimuth[at]) / steps[at] * (seconds[at + 1] - seconds[at])
        rate = np.ones_like(t)
        for _ in range(_NEWTON_STEPS):
            here, later = (self._azimuth(sun_B(t + shift)) for shift in (-_STEP_S, _STEP_S))
            rate = np.angle(np.exp(1j * (later - here))) / (2.0 * _STEP_S)
            off = np.angle(np.exp(1j * self._azimuth(sun_B(t))))
            t = t - off / rate
        elevation = np.arcsin(np.clip(sun_B(t)[:, 2], -1.0, 1.0))
        across, along = np.radians(self.noise_deg) * rng.standard_normal((2, t.size))
        t = t + across / (np.cos(elevation) * rate)
        return t, self.direction(elevation + along)

    def direction(self, elevation_rad: FloatArray) -> FloatArray:
        """(M, 3) unit vectors of the slit at elevations (M,)."""
        c = np.cos(elevation_rad)
        x, y = c * np.cos(np.radians(self.azimuth_deg)), c * np.sin(np.radians(self.azimuth_deg))
        return np.stack([x, y, np.sin(elevation_rad)], axis=-1)

    def _azimuth(self, sun_B: FloatArray) -> FloatArray:
        return np.asarray(np.arctan2(sun_B[:, 1], sun_B[:, 0]) - np.radians(self.azimuth_deg))
