"""The J2 orbit against textbook rates, an integrated trajectory, and its own derivative."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import least_squares

from fluxtwin.sim.earth import epoch, frames
from fluxtwin.sim.earth.constants import EARTH_RADIUS_KM, GM_EARTH_KM3_S2, J2_EARTH
from fluxtwin.sim.earth.orbit import Orbit, argument_of_latitude, eccentric_anomaly, kepler_period_s, orbital_rates

pytestmark = pytest.mark.reference

START = np.datetime64("1978-07-24T06:00:00", "ns")
DEG_PER_DAY = np.degrees(1.0) * 86400.0


def orbit(a_km=7168.0, e=0.0, i_deg=108.0, raan=1.0, perigee=0.6, latitude=0.6):
    return Orbit(
        epoch_utc=START,
        altitude_km=a_km - EARTH_RADIUS_KM,
        eccentricity=e,
        inclination_rad=np.radians(i_deg),
        raan_rad=raan,
        argument_of_perigee_rad=perigee,
        argument_of_latitude_rad=latitude,
    )


@pytest.mark.parametrize(("a", "e", "i_deg"), [(7168, 0.0, 108), (26560, 0.74, 63.4), (6778, 0.001, 51.6)])
def test_rates_against_printed_constants(close, a, e, i_deg):
    """Larson & Wertz, Space Mission Analysis and Design, 3rd ed., eqs. 6-19 and 6-20 [deg/day, km]."""
    i = np.radians(i_deg)
    rates = orbital_rates(a, e, i)
    node = -2.06474e14 * a**-3.5 * np.cos(i) * (1 - e**2) ** -2
    perigee = 1.03237e14 * a**-3.5 * (4 - 5 * np.sin(i) ** 2) * (1 - e**2) ** -2
    because = "the printed constants hold six figures and an older J2: 2e-5 of the rate, 1e-4 deg/day"
    close(rates.raan_rad_s * DEG_PER_DAY, node, atol=1e-4, unit="deg/day", because=because)
    close(rates.argument_of_perigee_rad_s * DEG_PER_DAY, perigee, atol=1e-4, unit="deg/day", because=because)
    for mutant in (-node, 1.01 * node):
        with pytest.raises(AssertionError):
            close(rates.raan_rad_s * DEG_PER_DAY, mutant, atol=1e-4, unit="deg/day", because=because)


def test_known_orbits(close):
    """Sun-synchronous at 800 km: i = 98.6 deg turns with the mean sun, 0.9856 deg/day. Molniya: 63.43 deg."""
    node = orbital_rates(EARTH_RADIUS_KM + 800.0, 0.0, np.radians(98.6)).raan_rad_s * DEG_PER_DAY
    close(node, 0.9856, atol=0.006, unit="deg/day", because="the inclination is printed to 0.05 deg")
    critical = orbital_rates(26560.0, 0.74, np.arcsin(np.sqrt(0.8))).argument_of_perigee_rad_s
    close(critical * DEG_PER_DAY, 0.0, atol=1e-12, unit="deg/day", because="5 cos^2 i = 1 exactly")


def test_seasat_period(close):
    """Seasat in the papers: a = 7168 km, i = 108 deg, 100.66 min; with J2 the nodal period is longer."""
    speed_km_s = np.sqrt(GM_EARTH_KM3_S2 / 7168.0)
    kepler_min = kepler_period_s(np.array([7168.0, 0.0, 0.0]), np.array([0.0, 0.0, speed_km_s])) / 60.0
    assert kepler_period_s(np.array([7168.0, 0.0, 0.0]), np.array([0.0, 0.0, 1.5 * speed_km_s])) == np.inf
    close(kepler_min, 100.66, atol=0.005, unit="min", because="printed to 0.01 min")
    k = 1.5 * J2_EARTH * (EARTH_RADIUS_KM / 7168.0) ** 2
    textbook = kepler_min * (1 - k * (4 * np.cos(np.radians(108.0)) ** 2 - 1))  # first order in J2, e = 0
    nodal_min = orbit().nodal_period_s / 60.0
    close(nodal_min, textbook, atol=2e-4, unit="min", because="second order, J2^2 of 100 min")
    with pytest.raises(AssertionError):
        close(nodal_min, kepler_min, atol=2e-4, unit="min", because="without J2 it must fail")


def test_kepler_equation_of_the_textbooks(close):
    """Vallado, Fundamentals of Astrodynamics, example 2-1: M = 235.4 deg, e = 0.4, E = 220.512074 deg."""
    E = np.degrees(eccentric_anomaly(np.radians([235.4]), 0.4))
    close(E, 220.512074, atol=1e-6, unit="deg", because="printed to 1e-6 deg")


@pytest.mark.parametrize("e", [0.0, 1e-9, 0.01, 0.5, 0.9, 0.999, 0.9999999])
def test_kepler_equation_is_solved_everywhere(close, e):
    M = np.concatenate([np.linspace(-20.0, 20.0, 4001), np.pi * np.arange(-3, 4), [1e-9, -1e-9, 1e-3]])
    E = eccentric_anomaly(M, e)
    close(E - e * np.sin(E), M, atol=1e-14, unit="rad", because="rounding of 20 rad")
    assert (np.diff(E[:4001]) > 0).all()


@pytest.mark.parametrize("e", [0.0, 0.1, 0.7])
def test_velocity_is_the_derivative_of_the_position(close, e):
    flying = orbit(a_km=26560.0 if e == 0.7 else 7500.0, e=e)
    times = epoch.add_seconds(START, np.linspace(0.0, 90000.0, 300))
    second = np.timedelta64(1, "s")
    r = {k: flying.propagate(times + k * second)[0] for k in (-2, -1, 1, 2)}
    numerical = (8 * (r[1] - r[-1]) - (r[2] - r[-2])) / 12
    v = flying.propagate(times)[1]
    bound = {"atol": 1e-9, "unit": "km/s", "because": "five points, 1 s apart: a n^5/30 and the rounding of r"}
    close(v, numerical, **bound)
    node_only = v - flying.rates.raan_rad_s * np.cross([0.0, 0.0, 1.0], flying.propagate(times)[0])
    for mutant in (node_only, 1.01 * v, -v):  # without the turning of the plane it is off by metres a second
        with pytest.raises(AssertionError):
            close(mutant, numerical, **bound)


def test_elements_come_back_on_the_axes_of_date(close):
    """Angles from the state itself, on the true equator; in 1978 GCRS axes are 0.3 deg away from it."""
    flying = orbit(e=0.05)
    r_N, v_N = flying.propagate(START)
    T = frames.rotation_TN(START)

    def elements(r, v):
        # The mean plane: take the turning of the node out of the velocity before the normal is formed.
        v = v - flying.rates.raan_rad_s * np.cross([0.0, 0.0, 1.0], r)
        h = np.cross(r, v)[0]
        return np.array([np.arccos(h[2] / np.linalg.norm(h)), np.arctan2(h[0], -h[1])])

    expected = [flying.inclination_rad, flying.raan_rad]
    bound = {"atol": 1e-12, "unit": "rad", "because": "rounding"}
    close(elements(T.apply(r_N), T.apply(v_N)), expected, **bound)
    off = np.degrees(np.abs(elements(r_N, v_N) - expected)).max()
    assert 0.1 < off < 0.4
    with pytest.raises(AssertionError):
        close(elements(r_N, v_N), expected, **bound)


def test_radius_of_an_elliptic_orbit(close):
    flying = orbit(a_km=8000.0, e=0.1, perigee=0.3, latitude=0.3)
    r0 = np.linalg.norm(flying.propagate(START)[0])
    close(r0, 7200.0, atol=1e-9, unit="km", because="a (1 - e) at perigee")
    half = epoch.add_seconds(START, np.pi / flying.rates.mean_anomaly_rad_s)
    close(np.linalg.norm(flying.propagate(half)[0]), 8800.0, atol=1e-9, unit="km", because="a (1 + e) at apogee")


def test_node_to_node_takes_the_nodal_period(close):
    flying = orbit(latitude=0.0, perigee=0.0)
    crossings = epoch.add_seconds(START, flying.nodal_period_s * np.arange(15))
    r_T = frames.rotation_TN(START).apply(flying.propagate(crossings)[0])
    close(r_T[:, 2], 0.0, atol=1e-5, unit="km", because="stamps are cut to 1 ns, 7e-9 km, and rounding of a day")
    node = np.unwrap(np.arctan2(r_T[:, 1], r_T[:, 0]))
    drift = (node[-1] - node[0]) / (14 * flying.nodal_period_s)
    close(drift * DEG_PER_DAY, flying.rates.raan_rad_s * DEG_PER_DAY, atol=1e-6, unit="deg/day", because="rounding")


def test_argument_of_latitude(close):
    flying = orbit(latitude=4.0, perigee=0.0)
    times = epoch.add_seconds(START, flying.nodal_period_s * np.array([0.0, 0.25, 0.9]))
    u = argument_of_latitude(times, *flying.propagate(times))
    expected = (4.0 + 2 * np.pi * np.array([0.0, 0.25, 0.9])) % (2 * np.pi)
    because = "the velocity of the turning plane leans by up to 0.05 deg; at i = 108 deg its node moves 4e-4 rad"
    close(u, expected, atol=1e-3, unit="rad", because=because)
    with pytest.raises(AssertionError):
        close(-u, expected, atol=1e-3, unit="rad", because=because)
    equatorial = orbit(i_deg=0.0, raan=0.5, latitude=0.25, perigee=0.0)
    around = argument_of_latitude(START, *equatorial.propagate(START))
    close(np.sin(around), np.sin(0.75), atol=1e-9, unit="1", because="no node: counted from the equinox")


def test_leap_second_moves_the_spacecraft_by_its_velocity(close):
    """1 January 1979 came one second late: a satellite is 7.5 km further than a clock without it would say."""
    before = Orbit(
        epoch_utc=np.datetime64("1978-12-31T12:00:00", "ns"),
        altitude_km=790.0,
        inclination_rad=np.radians(108.0),
        raan_rad=0.0,
    )
    midnight = np.datetime64("1979-01-01T00:00:00", "ns")
    r, v = before.propagate(midnight)
    earlier = before.propagate(midnight - np.timedelta64(1, "s"))[0]  # 23:59:59 is two seconds before
    close(np.linalg.norm(r - earlier), 2 * np.linalg.norm(v), atol=0.01, unit="km", because="curvature, n^2 r 2^2/2")


def j2_acceleration(_t, y):
    """Two bodies and J2: Vallado, Fundamentals of Astrodynamics, section 8.6 (axes: pole along z)."""
    r = y[:3]
    size = np.linalg.norm(r)
    k = 1.5 * J2_EARTH * GM_EARTH_KM3_S2 * EARTH_RADIUS_KM**2 / size**5
    z2 = 5 * (r[2] / size) ** 2
    return np.concatenate([y[3:], -GM_EARTH_KM3_S2 * r / size**3 - k * r * np.array([1 - z2, 1 - z2, 3 - z2])])


def from_vector(x):
    e, perigee = np.hypot(x[1], x[2]), np.arctan2(x[2], x[1])
    return Orbit(
        epoch_utc=START,
        altitude_km=x[0] * 7000 - EARTH_RADIUS_KM,
        eccentricity=e,
        inclination_rad=x[3],
        raan_rad=x[4],
        argument_of_perigee_rad=perigee,
        argument_of_latitude_rad=x[5],
    )


@pytest.mark.parametrize(
    ("a", "e", "i_deg"), [(7168, 0.001, 108), (7168, 1e-4, 20), (6998, 0.001, 97.6), (8000, 0.12, 40), (9000, 0.2, 116)]
)
def test_mean_orbit_against_numerical_integration(close, a, e, i_deg):
    """Mean elements matched to six hours of an integrated osculating orbit, then kept for a day.

    What remains is the short-period motion that the mean orbit leaves out, J2 R^2/a = 6 km times a factor
    of order one that depends on the inclination, and the drift from matching: under 15 km over the day.
    """
    start = orbit(a_km=a, e=e, i_deg=i_deg)
    seconds = np.arange(0.0, 86401.0, 120.0)
    times = epoch.add_seconds(START, seconds)
    T = frames.rotation_TN(START)
    y0 = np.concatenate([T.apply(x)[0] for x in start.propagate(START)])
    solved = solve_ivp(j2_acceleration, (0, 86400.0), y0, "DOP853", seconds, rtol=1e-10, atol=1e-8).y.T
    truth_km = T.inv().apply(solved[:, :3])
    head = seconds <= 6 * 3600
    guess = [a / 7000, e * np.cos(0.6), e * np.sin(0.6), np.radians(i_deg), 1.0, 0.6]
    fit = least_squares(
        lambda x: (from_vector(x).propagate(times[head])[0] - truth_km[head]).ravel(), guess, x_scale=1e-3
    )
    matched = from_vector(fit.x)
    because = "short-period J2 terms left out"
    close(matched.propagate(times)[0], truth_km, atol=15.0, unit="km", because=because)
    with pytest.raises(AssertionError):  # the node the wrong way: hundreds of km in a day
        reverse = Orbit(**{**vars(matched), "inclination_rad": np.pi - matched.inclination_rad})
        close(reverse.propagate(times)[0], truth_km, atol=15.0, unit="km", because=because)
    node_truth = node_rate(solved, seconds)
    close(
        matched.rates.raan_rad_s * DEG_PER_DAY,
        node_truth * DEG_PER_DAY,
        atol=0.02,
        unit="deg/day",
        because="second order in J2, and the matched a",
    )


@pytest.mark.parametrize("i_deg", [20.0, 80.0])
def test_perigee_to_perigee_of_an_eccentric_orbit(close, i_deg):
    """Mean anomaly rate against integrated perigee passages, with the mean a from the conserved energy.

    Brouwer's mean a obeys E = -GM/(2 a) + <V>, <V> = GM J2 R^2 / (a^3 (1 - e^2)^1.5) (3/4 sin^2 i - 1/2).
    """
    a, e, i = 23500.0, 0.7, np.radians(i_deg)
    far = a * (1 + e)
    speed = np.sqrt(GM_EARTH_KM3_S2 * (2 / far - 1 / a))
    y0 = np.array([far, 0.0, 0.0, 0.0, speed * np.cos(i), speed * np.sin(i)])  # apogee at the node

    def perigee(_t, y):
        return y[:3] @ y[3:]

    perigee.direction = 1.0
    flown = solve_ivp(j2_acceleration, (0, 6 * 86400.0), y0, "DOP853", rtol=1e-11, atol=1e-8, events=perigee)
    passages = flown.t_events[0]
    passages = passages[passages > 1.0]
    measured_s = (passages[-1] - passages[0]) / (passages.size - 1)
    well = GM_EARTH_KM3_S2 * J2_EARTH * EARTH_RADIUS_KM**2
    energy = speed**2 / 2 - GM_EARTH_KM3_S2 / far + well / far**3 * -0.5  # on the equator P2 = -1/2
    mean_well = well / (a**3 * (1 - e**2) ** 1.5) * (0.75 * np.sin(i) ** 2 - 0.5)
    mean_a = -GM_EARTH_KM3_S2 / (2 * (energy - mean_well))
    expected_s = 2 * np.pi / orbital_rates(mean_a, e, i).mean_anomaly_rad_s
    because = "second order in J2, and the turning perigee: under 1e-6 of the period"
    close(expected_s, measured_s, atol=1e-6 * measured_s, unit="s", because=because)
    with pytest.raises(AssertionError):  # the factor sqrt(1 - e^2) forgotten
        rates = orbital_rates(mean_a, e, i)
        n = np.sqrt(GM_EARTH_KM3_S2 / mean_a**3)
        wrong = n + (rates.mean_anomaly_rad_s - n) / np.sqrt(1 - e**2)
        close(2 * np.pi / wrong, measured_s, atol=1e-6 * measured_s, unit="s", because=because)


def node_rate(states, seconds):
    h = np.cross(states[:, :3], states[:, 3:])
    return np.polyfit(seconds, np.unwrap(np.arctan2(h[:, 0], -h[:, 1])), 1)[0]
