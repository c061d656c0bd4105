"""Torque-free motion against numerical integration, conservation laws and textbook nutation."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation
from scipy.special import ellipk

from fluxtwin.sim.attitude.rigid_body import principal_axes, torque_free
from fluxtwin.sim.base.errors import BadInput

pytestmark = pytest.mark.reference

BODIES = {
    "about the largest moment": ([1.0, 1.4, 1.9], [0.01, 0.02, 0.06]),
    "about the largest, backwards": ([1.0, 1.4, 1.9], [0.01, -0.02, -0.06]),
    "about the smallest moment": ([1.0, 1.4, 1.9], [0.06, -0.02, 0.01]),
    "moments out of order": ([1.9, 1.0, 1.4], [-0.03, 0.05, 0.02]),
    "moments the other way round": ([1.4, 1.0, 1.9], [0.02, 0.05, -0.01]),
    "nearly on the separatrix": ([1.0, 1.5, 2.0], [0.03 * np.sqrt(2.0) * 1.0001, 0.02, 0.03]),
    "on the separatrix": ([1.0, 1.5, 2.0], [0.03 * np.sqrt(2.0), 0.02, 0.03]),
    "nearly axisymmetric": ([0.8, 0.8000001, 1.12], [0.02, 0.01, 0.05]),
    "axisymmetric about x": ([1.12, 0.8, 0.8], [0.05, 0.02, -0.01]),
    "a rod": ([0.3, 0.8, 0.8], [0.05, 0.02, -0.01]),
    "a sphere": ([1.0, 1.0, 1.0], [0.02, -0.01, 0.03]),
    "pure spin": ([1.0, 1.4, 1.9], [0.0, 0.0, 0.05]),
    "at rest": ([1.0, 1.4, 1.9], [0.0, 0.0, 0.0]),
}
START = Rotation.from_euler("xyz", [0.3, -1.1, 2.0])


def _cross_matrix(w: np.ndarray) -> np.ndarray:
    return np.array([[0.0, -w[2], w[1]], [w[2], 0.0, -w[0]], [-w[1], w[0], 0.0]])


def integrated(t: np.ndarray, inertia: np.ndarray, rate0: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Euler's equations with the attitude matrix itself as the state: J w' = J w x w, A' = -[w x] A."""

    def slope(_: float, state: np.ndarray) -> np.ndarray:
        A, w = state[:9].reshape(3, 3), state[9:]
        return np.concatenate([(-_cross_matrix(w) @ A).ravel(), np.linalg.solve(inertia, np.cross(inertia @ w, w))])

    start = np.concatenate([START.as_matrix().ravel(), rate0])
    run = solve_ivp(slope, (t[0], t[-1]), start, method="DOP853", t_eval=t, rtol=1e-12, atol=1e-13)
    return run.y[:9].T.reshape(-1, 3, 3), run.y[9:].T


@pytest.mark.parametrize("name", BODIES)
def test_agrees_with_integration_of_eulers_equations(name: str, close) -> None:
    moments, rate0 = (np.array(v) for v in BODIES[name])
    # On the separatrix any error grows as exp(0.019 t), whatever the method: stop after 300 s.
    t = np.linspace(0.0, 300.0 if name == "on the separatrix" else 1000.0, 201)
    A, w = integrated(t, np.diag(moments), rate0)
    R_BN, rate = torque_free(t, moments, START, rate0)
    why = "DOP853 at rtol 1e-12 over some 10 turns"
    close(R_BN.as_matrix(), A, atol=1e-9, unit="rad", because=why)
    close(rate, w, atol=1e-10, unit="rad/s", because=why)


def test_a_wrong_inertia_or_a_transposed_attitude_would_be_seen(close) -> None:
    moments, rate0 = (np.array(v) for v in BODIES["about the largest moment"])
    t = np.linspace(0.0, 1000.0, 51)
    A, _ = integrated(t, np.diag(moments), rate0)
    R_BN, _ = torque_free(t, moments, START, rate0)
    wrong_moments, _ = torque_free(t, moments * [1.01, 1.0, 1.0], START, rate0)
    wrong_sign, _ = torque_free(t, moments, START, -rate0)
    swapped, _ = torque_free(t, moments[[1, 0, 2]], START, rate0)
    for mutant in (wrong_moments, wrong_sign, swapped, R_BN.inv()):
        with pytest.raises(AssertionError):
            close(mutant.as_matrix(), A, atol=1e-9, unit="rad", because="a mutant must fail")


def test_a_tensor_off_its_principal_axes(close) -> None:
    moments, rate0 = (np.array(v) for v in BODIES["moments out of order"])
    M = Rotation.from_euler("xyz", [0.5, 0.2, -0.9]).as_matrix()
    inertia = M @ np.diag(moments) @ M.T
    t = np.linspace(0.0, 1000.0, 51)
    A, w = integrated(t, inertia, rate0)
    R_BN, rate = torque_free(t, inertia, START, rate0)
    why = "DOP853 at rtol 1e-12 over some 10 turns"
    close(R_BN.as_matrix(), A, atol=1e-9, unit="rad", because=why)
    close(rate, w, atol=1e-10, unit="rad/s", because=why)


