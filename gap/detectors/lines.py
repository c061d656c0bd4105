"""One line of any frequency in a three-axis series, evenly sampled or not; and whether it is that of a wheel.

A long record is diagnosed on evenly spaced rows: what is slow is all there. One contiguous stretch at the full rate
then shows the rest, given the fit that was found: fast lines, single wrong readings, and the noise from one reading to the
next. Its noise is chosen anew, with only that fit as design: slow structure counts as noise there.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import stats

from fluxtwin.calib.common.criterion import FALSE_ALARM
from fluxtwin.gap.detectors.finding import Finding, Fitted, does_as_well, drivers, fitted, in_parts, stands_out, varies
from fluxtwin.gap.hypotheses.blocks import BlockFit, in_body
from fluxtwin.gap.linear.projection import ProjectedResidual, projected
from fluxtwin.gap.noise.choice import RobustRows, Whitener, noise_of, whitener_of
from fluxtwin.gap.problem.problem import Problem, pose, realigned
from fluxtwin.gap.selection.criterion import THRESHOLD
from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.effects.chain import Active
from fluxtwin.sim.effects.signal import Setting
from fluxtwin.sim.effects.spacecraft_field import WheelField
from fluxtwin.sim.telemetry.record import Telemetry

MOST_ROWS_FAST = 60_000
"""Of the stretch: its Jacobians, their whitened and orthonormal copies take about a third of a gigabyte, and as much
again where a wheel is named."""
MULTIPLES = (2.0, 3.0, 4.0, 5.0, 6.0, 0.5, 1.0 / 3.0)
"""Of the frequency of a wheel, at which it may have a field too."""


@dataclass(frozen=True)
class Line:
    """The strongest line."""

    frequency_Hz: float
    worth: float
    """By the criterion, with as many frequencies tried as the record has independent ones."""
    explained: float
    """Energy that it carries, in noise units."""


def strongest_line(seconds: FloatArray, left: ProjectedResidual) -> Line:
    """Search the whitened residual for a line: the top of the sum of the three axes' periodograms.

    The winner is fitted as columns, calibration projected out.
    """
    frequency = _peak(seconds, left.residual.reshape(-1, 3))
    return Line(0.0, 0.0, 0.0) if frequency is None else line_near(seconds, left, frequency)


def line_near(seconds: FloatArray, left: ProjectedResidual, frequency: float) -> Line:
    """The strongest line within a third of a cycle over the record of a frequency in Hz."""
    width = 0.35 / float(seconds[-1] - seconds[0])
    for steps in (3, 1, 1):
        tried = frequency + width * np.arange(-steps, steps + 1) / steps
        energies = [fitted(left, line_columns(seconds, f)).energy for f in tried]
        frequency, width = _top(tried, energies, int(np.argmax(energies))), 0.3 * width
    found = fitted(left, line_columns(seconds, frequency))
    return Line(frequency, found.worth(float(np.log(independent_frequencies(seconds)))), found.energy)


def independent_frequencies(seconds: FloatArray) -> float:
    """How many independent frequencies a record has."""
    return max(float(seconds[-1] - seconds[0]) / (2.0 * float(np.median(np.diff(seconds)))), 1.0)


def line_columns(seconds: FloatArray, frequency_Hz: float) -> FloatArray:
    """(N, 3, 6) cosine and sine in each axis: columns x cos, y cos, z cos, x sin, y sin, z sin."""
    return _waves(2 * np.pi * frequency_Hz * seconds)


def _waves(phase_rad: FloatArray) -> FloatArray:
    return in_body(np.stack([np.cos(phase_rad), np.sin(phase_rad)], axis=1))


def _peak(seconds: FloatArray, series: FloatArray) -> float | None:
    steps = np.diff(seconds)
    span = float(seconds[-1] - seconds[0])
    if steps.size < 20 or span <= 0:
        return None
    spacing = float(np.median(steps))
    even = bool(np.all(np.abs(steps / spacing - np.rint(steps / spacing)) < 0.02))
    cell = spacing if even else spacing / 8  # the phase error at the highest line is 0.2 rad at most
    cells = int(np.ceil(span / cell)) + 1
    length = 1 << int(np.ceil(np.log2(2 * cells)))
    if length > 1 << 23:  # half a gigabyte
        return None
    grid = np.zeros((length, 3))
    np.add.at(grid, np.rint((seconds - seconds[0]) / cell).astype(int), series)
    power = np.sum(np.abs(np.fft.rfft(grid, axis=0)) ** 2, axis=1)
    frequencies = np.fft.rfftfreq(length, cell)
    allowed = (frequencies > 1.5 / span) & (frequencies <= 0.5 / spacing)
    return float(frequencies[allowed][np.argmax(power[allowed])])


def _top(frequencies: FloatArray, energies: list[float], place: int) -> float:
    """The top of the parabola through the best of some frequencies and its neighbours."""
    if not 0 < place < len(energies) - 1:
        return float(frequencies[place])
    low, middle, high = energies[place - 1 : place + 2]
    bend = low + high - 2.0 * middle
    move = 0.5 * (low - high) / bend if bend < 0 else 0.0
    return float(frequencies[place] + move * (frequencies[1] - frequencies[0]))


def wheel_line(
    setting: Setting, left: ProjectedResidual, line: Line, rivals: Sequence[BlockFit] = ()
) -> Finding | None:
    """Is a line that of a rotating dipole: one frequency, steady, elliptical?

    Its ellipse must be one in body axes: where it changes with the orbit phase, the field or its slope, the line is a
    piece of something that acts on time, place or attitude. rivals: fits of the design's blocks.
    """
    if line.worth <= THRESHOLD:
        return None
    columns = line_columns(setting.seconds, line.frequency_Hz)
    found = fitted(left, columns)
    faults = does_as_well(line.worth, found, rivals)
    if stands_out(left, columns, np.concatenate(in_parts(columns, 3)[1:], axis=2)):
        faults.append("amplitude or phase changes along the record")
    if _linear(found):
        faults.append("it is linearly polarised")
    if _of_the_orbit(setting, line.frequency_Hz):
        faults.append("the record is too short to tell it from what repeats with the orbit")
    faults += varies(left, columns, drivers(setting))
    what = f"a line at {line.frequency_Hz:.6g} Hz" + ("" if faults else ", steady, elliptical")
    effect = WheelField(frequency_Hz=float(line.frequency_Hz))
    return Finding(effect, found.size, found.sigma, line.worth, what, tuple(faults))


def _linear(found: Fitted) -> bool:
    """Whether the vectors of cosine and sine are parallel: their cross product is zero within its error."""
    a, b = found.size[:3], found.size[3:]
    across = np.cross(a, b)
    derivative = np.concatenate([np.cross(np.eye(3), b), np.cross(a, np.eye(3))]).T
    scatter = derivative @ found.covariance @ derivative.T
    distance = float(across @ np.linalg.pinv(scatter, rcond=1e-6) @ across)
    return bool(stats.chi2.sf(distance, 2) > FALSE_ALARM)


def _of_the_orbit(setting: Setting, frequency_Hz: float) -> bool:
    """Whether a line is within what a record resolves of one to four cycles an orbit: the field has two, and so have the
    drivers that may change it."""
    orbits = float(np.ptp(np.unwrap(setting.orbit_phase_rad))) / (2.0 * np.pi)
    cycles = frequency_Hz * float(np.ptp(setting.seconds)) / orbits
    return abs(cycles - float(np.clip(np.rint(cycles), 1.0, 4.0))) < 1.0 / orbits


def multiples(setting: Setting, active: Iterable[Active]) -> FloatArray:
    """(N, 3, k) lines that the wheels among effects may have besides their own: none of them is a second wheel.

    The rotor of a wheel has more poles than two, and its motor and bearings turn in fixed ratios to it.
    """
    phases = [one.phase_rad(setting) for one, _ in active if isinstance(one, WheelField)]
    found = [_waves(ratio * phase) for phase in phases if phase is not None for ratio in MULTIPLES]
    return np.concatenate([np.zeros((setting.seconds.size, 3, 0)), *found], axis=2)


@dataclass(frozen=True, eq=False)
class FullRate:
    """The stretch, given the fit; n rows."""

    problem: Problem
    robust: RobustRows
    whitener: Whitener
    residual_nT: FloatArray
    """(n, 3) less everything that was fitted on the evenly spaced rows."""
    fitted_nT: FloatArray
    """(n, 3, q) its Jacobian."""
    left: ProjectedResidual
    line: Line


def full_rate(
    whole: Telemetry, problem: Problem, modelled: Sequence[Active], chosen: Sequence[Active]
) -> FullRate | None:
    """Look at the middle of a record at its full rate; None where what was found holds for the thinned rows only.

    problem: that of the thinned rows; modelled, chosen: what was fitted there.
    """
    if any(hasattr(effect, "sequence") and effect.sequence for effect, _ in chosen):
        return None
    near = _stretch(whole, problem, modelled, chosen)
    residual = near.residual_of([*modelled, *chosen])
    fitted = near.derivatives([*modelled, *chosen])
    noise, robust = noise_of(near, residual, [fitted])
    whitener = whitener_of(near, noise, robust.weights)
    left = projected(
        whitener, residual, np.concatenate([fitted, multiples(near.setting, [*modelled, *chosen])], axis=2)
    )
    line = strongest_line(near.setting.seconds, left)
    return FullRate(near, robust, whitener, residual, fitted, left, line)


def _stretch(whole: Telemetry, problem: Problem, modelled: Sequence[Active], chosen: Sequence[Active]) -> Problem:
    """The same problem on the middle rows of a record, about the same parameters."""
    first = max((len(whole) - MOST_ROWS_FAST) // 2, 0)
    near = pose(
        whole.select(slice(first, first + MOST_ROWS_FAST)),
        problem.setting.model,
        modelled=(),
        budget=problem.budget,
        instrument=problem.setting.instrument,
        frozen=problem.frozen,
    )
    near = replace(near, modelled=problem.modelled, modelled_theta=tuple(theta for _, theta in modelled))
    return realigned(near, beside=[*modelled, *chosen])
