"""Where Seasat's orbit lay: the scan that chooses the node and the mounting of the four sun-sensor heads.

The papers give altitude and inclination but no node, no time of day and no mounting. What they do say about
the sun decides both, as far as it can be decided:

* during the last half of August and September 1978 30-35 % of the orbit lay in darkness, and sun-sensor data
  came only from the southern hemisphere, for about 20 % of the orbit (claim 28);
* the reference attitudes of days 205, 219, 225 and 227 come from sun sensor and horizon scanner, at 92, 88,
  101 and 44 minutes of about one orbit, so the sun was seen nearly all along those orbits (claims 10-11);
* on day 279 data came from head 2 south of 45 S or from head 3 north of 30 N (claim 32).

The launch (1978-06-27 01:12:44 UTC, Vandenberg, southbound into 108 deg; Seasat Final Report, JPL 80-38)
enters nowhere: it gives a node of its own, and is the witness.
"""

from __future__ import annotations

from functools import cache
from itertools import product

import numpy as np

from fluxtwin.scenarios.flights import Numbers, day
from fluxtwin.sim.base.types import BoolArray, FloatArray, TimeArray
from fluxtwin.sim.earth import frames, sun
from fluxtwin.sim.earth.constants import EARTH_RADIUS_KM
from fluxtwin.sim.earth.orbit import orbital_rates
from fluxtwin.sim.spacecraft.sensors.sun_sensor import SunSensorSection

SEMI_MAJOR_AXIS_KM = 7168.0
INCLINATION_DEG = 108.0
DATA_DAYS = (205, 219, 225, 227)
DATA_MINUTES = (92, 88, 101, 44)
LATE_DAYS = tuple(range(228, 274))
"""16 August to 30 September 1978."""
CHECK_DAY = 279
LAUNCH = np.datetime64("1978-06-27T01:12:44", "ns")
LAUNCH_LATITUDE_DEG, LAUNCH_LONGITUDE_DEG = 34.63, -120.61
"""Vandenberg, Space Launch Complex 3."""
_ELEVATIONS = (-30.0, -15.0, 0.0, 15.0, 30.0, 45.0)
_HALF_FOVS = (32.0, 64.0)
"""Half the field of view: 128 x 128 deg is HCMM's head (claim 49); 64 x 64 deg a narrower one, assumed."""
_SPACINGS = (15.0, 30.0, 45.0, 60.0, 90.0)
_U = np.radians(np.arange(0.0, 360.0, 2.0))
_RATES = orbital_rates(SEMI_MAJOR_AXIS_KM, 0.0, float(np.radians(INCLINATION_DEG)))
_NODE_RATE_DEG_DAY = float(np.degrees(_RATES.raan_rad_s) * 86400.0)
_PERIOD_MIN = float(2 * np.pi / (_RATES.mean_anomaly_rad_s + _RATES.argument_of_perigee_rad_s) / 60.0)


def scan_node() -> Numbers:
    """Try every node. Misfit: mean distance of the late days' dark share from 0.30-0.35, plus the mean share
    of the data days' orbits that darkness makes impossible (both as shares of the orbit)."""
    days = np.array([*DATA_DAYS, *LATE_DAYS], dtype=float)
    sun_T = _sun_of_date(days)
    nodes = np.arange(0.0, 360.0, 1.0)
    dark = np.stack([_dark_share(_normal(node, days), sun_T) for node in nodes])
    late, data = dark[:, len(DATA_DAYS) :], dark[:, : len(DATA_DAYS)]
    misfit = distance_from(late, 0.30, 0.35).mean(axis=1) + data.mean(axis=1)
    return Numbers(
        # (K,) nodes at 0 h UTC of day 205, true of date, and the misfit of each.
        raan_deg=nodes,
        misfit=misfit,
        # (K, days) share of the orbit in darkness on the late days, and (K, 4) on the data days.
        late_dark_share=late,
        data_dark_share=data,
        chosen_deg=nodes[np.argmin(misfit)],
        # Node that the launch gives: the witness.
        launch_deg=node_from_launch(),
    )


def scan_heads(raan_deg: float) -> Numbers:
    """Try four-head mountings (equal elevation, equal spacing in azimuth) for the node chosen.

    Misfit: how far claims 10-11, 28 and 32 are missed, as shares of the orbit, summed with equal weight.
    """
    days = np.array([*DATA_DAYS, *LATE_DAYS[::3], CHECK_DAY], dtype=float)
    # Sun direction in O (D, U, 3), sunlit (D, U) and latitude [rad] (D, U) all around each day's orbit.
    i, node = np.radians(INCLINATION_DEG), np.radians(_node_on(raan_deg, days))[:, None]
    cu, su = np.cos(_U)[None, :], np.sin(_U)[None, :]
    cn, sn = np.cos(node), np.sin(node)
    up = np.stack([cu * cn - su * np.cos(i) * sn, cu * sn + su * np.cos(i) * cn, su * np.sin(i) + 0 * cn], axis=-1)
    normal = np.broadcast_to(_normal(raan_deg, days)[:, None, :], up.shape)
    sun_T = _sun_of_date(days)
    sun_O = np.stack([np.einsum("duk,dk->du", axis, sun_T) for axis in (np.cross(normal, up), -normal, -up)], axis=-1)
    horizon = -np.sqrt(1.0 - (EARTH_RADIUS_KM / SEMI_MAJOR_AXIS_KM) ** 2)
    lit = -sun_O[..., 2] > horizon
    latitude = np.arcsin(up[..., 2])

    @cache
    def seen_by(azimuth: float, elevation: float, half: float) -> BoolArray:
        head = SunSensorSection(azimuth_deg=azimuth, elevation_deg=elevation, half_fov_deg=half)
        return head.sees(sun_O.reshape(-1, 3), lit.ravel()).reshape(lit.shape)

    found = []
    for elevation, half, spacing, first in product(_ELEVATIONS, _HALF_FOVS, _SPACINGS, np.arange(0.0, 360.0, 15.0)):
        azimuths = tuple(float((first + k * spacing) % 360.0) for k in range(4))
        seen = np.stack([seen_by(one, elevation, half) for one in azimuths])
        found.append(_judge(azimuths, elevation, half, seen, latitude))
    return min(found, key=lambda one: one.misfit)


