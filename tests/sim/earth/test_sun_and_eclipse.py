"""The sun against published values, and the Earth's shadow against geometry."""

from __future__ import annotations

import numpy as np
import pytest

from fluxtwin.sim.earth import epoch, frames, sun
from fluxtwin.sim.earth.constants import AU_KM, EARTH_RADIUS_KM, GM_EARTH_KM3_S2, SUN_RADIUS_KM

pytestmark = pytest.mark.reference

SUN_KM = AU_KM * np.array([1.0, 0.0, 0.0])


def of_date(time):
    """Right ascension and declination on the true equator and equinox of date, distance."""
    s = frames.rotation_TN(time).apply(sun.sun_N_km(time))
    distance = np.linalg.norm(s, axis=1)
    return np.arctan2(s[:, 1], s[:, 0]) % (2 * np.pi), np.arcsin(s[:, 2] / distance), distance


def test_meeus_example_of_full_vsop87(close):
    """Meeus, Astronomical Algorithms, 2nd ed., chapter 25: 1992 October 13, 0 h TD, complete VSOP87.

    Apparent right ascension 13 h 13 min 30.749 s, declination -7 deg 47' 01.74", radius vector 0.99760853 au.
    """
    time = np.datetime64("1992-10-12T23:59:00.816", "ns")  # TT - UTC = 32.184 + 27 s
    alpha, delta, distance = of_date(time)
    expected = np.radians(15 * (13 + 13 / 60 + 30.749 / 3600)), -np.radians(7 + 47 / 60 + 1.74 / 3600)
    bound = {"atol": np.radians(0.2 / 3600), "unit": "rad", "because": "0.2 arcsec between theories and frames"}
    close(alpha, expected[0], **bound)
    close(delta, expected[1], **bound)
    close(distance / AU_KM, 0.99760853, atol=3e-7, unit="au", because="VSOP87 as printed, theories differ by 1e-7")
    geometric = alpha + np.radians(20.5 / 3600)
    for mutant in (alpha * 1.01, -alpha, geometric):
        with pytest.raises(AssertionError):
            close(mutant, expected[0], **bound)


def test_low_precision_formula_of_the_almanac(close):
    """Astronomical Almanac, page C5: 0.01 deg between 1950 and 2050 (0.02 deg allowed: its own rounding)."""
    times = np.datetime64("1955-01-01", "ns") + np.arange(0, 90 * 365, 97).astype("timedelta64[D]")
    n = epoch.days_mjd2000(times) - 0.5
    g = np.radians(357.528 + 0.9856003 * n)
    longitude = np.radians(280.460 + 0.9856474 * n + 1.915 * np.sin(g) + 0.020 * np.sin(2 * g))
    obliquity = np.radians(23.439 - 0.0000004 * n)
    expected = np.stack(
        [np.cos(longitude), np.cos(obliquity) * np.sin(longitude), np.sin(obliquity) * np.sin(longitude)], axis=1
    )
    ours = frames.rotation_TN(times).apply(sun.sun_direction_N(times))
    bound = {"atol": np.radians(0.02), "unit": "rad", "because": "twice the accuracy the Almanac states"}
    close(ours, expected, **bound)
    distance_au = np.linalg.norm(sun.sun_N_km(times), axis=1) / AU_KM
    close(
        distance_au,
        1.00014 - 0.01671 * np.cos(g) - 0.00014 * np.cos(2 * g),
        atol=3e-4,
        unit="au",
        because="no lunar term in the formula, constants rounded",
    )
    for mutant in (-ours, ours[:, [0, 2, 1]], sun.sun_direction_N(times + np.timedelta64(1, "D"))):
        with pytest.raises(AssertionError):
            close(mutant, expected, **bound)


def test_parallax(close):
    time = np.datetime64("1978-09-01", "ns")
    centre = sun.sun_direction_N(time)[0]
    aside = np.cross(centre, [0.0, 0.0, 1.0])
    aside *= 7168.0 / np.linalg.norm(aside)
    seen = sun.sun_direction_N(time, aside)[0]
    shift = np.arccos(np.clip(seen @ centre, -1, 1))
    expected = 7168.0 / np.linalg.norm(sun.sun_N_km(time)[0])
    close(shift, expected, atol=2e-8, unit="rad", because="arccos near 1 resolves 1.5e-8 rad")
    assert (seen - centre) @ aside < 0


def ring(radius_km, beta_rad, points=40_001):
    """Positions along a circular orbit whose plane lies `beta` from the sun, which is along x."""
    u = np.linspace(-np.pi, np.pi, points)
    towards = np.array([np.cos(beta_rad), 0.0, np.sin(beta_rad)])
    return radius_km * (np.outer(np.cos(u), towards) + np.outer(np.sin(u), [0.0, 1.0, 0.0]))


def eclipse_fraction(radius_km, beta_rad, earth_km=EARTH_RADIUS_KM):
    """Share of a circular orbit in the shadow of a sphere lit by a point sun at infinity (Wertz 1978, 3.5)."""
    root = (earth_km / radius_km) ** 2 - np.sin(beta_rad) ** 2
    return np.arcsin(np.sqrt(max(root, 0.0)) / np.cos(beta_rad)) / np.pi


