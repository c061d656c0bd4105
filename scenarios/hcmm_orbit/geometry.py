"""Where the satellite stands along a trial orbit, on a fixed grid of times about every printed acquisition; which part of a
pass was used, the stretch of time whose sun-nadir angles have the printed range; and the angles in that part."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from fluxtwin.scenarios.flights import Numbers
from fluxtwin.scenarios.hcmm_orbit.record import Pass, Range, read_stations
from fluxtwin.sim.base.types import BoolArray, FloatArray, TimeArray
from fluxtwin.sim.earth import epoch, frames, sun
from fluxtwin.sim.earth.field import FieldModel, field_E_nT
from fluxtwin.sim.earth.orbit import Orbit

EPOCH = np.datetime64("1978-11-30T12:00:00", "ns")
"""Epoch of the fitted elements, near the middle of the record."""
INCLINATION_DEG = 97.6
"""Public figure for HCMM (NORAD 10818, 1978-041A); the record alone gives it to 0.6 deg."""
_FIRST_MIN, _LAST_MIN, _STEP_MIN = -8.0, 22.0, 0.25
_WINDOW_STEP_MIN = 0.1
_SHORTEST_MIN = 1.5
"""The text speaks of passes of 2 to 12 minutes."""
_TURN_DEG = 1.0
"""A printed end this near to a turning point is that point."""
_EQUAL_DEG = 0.05
"""Windows whose misfits differ by less are equal: a tenth of the rounding of print."""
_SAMPLES = 61
"""Times in a window: at most 14 s apart, 0.05 deg of the fastest angle at an extremum."""


def orbit_of(semi_major_axis_km: float, raan_deg: float, u_deg: float, inclination_deg: float) -> Orbit:
    """A circular orbit by its mean elements at EPOCH, true equator and equinox of date."""
    return Orbit(
        epoch_utc=EPOCH,
        altitude_km=semi_major_axis_km - 6378.137,
        inclination_rad=float(np.radians(inclination_deg)),
        raan_rad=float(np.radians(raan_deg)),
        argument_of_latitude_rad=float(np.radians(u_deg)),
    )


def make_grid(passes: Sequence[Pass]) -> Numbers:
    """What does not depend on the orbit, of P passes at G times each: times, sun and stations."""
    minutes = np.arange(_FIRST_MIN, _LAST_MIN + 1e-9, _STEP_MIN)
    time = np.concatenate([epoch.add_seconds(item.aos, 60.0 * minutes) for item in passes])
    stations = read_stations()
    at = [stations[item.station] for item in passes]
    return Numbers(
        passes=tuple(passes),
        # (G,) after the printed acquisition, and (P G,).
        minutes=minutes,
        time=time,
        # (P G, 3) unit vectors to the sun; the parallax of a low orbit, 10 arcsec, is left out.
        sun_N=sun.sun_direction_N(time),
        R_EN=frames.rotation_EN(time),
        # (P G, 3) position of each pass's station, and its vertical.
        site_E_km=np.repeat([station.r_E_km for station in at], minutes.size, axis=0),
        up_E=np.repeat([station.up_E for station in at], minutes.size, axis=0),
    )


def look(grid: Numbers, orbit: Orbit) -> Numbers:
    """Sun-nadir angle and elevation (P, G) along one orbit."""
    r_N_km, _ = orbit.propagate(grid.time)
    line = grid.R_EN.apply(r_N_km) - grid.site_E_km
    elevation = np.arcsin(np.einsum("ij,ij->i", line, grid.up_E) / np.linalg.norm(line, axis=1))
    shape = (len(grid.passes), grid.minutes.size)
    return Numbers(
        sun_nadir_deg=np.degrees(frames.angle_between(-r_N_km, grid.sun_N)).reshape(shape),
        elevation_deg=np.degrees(elevation).reshape(shape),
    )


def rise_and_set_min(grid: Numbers, sky: Numbers) -> tuple[FloatArray, FloatArray]:
    """Minutes after the printed acquisition at which each pass begins and ends, (P,) each, elevation 0.

    The pass taken is the one whose culmination lies nearest 5 min after the acquisition. A pass that stays below the
    horizon begins and ends at its culmination.
    """
    height, minutes = sky.elevation_deg, grid.minutes
    tops = np.zeros(height.shape, dtype=bool)
    tops[:, 1:-1] = (height[:, 1:-1] >= height[:, :-2]) & (height[:, 1:-1] > height[:, 2:])
    none = ~tops.any(axis=1)
    tops[none, np.argmax(height[none], axis=1)] = True
    top = np.argmin(np.where(tops, np.abs(minutes - 5.0), np.inf), axis=1)
    return _crossing(minutes, height, top, -1), _crossing(minutes, height, top, 1)


def _crossing(minutes: FloatArray, height: FloatArray, top: np.ndarray, step: int) -> FloatArray:
    """(P,) where each series (P, G), from its top on in the direction of `step`, first falls through zero; the top itself
    if it is below, the last time if none is."""
    number, row = np.arange(minutes.size)[::step], np.arange(top.size)
    below = (height[:, ::step] < 0.0) & (step * (number - top[:, None]) >= 0)
    outer = number[np.argmax(below, axis=1)]
    falls = below.any(axis=1)
    inner = np.where(falls & (outer != top), outer - step, outer)
    above = height[row, inner]
    part = np.divide(above, above - height[row, outer], out=np.zeros(top.size), where=inner != outer)
    return np.asarray(np.where(falls, minutes[inner] + part * (minutes[outer] - minutes[inner]), minutes[::step][-1]))


@dataclass(frozen=True)
class PassWindows:
    """Minutes after the printed acquisition, (P,) each."""

    start_min: FloatArray
    end_min: FloatArray


def fix_windows(grid: Numbers, sky: Numbers, ranges: Sequence[Range]) -> PassWindows:
    """The window of every pass, from its printed sun-nadir range alone; of equal ones the longest.

    Only times with the spacecraft above the station's horizon count, half a minute of grace at either end. Where the
    angle turns inside the visible arc within a degree of a printed end, that end is taken to be the turning point:
    print is whole degrees, and a night pass whose least angle is 26.4 deg is printed as 26 or 27.
    """
    visible = zip(*(ends.tolist() for ends in rise_and_set_min(grid, sky)), strict=True)
    found = [_window(grid.minutes, *one) for one in zip(sky.sun_nadir_deg, visible, ranges, strict=True)]
    return PassWindows(*np.array(found).T)


def turning_ends(grid: Numbers, sky: Numbers, ranges: Sequence[Range]) -> BoolArray:
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


def _window(minutes: FloatArray, angle: FloatArray, visible: Range, printed: Range) -> Range:
    times, low, high = ranges_of_windows(minutes, angle, visible)
    printed = _with_turning_points(printed, _turning_points(np.interp(times, minutes, angle)))
    length = times[None, :] - times[:, None]
    misfit = np.where(length >= _SHORTEST_MIN, np.abs(low - printed[0]) + np.abs(high - printed[1]), np.inf)
    least = float(np.nanmin(misfit))
    first, last = np.unravel_index(int(np.argmax(np.where(misfit <= least + _EQUAL_DEG, length, -1.0))), misfit.shape)
    return float(times[first]), float(times[last])


def ranges_of_windows(
    minutes: FloatArray, angle: FloatArray, visible: Range
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Times (T,) from half a minute before rise to half a minute after set, and `parts_of` the angle there."""
    times = np.arange(visible[0] - 0.5, visible[1] + 0.5 + 1e-9, _WINDOW_STEP_MIN)
    return times, *parts_of(np.interp(times, minutes, angle))


