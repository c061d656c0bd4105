"""Sun-sensor heads, horizon scanner, gyro and the reference attitude made from them."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from fluxtwin.sim.attitude.gauss_markov import gauss_markov
from fluxtwin.sim.base.errors import BadInput
from fluxtwin.sim.earth import frames
from fluxtwin.sim.spacecraft.sensors.base import Surroundings
from fluxtwin.sim.spacecraft.sensors.gyro import GyroSection
from fluxtwin.sim.spacecraft.sensors.horizon_scanner import HorizonScannerSection
from fluxtwin.sim.spacecraft.sensors.reference_attitude import attitude_from_sun_and_nadir, attitude_with_error
from fluxtwin.sim.spacecraft.sensors.sun_sensor import SunSensorSection, measure_sun

pytestmark = pytest.mark.reference

START = np.datetime64("1978-09-01T00:00:00", "ns")


def stamps(seconds: np.ndarray) -> np.ndarray:
    return START + np.rint(np.asarray(seconds) * 1e9).astype("int64").astype("timedelta64[ns]")


def directions(n: int, seed: int = 0) -> np.ndarray:
    v = np.random.default_rng(seed).standard_normal((n, 3))
    return v / np.linalg.norm(v, axis=1)[:, None]


def surroundings(time: np.ndarray, R_BO: Rotation, rate_B_rad_s: np.ndarray) -> Surroundings:
    """Of a body that stays so against an orbital frame that is that of N, above the Earth's centre."""
    place = np.tile([0.0, 0.0, -7000.0], (time.size, 1))
    R_BN = Rotation.from_quat(np.tile(R_BO.as_quat(), (time.size, 1)))
    sun, lit = np.tile([1.0, 0.0, 0.0], (time.size, 1)), np.ones(time.size)
    return Surroundings(time, place, R_BN, Rotation.identity(time.size), rate_B_rad_s, sun, lit)


# ---- sun sensors ---------------------------------------------------------------------------------------------


def test_field_of_view_is_a_square_of_128_degrees() -> None:
    """A 128 x 128 degree head (HCMM): the sun 63 degrees off along an axis is seen, 65 is not; along the
    diagonal the corner lies at atan(sqrt 2 tan 64 deg) = 71 degrees."""
    head = SunSensorSection(azimuth_deg=0.0, elevation_deg=90.0)

    def off(angle_deg: float, azimuth_deg: float) -> np.ndarray:
        a, z = np.radians([angle_deg, azimuth_deg])
        return np.array([[np.sin(a) * np.cos(z), np.sin(a) * np.sin(z), -np.cos(a)]])

    for azimuth in (0.0, 90.0, 180.0, 270.0):
        assert head.sees(off(63.0, azimuth))[0]
        assert not head.sees(off(65.0, azimuth))[0]
        assert head.sees(off(70.9, azimuth + 45.0))[0]
        assert not head.sees(off(71.1, azimuth + 45.0))[0]
    assert not head.sees(off(180.0, 0.0))[0], "the sun behind"
    assert not head.sees(off(10.0, 0.0), 0.3)[0], "in the penumbra, mostly dark"


def test_a_turned_head_has_its_square_turned() -> None:
    straight = SunSensorSection(azimuth_deg=0.0, elevation_deg=-90.0)
    turned = SunSensorSection(azimuth_deg=-45.0, elevation_deg=-90.0)
    a = np.radians(68.0)
    corner = np.array([[np.sin(a) * np.sqrt(0.5), np.sin(a) * np.sqrt(0.5), np.cos(a)]])
    assert straight.sees(corner)[0]
    assert not turned.sees(corner)[0]
    # Its x axis lies in the xy plane, towards larger azimuths, whatever the elevation.
    for elevation_deg in (-60.0, 0.0, 45.0):
        x_B = SunSensorSection(azimuth_deg=30.0, elevation_deg=elevation_deg).R_HB.as_matrix()[0]
        assert x_B == pytest.approx([-0.5, np.sqrt(0.75), 0.0], abs=1e-15)


