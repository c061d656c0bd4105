"""Frames and attitude conventions against the papers, the textbooks and ERFA's own chain."""

from __future__ import annotations

import erfa
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from fluxtwin.sim.base.errors import BadInput
from fluxtwin.sim.earth import epoch, frames

pytestmark = pytest.mark.reference

X, Y, Z = np.eye(3)


def passive(axis: int, angle: float) -> np.ndarray:
    """Elementary rotation of the axes: Wertz 1978, Spacecraft Attitude Determination and Control, eq. 12-9."""
    c, s = np.cos(angle), np.sin(angle)
    return {
        1: np.array([[1, 0, 0], [0, c, s], [0, -s, c]]),
        2: np.array([[c, 0, -s], [0, 1, 0], [s, 0, c]]),
        3: np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]]),
    }[axis]


def test_earth_rotation_against_erfa_matrix(close):
    start = np.datetime64("1978-07-24T06:00:00", "ns")
    times = start + np.arange(0, 5) * np.timedelta64(371 * 86400 + 4321, "s")
    expected = erfa.c2t06a(*epoch.jd_tt(times), *epoch.jd_ut1(times), 0.0, 0.0)
    bound = {"atol": 1e-10, "unit": "rad", "because": "we leave out s', 47 microarcsec a century"}
    ours = frames.rotation_EN(times).as_matrix()
    close(ours, expected, **bound)
    with pytest.raises(AssertionError):
        close(np.swapaxes(ours, 1, 2), expected, **bound)


def test_axes_of_1978_against_precession(close):
    """Lieske 1979 (doi via IAU 1976): general precession 5029.0966, in right ascension 4612.436 arcsec/century.

    Julian centuries from J2000 to 1978 August 1: -0.21421. Nutation adds at most 17.2 arcsec.
    """
    centuries = (2443721.5 - 2451545.0) / 36525.0
    R_TN = frames.rotation_TN(np.datetime64("1978-08-01"))
    turned_deg = np.degrees(R_TN.magnitude()[0])
    because = "nutation, up to 17.2 arcsec = 0.0048 deg"
    close(turned_deg, -5029.0966 * centuries / 3600, atol=0.005, unit="deg", because=because)
    equinox = R_TN.apply(X)[0]  # where the GCRS x axis lies on the equator of date
    right_ascension_deg = np.degrees(np.arctan2(equinox[1], equinox[0]))
    close(right_ascension_deg, 4612.436 * centuries / 3600, atol=0.005, unit="deg", because=because)
    assert abs(right_ascension_deg) == pytest.approx(0.27, abs=0.006)


def test_orbital_frame_axes(close):
    """Journal, below eq. 1: z nadir, y negative orbit normal; x completes, so it points along the motion."""
    R_ON = frames.rotation_ON(7000.0 * X, 7.5 * Y)
    seen = {"nadir": R_ON.apply(-X), "negative normal": R_ON.apply(-Z), "motion": R_ON.apply(Y)}
    exact = {"atol": 1e-15, "unit": "1", "because": "unit axes"}
    close(seen["nadir"], [Z], **exact)
    close(seen["negative normal"], [Y], **exact)
    close(seen["motion"], [X], **exact)
    with pytest.raises(AssertionError):
        close(R_ON.inv().apply(Y), [X], **exact)
    # On an elliptic orbit z stays nadir; the velocity then has a part along z.
    climbing = frames.rotation_ON(7000.0 * X, np.array([1.0, 7.5, 0.0])).apply([1.0, 7.5, 0.0])
    close(climbing, [[7.5, 0.0, -1.0]], atol=1e-14, unit="km/s", because="rounding")


def test_parallel_position_and_velocity_are_refused():
    with pytest.raises(BadInput, match="row 1"):
        frames.rotation_ON(np.array([7000 * X, 7000 * X]), np.array([7 * Y, 7 * X]))


