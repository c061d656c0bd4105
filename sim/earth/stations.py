"""Ground stations: how high a spacecraft stands over each, and when it is in view.

Elevation is the angle above the plane across the geodetic vertical (WGS 84), straight lines, no refraction
(0.5 deg at the horizon, 20 s of a low orbit at most).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from fluxtwin.sim.base.errors import BadInput
from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.earth import epoch, frames
from fluxtwin.sim.earth.orbit import Ephemeris

_STEP_S, _FINE_S = 20.0, 2.0
"""Sampling of the span, and about each culmination."""
_BISECTIONS = 24
"""Halvings of a step: 20 s become a microsecond."""


@dataclass(frozen=True)
class Station:
    """A place on the ground, WGS 84, and the elevation from which it has contact."""

    name: str
    latitude_rad: float
    longitude_rad: float
    altitude_km: float = 0.0
    mask_rad: float = 0.0

    @property
    def r_E_km(self) -> FloatArray:
        return np.asarray(frames.from_geodetic(*self._angles(), np.array([self.altitude_km]))[0])

    @property
    def up_E(self) -> FloatArray:
        """(3,) geodetic vertical."""
        return np.asarray(frames.from_geocentric(*self._angles(), np.ones(1))[0])

    def elevation_rad(self, r_E_km: FloatArray) -> FloatArray:
        """(N,) angle above the horizontal plane of spacecraft at r_E_km (N, 3), Earth-fixed."""
        line = np.asarray(r_E_km, dtype=np.float64) - self.r_E_km
        return np.asarray(np.arcsin(line @ self.up_E / np.linalg.norm(line, axis=-1)))

    def _angles(self) -> tuple[FloatArray, FloatArray]:
        return np.array([self.latitude_rad]), np.array([self.longitude_rad])


@dataclass(frozen=True)
class Contact:
    """One pass of a spacecraft over a station."""

    station: str
    rise: np.datetime64
    """UTC at which the elevation passes the mask, or the start of the span if it is above it already."""
    set: np.datetime64
    highest: np.datetime64
    highest_rad: float
    cut: bool
    """The span begins or ends inside this pass."""

    @property
    def seconds(self) -> float:
        return float(epoch.seconds_since(self.set, self.rise)[0])


def find_contacts(
    stations: list[Station], ephemeris: Ephemeris, start: np.datetime64, end: np.datetime64
) -> list[Contact]:
    """Every pass over every station between two stamps, in order of rise.

    The span is sampled every 20 s, more finely about each culmination, and rise and set are found by bisection. Raises
    BadInput for a span of no length or of more than 400 days.
    """
    length_s = float(epoch.seconds_since(end, start)[0])
    if not 0.0 < length_s <= 400 * 86400.0:
        raise BadInput(f"{length_s:g} s", where="span of the passes", wanted="more than 0 s, at most 400 days")
    count = int(np.ceil(length_s / _STEP_S)) + 1
    seconds = np.linspace(0.0, length_s, count)
    r_E_km = _fixed(ephemeris, start, seconds)
    found = [contact for station in stations for contact in _of_station(station, ephemeris, start, seconds, r_E_km)]
    return sorted(found, key=lambda contact: (contact.rise, contact.station))


def in_view(stations: list[Station], r_E_km: FloatArray) -> FloatArray:
    """(N, K) elevation above the mask of each of K stations [rad]; positive where there is contact."""
    return np.stack([station.elevation_rad(r_E_km) - station.mask_rad for station in stations], axis=1)


def _of_station(
    station: Station, ephemeris: Ephemeris, start: np.datetime64, seconds: FloatArray, r_E_km: FloatArray
) -> list[Contact]:
    def above(when_s: FloatArray) -> FloatArray:
        return station.elevation_rad(_fixed(ephemeris, start, when_s)) - station.mask_rad

    height = station.elevation_rad(r_E_km) - station.mask_rad
    peak = np.flatnonzero((height[1:-1] >= height[:-2]) & (height[1:-1] > height[2:])) + 1
    fine = (seconds[peak, None] + np.arange(-_STEP_S, _STEP_S + 0.1, _FINE_S)[None, :]).ravel()
    fine = fine[(fine > 0) & (fine < seconds[-1])]
    grid = np.concatenate([seconds, fine])
    order = np.argsort(grid, kind="stable")
    values = np.concatenate([height, above(fine)])[order] if fine.size else height
    grid = grid[order]
    edges = np.flatnonzero((values[1:] > 0) != (values[:-1] > 0))
    crossing = _bisect(above, grid[edges], grid[edges + 1]) if edges.size else np.zeros(0)
    bounds = np.concatenate([[0.0] if values[0] > 0 else [], crossing, [seconds[-1]] if values[-1] > 0 else []])
    contacts = []
    for first, last in bounds.reshape(-1, 2):
        inside = (grid >= first) & (grid <= last)
        near = grid[int(np.argmax(np.where(inside, values, -np.inf)))] if inside.any() else 0.5 * (first + last)
        about = np.clip(near + np.linspace(-_FINE_S, _FINE_S, 41), first, last)
        around = above(about)
        top = int(np.argmax(around))
        rise, down, highest = epoch.add_seconds(start, np.array([first, last, about[top]]))
        cut = bool(first == 0.0 or last == seconds[-1])
        contacts.append(Contact(station.name, rise, down, highest, float(around[top] + station.mask_rad), cut))
    return contacts


def _bisect(above: Callable[[FloatArray], FloatArray], low: FloatArray, high: FloatArray) -> FloatArray:
    """Zeros of `above` between pairs of times, all at once."""
    rising = above(high) > 0
    for _ in range(_BISECTIONS):
        middle = 0.5 * (low + high)
        before = (above(middle) > 0) != rising
        low, high = np.where(before, middle, low), np.where(before, high, middle)
    return np.asarray(0.5 * (low + high))


def _fixed(ephemeris: Ephemeris, start: np.datetime64, seconds: FloatArray) -> FloatArray:
    time = epoch.add_seconds(start, seconds)
    return np.asarray(frames.rotation_EN(time).apply(ephemeris(time)[0]))