@pytest.mark.parametrize("name", [n for n in BODIES if n not in ("at rest", "on the separatrix")])
def test_momentum_and_energy_are_kept_for_a_day(name: str, close) -> None:
    moments, rate0 = (np.array(v) for v in BODIES[name])
    t = np.linspace(-86400.0, 86400.0, 301)
    R_BN, rate = torque_free(t, moments, START, rate0)
    momentum_N = R_BN.inv().apply(moments * rate)
    start_N = START.inv().apply(moments * rate0)
    size = np.linalg.norm(start_N)
    why = "exact solution: rounding of a phase of some 1e4 rad"
    close(momentum_N / size, start_N / size, atol=2e-11, unit="of |L|", because=why)
    energy = 0.5 * (rate**2) @ moments
    close(energy / energy[0], 1.0, atol=2e-11, unit="of T", because=why)


@pytest.mark.parametrize("name", [n for n in BODIES if n not in ("at rest", "on the separatrix")])
def test_restarting_on_the_way_continues_the_motion(name: str, close) -> None:
    moments, rate0 = (np.array(v) for v in BODIES[name])
    whole, whole_rate = torque_free([20_000.0], moments, START, rate0)
    R_BN, rate = START, rate0
    for _ in range(50):
        R, w = torque_free([400.0], moments, R_BN, rate)
        R_BN, rate = R[0], w[0]
    growth = 100.0 if name == "nearly on the separatrix" else 1.0  # unstable: rounding of the rate grows
    why = "1e-14 of the 1400 rad turned through"
    close((whole[0] * R_BN.inv()).magnitude(), 0.0, atol=2e-11 * growth, unit="rad", because=why)
    close(whole_rate[0], rate, atol=2e-12 * growth, unit="rad/s", because=why)


def test_polhode_period_is_that_of_the_elliptic_functions(close) -> None:
    """Landau & Lifshitz, Mechanics, eq. 37.12: period 4 K(m) sqrt(I1 I2 I3 / ((I3 - I2)(L^2 - 2 T I1)))."""
    i1, i2, i3 = 1.0, 1.4, 1.9
    moments, rate0 = np.array([i1, i2, i3]), np.array([0.01, 0.02, 0.06])
    two_t, l2 = (rate0**2) @ moments, np.sum((moments * rate0) ** 2)
    m = (i2 - i1) * (two_t * i3 - l2) / ((i3 - i2) * (l2 - two_t * i1))
    period = 4.0 * ellipk(m) * np.sqrt(i1 * i2 * i3 / ((i3 - i2) * (l2 - two_t * i1)))
    _, rate = torque_free(period * np.array([1.0, 2.0, 0.5]), moments, START, rate0)
    close(rate[:2], rate0, atol=1e-15, unit="rad/s", because="a whole number of periods")
    close(rate[2], rate0 * [-1.0, -1.0, 1.0], atol=1e-15, unit="rad/s", because="half a period")


def test_nutation_of_the_st5_spinner(close) -> None:
    """I = (0.8, 0.8, 1.12) kg m2, 26 rpm, nutation 2 degrees (Sedlak's ST5 paper).

    Textbook figures: body nutation rate w3 (1 - Is/It) = -1.089 rad/s; the body axis turns about the momentum
    at L/It = 3.814 rad/s, always 2 degrees from it.
    """
    spin, tilt = 26.0 * 2.0 * np.pi / 60.0, np.radians(2.0)
    moments = np.array([0.8, 0.8, 1.12])
    rate0 = np.array([1.12 * spin * np.tan(tilt) / 0.8, 0.0, spin])
    t = np.arange(0.0, 60.0, 0.125)
    R_BN, rate = torque_free(t, moments, Rotation.identity(), rate0)
    turned = np.unwrap(np.arctan2(rate[:, 1], rate[:, 0]))
    close(np.polyfit(t, turned, 1)[0], 1.089, atol=5e-4, unit="rad/s", because="printed to 0.001")
    axis_N, L_N = R_BN.inv().apply([0.0, 0.0, 1.0]), moments * rate0
    close(axis_N @ L_N / np.linalg.norm(L_N), np.cos(tilt), atol=1e-12, unit="1", because="rounding")
    frame = Rotation.from_euler("y", -tilt)  # momentum to z
    about = frame.apply(axis_N)
    precession = np.unwrap(np.arctan2(about[:, 1], about[:, 0]))
    wanted = np.linalg.norm(L_N) / 0.8
    close(np.polyfit(t, precession, 1)[0], wanted, atol=1e-9, unit="rad/s", because="straight line fit")


@pytest.mark.parametrize(
    "inertia",
    [[1.0, 1.0, 3.0], [1.0, -1.0, 1.0], [[1.0, 0.1, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]], [1.0, 1.0]],
)
def test_an_inertia_that_no_body_has_is_refused(inertia: list) -> None:
    with pytest.raises(BadInput, match="inertia_kg_m2"):
        principal_axes(np.array(inertia))
