"""Prescribed attitude: rates against the differentiated attitude, statistics of the libration, determinism."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import motions
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from fluxtwin.sim.attitude import record as attitude
from fluxtwin.sim.attitude.libration import Libration, draw_libration
from fluxtwin.sim.attitude.record import Attitude, Waypoint
from fluxtwin.sim.base.errors import BadInput
from fluxtwin.sim.base.random_streams import stream
from fluxtwin.sim.earth import frames
from fluxtwin.sim.earth.constants import EARTH_RADIUS_KM, GM_EARTH_KM3_S2, J2_EARTH
from fluxtwin.sim.earth.orbit import Orbit, argument_of_latitude

pytestmark = pytest.mark.property

START = np.datetime64("1978-07-24T06:00:00", "ns")
ORBIT = Orbit(epoch_utc=START, altitude_km=790.0, inclination_rad=np.radians(108.0), raan_rad=1.0, eccentricity=0.01)
AMPLITUDES = (np.radians(2.0), np.radians(1.0), np.radians(0.5))


def stamps(seconds: np.ndarray) -> np.ndarray:
    return START + np.rint(np.asarray(seconds) * 1e9).astype("int64").astype("timedelta64[ns]")


def earth_pointing(time: np.ndarray) -> Attitude:
    return motions.earth_pointing(
        time,
        *ORBIT.propagate(time),
        yaw_amplitude_rad=AMPLITUDES[0],
        roll_amplitude_rad=AMPLITUDES[1],
        pitch_amplitude_rad=AMPLITUDES[2],
        shortest_period_s=300.0,
        longest_period_s=6000.0,
        rng=stream(7, "attitude.libration"),
        offsets_rad=(0.3, -0.2, 0.1),
        orbital_rate_O_rad_s=attitude.ephemeris_rate_O_rad_s(ORBIT.propagate, time),
    )


def waypoints() -> list[Waypoint]:
    turns = [Rotation.identity(), Rotation.from_euler("zxy", [2.0, 0.4, -0.3]), Rotation.from_rotvec([0, 1.0, 0])]
    return [
        Waypoint(stamps(100.0), turns[0], 50.0),
        Waypoint(stamps(1000.0), turns[1], 200.0),
        Waypoint(stamps(2000.0), turns[2]),
    ]


def slewing(time: np.ndarray) -> Attitude:
    return attitude.slews(time, waypoints())


def slewing_in_orbit(time: np.ndarray) -> Attitude:
    rate = attitude.ephemeris_rate_O_rad_s(ORBIT.propagate, time)
    return attitude.orbital_slews(time, *ORBIT.propagate(time), waypoints(), orbital_rate_O_rad_s=rate)


def tumbling(time: np.ndarray) -> Attitude:
    q = np.array([0.1, 0.7, -0.3, 0.6])
    rate = np.radians([0.2, -0.1, 0.15])
    return attitude.tumble(time, np.array([10.0, 14.0, 19.0]), q, rate, epoch=START)


def spinning(time: np.ndarray) -> Attitude:
    inertia = np.array([0.8, 0.8, 1.12])
    return attitude.spin(
        time, inertia, np.array([0.2, -0.5, 0.7]), 0.05, nutation_rad=np.radians(2.0), phase_rad=1.0, epoch=START
    )


MODES: dict[str, Callable[[np.ndarray], Attitude]] = {
    "earth pointing": earth_pointing,
    "slews": slewing,
    "slews in orbit": slewing_in_orbit,
    "tumble": tumbling,
    "spin": spinning,
}


def differentiated(mode: Callable[[np.ndarray], Attitude], seconds: np.ndarray, step: float) -> np.ndarray:
    """Body rate from the attitude alone: half the turn from `step` before to `step` after."""
    turn = mode(stamps(seconds + step)).R_BN * mode(stamps(seconds - step)).R_BN.inv()
    return -turn.as_rotvec() / (2.0 * step)


@pytest.mark.parametrize("name", MODES)
def test_the_rate_is_the_derivative_of_the_attitude(name: str, close) -> None:
    seconds = np.linspace(3.0, 6000.0, 400)
    mode = MODES[name]
    expected = differentiated(mode, seconds, 0.5)
    why = "central difference: step^2/6 w'' is under 2e-8 rad/s here, for the spinner 1e-6"
    tolerance = 2e-6 if name == "spin" else 3e-8
    actual = mode(stamps(seconds)).rate_B_rad_s
    close(actual, expected, atol=tolerance, unit="rad/s", because=why)
    biggest = np.abs(expected).max(axis=0)
    assert (biggest > 20 * tolerance).all(), "every component must be tested by more than the tolerance"
    for mutant in (-actual, actual[:, [1, 0, 2]], mode(stamps(seconds)).R_BN.inv().apply(actual)):
        with pytest.raises(AssertionError):
            close(mutant, expected, atol=tolerance, unit="rad/s", because="a mutant must fail")


@pytest.mark.parametrize("name", MODES)
def test_two_samplings_see_one_motion(name: str) -> None:
    fine, coarse = np.arange(0.0, 3000.0, 4.0), np.arange(0.0, 3000.0, 60.0)
    mode = MODES[name]
    a, b = mode(stamps(fine)), mode(stamps(coarse))
    np.testing.assert_array_equal(a.rate_B_rad_s[::15], b.rate_B_rad_s)
    np.testing.assert_array_equal(a.q_NB[::15], b.q_NB)


def test_orbital_rate_of_a_circular_orbit_is_keplers(close) -> None:
    radius = 7168.0
    n = np.sqrt(GM_EARTH_KM3_S2 / radius**3)
    r, v = np.array([[0.0, radius, 0.0]]), np.array([[0.0, 0.0, n * radius]])
    rate = attitude.kepler_rate_O_rad_s(r, v)
    close(rate, [[0.0, -n, 0.0]], atol=1e-16, unit="rad/s", because="Kepler's third law; y is minus the normal")


def test_orbital_rate_from_the_ephemeris_holds_the_turn_of_the_plane(close) -> None:
    """Gauss: the frame turns about the radius by (r/h) a_h; J2's a_h = -3 J2 mu Re^2/r^4 sin i cos i sin u
    (Vallado, Fundamentals of Astrodynamics, the normal component of the J2 acceleration)."""
    orbit = dataclasses.replace(ORBIT, eccentricity=0.0)
    time = stamps(np.linspace(0.0, 6000.0, 100))
    r, v = orbit.propagate(time)
    exact, kepler = attitude.ephemeris_rate_O_rad_s(orbit.propagate, time), attitude.kepler_rate_O_rad_s(r, v)
    close(exact[:, :2], kepler[:, :2], atol=1e-10, unit="rad/s", because="step^2/6 w'' and rounding")
    u, radius, i = argument_of_latitude(time, r, v), np.linalg.norm(r, axis=1), orbit.inclination_rad
    across = -3.0 * J2_EARTH * GM_EARTH_KM3_S2 * EARTH_RADIUS_KM**2 / radius**4
    across = across * np.sin(i) * np.cos(i) * np.sin(u)
    about_radius = across * radius / np.linalg.norm(np.cross(r, v), axis=1)
    why = "the mean motion leaves out terms of order J2 squared: 2e-3 of 8e-7 rad/s"
    close(exact[:, 2], -about_radius, atol=2e-9, unit="rad/s", because=why)
    with pytest.raises(AssertionError):
        close(exact[:, 2], -1.01 * about_radius, atol=2e-9, unit="rad/s", because="a mutant must fail")
    assert np.abs(exact - kepler).max() < 1.5 * J2_EARTH * 1.04e-3, "the error that kepler_rate states"


def test_the_angles_are_the_papers_3_1_2_set(close) -> None:
    time = stamps(np.arange(0.0, 6000.0, 10.0))
    libration = draw_libration(AMPLITUDES, 300.0, 6000.0, stream(7, "attitude.libration"))
    r, v = ORBIT.propagate(time)
    turned = attitude.librating(time, r, v, libration).R_BN * frames.rotation_ON(r, v).inv()
    angles = np.stack(frames.yaw_roll_pitch(turned), axis=1)
    close(angles, libration.angles(time), atol=1e-13, unit="rad", because="round trip")


def test_the_phase_of_a_line_is_that_at_the_beginning_of_2000() -> None:
    """A roll of 0.1 rad with a period of 400 s: at its phase of 30 deg, and 100 s later at 120 deg."""
    one, none = np.array([[0.0], [0.1], [0.0]]), np.zeros((3, 1))
    libration = Libration(one, none + 2.0 * np.pi / 400.0, none + np.pi / 6.0, np.zeros(3))
    angles = libration.angles(np.array(["2000-01-01T00:00:00", "2000-01-01T00:01:40"], dtype="datetime64[ns]"))
    assert angles == pytest.approx(np.array([[0.0, 0.05, 0.0], [0.0, 0.1 * np.sqrt(0.75), 0.0]]))


def test_libration_has_the_stated_rms_and_band(close) -> None:
    """Over 200 of the longest periods, lines being apart by a mean 45 % in frequency."""
    libration = draw_libration(AMPLITUDES, 300.0, 6000.0, stream(11, "attitude.libration"))
    seconds = np.arange(0.0, 1.2e6, 60.0)
    angles = libration.angles(stamps(seconds))
    rms = np.sqrt(np.mean(angles**2, axis=0)) / AMPLITUDES
    why = "cross terms of lines that beat slowly: under 2 % in 200 periods"
    close(rms, np.sqrt(0.5), atol=0.015, unit="of the amplitude", because=why)
    power = np.abs(np.fft.rfft(angles * np.hanning(seconds.size)[:, None], axis=0)) ** 2
    frequency = np.fft.rfftfreq(seconds.size, 60.0)
    inside = (frequency > 1 / 6000.0 - 3e-6) & (frequency < 1 / 300.0 + 3e-6)
    outside = power[~inside].sum(axis=0) / power.sum(axis=0)
    close(outside, 0.0, atol=1e-4, unit="of the power", because="leakage of the Hann window")


def test_libration_angles_have_streams_of_their_own() -> None:
    """Switching roll off moves neither yaw nor pitch."""
    time = stamps(np.arange(0.0, 6000.0, 60.0))
    both = draw_libration(AMPLITUDES, 300.0, 6000.0, stream(3, "a")).angles(time)
    without = draw_libration((AMPLITUDES[0], 0.0, AMPLITUDES[2]), 300.0, 6000.0, stream(3, "a")).angles(time)
    np.testing.assert_array_equal(both[:, [0, 2]], without[:, [0, 2]])
    assert (without[:, 1] == 0.0).all()


def test_slews_rest_at_the_waypoints_and_hold(close) -> None:
    points = waypoints()
    seconds = np.array([0.0, 100.0, 150.0, 1000.0, 1100.0, 1200.0, 2000.0, 9000.0])
    found = slewing(stamps(seconds))
    expected = Rotation.concatenate([points[k].attitude for k in (0, 0, 0, 1, 1, 1, 2, 2)])
    off = (found.R_BN * expected.inv()).magnitude()
    close(off, 0.0, atol=1e-12, unit="rad", because="rounding")
    close(found.rate_B_rad_s, 0.0, atol=1e-15, unit="rad/s", because="rest to rest")
    middle = slewing(stamps(np.array([575.0])))
    turn = (points[1].attitude * points[0].attitude.inv()).magnitude()
    close(
        np.linalg.norm(middle.rate_B_rad_s),
        1.875 * turn / 850.0,
        atol=1e-12,
        unit="rad/s",
        because="the quintic's steepest slope is 15/8",
    )


def test_inertial_hold(close) -> None:
    R = Rotation.from_euler("zyx", [0.1, 0.2, 0.3])
    held = attitude.inertial_hold(stamps(np.arange(5.0)), R)
    close(held.R_BN.as_matrix(), R.as_matrix(), atol=1e-15, unit="1", because="the same rotation")
    assert (held.rate_B_rad_s == 0.0).all()
    assert len(held) == 5


def test_spin_starts_with_the_momentum_where_it_was_asked(close) -> None:
    axis = np.array([0.2, -0.5, 0.7])
    spinner = spinning(stamps(np.arange(0.0, 500.0, 7.0)))
    L_N = spinner.R_BN.inv().apply(np.array([0.8, 0.8, 1.12]) * spinner.rate_B_rad_s)
    close(
        L_N / np.linalg.norm(L_N, axis=1)[:, None],
        axis / np.linalg.norm(axis),
        atol=1e-12,
        unit="1",
        because="momentum is kept",
    )
    z_N = spinner.R_BN.inv().apply([0.0, 0.0, 1.0])
    nutation = np.arccos(z_N @ axis / np.linalg.norm(axis))
    close(nutation, np.radians(2.0), atol=1e-9, unit="rad", because="the nutation angle of an axisymmetric body")
    close(spinner.rate_B_rad_s[:, 2], 0.05, atol=1e-14, unit="rad/s", because="rate about the spin axis")


@pytest.mark.parametrize("sense", [1.0, -1.0])
def test_spin_along_and_against_an_axis(sense: float, close) -> None:
    for axis in ([0.0, 0.0, 1.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]):
        spinner = attitude.spin(stamps(np.arange(3.0)), np.array([1.0, 1.0, 1.5]), np.array(axis), sense * 0.1)
        rate_N = spinner.R_BN.inv().apply(spinner.rate_B_rad_s)
        close(rate_N, 0.1 * np.array(axis), atol=1e-14, unit="rad/s", because="pure spin about the momentum")
        close(spinner.rate_B_rad_s[:, 2], sense * 0.1, atol=1e-15, unit="rad/s", because="as asked")


def test_impossible_motion_is_refused() -> None:
    time = stamps(np.arange(3.0))
    early = [Waypoint(stamps(0.0), Rotation.identity(), 100.0), Waypoint(stamps(50.0), Rotation.identity())]
    with pytest.raises(BadInput, match="waypoint 2"):
        attitude.slews(time, early)
    with pytest.raises(BadInput, match="nutation"):
        attitude.spin(time, np.ones(3), np.array([0, 0, 1.0]), 0.1, nutation_rad=2.0)


def test_the_lines_of_a_libration_begin_at_its_longest_period() -> None:
    """Eight to a band, in equal ratios; here each at the beginning of its eighth."""
    least: Any = SimpleNamespace(random=np.zeros)
    found = 2.0 * np.pi / draw_libration(AMPLITUDES, 300.0, 6000.0, least).frequency_rad_s
    assert np.allclose(found, 6000.0 * 20.0 ** -(np.arange(8) / 8.0), rtol=1e-12)
