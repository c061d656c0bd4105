"""Which part of a pass was used: the stretch of time whose sun-nadir angles have the printed range."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fluxtwin.scenarios.hcmm_orbit.geometry import Grid, Sky, rise_and_set_min
from fluxtwin.scenarios.hcmm_orbit.record import Range
from fluxtwin.sim.base.types import BoolArray, FloatArray

_STEP_MIN = 0.1
_SHORTEST_MIN = 1.5
"""The text speaks of passes of 2 to 12 minutes."""
_TURN_DEG = 1.0
"""A printed end this near to a turning point is that point."""
_EQUAL_DEG = 0.05
"""Windows whose misfits differ by less are equal: a tenth of the rounding of print."""


@dataclass(frozen=True)
class PassWindows:
    """Minutes after the printed acquisition, (P,) each."""

    start_min: FloatArray
    end_min: FloatArray
    misfit_deg: FloatArray
    """Distance of both ends of the range from print, summed."""
    turns: FloatArray
    """1 where the angle passes through an extremum inside the visible arc, so that its range may not fix both ends."""


def fix_windows(grid: Grid, sky: Sky, ranges: list[Range]) -> PassWindows:
    """The window of every pass, from its printed sun-nadir range alone; of equal ones the longest.

    Only times with the spacecraft above the station's horizon count, half a minute of grace at either end. Where the
    angle turns inside the visible arc within a degree of a printed end, that end is taken to be the turning point:
    print is whole degrees, and a night pass whose least angle is 26.4 deg is printed as 26 or 27.
    """
    rise, fall = rise_and_set_min(grid, sky)
    found = np.array(
        [
            _window(grid.minutes, sky.sun_nadir_deg[k], (float(rise[k]), float(fall[k])), ranges[k])
            for k in range(len(ranges))
        ]
    )
    return PassWindows(*found.T)


def turning_ends(grid: Grid, sky: Sky, ranges: list[Range]) -> BoolArray:
    """(P, 2) True where a printed end is a turning point of the angle inside the visible arc."""
    rise, fall = rise_and_set_min(grid, sky)
    out = np.zeros((len(ranges), 2), dtype=bool)
    for k, printed in enumerate(ranges):
        inside = (grid.minutes >= rise[k]) & (grid.minutes <= fall[k])
        turning = _turning_points(sky.sun_nadir_deg[k][inside])
        out[k] = [bool((np.abs(turning - end) < _TURN_DEG).any()) for end in printed]
    return out


def _turning_points(values: FloatArray) -> FloatArray:
    return np.asarray(values[1:-1][(values[1:-1] - values[:-2]) * (values[2:] - values[1:-1]) < 0])


def _window(minutes: FloatArray, angle: FloatArray, visible: Range, printed: Range) -> tuple[float, ...]:
    times, low, high = ranges_of_windows(minutes, angle, visible)
    turning = _turning_points(np.interp(times, minutes, angle))
    printed = _with_turning_points(printed, turning)
    length = times[None, :] - times[:, None]
    misfit = np.where(length >= _SHORTEST_MIN, np.abs(low - printed[0]) + np.abs(high - printed[1]), np.inf)
    least = float(np.nanmin(misfit))
    best = np.unravel_index(int(np.argmax(np.where(misfit <= least + _EQUAL_DEG, length, -1.0))), misfit.shape)
    first, last = int(best[0]), int(best[1])
    return float(times[first]), float(times[last]), float(misfit[best]), float(turning.size > 0)


def ranges_of_windows(
    minutes: FloatArray, angle: FloatArray, visible: Range
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Times (T,) from half a minute before rise to half a minute after set, and the lowest and highest angle (T, T) of the
    window from time i to time j; NaN where it would end before it starts."""
    times = np.arange(visible[0] - 0.5, visible[1] + 0.5 + 1e-9, _STEP_MIN)
    values = np.interp(times, minutes, angle)
    spread = np.where(np.triu(np.ones((times.size, times.size), dtype=bool)), values[None, :], np.nan)
    return times, np.fmin.accumulate(spread, axis=1), np.fmax.accumulate(spread, axis=1)


def _with_turning_points(printed: Range, turning: FloatArray) -> Range:
    """The printed range with each end replaced by a turning point of the angle that it may well be."""
    low, high = printed
    for value in turning:
        if abs(value - low) < _TURN_DEG:
            low = float(value)
        elif abs(value - high) < _TURN_DEG:
            high = float(value)
    return low, high
