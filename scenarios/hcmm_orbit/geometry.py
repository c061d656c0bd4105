"""Sun-nadir angle and elevation along a trial orbit, on a fixed grid of times about every printed acquisition."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from fluxtwin.scenarios.hcmm_orbit.record import Pass, read_stations
from fluxtwin.sim.base.types import FloatArray, TimeArray
from fluxtwin.sim.earth import epoch, frames, sun
from fluxtwin.sim.earth.orbit import Orbit

EPOCH = np.datetime64("1978-11-30T12:00:00", "ns")
"""Epoch of the fitted elements, near the middle of the record."""
INCLINATION_DEG = 97.6
"""Public figure for HCMM (NORAD 10818, 1978-041A); the record alone gives it to 0.6 deg."""
_FIRST_MIN, _LAST_MIN, _STEP_MIN = -8.0, 22.0, 0.25


def orbit_of(semi_major_axis_km: float, raan_deg: float, u_deg: float, inclination_deg: float) -> Orbit:
    """A circular orbit by its mean elements at EPOCH, true equator and equinox of date."""
    return Orbit(
        epoch_utc=EPOCH,
        altitude_km=semi_major_axis_km - 6378.137,
        inclination_rad=float(np.radians(inclination_deg)),
        raan_rad=float(np.radians(raan_deg)),
        argument_of_latitude_rad=float(np.radians(u_deg)),
    )


@dataclass(frozen=True)
class Grid:
    """What does not depend on the orbit: P passes, G times each."""

    passes: tuple[Pass, ...]
    minutes: FloatArray
    """(G,) after the printed acquisition."""
    time: TimeArray
    """(P G,)."""
    sun_N: FloatArray
    """(P G, 3) unit vectors to the sun; the parallax of a low orbit, 10 arcsec, is left out."""
    R_EN: Rotation
    site_E_km: FloatArray
    """(P G, 3) position of each pass's station."""
    up_E: FloatArray

    @property
    def shape(self) -> tuple[int, int]:
        return len(self.passes), self.minutes.size


@dataclass(frozen=True)
class Sky:
    """Along one orbit, (P, G)."""

    sun_nadir_deg: FloatArray
    elevation_deg: FloatArray


def make_grid(passes: Sequence[Pass]) -> Grid:
    """Times, sun and stations for these passes."""
    minutes = np.arange(_FIRST_MIN, _LAST_MIN + 1e-9, _STEP_MIN)
    time = np.concatenate([epoch.add_seconds(item.aos, 60.0 * minutes) for item in passes])
    stations = read_stations()
    at = [stations[item.station] for item in passes]
    return Grid(
        passes=tuple(passes),
        minutes=minutes,
        time=time,
        sun_N=sun.sun_direction_N(time),
        R_EN=frames.rotation_EN(time),
        site_E_km=np.repeat([station.r_E_km for station in at], minutes.size, axis=0),
        up_E=np.repeat([station.up_E for station in at], minutes.size, axis=0),
    )


def look(grid: Grid, orbit: Orbit) -> Sky:
    """Sun-nadir angle and elevation at every time of the grid."""
    r_N_km, _ = orbit.propagate(grid.time)
    line = grid.R_EN.apply(r_N_km) - grid.site_E_km
    elevation = np.arcsin(np.einsum("ij,ij->i", line, grid.up_E) / np.linalg.norm(line, axis=1))
    return Sky(
        sun_nadir_deg=np.degrees(angle_between(-r_N_km, grid.sun_N)).reshape(grid.shape),
        elevation_deg=np.degrees(elevation).reshape(grid.shape),
    )


def angle_between(a: FloatArray, b: FloatArray) -> FloatArray:
    """(N,) angle [rad] between vectors (N, 3) of any length, good near 0 and pi too."""
    angle: FloatArray = np.arctan2(np.linalg.norm(np.cross(a, b), axis=1), np.einsum("ij,ij->i", a, b))
    return angle


def rise_and_set_min(grid: Grid, sky: Sky) -> tuple[FloatArray, FloatArray]:
    """Minutes after the printed acquisition at which each pass begins and ends, (P,) each, elevation 0.

    The pass taken is the one whose culmination lies nearest 5 min after the acquisition. A pass that stays below the
    horizon begins and ends at its culmination.
    """
    rise, fall = np.empty(len(grid.passes)), np.empty(len(grid.passes))
    for row, height in enumerate(sky.elevation_deg):
        inner = np.flatnonzero((height[1:-1] >= height[:-2]) & (height[1:-1] > height[2:])) + 1
        tops = inner if inner.size else np.array([int(np.argmax(height))])
        top = int(tops[np.argmin(np.abs(grid.minutes[tops] - 5.0))])
        rise[row] = _crossing(grid.minutes[: top + 1][::-1], height[: top + 1][::-1])
        fall[row] = _crossing(grid.minutes[top:], height[top:])
    return rise, fall


def _crossing(minutes: FloatArray, height: FloatArray) -> float:
    """Where a series that starts at its top first falls through zero; the top itself if it starts below zero."""
    below = np.flatnonzero(height < 0.0)
    if not below.size:
        return float(minutes[-1])
    k = int(below[0])
    if k == 0:
        return float(minutes[0])
    part = height[k - 1] / (height[k - 1] - height[k])
    return float(minutes[k - 1] + part * (minutes[k] - minutes[k - 1]))
