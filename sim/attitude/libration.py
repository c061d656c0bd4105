"""Libration: a band-limited wander of yaw, roll and pitch about the pointing direction.

Each angle is a constant plus a sum of sinusoids whose periods lie inside a given band and whose phases are
random. The lines are drawn once, into a frozen record; after that the motion is a smooth function of time
that can be evaluated, with its exact derivative, at any stamps.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fluxtwin.sim.base.types import FloatArray, TimeArray
from fluxtwin.sim.earth import epoch as clock

_LINES = 8  # enough that no single line dominates, few enough to stay cheap at 1e6 stamps


@dataclass(frozen=True)
class Libration:
    """The lines of the three angles, in the order yaw, roll, pitch; K lines each."""

    amplitude_rad: FloatArray
    """(3, K) amplitude of each line."""
    frequency_rad_s: FloatArray
    """(3, K) angular frequency."""
    phase_rad: FloatArray
    """(3, K) phase of the sine at 2000-01-01 0 h."""
    offsets_rad: FloatArray
    """(3,) constant part."""

    def angles(self, time: TimeArray) -> FloatArray:
        """(N, 3) yaw, roll, pitch in rad."""
        return self._sum(time, np.sin, self.amplitude_rad) + self.offsets_rad

    def rates(self, time: TimeArray) -> FloatArray:
        """(N, 3) derivatives of yaw, roll, pitch in rad/s: exact, not differenced."""
        return self._sum(time, np.cos, self.amplitude_rad * self.frequency_rad_s)

    def _sum(self, time: TimeArray, wave: np.ufunc, amplitude: FloatArray) -> FloatArray:
        seconds = clock.seconds_since(time, clock.MJD2000)
        total = np.zeros((seconds.size, 3))
        for angle in range(3):  # line by line: an (N, 3, K) array would not fit for long records
            for a, w, p in zip(amplitude[angle], self.frequency_rad_s[angle], self.phase_rad[angle], strict=True):
                if a != 0.0:
                    total[:, angle] += a * wave(w * seconds + p)
        return total


def draw_libration(
    amplitudes_rad: tuple[float, float, float],
    shortest_period_s: float,
    longest_period_s: float,
    rng: np.random.Generator,
    *,
    offsets_rad: tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> Libration:
    """A libration of yaw, roll, pitch with the given amplitudes and periods inside the band.

    The amplitude of an angle is sqrt 2 times its rms about the offset over a long time, as for one sinusoid;
    it is shared equally (in power) by eight lines, one at random in each eighth of the band's logarithm, so
    the largest excursion is under sqrt 8 amplitudes. A band of one period holds one line. All draws are made
    even for zero amplitudes: switching one angle off moves no other. Phases count from 2000, the same for every run.
    """
    amplitude = np.asarray(amplitudes_rad, dtype=np.float64)
    lines = 1 if shortest_period_s == longest_period_s else _LINES
    place = (np.arange(lines) + rng.random((3, lines))) / lines
    phase = 2.0 * np.pi * rng.random((3, lines))
    period = longest_period_s * (shortest_period_s / longest_period_s) ** place
    return Libration(
        amplitude_rad=np.repeat(amplitude[:, None], lines, axis=1) / np.sqrt(lines),
        frequency_rad_s=2.0 * np.pi / period,
        phase_rad=phase,
        offsets_rad=np.asarray(offsets_rad, dtype=np.float64),
    )
