"""The horizon of an ellipsoid in closed form against rays that touch it, and what scanners make of it."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import brentq
from scipy.spatial.transform import Rotation

from fluxtwin.sim.earth import frames, horizon
from fluxtwin.sim.spacecraft.sensors.horizon_scanner import ConicalScanner, HorizonScannerSection

pytestmark = pytest.mark.reference

HCMM_KM, NORTH = 6997.0, np.array([0.0, 0.0, 1.0])


def at(day: str, count: int) -> np.ndarray:
    return np.full(count, np.datetime64(day, "ns"))


def circle(radius_km: float, inclination_deg: float, count: int = 181) -> tuple[np.ndarray, np.ndarray]:
    u, i = np.linspace(0.0, 2.0 * np.pi, count), np.radians(inclination_deg)
    r = np.stack([np.cos(u), np.sin(u) * np.cos(i), np.sin(u) * np.sin(i)], axis=1)
    v = np.stack([-np.sin(u), np.cos(u) * np.cos(i), np.cos(u) * np.sin(i)], axis=1)
    return radius_km * r, 7.5 * v


def errors_deg(axes, seen, assumed, day="1978-11-30", radius_km=HCMM_KM):
    """Roll and pitch error (N, 2) of a body on its axes."""
    r, v = circle(radius_km, 97.6)
    time, pole, R_ON = at(day, len(r)), np.tile(NORTH, (len(r), 1)), frames.rotation_ON(r, v)
    surfaces = (horizon.surface(name, time) for name in (seen, assumed))
    return np.degrees(frames.roll_pitch(ConicalScanner(axes).nadir(r, pole, R_ON, R_ON, *surfaces)))


@pytest.mark.parametrize("name", horizon.SURFACES)
def test_the_closed_form_is_where_a_ray_touches(name, close):
    """Witness: stretched to a unit sphere, the ray passes the surface at no distance at the angle of the formula."""
    rng = np.random.default_rng(7)
    for _ in range(20):
        r = rng.standard_normal(3)
        r *= rng.uniform(6700.0, 9000.0) / np.linalg.norm(r)
        nadir = -r / np.linalg.norm(r)
        towards = np.cross(nadir, rng.standard_normal(3))
        towards /= np.linalg.norm(towards)
        seen = horizon.surface(name, at("1978-01-15", 1))
        radius, shift = np.ravel(seen.radius_km)[0], np.ravel(seen.shift_km)[0]
        stretch = np.array([1.0, 1.0, 1.0 / (1.0 - np.ravel(seen.flattening)[0])]) / radius

        def clearance(angle, p=(r - [0.0, 0.0, shift]) * stretch, nadir=nadir, towards=towards, stretch=stretch):
            d = (np.cos(angle) * nadir + np.sin(angle) * towards) * stretch
            return np.linalg.norm(p - d * (p @ d) / (d @ d)) - 1.0

        touching = brentq(clearance, 0.3, 1.55, xtol=1e-13)
        found = horizon.nadir_angle(horizon.tangent_cone(seen, r[None], NORTH[None]), nadir[None], towards[None])
        close(found[0], touching, atol=1e-10, unit="rad", because="both exact; the root to 1e-13")


def test_the_horizon_at_the_equator_and_over_a_pole(close):
    """By hand: from the equatorial plane along it, and from over the pole, the sections of the ellipsoid are known."""
    a, f, r = horizon.EARTH_RADIUS_KM, horizon.EARTH_FLATTENING, HCMM_KM
    earth = horizon.surface("ellipsoid", at("1978-11-30", 1))
    b = a * (1.0 - f)
    position, pole = np.array([[r, 0.0, 0.0], [r, 0.0, 0.0], [0.0, 0.0, r]]), np.tile(NORTH, (3, 1))
    towards = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])
    found = horizon.nadir_angle(horizon.tangent_cone(earth, position, pole), -position / r, towards)
    expected = [np.arcsin(a / r), np.arctan(b / np.sqrt(r**2 - a**2)), np.arctan(a / np.sqrt(r**2 - b**2))]
    close(found, expected, atol=1e-12, unit="rad", because="tangent to a circle and to two ellipses")


@pytest.mark.parametrize("axes", [(1, -1), (1,), (-1,)])
def test_a_scanner_that_knows_its_earth_finds_nadir(axes):
    r, v = circle(HCMM_KM, 97.6)
    time, pole, R_ON = at("1978-11-30", len(r)), np.tile(NORTH, (len(r), 1)), frames.rotation_ON(r, v)
    ball = horizon.surface("sphere", time)
    R_BN = Rotation.from_rotvec(np.random.default_rng(1).uniform(-0.3, 0.3, (len(r), 3))) * R_ON
    found = ConicalScanner(axes).nadir(r, pole, R_BN, R_ON, ball, ball)
    assert np.abs(found - R_BN.apply(-r / HCMM_KM)).max() < 1e-12  # any attitude, on a sphere
    assert np.abs(errors_deg(axes, "ellipsoid", "ellipsoid")).max() < 1e-9  # corrected: nothing is left on the axes


def test_the_flattening_costs_what_the_horizon_moves(close):
    """One scanner reads a lower horizon as roll, a pair does not; and half an orbit on, a centred ellipsoid is seen as by a
    scanner on the other side, in a mirror."""
    pair, one, other = (errors_deg(axes, "ellipsoid", "sphere")[:-1] for axes in ((1, -1), (1,), (-1,)))
    assert 0.1 < np.abs(pair[:, 1]).max() < 0.2
    assert np.ptp(one[:, 0]) > 4.0 * np.ptp(pair[:, 0])
    mirrored = np.roll(one, 90, axis=0) * [-1.0, 1.0]
    close(other, mirrored, atol=1e-9, unit="deg", because="the point reflection of an ellipsoid is the same ellipsoid")


def test_radiance_alone_errs_by_what_others_computed():
    """A study of 1980 (1980STIN...8115014P, abstract): edge scanners at 900 km in a polar orbit err by at most 0.06 deg in
    pitch and 0.03 deg in roll. Another scanner and another atmosphere, so the order is asked: a factor of 2.5."""
    found = [
        np.abs(errors_deg((1, -1), "infrared", "ellipsoid", day, 7278.0)).max(axis=0)
        for day in ("1978-01-15", "1978-04-15", "1978-07-15", "1978-10-15")
    ]
    roll, pitch = np.max(found, axis=0)
    assert 0.03 / 2.5 < roll < 0.03 * 2.5
    assert 0.06 / 2.5 < pitch < 0.06 * 2.5


def test_the_horizon_is_higher_towards_the_summer_pole():
    r = np.array([[0.0, 0.0, HCMM_KM], [0.0, 0.0, -HCMM_KM]])
    pole, towards = np.tile(NORTH, (2, 1)), np.tile([1.0, 0.0, 0.0], (2, 1))
    for day, summer in (("1978-06-21", 0), ("1978-12-21", 1)):
        cone = horizon.tangent_cone(horizon.surface("infrared", at(day, 2)), r, pole)
        angle = horizon.nadir_angle(cone, -r / HCMM_KM, towards)
        assert angle[summer] > angle[1 - summer] + np.radians(0.05)


def test_a_scan_that_misses_the_earth_gives_nothing():
    r = np.array([[0.0, 0.0, 8.0e4]])
    R = frames.rotation_ON(r, np.array([[1.0, 0.0, 0.0]]))
    ball = horizon.surface("sphere", at("1978-06-21", 1))
    assert np.isnan(ConicalScanner().nadir(r, NORTH[None], R, R, ball, ball)).all()


def test_a_scanner_of_a_scenario_has_its_cone_in_radians():
    found = HorizonScannerSection(scans="-y", half_cone_deg=30.0).conical
    assert (found.axes, found.half_cone_rad) == ((-1,), pytest.approx(np.pi / 6.0))
