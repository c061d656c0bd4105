"""Parts of the Earth: boxes of latitude and longitude, and circles about a place."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from fluxtwin.sim.base.errors import BadInput
from fluxtwin.sim.base.types import FloatArray

WANTED = "region_deg = [south, north, west, east], or [latitude, longitude, radius] of a circle"


def depth_deg(latitude_deg: FloatArray, longitude_deg: FloatArray, region_deg: Sequence[float]) -> FloatArray:
    """(N,) how far within a region ground points lie, in degrees of arc along the ground; negative outside.

    region_deg: southern and northern latitude, western and eastern longitude (west > east crosses 180), or latitude,
    longitude and radius of a circle; all geocentric. A pole is no edge, and no more are two meridians all the way apart.
    Raises BadInput for another number of values.
    """
    if len(region_deg) == 3:
        latitude, longitude, radius = np.radians(region_deg)
        here = np.radians(latitude_deg)
        cosine = np.sin(here) * np.sin(latitude)
        cosine = cosine + np.cos(here) * np.cos(latitude) * np.cos(np.radians(longitude_deg) - longitude)
        return np.asarray(np.degrees(radius - np.arccos(np.clip(cosine, -1.0, 1.0))))
    if len(region_deg) != 4:
        raise BadInput(f"a region of {len(region_deg)} numbers", where="switched_field", wanted=WANTED)
    south, north, west, east = region_deg
    depth = np.full(np.shape(latitude_deg), np.inf)
    depth = np.minimum(depth, latitude_deg - south) if south > -90.0 else depth
    depth = np.minimum(depth, north - latitude_deg) if north < 90.0 else depth
    if east - west < 360.0:
        half = 0.5 * np.mod(east - west, 360.0)
        off = np.abs(np.mod(longitude_deg - west - half + 180.0, 360.0) - 180.0)
        depth = np.minimum(depth, (half - off) * np.cos(np.radians(latitude_deg)))
    return np.asarray(depth)


def outline_deg(region_deg: Sequence[float]) -> FloatArray:
    """(2, K) longitude, not reduced to a turn, and latitude along the edge of a region."""
    if len(region_deg) == 4:
        south, north, west, east = region_deg
        return np.array([[west, east, east, west, west], [south, south, north, north, south]])
    latitude, longitude, radius = np.radians(region_deg)
    bearing = np.linspace(0.0, 2.0 * np.pi, 181)
    sine = np.sin(latitude) * np.cos(radius) + np.cos(latitude) * np.sin(radius) * np.cos(bearing)
    east = np.sin(bearing) * np.sin(radius) * np.cos(latitude)
    turned = np.arctan2(east, np.cos(radius) - np.sin(latitude) * sine)
    return np.asarray(np.degrees(np.stack([longitude + turned, np.arcsin(np.clip(sine, -1.0, 1.0))])))


def region_words(region_deg: Sequence[float]) -> str:
    """Where a region is, to read."""
    if len(region_deg) == 3:
        latitude, longitude, radius = region_deg
        return f"within {radius:g} deg of {_latitude(latitude)}, {_longitude(longitude)}"
    south, north, west, east = region_deg
    return f"over {_latitude(south)} to {_latitude(north)}, {_longitude(west)} to {_longitude(east)}"


def _latitude(deg: float) -> str:
    return f"{abs(deg):g} {'N' if deg >= 0 else 'S'}"


def _longitude(deg: float) -> str:
    turned = (deg + 180.0) % 360.0 - 180.0
    return f"{abs(turned):g} {'E' if turned >= 0 else 'W'}"
