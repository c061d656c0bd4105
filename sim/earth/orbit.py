"""Circular and elliptic orbits with the secular effects of the Earth's oblateness.

The elements are mean in the J2 sense: node, perigee and mean anomaly move at their secular first-order rates
and a, e, i stay; the short-period terms (about 10 km in low orbit) and all other forces are left out. They
refer to the true equator and equinox of date at `epoch_utc`, and those axes then stay fixed; what comes out
is GCRS. Elapsed time counts leap seconds.

The velocity is the exact time derivative of the position, secular rates included. So the orbital frame that
`frames.rotation_ON` builds from both turns consistently; its y axis leans up to 0.05 deg from the normal of
the mean plane, because the plane itself is turning.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from fluxtwin.sim.base.types import FloatArray, TimeArray
from fluxtwin.sim.earth import epoch, frames
from fluxtwin.sim.earth.constants import EARTH_RADIUS_KM, GM_EARTH_KM3_S2, J2_EARTH

Ephemeris = Callable[[TimeArray], tuple[FloatArray, FloatArray]]
"""Position [km] and velocity [km/s], GCRS, each (N, 3), at N stamps: `Orbit.propagate`, `tle.Tle.propagate`."""
_NEWTON_STEPS = 50


class OrbitalRates(NamedTuple):
    """Secular rates of an orbit under J2 [rad/s]."""

    raan_rad_s: float
    argument_of_perigee_rad_s: float
    mean_anomaly_rad_s: float


def orbital_rates(semi_major_axis_km: float, eccentricity: float = 0.0, inclination_rad: float = 0.0) -> OrbitalRates:
    """First-order secular rates under J2 of node, perigee and mean anomaly (its Kepler part included).

    Source: Brouwer 1959 (doi 10.1086/107958) to first order; Vallado, Fundamentals of Astrodynamics and
    Applications, section 9.6, with n = sqrt(GM/a^3).
    """
    n = np.sqrt(GM_EARTH_KM3_S2 / semi_major_axis_km**3)
    shape = 1.0 - eccentricity**2
    k = 0.75 * J2_EARTH * (EARTH_RADIUS_KM / (semi_major_axis_km * shape)) ** 2 * n
    cos_i = np.cos(inclination_rad)
    return OrbitalRates(
        raan_rad_s=float(-2.0 * k * cos_i),
        argument_of_perigee_rad_s=float(k * (5.0 * cos_i**2 - 1.0)),
        mean_anomaly_rad_s=float(n + k * np.sqrt(shape) * (3.0 * cos_i**2 - 1.0)),
    )


@dataclass(frozen=True, kw_only=True)
class Orbit:
    """Mean elements at `epoch_utc`, on the true equator and equinox of that date."""

    epoch_utc: np.datetime64
    altitude_km: float
    """Semi-major axis minus 6378.137 km."""
    inclination_rad: float
    raan_rad: float
    eccentricity: float = 0.0
    argument_of_perigee_rad: float = 0.0
    argument_of_latitude_rad: float = 0.0
    """Argument of perigee plus mean anomaly, at the epoch."""

    @property
    def semi_major_axis_km(self) -> float:
        return self.altitude_km + EARTH_RADIUS_KM

    @property
    def rates(self) -> OrbitalRates:
        return orbital_rates(self.semi_major_axis_km, self.eccentricity, self.inclination_rad)

    @property
    def nodal_period_s(self) -> float:
        """Mean time from one ascending node to the next [s]."""
        return 2.0 * np.pi / (self.rates.mean_anomaly_rad_s + self.rates.argument_of_perigee_rad_s)

    def propagate(self, time: TimeArray | np.datetime64) -> tuple[FloatArray, FloatArray]:
        """Position [km] and velocity [km/s] in GCRS, each (N, 3), before or after the epoch."""
        t = epoch.seconds_since(time, self.epoch_utc)
        rates = self.rates
        anomaly = self.argument_of_latitude_rad - self.argument_of_perigee_rad + rates.mean_anomaly_rad_s * t
        perigee = self.argument_of_perigee_rad + rates.argument_of_perigee_rad_s * t
        node = self.raan_rad + rates.raan_rad_s * t
        p, p_rate = self._in_perifocal_plane(anomaly, rates.mean_anomaly_rad_s)
        in_plane, in_plane_rate = _turn(p, p_rate, perigee, rates.argument_of_perigee_rad_s)
        tilted, tilted_rate = (
            _tilt(in_plane, self.inclination_rad),
            _tilt(in_plane_rate, self.inclination_rad),
        )
        r_T_km, v_T_km_s = _turn(tilted, tilted_rate, node, rates.raan_rad_s)
        to_date = _to_date(self.epoch_utc)
        return r_T_km @ to_date, v_T_km_s @ to_date

    def _in_perifocal_plane(self, anomaly: FloatArray, rate: float) -> tuple[FloatArray, FloatArray]:
        e, a = self.eccentricity, self.semi_major_axis_km
        b = a * np.sqrt(1.0 - e**2)
        E = eccentric_anomaly(anomaly, e)
        cos_E, sin_E = np.cos(E), np.sin(E)
        E_rate = rate / (1.0 - e * cos_E)
        zero = np.zeros_like(E)
        position = np.stack([a * (cos_E - e), b * sin_E, zero], axis=1)
        velocity = np.stack([-a * sin_E * E_rate, b * cos_E * E_rate, zero], axis=1)
        return position, velocity


@lru_cache(maxsize=64)
def _to_date(epoch_utc: np.datetime64) -> FloatArray:
    """(3, 3) GCRS to true equator and equinox of date; a search for elements asks for that of one epoch again and again."""
    return np.asarray(frames.rotation_TN(epoch_utc).as_matrix()[0])


def kepler_period_s(r_km: FloatArray, v_km_s: FloatArray) -> float:
    """Kepler period of the orbit through a position and velocity (3,), by vis-viva; infinite where it is not closed."""
    r, v = np.linalg.norm(r_km), np.linalg.norm(v_km_s)
    axis_km = 1.0 / (2.0 / r - v**2 / GM_EARTH_KM3_S2)
    return float(2.0 * np.pi * np.sqrt(axis_km**3 / GM_EARTH_KM3_S2)) if axis_km > 0 else float("inf")


def eccentric_anomaly(mean_anomaly_rad: FloatArray, eccentricity: float) -> FloatArray:
    """Solve Kepler's equation M = E - e sin E for E [rad], shape (N,), to rounding. Needs 0 <= e < 1.

    Newton's method from Danby's start M +- 0.85 e (Danby 1987, doi 10.1007/BF01686811), kept by bisection
    between bounds that close in on the root, so that it converges at any eccentricity.
    """
    turns = np.floor(np.asarray(mean_anomaly_rad, dtype=np.float64) / (2.0 * np.pi) + 0.5)
    M = mean_anomaly_rad - 2.0 * np.pi * turns
    if eccentricity == 0.0:
        return M + 2.0 * np.pi * turns
    low, high = np.minimum(M, M + eccentricity * np.sign(M)), np.maximum(M, M + eccentricity * np.sign(M))
    E = M + 0.85 * eccentricity * np.sign(np.sin(M))
    for _ in range(_NEWTON_STEPS):
        excess = E - eccentricity * np.sin(E) - M
        low, high = np.where(excess < 0, E, low), np.where(excess > 0, E, high)
        newton = E - excess / (1.0 - eccentricity * np.cos(E))
        inside = (newton >= low) & (newton <= high)
        following = np.where(inside, newton, 0.5 * (low + high))
        done = np.abs(following - E).max(initial=0.0) < 1e-15 * np.pi
        E = following
        if done:
            break
    return E + 2.0 * np.pi * turns


def argument_of_latitude(time: TimeArray | np.datetime64, r_N_km: FloatArray, v_N_km_s: FloatArray) -> FloatArray:
    """Angle from the ascending node to the position, along the motion, in [0, 2 pi), shape (N,).

    The node is that on the true equator of date at each stamp. Where the orbit lies in the equator the angle
    counts from the equinox.
    """
    T = frames.rotation_TN(time)
    r, v = T.apply(r_N_km), T.apply(v_N_km_s)
    normal = np.cross(r, v)
    node = np.stack([-normal[:, 1], normal[:, 0], np.zeros(len(normal))], axis=1)
    flat = np.linalg.norm(node, axis=1) <= 1e-12 * np.linalg.norm(normal, axis=1)
    node[flat] = [1.0, 0.0, 0.0]
    across = np.cross(normal, node) / np.linalg.norm(normal, axis=1)[:, None]
    angle = np.arctan2(np.einsum("ij,ij->i", r, across), np.einsum("ij,ij->i", r, node))
    return np.asarray(angle % (2.0 * np.pi))


def _turn(position: FloatArray, velocity: FloatArray, angle: FloatArray, rate: float) -> tuple[FloatArray, FloatArray]:
    """Vectors turned by `angle` about z, and the derivative of that while the angle grows at `rate`."""
    c, s = np.cos(angle), np.sin(angle)

    def about_z(x: FloatArray) -> FloatArray:
        return np.stack([c * x[:, 0] - s * x[:, 1], s * x[:, 0] + c * x[:, 1], x[:, 2]], axis=1)

    turned = about_z(position)
    carried = rate * np.stack([-turned[:, 1], turned[:, 0], np.zeros(len(turned))], axis=1)
    return turned, about_z(velocity) + carried


def _tilt(x: FloatArray, angle: float) -> FloatArray:
    """Vectors turned by `angle` about x."""
    c, s = np.cos(angle), np.sin(angle)
    return np.stack([x[:, 0], c * x[:, 1] - s * x[:, 2], s * x[:, 1] + c * x[:, 2]], axis=1)