@given(st.tuples(*3 * [st.floats(-np.pi, np.pi)]))
def test_any_three_angles_are_turns_about_z_x_and_y(close, angles):
    yaw, roll, pitch = angles
    expected = passive(2, pitch) @ passive(1, roll) @ passive(3, yaw)
    ours = frames.rotation_BO(yaw, roll, pitch).as_matrix()[0]
    close(ours, expected, atol=2e-15, unit="1", because="rounding of a product of three matrices")


def test_angles_are_the_3_1_2_set(close):
    yaw, roll, pitch = 0.7, -0.4, 1.1
    expected = passive(2, pitch) @ passive(1, roll) @ passive(3, yaw)
    ours = frames.rotation_BO(yaw, roll, pitch).as_matrix()[0]
    exact = {"atol": 1e-15, "unit": "1", "because": "rounding of a product of three matrices"}
    close(ours, expected, atol=4e-16, unit="1", because=exact["because"])
    others = [
        expected.T,
        passive(1, roll) @ passive(2, pitch) @ passive(3, yaw),  # 3-2-1
        passive(2, -pitch) @ passive(1, roll) @ passive(3, yaw),
        passive(2, roll) @ passive(1, pitch) @ passive(3, yaw),
    ]
    for other in others:
        with pytest.raises(AssertionError):
            close(ours, other, **exact)


def test_small_angles_give_journal_equation_13(close):
    y, r, p = 0.003, -0.002, 0.004
    journal = np.array([[1, y, -p], [-y, 1, r], [p, -r, 1]])
    ours = frames.rotation_BO(y, r, p).as_matrix()[0]
    bound = {"atol": 2.5e-5, "unit": "1", "because": "second order: y^2 + p^2"}
    close(ours, journal, **bound)
    for mutant in (journal.T, journal * 1.01, journal[:, [1, 0, 2]]):
        with pytest.raises(AssertionError):
            close(ours, mutant, **bound)


def test_textbook_quaternion_of_a_90_degree_turn(close):
    """Body turned by +90 deg about z: its x axis lies along inertial y. Wertz eqs. 12-11 and 12-13."""
    half = np.sqrt(0.5)
    q_NB = np.array([[0.0, 0.0, half, half]])
    R_BN = frames.rotation_from_q(q_NB)
    attitude_matrix = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    exact = {"atol": 1e-15, "unit": "1", "because": "rounding of sqrt 1/2"}
    close(R_BN.as_matrix()[0], attitude_matrix, **exact)
    close(R_BN.apply(Y), [X], **exact)
    close(frames.q_from_rotation(R_BN), q_NB, **exact)
    with pytest.raises(AssertionError):  # the trap: scipy's reading of the same four numbers is the transpose
        close(Rotation.from_quat(q_NB).as_matrix()[0], attitude_matrix, **exact)


def test_zero_quaternion_is_refused():
    with pytest.raises(BadInput, match=r"row 1.*zero"):
        frames.rotation_from_q(np.array([[0.0, 0.0, 0.0, 1.0], [0.0, 0.0, 0.0, 0.0]]))
    with pytest.raises(BadInput, match="not a number"):
        frames.rotation_from_q(np.array([[np.nan, 0.0, 0.0, 1.0]]))


def test_north_east_centre(close):
    exact = {"atol": 1e-15, "unit": "1", "because": "unit axes"}
    on_equator = frames.rotation_NEC_E(7000.0 * X)
    close(on_equator.apply(Z), [X], **exact)  # the Earth's axis is north
    close(on_equator.apply(Y), [Y], **exact)  # increasing longitude is east
    close(on_equator.apply(-X), [Z], **exact)
    at_pole = frames.rotation_NEC_E(7000.0 * Z)
    close(at_pole.apply(Y), [Y], **exact)
    close(at_pole.apply(-X), [X], **exact)
    tilted = frames.rotation_NEC_geodetic(np.radians(45.0), np.radians(90.0))
    close(tilted.apply([0.0, 1.0, 1.0]), [[0.0, 0.0, -np.sqrt(2.0)]], **exact | {"atol": 1e-15})
