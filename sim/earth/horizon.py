"""The Earth's horizon from orbit, in closed form: of an ellipsoid, and of the surface that an infrared scanner sees.

A line of sight d from p touches the ellipsoid (x - c)' Q (x - c) = 1 where d' M d = 0, with q = p - c and
M = (Q q)(Q q)' - (q' Q q - 1) Q: the horizon is a quadratic cone. At a given azimuth this is Wertz (ed.), Spacecraft
Attitude Determination and Control (1978), equation 4-24.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fluxtwin.sim.base.types import FloatArray, TimeArray
from fluxtwin.sim.earth import frames, sun
from fluxtwin.sim.earth.constants import EARTH_FLATTENING, EARTH_RADIUS_KM

SURFACES = ("sphere", "ellipsoid", "infrared")
MEAN_RADIUS_KM = EARTH_RADIUS_KM * (1.0 - EARTH_FLATTENING / 3.0)
"""What a scanner that knows of no flattening takes the Earth for."""

INFRARED_FLATTENING, INFRARED_FLATTENING_BY_SEASON = 1.0 / 185.0, -1.0 / 640.0
INFRARED_RADIUS_BY_SEASON_KM = -4.5
INFRARED_SHIFT_BY_SEASON_KM = 11.5
"""The ellipsoid on which the infrared scanners of OrbView-2 triggered, of the Earth's equatorial radius. "By season"
multiplies the sine of the sun's declination; the shift is along the axis, towards the summer pole. Poles are 13 km lower
than the flattening of the solid Earth puts them, and the winter pole more than the summer pole."""
INFRARED_SOURCE = (
    "the surface on which two conical infrared scanners at 705 km triggered (OrbView-2), fitted to flight data of "
    "1997-2001: F. Patt (SAIC GSC), subroutine earth of the SeaWiFS navigation, state of 4 April 2001, in NASA's "
    "SeaDAS. The threshold of another scanner differs, and weather in the stratosphere adds about as much again (abstract "
    "of Empirical correction for Earth sensor horizon radiance variation, 1998, on the horizon sensors of TOMS-EP)."
)


@dataclass(frozen=True)
class Surface:
    """An ellipsoid of revolution about the Earth's axis; every field one number or (N,)."""

    radius_km: FloatArray | float
    """Equatorial radius."""
    flattening: FloatArray | float = 0.0
    shift_km: FloatArray | float = 0.0
    """Its centre along the axis, north of the Earth's."""


def surface(name: str, time: TimeArray, radiance: float = 1.0) -> Surface:
    """What is seen, or taken, for the Earth at each of N stamps, by its name in SURFACES.

    time: (N,) UTC. radiance: by how much the infrared surface differs from the ellipsoid, 1 as published.
    """
    if name == "sphere":
        return Surface(MEAN_RADIUS_KM)
    if name == "ellipsoid":
        return Surface(EARTH_RADIUS_KM, EARTH_FLATTENING)
    season = np.einsum("ij,ij->i", sun.sun_direction_N(time), north_N(time))
    more = INFRARED_FLATTENING + INFRARED_FLATTENING_BY_SEASON * season - EARTH_FLATTENING
    return Surface(
        EARTH_RADIUS_KM + radiance * INFRARED_RADIUS_BY_SEASON_KM * season,
        EARTH_FLATTENING + radiance * more,
        radiance * INFRARED_SHIFT_BY_SEASON_KM * season,
    )


def north_N(time: TimeArray) -> FloatArray:
    """(N, 3) unit vectors along the Earth's axis, N axes."""
    return np.asarray(frames.rotation_EN(time).apply([0.0, 0.0, 1.0], inverse=True))


def tangent_cone(seen: Surface, r_km: FloatArray, pole: FloatArray) -> FloatArray:
    """(N, 3, 3) symmetric M of the horizon: d' M d = 0 for lines of sight d that touch the surface, above 0 inside.

    r_km: (N, 3) where the observer is, from the Earth's centre; pole: (N, 3) unit vectors to the north; same axes.
    """
    k = (1.0 / (1.0 - np.asarray(seen.flattening)) ** 2 - 1.0) * np.ones(len(r_km))
    q = r_km - np.asarray(seen.shift_km).reshape(-1, 1) * pole
    Q = np.eye(3) + k[:, None, None] * pole[:, :, None] * pole[:, None, :]
    Qq = np.einsum("nij,nj->ni", Q, q)
    beyond = np.einsum("ni,ni->n", q, Qq) - np.asarray(seen.radius_km) ** 2
    cone: FloatArray = (Qq[:, :, None] * Qq[:, None, :] - beyond[:, None, None] * Q) / np.sum(q**2, axis=1)[
        :, None, None
    ]
    return cone


def nadir_angle(cone: FloatArray, nadir: FloatArray, towards: FloatArray) -> FloatArray:
    """(N,) angle from nadir to the horizon [rad] in the direction `towards`, a unit vector across nadir; both (N, 3)."""
    a, b, c = (
        np.einsum("ni,nij,nj->n", one, cone, other)
        for one, other in ((towards, towards), (nadir, towards), (nadir, nadir))
    )
    return np.asarray(np.arctan2(b + np.sqrt(b**2 - a * c), -a))