def test_without_error_the_measurement_is_the_sun(close) -> None:
    head = SunSensorSection(azimuth_deg=-31.0, elevation_deg=-54.0)
    sun = directions(2000)
    sun = sun[head.sees(sun)]
    found = head.read(sun, np.random.default_rng(0))
    close(found, sun, atol=1e-14, unit="1", because="angles there and back")
    assert sun.shape[0] > 300


def test_rounding_to_the_lsb(close) -> None:
    """LSB 0.5 degrees: each angle errs uniformly, sd 0.5/sqrt 12 = 0.144 degrees, and never by more than 0.25."""
    lsb = np.radians(0.5)
    head = SunSensorSection(azimuth_deg=0.0, elevation_deg=-90.0, lsb_deg=0.5)
    sun = directions(20_000)
    sun = sun[head.sees(sun)]
    found = head.read(sun, np.random.default_rng(0))
    angles = np.arctan2(found[:, :2], found[:, 2:])
    close(np.mod(angles / lsb + 0.5, 1.0), 0.5, atol=1e-9, unit="LSB", because="whole multiples")
    error = angles - np.arctan2(sun[:, :2], sun[:, 2:])
    assert np.abs(error).max() <= 0.5 * lsb * (1 + 1e-9)
    # 12,000 uniform draws: the sd of the estimated variance is 0.8 %; 4 sigma, false alarm 6e-5.
    n = error.size
    close(error.var() / (lsb**2 / 12.0), 1.0, atol=4.0 * np.sqrt(0.8 / n), unit="LSB^2/12", because="4 sigma")


def test_misalignment_turns_the_head_not_the_sun(close) -> None:
    """A head turned by +1 degree about z sees the sun turned by -1 degree about z, in nominal axes."""
    head = SunSensorSection(azimuth_deg=0.0, misalignment_deg=(0.0, 0.0, 1.0))
    found = head.read(np.array([[1.0, 0.0, 0.0]]), np.random.default_rng(0))[0]
    a = np.radians(1.0)
    close(found, [np.cos(a), -np.sin(a), 0.0], atol=1e-14, unit="1", because="rotation by -1 degree")


