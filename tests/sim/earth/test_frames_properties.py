"""Round trips, and splined series against the series themselves."""

from __future__ import annotations

import erfa
import motions
import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from fluxtwin.sim.earth import epoch, frames, sun
from fluxtwin.sim.earth.frames import on_grid
from fluxtwin.sim.earth.orbit import Orbit

pytestmark = pytest.mark.property

SPAN_S = 40 * 366 * 86400


@given(st.integers(-SPAN_S // 2, SPAN_S), st.integers(-SPAN_S // 2, SPAN_S), st.integers(0, 999_999_999))
def test_stamps_and_elapsed_seconds_round_trip(start_s, stop_s, nanoseconds):
    origin = np.datetime64("1990-01-01T00:00:00", "ns")
    start = origin + np.timedelta64(start_s, "s")
    stop = origin + np.timedelta64(stop_s, "s") + np.timedelta64(nanoseconds, "ns")
    back = epoch.add_seconds(start, epoch.seconds_since(stop, start))
    # A double of 1e9 s resolves 1.2e-7 s.
    assert abs((back[0] - stop).astype("int64")) <= 500


@given(st.floats(1900.0, 2100.0))
def test_decimal_year_round_trip(year):
    assert epoch.decimal_year(motions.from_decimal_year(year))[0] == pytest.approx(year, abs=1e-12, rel=0)


def test_seconds_are_counted_alike_in_any_order():
    times = np.datetime64("1978-12-30", "ns") + np.arange(0, 4 * 86400, 977) * np.timedelta64(1, "s")
    shuffled = np.random.default_rng(0).permutation(times.size)
    start = np.datetime64("1978-12-31T12:00:00", "ns")
    assert (epoch.seconds_since(times[shuffled], start) == epoch.seconds_since(times, start)[shuffled]).all()


@given(st.tuples(*4 * [st.floats(-1.0, 1.0)]))
def test_quaternions_round_trip_and_mean_what_the_textbook_says(close, components):
    """Wertz 1978, eq. 12-13b: the attitude matrix A = R_BN of a quaternion with the scalar last."""
    size = np.linalg.norm(components)
    assume(size > 1e-3)
    q_NB = np.array(components) / size
    R_BN = frames.rotation_from_q(q_NB[None])
    vector, scalar = q_NB[:3], q_NB[3]
    cross = np.cross(np.eye(3), vector)  # cross @ x is the product of vector and x
    attitude_matrix = (scalar**2 - vector @ vector) * np.eye(3) + 2 * np.outer(vector, vector) - 2 * scalar * cross
    close(R_BN.as_matrix()[0], attitude_matrix, atol=1e-14, unit="1", because="rounding")
    close(abs(frames.q_from_rotation(R_BN)[0] @ q_NB), 1.0, atol=1e-14, unit="1", because="q and -q are one attitude")


@pytest.mark.parametrize(("first", "second"), [((7, 4), (7, 4)), ((7, 4), (1, 4)), ((4,), (7, 4)), ((4,), (4,))])
def test_a_product_is_scipys_to_the_bit(first, second):
    rng = np.random.default_rng(1)
    one, other = Rotation.from_quat(rng.normal(size=first)), Rotation.from_quat(rng.normal(size=second))
    ours, witness = frames.product(one, other), one * other
    assert np.array_equal(ours.as_quat(), witness.as_quat()) and ours.single == witness.single
    assert not np.array_equal(ours.as_quat(), (other * one).as_quat())


@given(st.floats(-3.1, 3.1), st.floats(-1.5, 1.5), st.floats(-3.1, 3.1))
def test_yaw_roll_and_pitch_round_trip(close, yaw, roll, pitch):
    """Roll is the middle angle: unique within 90 deg."""
    back = frames.yaw_roll_pitch(frames.rotation_BO(yaw, roll, pitch))
    close(np.ravel(back), [yaw, roll, pitch], atol=1e-12, unit="rad", because="roll up to 86 deg")


def test_orbital_frame_is_right_handed_and_orthonormal(close):
    rng = np.random.default_rng(11)
    r, v = rng.normal(size=(2, 200, 3))
    R_ON = frames.rotation_ON(7000 * r, 7 * v).as_matrix()
    close(R_ON @ np.swapaxes(R_ON, 1, 2), np.eye(3)[None], atol=1e-14, unit="1", because="rounding")
    close(np.linalg.det(R_ON), 1.0, atol=1e-14, unit="1", because="rounding")
    # Turning everything turns the frame along: the axes belong to the orbit, not to N.
    Q = Rotation.random(random_state=rng)
    turned = frames.rotation_ON(Q.apply(7000 * r), Q.apply(7 * v)).as_matrix()
    close(turned @ Q.as_matrix(), R_ON, atol=1e-12, unit="1", because="rounding, near-parallel r and v")


@given(st.tuples(*3 * [st.floats(-2e4, 2e4)]))
def test_geocentric_and_geodetic_round_trip(close, place):
    r_E_km = np.array([place])
    assume(np.linalg.norm(r_E_km) > 6000.0)
    back = frames.from_geocentric(*frames.geocentric(r_E_km))
    close(back, r_E_km, atol=1e-11, unit="km", because="rounding of 2e4 km")
    back = frames.from_geodetic(*frames.geodetic(r_E_km))
    close(back, r_E_km, atol=1e-6, unit="km", because="ERFA's closed form, to a millimetre")


def test_splined_series_agree_with_the_full_series(close):
    """40 days at irregular stamps: enough rows for the grid to be used, checked on a few rows in full."""
    rng = np.random.default_rng(2)
    start = np.datetime64("1978-07-01", "ns")
    times = start + np.sort(rng.integers(0, 40 * 86400 * 10**9, 5000)).astype("timedelta64[ns]")
    rows = np.r_[0, rng.integers(0, times.size, 40), times.size - 1]
    few = times[rows]
    tt, ut1 = epoch.jd_tt(few), epoch.jd_ut1(few)
    c2i = erfa.c2ixys(*erfa.xys06a(*tt))
    full = erfa.c2tcio(c2i, erfa.era00(*ut1), np.eye(3))
    bound = {"atol": 1e-11, "unit": "rad", "because": "cubic spline of terms of 5 days and more on a 3 h grid"}
    close(frames.rotation_EN(times).as_matrix()[rows], full, **bound)
    close(frames.rotation_TN(times).as_matrix()[rows], erfa.pnm06a(*tt), **bound)
    close(
        sun.sun_N_km(times)[rows],
        np.concatenate([sun.sun_N_km(t) for t in few]),
        atol=1e-3,
        unit="km",
        because="7e-12 of an astronomical unit",
    )


def test_grid_is_used_only_where_it_saves_work():
    calls = []

    def slow(days):
        calls.append(days.size)
        return np.stack([np.sin(days), days], axis=1)

    on_grid(np.linspace(0.0, 1.0, 10), slow, 0.1)
    days = np.linspace(0.0, 1.0, 10_000)
    np.testing.assert_allclose(on_grid(days, slow, 0.1), slow(days), atol=5.0 / 384.0 * 0.1**4)  # Hall and Meyer 1976
    on_grid(np.linspace(0.0, 1.0, 2 * calls[1]), slow, 0.1)  # twice the nodes save nothing
    assert calls[-1] == 2 * calls[1]
    on_grid(np.array([0.0, 1.0e6]), slow, 0.1)
    assert calls[0] == 10
    assert calls[1] < 30
    assert calls[-1] == 2


def test_a_batch_is_its_rows(close):
    """Position, velocity and light of many stamps at once, in any order, are those of each stamp alone."""
    flying = Orbit(
        epoch_utc=np.datetime64("1978-07-24T06:00:00"),
        altitude_km=790.0,
        eccentricity=0.01,
        inclination_rad=1.885,
        raan_rad=2.0,
        argument_of_perigee_rad=1.0,
    )
    times = flying.epoch_utc + np.random.default_rng(4).integers(-(10**14), 10**14, 200).astype("timedelta64[ns]")
    r, v = flying.propagate(times)
    light = sun.illumination(r, sun.sun_N_km(times))
    for row in (0, 17, 199):
        r_one, v_one = flying.propagate(times[row])
        close(r_one[0], r[row], atol=1e-9, unit="km", because="rounding")
        close(v_one[0], v[row], atol=1e-12, unit="km/s", because="rounding")
        close(
            sun.illumination(r_one, sun.sun_N_km(times[row]))[0],
            light[row],
            atol=1e-6,
            unit="disc",
            because="the sun's spline, 1e-3 km",
        )


def test_stamps_a_little_later_are_on_the_same_grid():
    calls = []

    def slow(days):
        calls.append(days.size)
        return np.stack([np.sin(days), days], axis=1)

    days = np.linspace(3.02, 4.01, 10_000)
    for later in (0.0, 0.01, 0.02):
        np.testing.assert_allclose(on_grid(days + later, slow, 0.1), slow(days + later), atol=5.0 / 384.0 * 0.1**4)
    assert sum(size < days.size for size in calls) == 1
