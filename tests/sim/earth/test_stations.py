"""Stations and their passes, against geometry on paper and against brute force."""

from __future__ import annotations

import numpy as np
import pytest
from astropy import coordinates, units

from fluxtwin.sim.base.errors import BadInput
from fluxtwin.sim.earth import epoch, frames
from fluxtwin.sim.earth.constants import EARTH_RADIUS_KM
from fluxtwin.sim.earth.orbit import Orbit
from fluxtwin.sim.earth.stations import Station, find_contacts, in_view

pytestmark = pytest.mark.reference

START = np.datetime64("2020-03-20T00:00:00", "ns")


def at(
    name: str, latitude_deg: float, longitude_deg: float, mask_deg: float = 0.0, altitude_km: float = 0.0
) -> Station:
    return Station(name, np.radians(latitude_deg), np.radians(longitude_deg), altitude_km, np.radians(mask_deg))


def low_orbit(inclination_deg: float) -> Orbit:
    return Orbit(
        epoch_utc=START,
        altitude_km=700.0,
        inclination_rad=np.radians(inclination_deg),
        raan_rad=0.3,
        argument_of_latitude_rad=0.0,
    )


def test_straight_above_is_ninety_degrees_and_the_horizon_is_level(close):
    for latitude in (-90.0, -35.0, 0.0, 52.0):
        station = at("x", latitude, 20.0)
        overhead = frames.from_geodetic(np.radians([latitude]), np.radians([20.0]), np.array([500.0]))
        close(
            np.degrees(station.elevation_rad(overhead)), 90.0, atol=1e-4, unit="deg", because="rounding of an arcsine"
        )
        east = np.cross([0.0, 0.0, 1.0], station.up_E) if abs(latitude) < 90 else np.array([1.0, 0.0, 0.0])
        level = station.r_E_km + 300.0 * east / np.linalg.norm(east)
        close(np.degrees(station.elevation_rad(level[None, :])), 0.0, atol=1e-9, unit="deg", because="rounding")


def test_elevation_against_astropy(close):
    """Witness: astropy's horizontal frame of the same places, geometric, without refraction."""
    station = at("x", 38.9984, 283.1573, altitude_km=0.05)
    rng = np.random.default_rng(5)
    offset = rng.normal(size=(50, 3)) * 900.0
    r_E_km = station.r_E_km + offset
    place = coordinates.EarthLocation.from_geodetic(283.1573 * units.deg, 38.9984 * units.deg, 50.0 * units.m)
    north_east_up = place.to_geodetic()
    lat, lon = north_east_up.lat.rad, north_east_up.lon.rad
    up = np.array([np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)])
    line = r_E_km - np.array([c.to_value(units.km) for c in (place.x, place.y, place.z)])
    expected = np.degrees(np.arcsin(line @ up / np.linalg.norm(line, axis=1)))
    close(np.degrees(station.elevation_rad(r_E_km)), expected, atol=1e-6, unit="deg", because="same WGS 84 point")


def test_length_of_an_overhead_pass_is_that_of_the_textbook(close):
    """Equatorial orbit, equatorial station: the central angle from rise to set is 2 acos(R/a) at zero elevation, and with
    a mask e it is 2 (acos(R cos e / a) - e) (Wertz & Larson, SMAD, section 5.2), run through at the rate of the orbit less
    that of the Earth."""
    orbit = low_orbit(0.0)
    rate = 2 * np.pi / orbit.nodal_period_s + orbit.rates.raan_rad_s - 7.292115e-5
    for mask_deg in (0.0, 10.0, 30.0):
        mask = np.radians(mask_deg)
        arc = 2 * (np.arccos(EARTH_RADIUS_KM * np.cos(mask) / orbit.semi_major_axis_km) - mask)
        found = find_contacts([at("x", 0.0, 100.0, mask_deg)], orbit.propagate, START, START + np.timedelta64(5, "h"))
        whole = [c for c in found if not c.cut]
        assert len(whole) >= 2
        for contact in whole:
            close(
                contact.seconds, arc / rate, atol=0.5, unit="s", because="true equator of date leans 0.1 deg to GCRS's"
            )
            close(np.degrees(contact.highest_rad), 90.0, atol=0.2, unit="deg", because="the equator leans to GCRS's")


def test_contacts_against_brute_force(close):
    orbit = low_orbit(98.0)
    stations = [at("north", 64.97, 212.49, 5.0), at("south", -35.63, 148.96), at("middle", 40.0, 0.0, 20.0)]
    found = find_contacts(stations, orbit.propagate, START, START + np.timedelta64(36, "h"))
    time = epoch.add_seconds(START, np.arange(0.0, 36 * 3600.0 + 0.5, 1.0))
    height = in_view(stations, frames.rotation_EN(time).apply(orbit.propagate(time)[0]))
    for column, station in enumerate(stations):
        up = height[:, column] > 0
        mine = [c for c in found if c.station == station.name]
        edges = np.flatnonzero(up[1:] != up[:-1])
        assert sum(2 - int(c.cut) for c in mine) == edges.size
        close(sum(c.seconds for c in mine), up.sum(), atol=1.0 * len(mine) + 1.0, unit="s", because="one-second steps")
        for contact in mine:
            inside = (time >= contact.rise) & (time <= contact.set)
            top = np.degrees(height[inside, column].max()) + np.degrees(station.mask_rad)
            close(np.degrees(contact.highest_rad), top, atol=0.3, unit="deg", because="brute force steps 1 s")
    assert [c.rise for c in found] == sorted(c.rise for c in found)


def test_a_grazing_pass_shorter_than_the_step_is_not_lost():
    """The mask is put just under the highest point of a pass, so that a few seconds remain."""
    orbit = low_orbit(98.0)
    end = START + np.timedelta64(12, "h")
    plain = max(find_contacts([at("x", 40.0, 0.0)], orbit.propagate, START, end), key=lambda c: c.highest_rad)
    mask_deg = np.degrees(plain.highest_rad) - 0.02
    (left,) = find_contacts([at("x", 40.0, 0.0, mask_deg)], orbit.propagate, START, end)
    assert 0.0 < left.seconds < 20.0
    assert plain.rise < left.rise < left.set < plain.set


def test_a_pass_that_the_span_cuts_is_marked():
    orbit = low_orbit(98.0)
    first = find_contacts([at("x", 64.97, 212.49)], orbit.propagate, START, START + np.timedelta64(12, "h"))[0]
    middle = first.rise + (first.set - first.rise) // 2
    (cut,) = find_contacts([at("x", 64.97, 212.49)], orbit.propagate, middle, middle + np.timedelta64(30, "m"))
    assert cut.cut
    assert cut.rise == middle


@pytest.mark.parametrize("hours", [0, -1, 401 * 24])
def test_an_impossible_span_is_refused(hours):
    with pytest.raises(BadInput, match="span"):
        find_contacts([at("x", 0.0, 0.0)], low_orbit(98.0).propagate, START, START + np.timedelta64(hours, "h"))