@pytest.mark.parametrize("radius_km", [6778.0, 7168.0, 12000.0, 42164.0])
@pytest.mark.parametrize("beta_deg", [0.0, 5.0, 25.0, 55.0, 75.0])
def test_eclipse_fraction_of_a_circular_orbit(close, radius_km, beta_deg):
    beta = np.radians(beta_deg)
    edge = np.degrees(np.arcsin(EARTH_RADIUS_KM / radius_km))
    assert abs(beta_deg - edge) > 1.0, "too close to a grazing shadow for the tolerance"
    lit = sun.illumination(ring(radius_km, beta), np.broadcast_to(SUN_KM, (40_001, 3))) > 0.5
    because = "half a disc is hidden where the limb crosses its centre; the sampling and the parallax, 5e-5 each"
    found = 1.0 - lit.mean()
    close(found, eclipse_fraction(radius_km, beta), atol=2e-4, unit="orbit", because=because)
    if found > 0:
        with pytest.raises(AssertionError):
            wrong = eclipse_fraction(radius_km, beta, 1.01 * EARTH_RADIUS_KM)
            close(found, wrong, atol=2e-4, unit="orbit", because="an Earth 1 % larger must fail")


def test_penumbra_is_crossed_in_a_solar_diameter(close):
    """The Earth's limb sweeps over the sun at the orbital rate when the sun lies in the plane."""
    radius = 7168.0
    positions = ring(radius, 0.0, 400_001)
    seen = sun.illumination(positions, np.broadcast_to(SUN_KM, positions.shape))
    rate = np.sqrt(GM_EARTH_KM3_S2 / radius**3)
    partial_s = np.mean((seen > 0) & (seen < 1)) * 2 * np.pi / rate / 2
    expected_s = 2 * np.arcsin(SUN_RADIUS_KM / AU_KM) / rate
    close(partial_s, expected_s, atol=0.04, unit="s", because="sampled every 0.015 s at four edges")
    assert expected_s == pytest.approx(8.9, abs=0.1)


@pytest.mark.parametrize("radius_km", [6778.0, 7168.0, 42164.0])
def test_fraction_against_rays_to_the_disc(close, radius_km):
    """The disc of the sun as 40,000 points, each hidden if its ray meets the sphere: no flat-disc formula."""
    limb = np.arccos(-np.sqrt(1 - (EARTH_RADIUS_KM / radius_km) ** 2))
    width = SUN_RADIUS_KM / AU_KM
    angles = limb + width * np.linspace(-1.3, 1.3, 27)
    positions = radius_km * np.stack([np.cos(angles), np.sin(angles), np.zeros_like(angles)], axis=1)
    side = (np.arange(225) + 0.5) / 225 * 2 - 1
    a, b = (g.ravel() for g in np.meshgrid(side, side))
    inside = np.hypot(a, b) < 1
    points = SUN_KM + SUN_RADIUS_KM * np.stack([np.zeros(inside.sum()), a[inside], b[inside]], axis=1)
    expected = []
    for r in positions:
        ray = points - r
        ray /= np.linalg.norm(ray, axis=1)[:, None]
        along = ray @ r
        hidden = (along < 0) & (r @ r - along**2 < EARTH_RADIUS_KM**2)
        expected.append(1 - hidden.mean())
    found = sun.illumination(positions, np.broadcast_to(SUN_KM, positions.shape))
    assert min(expected) == 0.0
    assert max(expected) == 1.0
    because = "flat discs 0.001; a row of sampling points is 0.0045 of the disc"
    close(found, expected, atol=0.006, unit="disc", because=because)
    with pytest.raises(AssertionError):
        close(1 - found, expected, atol=0.006, unit="disc", because="light and shadow swapped must fail")


def test_umbra_ends_in_a_point(close):
    """Similar triangles: the umbra is R a / (Rs - R) long, 1.384 million km; beyond it a ring of sun is seen."""
    length = EARTH_RADIUS_KM * AU_KM / (SUN_RADIUS_KM - EARTH_RADIUS_KM)
    behind = np.array([[-x, 0.0, 0.0] for x in (0.5 * length, 0.99 * length, 1.2 * length)])
    seen = sun.illumination(behind, np.broadcast_to(SUN_KM, (3, 3)))
    assert seen[0] == 0
    assert seen[1] == 0
    ring_seen = 1 - (EARTH_RADIUS_KM * (AU_KM + 1.2 * length) / (1.2 * length * SUN_RADIUS_KM)) ** 2
    close(seen[2], ring_seen, atol=1e-4, unit="disc", because="sine against tangent of half a degree")


def test_a_missing_position_gives_a_missing_answer():
    rows = np.array([[7000.0, 0.0, 0.0], [np.nan, 0.0, 0.0], [-7000.0, 0.0, 0.0]])
    lit = sun.illumination(rows, np.broadcast_to(SUN_KM, (3, 3)))
    assert lit[0] == 1.0
    assert np.isnan(lit[1])
    assert lit[2] == 0.0
