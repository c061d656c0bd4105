"""Time scales, earth rotation, sun and TEME against astropy, an implementation of its own layer above ERFA.

astropy runs offline, with UT1 = UTC and no polar motion, as the project does.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator

import astropy.coordinates.builtin_frames.intermediate_rotation_transforms as astropy_rotations
import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import (
    GCRS,
    ITRS,
    TEME,
    CartesianRepresentation,
    EarthLocation,
    PrecessedGeocentric,
    get_sun,
)
from astropy.time import Time
from astropy.utils import iers

from fluxtwin.sim.earth import epoch, frames, sun, tle

pytestmark = pytest.mark.reference

TIMES = np.array(
    [
        "1974-03-01T05:00:00",
        "1978-07-24T06:00:00",
        "1978-12-31T23:59:59.5",
        "1999-05-05T00:00:00",
        "2012-06-30T12:00:00",
        "2016-12-31T23:59:59.9",
        "2022-01-12T03:04:05.25",
        "2026-01-01T00:00:00",
    ],
    dtype="datetime64[ns]",
)
LEAP_DAYS = np.array(
    ["1972-06-30", "1972-12-31", "1978-12-31", "1981-06-30", "1998-12-31", "2008-12-31", "2016-12-31"],
    dtype="datetime64[ns]",
)
BOTH_SIDES = np.sort(np.concatenate([LEAP_DAYS + np.timedelta64(s, "s") for s in (43200, 86399, 86400, 129600)]))


@pytest.fixture(autouse=True)
def offline(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.setattr(astropy_rotations, "get_polar_motion", lambda time: (0.0, 0.0))
    with iers.conf.set_temp("auto_download", False), iers.conf.set_temp("auto_max_age", None):
        yield


def astropy_time(stamps: np.ndarray) -> Time:
    time = Time(np.datetime_as_string(stamps), scale="utc")
    time.delta_ut1_utc = 0.0
    return time


def positions() -> np.ndarray:
    return np.random.default_rng(3).normal(size=(TIMES.size, 3)) * 5000.0


def test_terrestrial_time(close):
    theirs = astropy_time(BOTH_SIDES).tt
    ours = epoch.jd_tt(BOTH_SIDES)
    gap_s = ((ours[0] - theirs.jd1) + (ours[1] - theirs.jd2)) * 86400.0
    close(gap_s, 0.0, atol=1e-6, unit="s", because="two-part Julian dates resolve 1e-11 s; 1e-6 s moves nothing")


def test_elapsed_time_counts_leap_seconds(close):
    start = np.datetime64("1975-04-05T06:07:08.5", "ns")
    theirs = (astropy_time(BOTH_SIDES) - astropy_time(start)).sec
    because = "astropy's difference of two Julian dates, 5e4 days long, rounds at 1e-9 s"
    close(epoch.seconds_since(BOTH_SIDES, start), theirs, atol=1e-6, unit="s", because=because)
    close(epoch.seconds_since(BOTH_SIDES, start)[0], theirs[0], atol=1e-6, unit="s", because="before the start")
    without = (BOTH_SIDES - start).astype("int64") * 1e-9
    with pytest.raises(AssertionError):
        close(without, theirs, atol=1e-6, unit="s", because="a clock that skips leap seconds must fail")


def test_decimal_year(close):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # some versions call a year near today's dubious
        theirs = astropy_time(TIMES).decimalyear
    because = "a leap second in the year's length is 3e-8 yr"
    close(epoch.decimal_year(TIMES), theirs, atol=7e-8, unit="yr", because=because)


def test_gcrs_to_itrs(close):
    r_N_km = positions()
    time = astropy_time(TIMES)
    there = GCRS(CartesianRepresentation(r_N_km.T * u.km), obstime=time).transform_to(ITRS(obstime=time))
    expected = there.cartesian.xyz.to_value(u.km).T
    R_EN = frames.rotation_EN(TIMES)
    bound = {"atol": 1e-6, "unit": "km", "because": "we leave out s', 6e-11 rad in 2026; rounding of days is 2e-7 km"}
    close(R_EN.apply(r_N_km), expected, **bound)
    for mutant in (R_EN.inv().apply(r_N_km), 1.01 * R_EN.apply(r_N_km), R_EN.apply(r_N_km)[:, [1, 0, 2]]):
        with pytest.raises(AssertionError):
            close(mutant, expected, **bound)
    late = frames.rotation_EN(TIMES + np.timedelta64(1, "ms")).apply(r_N_km)
    with pytest.raises(AssertionError):
        close(late, expected, **bound)


def test_true_of_date(close):
    """astropy's precessed frame lacks nutation, so the two may differ by up to 17.2 + 9.2 arcsec, no more."""
    time = astropy_time(TIMES[1:2])
    ours = frames.rotation_TN(TIMES[1]).as_matrix()[0]
    mean = np.stack(
        [
            GCRS(CartesianRepresentation(axis * u.km), obstime=time[0])
            .transform_to(PrecessedGeocentric(equinox=time[0], obstime=time[0]))
            .cartesian.xyz.to_value(u.km)
            for axis in np.eye(3)
        ],
        axis=1,
    )
    close(ours, mean, atol=1.0e-4, unit="rad", because="nutation reaches 17.2 arcsec = 8e-5 rad in longitude")
    with pytest.raises(AssertionError):
        close(ours.T, mean, atol=1.0e-4, unit="rad", because="the transpose must fail")