def test_the_head_with_the_sun_nearest_its_boresight_is_in_use() -> None:
    axes = [(1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (-1.0, 0.0, 0.0), (0.0, -1.0, 0.0)]
    heads = [(k + 1, SunSensorSection(azimuth_deg=90.0 * k)) for k in range(4)]
    sun = directions(3000)
    lit = np.where(np.arange(3000) % 5 == 0, 0.0, 1.0)
    number, measured = measure_sun(heads, sun, lit, np.random.default_rng(0))
    cosines = sun @ np.array(axes).T
    seen = np.stack([head.sees(sun, lit) for _, head in heads], axis=1)
    wanted = np.where(seen.any(axis=1), 1 + np.argmax(np.where(seen, cosines, -2.0), axis=1), 0)
    np.testing.assert_array_equal(number, wanted)
    np.testing.assert_allclose(measured[number > 0], sun[number > 0], rtol=0, atol=1e-14)
    assert np.isnan(measured[number == 0]).all()
    assert (number[lit == 0.0] == 0).all()
    assert set(np.unique(number)) == {0, 1, 2, 3, 4}


def test_what_is_seen_does_not_move_the_noise() -> None:
    head = (1, SunSensorSection(azimuth_deg=0.0, elevation_deg=-90.0, noise_deg=0.5))
    sun = directions(50)
    a = measure_sun([head], sun, np.ones(50), np.random.default_rng(4))[1]
    dark = np.where(np.arange(50) < 25, 0.0, 1.0)
    b = measure_sun([head], sun, dark, np.random.default_rng(4))[1]
    np.testing.assert_array_equal(a[25:], b[25:])


def test_taking_a_head_away_does_not_move_the_noise_of_the_others() -> None:
    heads = [(k + 1, SunSensorSection(azimuth_deg=90.0 * k, noise_deg=0.5)) for k in range(3)]
    sun = directions(200)
    number, whole = measure_sun(heads, sun, 1.0, np.random.default_rng(4))
    without = measure_sun(heads[1:], sun, 1.0, np.random.default_rng(4))[1]
    others = number > 1
    assert others.sum() > 50
    np.testing.assert_array_equal(without[others], whole[others])
    noise = whole - sun
    assert not np.allclose(noise[number == 2][:20], noise[number == 3][:20])


# ---- horizon scanner -----------------------------------------------------------------------------------------


def test_roll_and_pitch_are_those_of_the_3_1_2_set(close) -> None:
    """Nadir is z of O: carried to B by yaw, roll, pitch it gives roll and pitch back, whatever the yaw."""
    rng = np.random.default_rng(1)
    yaw, pitch = rng.uniform(-np.pi, np.pi, (2, 500))
    roll = rng.uniform(-1.5, 1.5, 500)
    nadir = frames.rotation_BO(yaw, roll, pitch).apply([0.0, 0.0, 1.0])
    found_roll, found_pitch = frames.roll_pitch(nadir).T
    close(found_roll, roll, atol=1e-13, unit="rad", because="round trip")
    close(found_pitch, pitch, atol=1e-13, unit="rad", because="round trip")
    close(frames.nadir_of(np.stack([roll, pitch], axis=1)), nadir, atol=1e-14, unit="1", because="round trip")
    # Journal eq. 13: to first order the column of nadir is (-p, r, 1).
    close(
        frames.nadir_of(np.array([[1e-4, 2e-4]])),
        [[-2e-4, 1e-4, 1.0]],
        atol=3e-8,
        unit="1",
        because="second order in the angles",
    )


def test_scanner_bias_noise_and_rounding(close) -> None:
    n = 20_000
    around = surroundings(stamps(np.arange(n)), frames.rotation_BO(0.0, 0.02, -0.03), np.zeros((n, 3)))
    noise_deg, roll_deg, pitch_deg, lsb_deg = np.degrees([0.002, 0.01, -0.005, 0.001]).tolist()
    scanner = HorizonScannerSection(noise_deg=noise_deg, roll_bias_deg=roll_deg, pitch_bias_deg=pitch_deg)
    measured = scanner.measure(around, np.random.default_rng(0))["nadir_B"]
    roll, pitch = frames.roll_pitch(measured).T
    four = 4.0 / np.sqrt(n)
    close([roll.mean(), pitch.mean()], [0.03, -0.035], atol=0.002 * four, unit="rad", because="4 sigma of the mean")
    close([roll.std(), pitch.std()], 0.002, atol=0.002 * four / np.sqrt(2.0), unit="rad", because="4 sigma")
    coarse = HorizonScannerSection(noise_deg=noise_deg, lsb_deg=lsb_deg)
    roll, _ = frames.roll_pitch(coarse.measure(around, np.random.default_rng(0))["nadir_B"]).T
    close(np.mod(roll / 0.001 + 0.5, 1.0), 0.5, atol=1e-9, unit="LSB", because="whole multiples")


# ---- gyro ----------------------------------------------------------------------------------------------------


def test_gyro_bias_noise_and_random_walk(close) -> None:
    """Allan-like check: the variance of differences over a lag T is walk^2 T + 2 noise^2."""
    walk, noise = 1e-6, 2e-5
    gyro = GyroSection(
        bias_deg_h=(3600.0 * np.degrees([1e-3, -2e-3, 3e-3])).tolist(),
        noise_deg_s=float(np.degrees(noise)),
        random_walk_deg_h_per_sqrt_h=float(np.degrees(walk)) * 3600.0 * 60.0,
    )
    rng = np.random.default_rng(0)
    seconds = np.cumsum(rng.choice([0.5, 2.0], 60_000))
    rate = np.tile([0.0, -1e-3, 0.0], (seconds.size, 1))
    around = surroundings(stamps(seconds), Rotation.identity(1), rate)
    measured = gyro.measure(around, np.random.default_rng(1))["rate_B_rad_s"]
    close(measured[0], [1e-3, -3e-3, 3e-3], atol=5 * noise, unit="rad/s", because="bias at the first stamp, 5 sigma")
    drift = measured - rate - [1e-3, -2e-3, 3e-3]
    for lag in (1, 100, 1000):
        a, b = drift[::lag][:-1], drift[::lag][1:]
        t = np.diff(seconds[::lag])
        ratio = np.mean((b - a) ** 2) / (walk**2 * t.mean() + 2 * noise**2)
        tail = 4.0 * np.sqrt(3.0 / a.size)  # correlated neighbours: variance at most 1.5 times that of 2/n
        close(ratio, 1.0, atol=tail, unit="of the variance", because="4 sigma")


# ---- reference attitude --------------------------------------------------------------------------------------


@pytest.mark.parametrize("tau", [0.0, 100.0])
def test_attitude_error_is_stationary_gauss_markov_at_uneven_stamps(tau: float, close) -> None:
    """Over 4000 independent runs: covariance sigma^2 exp(-dt/tau) between any stamps; chi-square at 1e-4."""
    seconds = np.array([0.0, 5.0, 90.0, 91.0, 600.0])
    runs, sigma = 4000, np.radians([0.1, 0.2, 0.3])
    rng = np.random.default_rng(0)
    theta = np.array([gauss_markov(stamps(seconds), sigma, tau, rng, columns=3) for _ in range(runs)]) / sigma
    lag = np.abs(seconds[:, None] - seconds)
    wanted = np.exp(-lag / tau) if tau else np.eye(5)
    for axis in range(3):
        L = np.linalg.cholesky(wanted)
        white = np.linalg.solve(L, theta[:, :, axis].T)
        low, high = chi2.ppf([5e-5, 1.0 - 5e-5], runs)
        assert ((low < (white**2).sum(axis=1)) & ((white**2).sum(axis=1) < high)).all()
        correlation = np.corrcoef(white) - np.eye(5)
        close(correlation, 0.0, atol=4.5 / np.sqrt(runs), unit="1", because="4.5 sigma: false alarm 1e-4 in all")
    across = np.corrcoef(theta[:, 2].T) - np.eye(3)
    close(across, 0.0, atol=4.5 / np.sqrt(runs), unit="1", because="axes are independent, 4.5 sigma")


def test_attitude_error_turns_the_reported_attitude_about_body_axes(close) -> None:
    """exp([theta x]) on the left of R_BN: a body vector is predicted as v + theta x v, to first order."""
    n = 300
    R_BN = Rotation.random(n, random_state=1)
    time = stamps(np.arange(n) * 60.0)
    theta = gauss_markov(time, 1e-4, 600.0, np.random.default_rng(9), columns=3)
    reported = attitude_with_error(time, R_BN, 1e-4, 600.0, np.random.default_rng(9))
    v_N = directions(n)
    v_B = R_BN.apply(v_N)
    close(reported.apply(v_N), v_B + np.cross(theta, v_B), atol=2e-7, unit="1", because="second order: (4e-4)^2")
    for wrong in (v_B - np.cross(theta, v_B), R_BN.apply(v_N + np.cross(theta, v_N)), v_B):
        with pytest.raises(AssertionError):
            close(reported.apply(v_N), wrong, atol=2e-7, unit="1", because="a mutant must fail")


def test_attitude_from_perfect_sun_and_nadir(close) -> None:
    n = 500
    R_BN = Rotation.random(n, random_state=2)
    sun_N, nadir_N = directions(n, 3), directions(n, 4)
    q = attitude_from_sun_and_nadir(R_BN.apply(2.0 * sun_N), R_BN.apply(nadir_N), sun_N, 7000.0 * nadir_N)
    known = np.isfinite(q).all(axis=1)
    apart = np.linalg.norm(np.cross(sun_N, nadir_N), axis=1)
    np.testing.assert_array_equal(known, apart > np.sin(np.radians(3.0)))
    off = (frames.rotation_from_q(q[known]) * R_BN[known].inv()).magnitude()
    close(off, 0.0, atol=1e-12, unit="rad", because="rounding, 20 times over at 3 degrees separation")
    assert known.sum() > 450


def test_nadir_has_priority(close) -> None:
    """A sun error moves only the turn about nadir: nadir is met exactly, the sun only as near as it can be."""
    n = 200
    R_BN = Rotation.random(n, random_state=5)
    sun_N, nadir_N = directions(n, 6), directions(n, 7)
    wrong_sun = R_BN.apply(sun_N) + 0.01 * directions(n, 8)
    q = attitude_from_sun_and_nadir(wrong_sun, R_BN.apply(nadir_N), sun_N, nadir_N)
    known = np.isfinite(q).all(axis=1)
    found = frames.rotation_from_q(q[known])
    nadir_B = R_BN[known].apply(nadir_N[known])
    close(found.apply(nadir_N[known]), nadir_B, atol=1e-14, unit="1", because="nadir is met exactly")
    assert np.abs(found.apply(sun_N[known]) - R_BN[known].apply(sun_N[known])).max() > 1e-3


@pytest.mark.parametrize("angle_deg", [20.0, 63.0, 90.0, 123.0])
def test_yaw_of_sun_and_nadir_errs_by_the_closed_form(angle_deg: float, close) -> None:
    """sigma_yaw^2 = (sigma_sun^2 + cos^2(angle) sigma_nadir^2) / sin^2(angle): the sun's error across the plane of the two
    over its lever, and the tilt of nadir that the lever turns with. The same form as equation 14 of the 1981 paper."""
    n, sun_rad, tilt_rad = 40000, np.radians(0.1), np.radians(0.15)
    rng, a = np.random.default_rng(12), np.radians(angle_deg)
    sun_N, nadir_N = np.tile([np.sin(a), 0.0, np.cos(a)], (n, 1)), np.tile([0.0, 0.0, 1.0], (n, 1))
    sun_B = sun_N + sun_rad * rng.standard_normal((n, 3))
    nadir_B = nadir_N + tilt_rad * rng.standard_normal((n, 3)) * [1.0, 1.0, 0.0]
    q = attitude_from_sun_and_nadir(sun_B, nadir_B, sun_N, nadir_N)
    error = frames.rotation_from_q(q).as_rotvec()
    expected = np.sqrt(sun_rad**2 + (np.cos(a) * tilt_rad) ** 2) / np.sin(a)
    # the scatter of a standard deviation of n draws is 1 in sqrt(2 n): 0.35 %
    close(error[:, 2].std() / expected, 1.0, atol=0.0125, unit="1", because="3.5 sigma of 40,000 draws")
    close(error[:, :2].std(axis=0) / tilt_rad, 1.0, atol=0.0125, unit="1", because="roll and pitch are the scanner's")
    if angle_deg != 90.0:
        assert abs(error[:, 2].std() / (sun_rad / np.sin(a)) - 1.0) > 0.05, "without the tilt it would be another"


def test_rows_without_sun_have_no_attitude() -> None:
    R_BN = Rotation.random(6, random_state=2)
    sun_N, nadir_N = directions(6, 3), directions(6, 4)
    sun_B = R_BN.apply(sun_N)
    sun_B[[1, 4]] = np.nan
    q = attitude_from_sun_and_nadir(sun_B, R_BN.apply(nadir_N), sun_N, nadir_N)
    np.testing.assert_array_equal(np.isnan(q).all(axis=1), [False, True, False, False, True, False])
    np.testing.assert_allclose(q[0], frames.q_from_rotation(R_BN)[0])


def test_impossible_sensors_are_refused() -> None:
    head = (1, SunSensorSection(azimuth_deg=0.0))
    with pytest.raises(BadInput, match="number of its own"):
        measure_sun([head, head], np.eye(3), 1.0, np.random.default_rng(0))
    with pytest.raises(ValueError, match="noise_deg_s"):
        GyroSection(noise_deg_s=-1.0)
    with pytest.raises(ValueError, match="noise_deg"):
        HorizonScannerSection(noise_deg=-1.0)
