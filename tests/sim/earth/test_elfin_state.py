"""Sun, shadow and orbit against a satellite that flew: ELFIN-A, 12 January 2022, every 10 s."""

from __future__ import annotations

import numpy as np
import pytest
import xarray as xr
from scipy.optimize import least_squares

from fluxtwin.sim.earth import frames, sun
from fluxtwin.sim.earth.constants import EARTH_RADIUS_KM
from fluxtwin.sim.earth.orbit import Orbit, argument_of_latitude

pytestmark = pytest.mark.reference

NEAR_ROWS = 3
"""Rows of 10 s around a penumbra in which the flag may differ: it is kept in whole rows, with another Earth."""


@pytest.fixture(scope="module")
def state(shared):
    with xr.open_dataset(shared / "flight" / "elfin_a_20220112_state.nc", engine="h5netcdf") as opened:
        return opened.load()


@pytest.fixture(scope="module")
def times(state):
    return state.time.values.astype("datetime64[ns]")


def angle_deg(a, b):
    return np.degrees(np.arctan2(np.linalg.norm(np.cross(a, b), axis=1), (a * b).sum(axis=1)))


def test_spin_sun_angle(state, times, close):
    """The file's angle between spin axis and sun; its axes, called GEI, are those of J2000."""
    axis = state.spin_axis_gei.values.astype(float)
    towards = sun.sun_direction_N(times, state.position_gei.values)
    expected = state.spin_sun_angle.values.astype(float)
    bound = {"atol": 0.01, "unit": "deg", "because": "the file's sun is a low-precision series, 0.01 deg"}
    close(angle_deg(axis, towards), expected, **bound)
    of_date = angle_deg(axis, frames.rotation_TN(times).apply(towards))
    assert np.abs(of_date - expected).mean() == pytest.approx(0.20, abs=0.02)
    mutants = (of_date, angle_deg(axis, -towards), angle_deg(axis[:, [1, 0, 2]], towards), 1.01 * expected)
    for mutant in mutants:
        with pytest.raises(AssertionError):
            close(mutant, expected, **bound)


def runs(mask):
    """First row and length of each run of True."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], mask, [False]]).astype(int)))
    return list(zip(edges[::2], edges[1::2] - edges[::2], strict=True))


def test_sunlit_flag_is_wrong_in_three_blocks_and_right_elsewhere(state, times):
    light = sun.illumination(state.position_gei.values, sun.sun_N_km(times))
    ours, theirs = light > 0.5, state.sunlit_flag.values == 1
    partial = (light > 0) & (light < 1)
    partial[1:] |= ours[1:] != ours[:-1]
    near = np.convolve(partial, np.ones(2 * NEAR_ROWS + 1), mode="same") > 0
    differ = runs((ours != theirs) & ~near)
    long_blocks = [(first, length) for first, length in differ if length > 30]
    assert len(long_blocks) == 3
    minutes = [(int(first) // 6, int(first + length) // 6) for first, length in long_blocks]
    assert minutes == [(0, 11), (120, 197), (1417, 1425)]
    for first, length in long_blocks:
        block = slice(first, first + length)
        assert (light[block] == 1.0).all()  # full sun by geometry, yet flagged as shadow
        assert not theirs[block].any()
    # One sunrise is flagged 90 s early, in the orbit before the longest block; nothing else differs.
    (odd,) = [(first, length) for first, length in differ if length <= 30]
    assert times[odd[0]] == np.datetime64("2022-01-12T01:54:20")
    assert odd[1] <= 9
    assert len(runs(~ours)) == 16


def test_shadow_lasts_as_long_as_the_geometry_says(state, times, close):
    """Each of our eclipses against the circular-orbit formula at the mean radius and the sun's angle to the plane."""
    r, v = state.position_gei.values, state.velocity_gei.values.astype(float)
    towards = sun.sun_direction_N(times)
    normal = np.cross(r, v)
    sin_beta = (normal * towards).sum(axis=1) / np.linalg.norm(normal, axis=1)
    shadow = runs(sun.illumination(r, sun.sun_N_km(times)) <= 0.5)
    inner = [(first, length) for first, length in shadow if first > 0 and first + length < times.size]
    for first, length in inner:
        middle = first + length // 2
        ratio = EARTH_RADIUS_KM / np.linalg.norm(r[middle])
        half = np.arcsin(np.sqrt(ratio**2 - sin_beta[middle] ** 2) / np.sqrt(1 - sin_beta[middle] ** 2))
        rate = np.linalg.norm(normal[middle]) / np.linalg.norm(r[middle]) ** 2
        close(10.0 * length, 2 * half / rate, atol=15.0, unit="s", because="rows of 10 s at both ends; e = 0.001")


def test_a_day_of_flight_is_a_mean_orbit_with_j2(state, times, close):
    """Our orbit fitted to the day: what is left are the short-period terms and the air drag, not the node."""
    rows = slice(None, None, 12)
    t, r = times[rows], state.position_gei.values[rows]
    v = state.velocity_gei.values[rows].astype(float)
    T = frames.rotation_TN(t[0])
    h = np.cross(T.apply(r[0]), T.apply(v[0]))[0]
    guess = [
        6800 / 7000,
        0.0,
        0.0,
        np.arccos(h[2] / np.linalg.norm(h)),
        np.arctan2(h[0], -h[1]),
        argument_of_latitude(t[:1], r[:1], v[:1])[0],
    ]

    def model(x):
        return Orbit(
            epoch_utc=t[0],
            altitude_km=x[0] * 7000 - EARTH_RADIUS_KM,
            eccentricity=np.hypot(x[1], x[2]),
            inclination_rad=x[3],
            raan_rad=x[4],
            argument_of_perigee_rad=np.arctan2(x[2], x[1]),
            argument_of_latitude_rad=x[5],
        )

    head = slice(0, 60)  # two hours fix the phase before the whole day fixes the period
    first = least_squares(lambda x: (model(x).propagate(t[head])[0] - r[head]).ravel(), guess, x_scale=1e-3)
    fit = least_squares(lambda x: (model(x).propagate(t)[0] - r).ravel(), first.x, x_scale=1e-3)
    flown = model(fit.x)
    because = "short-period J2 terms of 10 km; drag at 430 km makes a few km in a day"
    close(flown.propagate(t)[0], r, atol=12.0, unit="km", because=because)
    plane = T.apply(np.cross(r, v))
    node = np.unwrap(np.arctan2(plane[:, 0], -plane[:, 1]))
    rate = np.degrees(np.polyfit((t - t[0]).astype(float) * 1e-9, node, 1)[0]) * 86400
    ours = np.degrees(flown.rates.raan_rad_s) * 86400
    bound = {"atol": 0.02, "unit": "deg/day", "because": "sun, moon and J2^2; short-period terms average out"}
    close(ours, rate, **bound)
    with pytest.raises(AssertionError):
        close(-ours, rate, **bound)