def node_from_launch() -> float:
    """Node [deg] at 0 h of day 205 if the orbit plane passed over the pad, southbound, at lift-off."""
    i, latitude = np.radians(INCLINATION_DEG), np.radians(LAUNCH_LATITUDE_DEG)
    u = np.pi - np.arcsin(np.sin(latitude) / np.sin(i))
    from_node = np.arctan2(np.cos(i) * np.sin(u), np.cos(u))
    to_earth = frames.rotation_EN(LAUNCH) * frames.rotation_TN(LAUNCH).inv()
    sidereal = np.arctan2(*to_earth.as_matrix()[0, 0, 1::-1])
    elapsed_days = (day(DATA_DAYS[0]) - LAUNCH) / np.timedelta64(1, "D")
    drift = _NODE_RATE_DEG_DAY * float(elapsed_days)
    return float((np.degrees(sidereal + np.radians(LAUNCH_LONGITUDE_DEG) - from_node) + drift) % 360.0)


def _judge(
    azimuths: tuple[float, ...], elevation: float, half: float, seen: BoolArray, latitude: FloatArray
) -> Numbers:
    """One mounting, of which each head sees the sun in `seen` (4, D, U)."""
    some = np.asarray(seen.any(axis=0))
    data, late, check = some[: len(DATA_DAYS)], some[len(DATA_DAYS) : -1], some[-1]
    minutes = data.mean(axis=1) * _PERIOD_MIN
    short = np.maximum(np.minimum(np.array(DATA_MINUTES), _PERIOD_MIN) - minutes, 0.0) / _PERIOD_MIN
    south = latitude[len(DATA_DAYS) : -1] < 0
    visible = float(late.mean())
    visible_south = float((late & south).sum() / max(late.sum(), 1))
    far_south, far_north = latitude[-1] < np.radians(-45.0), latitude[-1] > np.radians(30.0)
    heads_south, heads_north = seen[:, -1, far_south].any(axis=1), seen[:, -1, far_north].any(axis=1)
    wrong = check & ~far_south & ~far_north
    two_heads = bool((heads_south & ~heads_north).any() and (heads_north & ~heads_south).any())
    return Numbers(
        azimuth_deg=azimuths,
        elevation_deg=elevation,
        half_fov_deg=half,
        misfit=short.mean()
        + abs(visible - 0.20)
        + visible * (1.0 - visible_south)
        + wrong.mean()
        + (0.0 if two_heads else 0.1),
        # Share of the late days' samples in which some head sees the sun, and of these the share in the south.
        late_visible_share=visible,
        late_visible_south=visible_south,
    )


def distance_from(values: FloatArray, low: float, high: float) -> FloatArray:
    """How far values are from an interval; 0 inside."""
    return np.maximum(np.maximum(low - values, values - high), 0.0)


def _dark_share(normal_T: FloatArray, sun_T: FloatArray) -> FloatArray:
    """Share of a circular orbit in the Earth's cylindrical shadow, by the angle of the sun from the plane."""
    sine = np.einsum("ij,ij->i", normal_T, sun_T)
    edge = np.sqrt(1.0 - (EARTH_RADIUS_KM / SEMI_MAJOR_AXIS_KM) ** 2) / np.sqrt(1.0 - sine**2)
    share: FloatArray = np.arccos(np.clip(edge, -1.0, 1.0)) / np.pi
    return share


def _normal(raan_deg: float, days: FloatArray) -> FloatArray:
    i, node = np.radians(INCLINATION_DEG), np.radians(_node_on(raan_deg, days))
    return np.stack([np.sin(i) * np.sin(node), -np.sin(i) * np.cos(node), np.full_like(node, np.cos(i))], axis=1)


def _node_on(raan_deg: float, days: FloatArray) -> FloatArray:
    return raan_deg + _NODE_RATE_DEG_DAY * (days + 0.5 - DATA_DAYS[0])


def _sun_of_date(days: FloatArray) -> FloatArray:
    """Sun direction at noon UTC of each day, true equator and equinox of date."""
    noon: TimeArray = np.array([day(int(d), 12.0) for d in days], dtype="datetime64[ns]")
    of_date: FloatArray = frames.rotation_TN(noon).apply(sun.sun_direction_N(noon))
    return of_date