def test_sun(close):
    theirs = get_sun(astropy_time(TIMES)).cartesian.xyz.to_value(u.km).T
    ours = sun.sun_N_km(TIMES)
    arcsec_km = np.radians(1.0 / 3600.0) * 1.5e8
    bound = {"atol": 0.01 * arcsec_km, "unit": "km", "because": "0.01 arcsec; TDB as TT is 0.002 s = 1e-4 arcsec"}
    close(ours, theirs, **bound)
    geometric = sun.sun_N_km(TIMES - np.timedelta64(499, "s"))
    for mutant in (-theirs, 1.01 * theirs, theirs[:, [0, 2, 1]], geometric):
        with pytest.raises(AssertionError):
            close(mutant, ours, **bound)


def test_teme_to_gcrs(close):
    r_km = positions()
    time = astropy_time(TIMES)
    there = TEME(CartesianRepresentation(r_km.T * u.km), obstime=time).transform_to(GCRS(obstime=time))
    expected = there.cartesian.xyz.to_value(u.km).T
    R = tle.rotation_N_TEME(TIMES)
    bound = {"atol": 1e-6, "unit": "km", "because": "rounding of days in astropy's sidereal time, 5e-11 rad"}
    close(R.apply(r_km), expected, **bound)
    true_of_date = frames.rotation_TN(TIMES).inv().apply(r_km)
    for mutant in (R.inv().apply(r_km), r_km, true_of_date):
        with pytest.raises(AssertionError):
            close(mutant, expected, **bound)


def test_teme_does_not_depend_on_ut1(close):
    """A second of UT1 turns the Earth by 15 arcsec, but TEME goes to GCRS and never stays on the Earth."""
    time = astropy_time(TIMES)
    shifted = astropy_time(TIMES)
    shifted.delta_ut1_utc = 0.8
    teme = CartesianRepresentation(positions().T * u.km)
    here = TEME(teme, obstime=time).transform_to(GCRS(obstime=time)).cartesian.xyz.to_value(u.km)
    there = TEME(teme, obstime=shifted).transform_to(GCRS(obstime=shifted)).cartesian.xyz.to_value(u.km)
    close(here, there, atol=1e-4, unit="km", because="0.8 s of the precession that separates the two angles")


def test_geodetic_coordinates(close):
    lat = np.radians([-90.0, -89.9, -45.0, 0.0, 12.5, 67.0, 90.0])
    lon = np.radians([0.0, 120.0, -179.0, 10.0, 45.0, -70.0, 0.0])
    alt = np.array([0.0, 800.0, 432.1, -0.1, 6000.0, 36000.0, 500.0])
    place = EarthLocation.from_geodetic(lon * u.rad, lat * u.rad, alt * u.km, ellipsoid="WGS84")
    expected = np.stack([place.x.to_value(u.km), place.y.to_value(u.km), place.z.to_value(u.km)], axis=1)
    ours = frames.from_geodetic(lat, lon, alt)
    bound = {"atol": 1e-8, "unit": "km", "because": "rounding of 4e4 km"}
    close(ours, expected, **bound)
    back = frames.geodetic(ours)
    close(back[0], lat, atol=1e-10, unit="rad", because="one step of Fukushima 2006: 1e-11 rad at 36,000 km")
    close(back[2], alt, atol=1e-8, unit="km", because="rounding of 4e4 km")
    with pytest.raises(AssertionError):  # geocentric latitude taken for geodetic: up to 21 km
        close(frames.from_geocentric(lat, lon, np.linalg.norm(expected, axis=1)), expected, **bound)
