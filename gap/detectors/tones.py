"""One line of any frequency in a three-axis series, evenly sampled or not."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import stats
from scipy.special import gammaln

from fluxtwin.gap.linear.leftover import Leftover, log10_sf_f
from fluxtwin.sim.base.types import FloatArray

_FINE = 8  # grid cells a sample spacing for uneven stamps: the phase error at the highest line is 0.2 rad at most
_LONGEST = 1 << 23
TONE_DEGREES = 6
_FIRST_WIDTH = 0.35  # over the span


@dataclass(frozen=True)
class Tone:
    """The strongest line."""

    frequency_Hz: float
    log10_p: float
    """Corrected for the number of frequencies."""
    explained: float
    """Energy that it carries, in noise units."""


def strongest_tone(seconds: FloatArray, left: Leftover) -> Tone:
    """Search the whitened residual for a line.

    The sum of the three axes' periodograms is chi-squared with six degrees of freedom at each frequency; the
    largest over all of them follows the upcrossing rate of such a process (Baluev 2008, MNRAS 385, 1279, eq. 6,
    written for six). The winner is fitted as columns, calibration projected out, before it is judged.
    """
    frequency = _peak(seconds, left.residual.reshape(-1, 3))
    if frequency is None:
        return Tone(0.0, 0.0, 0.0)
    return tone_near(seconds, left, frequency)


def tone_near(seconds: FloatArray, left: Leftover, frequency: float) -> Tone:
    """The strongest line within a third of a cycle over the record of a frequency in Hz."""
    width = _FIRST_WIDTH / float(seconds[-1] - seconds[0])
    for steps in (3, 1, 1):
        tried = frequency + width * np.arange(-steps, steps + 1) / steps
        found = [_explained(seconds, left, f) for f in tried]
        place = int(np.argmax([energy for energy, _ in found]))
        frequency, width = _top(tried, [energy for energy, _ in found], place), 0.3 * width
    explained, rank = _explained(seconds, left, frequency)
    if not rank or left.degrees < rank + 10:
        return Tone(frequency, 0.0, 0.0)
    spare = left.degrees - rank
    ratio = (explained / rank) / max((left.energy - explained) / spare, 1e-300)
    span = float(seconds[-1] - seconds[0])
    spacing = float(np.median(np.diff(seconds)))
    return Tone(frequency, _log10_p(ratio, rank, spare, span / (2 * spacing)), explained)


def tone_columns(seconds: FloatArray, frequency_Hz: float) -> FloatArray:
    """(N, 3, 6) cosine and sine in each axis: columns x cos, y cos, z cos, x sin, y sin, z sin."""
    phase = 2 * np.pi * frequency_Hz * seconds
    waves = np.stack([np.cos(phase), np.sin(phase)], axis=1)
    return np.asarray((np.eye(3)[None, :, None, :] * waves[:, None, :, None]).reshape(seconds.size, 3, 6))


def _peak(seconds: FloatArray, series: FloatArray) -> float | None:
    steps = np.diff(seconds)
    span = float(seconds[-1] - seconds[0])
    if steps.size < 20 or span <= 0:
        return None
    spacing = float(np.median(steps))
    even = bool(np.all(np.abs(steps / spacing - np.rint(steps / spacing)) < 0.02))
    cell = spacing if even else spacing / _FINE
    cells = int(np.ceil(span / cell)) + 1
    length = 1 << int(np.ceil(np.log2(2 * cells)))
    if length > _LONGEST:
        return None
    grid = np.zeros((length, 3))
    np.add.at(grid, np.rint((seconds - seconds[0]) / cell).astype(int), series)
    power = np.sum(np.abs(np.fft.rfft(grid, axis=0)) ** 2, axis=1)
    frequencies = np.fft.rfftfreq(length, cell)
    allowed = (frequencies > 1.5 / span) & (frequencies <= 0.5 / spacing)
    if not allowed.any():
        return None
    return float(frequencies[allowed][np.argmax(power[allowed])])


def _top(frequencies: FloatArray, energies: list[float], place: int) -> float:
    """The top of the parabola through the best of some frequencies and its neighbours."""
    if not 0 < place < len(energies) - 1:
        return float(frequencies[place])
    low, middle, high = energies[place - 1 : place + 2]
    bend = low + high - 2.0 * middle
    move = 0.5 * (low - high) / bend if bend < 0 else 0.0
    return float(frequencies[place] + move * (frequencies[1] - frequencies[0]))


def _explained(seconds: FloatArray, left: Leftover, frequency: float) -> tuple[float, int]:
    free, size = left.project(tone_columns(seconds, frequency))
    value, vector = np.linalg.eigh(free.T @ free)
    live = value > 1e-6 * size.max()
    projected = vector[:, live].T @ (free.T @ left.residual)
    return float(np.sum(projected**2 / value[live])), int(live.sum())


def _log10_p(ratio: float, rank: int, spare: int, cycles: float) -> float:
    """p of the largest of a chi-squared process: as for one frequency, times the expected number of upcrossings."""
    single = log10_sf_f(ratio, rank, spare)
    half = 0.5 * float(stats.chi2.isf(10**single, rank)) if single > -280 else -single * np.log(10)
    width = cycles * np.sqrt(np.pi / 3)
    log_crossings = np.log(width) + 0.5 * (rank - 1) * np.log(max(half, 1e-9)) - half - gammaln(rank / 2)
    crossings = log_crossings / np.log(10)
    return float(min(0.0, np.logaddexp(single * np.log(10), crossings * np.log(10)) / np.log(10)))