def parts_of(values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Lowest and highest (T, T) of the part of a series (T,) from i to j; NaN where it would end before it starts."""
    spread = np.where(np.triu(np.ones((values.size, values.size), dtype=bool)), values[None, :], np.nan)
    return np.fmin.accumulate(spread, axis=1), np.fmax.accumulate(spread, axis=1)


def _with_turning_points(printed: Range, turning: FloatArray) -> Range:
    """The printed range with each end replaced by a turning point of the angle that it may well be."""
    low, high = printed
    for value in turning:
        if abs(value - low) < _TURN_DEG:
            low = float(value)
        elif abs(value - high) < _TURN_DEG:
            high = float(value)
    return low, high


def ends_of(values: FloatArray) -> FloatArray:
    """(P, 2) lowest and highest of values (P, M)."""
    return np.stack([values.min(axis=1), values.max(axis=1)], axis=1)


def track_of(
    passes: Sequence[Pass], windows: PassWindows, orbit: Orbit, count: int
) -> tuple[FloatArray, TimeArray, FloatArray]:
    """Minutes (P, count) in the windows, and times (P count,) and positions r_N_km (P count, 3) there."""
    minutes = np.linspace(windows.start_min, windows.end_min, count, axis=1)
    time = np.concatenate([epoch.add_seconds(p.aos, 60.0 * row) for p, row in zip(passes, minutes, strict=True)])
    return minutes, time, orbit.propagate(time)[0]


def angles_along(
    passes: Sequence[Pass], windows: PassWindows, orbit: Orbit, model: FieldModel, *, turned_east_deg: float = 0.0
) -> Numbers:
    """What orbit, sun and model give along each pass's window, (P, M).

    turned_east_deg: the whole field is turned about the Earth's axis by this.
    """
    minutes, time, r_N_km = track_of(passes, windows, orbit, _SAMPLES)
    R_EN = frames.rotation_EN(time)
    r_E_km = R_EN.apply(r_N_km)
    turn = Rotation.from_euler("z", turned_east_deg, degrees=True)
    field_N = R_EN.inv().apply(turn.apply(field_E_nT(model, time, turn.inv().apply(r_E_km))))
    latitude, longitude, _ = frames.geocentric(r_E_km)
    sun_N = sun.sun_direction_N(time, r_N_km)
    found = {
        "sun_field_deg": frames.angle_between(sun_N, field_N),
        "nadir_field_deg": frames.angle_between(-r_N_km, field_N),
        "latitude_deg": latitude,
        "longitude_deg": longitude,
    }
    # Minutes after the printed acquisition; the latitude is geocentric.
    return Numbers(minutes=minutes, **{name: np.degrees(one).reshape(minutes.shape) for name, one in found.items()})
