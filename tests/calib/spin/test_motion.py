"""The motion of a free spinner, its derivatives, the filter's steps, the alignment and the slit, against witnesses.

Witnesses: `sim.rigid_body` (Jacobi's closed form, itself tested against integration and the literature), finite
differences, scipy's `Rotation.align_vectors` for Wahba's problem, the kinematics of a uniform spin, and figures that an
independent prototype of the ST5 hour printed (sigma of the sun sensor's own turn 0.184 deg at 2 deg of nutation, 1.84
at 0.2; a pulse late by 0.18 deg is 1.15 ms).
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from fluxtwin.calib.spin.batch import Noise, State, normal_equations
from fluxtwin.calib.spin.filter import FilterSettings, spin_filter
from fluxtwin.calib.spin.filter_kernels import step
from fluxtwin.calib.spin.motion import SpinMotion, skew, turn, turn_vector
from fluxtwin.calib.spin.rows import SpinRows
from fluxtwin.calib.spin.sedlak import align, align_with_prior, relative
from fluxtwin.calib.spin.start import _axes
from fluxtwin.sim.attitude.rigid_body import torque_free
from fluxtwin.sim.spacecraft.sensors.slit_sun_sensor import SlitSunSensor

pytestmark = pytest.mark.reference

ST5 = np.array([0.8, 0.8, 1.12])
SPIN = 26.0 * 2.0 * np.pi / 60.0


def free(inertia: np.ndarray, rate0: np.ndarray, t: np.ndarray, R0: Rotation) -> np.ndarray:
    """(N, 3, 3) by the simulator."""
    return np.asarray(torque_free(t, inertia, R0, rate0)[0].as_matrix())


def st5_motion(R0: Rotation, nutation_deg: float = 2.0) -> tuple[SpinMotion, np.ndarray]:
    """The motion in the estimator's terms, and the initial rate in the body."""
    tilt = np.tan(np.radians(nutation_deg)) * ST5[2] / ST5[0] * SPIN
    rate = np.array([0.6 * tilt, 0.8 * tilt, SPIN])
    A0 = R0.as_matrix()
    return SpinMotion(A0, A0.T @ (ST5 * rate) / ST5[0], SPIN * (1.0 - ST5[2] / ST5[0])), rate


def some_rows(
    motion: SpinMotion, seconds: float, noise_nT: float = 0.0, sun_rad: float = 0.0, seed: int = 0
) -> SpinRows:
    """Field that turns once in the time, sun fixed, pulses once a turn where the slit sees the sun."""
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, seconds, 0.125)
    a = 2.0 * np.pi * t / seconds
    H = 30_000.0 * np.stack([np.cos(a), np.sin(a), 0.4 * np.cos(2 * a)], axis=1)
    s = np.array([0.6, -0.5, 0.3])
    s = s / np.linalg.norm(s)
    slit = SlitSunSensor(azimuth_deg=np.degrees(0.3), noise_deg=np.degrees(sun_rad))
    pulse_s, seen = slit.crossings(t, lambda at: motion.see(at, np.tile(s, (len(at), 1))), rng)
    B = motion.see(t, H) + noise_nT * rng.standard_normal(H.shape)
    start = np.datetime64("2006-04-15", "ns")
    time = start + (t * 1e9).astype("timedelta64[ns]")
    return SpinRows(start, time, t, B, H, pulse_s, seen, np.tile(s, (len(pulse_s), 1)), np.arange(len(t)), {})


def test_without_noise_the_first_axis_is_that_of_the_momentum(close: Callable[..., None]) -> None:
    """The nutation of 0.2 deg averages out over 260 turns; one of its sides would be 0.2 deg off."""
    motion, rate = st5_motion(Rotation.from_rotvec([0.3, -1.1, 2.0]), 0.2)
    rows = some_rows(motion, 600.0)
    momentum_N = motion.attitude(np.zeros(1))[0].T @ (ST5 * rate)
    found = _axes(rows, rows.B_nT)[0]
    off_deg = np.degrees(np.linalg.norm(np.cross(found, momentum_N)) / np.linalg.norm(momentum_N))
    assert found @ momentum_N > 0.0
    close(off_deg, 0.0, atol=0.01, unit="deg", because="a twentieth of the nutation, which averages out")


def test_of_a_biased_reading_the_axis_is_the_best_compromise() -> None:
    """Over the sphere, with 30 readings and 30 pulses by 4 % of the field, and a constant by half of that: a bias of 3000 nT
    along z turns the axis where the field has a mean, and no axis a thousandth of a radian beside it fits better."""
    rows = some_rows(st5_motion(Rotation.from_rotvec([0.3, -1.1, 2.0]), 0.2)[0], 60.0).within(0.0, 20.0)
    z = rows.B_nT[:, 2] + 3000.0
    sigma = 0.04 * np.sqrt((rows.H_N_nT**2).sum(axis=1).mean())

    def misfit(axis_N: np.ndarray) -> float:
        off, sun = (z - rows.H_N_nT @ axis_N) / sigma, (rows.sun_B[:, 2] - rows.sun_N @ axis_N) / 0.04
        return float(30.0 * off.var() + (2.0 * off.mean()) ** 2 + 30.0 * (sun**2).mean())

    best = _axes(rows, rows.B_nT + np.array([0.0, 0.0, 3000.0]))[0]
    for v in np.linalg.svd(best[None, :])[2][1:]:
        for other in (best + 1e-3 * v, best - 1e-3 * v):
            assert misfit(other / np.linalg.norm(other)) > misfit(best)


def test_the_closed_form_is_that_of_the_rigid_body(close: Callable[..., None]) -> None:
    R0 = Rotation.from_rotvec([0.3, -1.1, 2.0])
    motion, rate = st5_motion(R0)
    t = np.linspace(-100.0, 3600.0, 500)
    close(motion.attitude(t), free(ST5, rate, t, R0), atol=1e-10, unit="1", because="rounding of 10,000 rad")
    close(motion.spin_rad_s, SPIN, atol=1e-12, unit="rad/s", because="rounding")
    close(motion.inertia_ratio, 1.4, atol=1e-12, unit="1", because="rounding")
    close(np.degrees(motion.nutation_rad), 2.0, atol=1e-9, unit="deg", because="rounding")
    close(motion.lam_rad_s, -1.089, atol=5e-4, unit="rad/s", because="the prototype's figure, three decimals")
    later = motion.shifted(17.0)
    close(later.attitude(t - 17.0), motion.attitude(t), atol=1e-10, unit="1", because="rounding")
    with pytest.raises(AssertionError):
        close(motion.attitude(t).transpose(0, 2, 1), free(ST5, rate, t, R0), atol=1e-10, unit="1", because="transposed")


def test_slopes_are_differences(close: Callable[..., None]) -> None:
    motion, _ = st5_motion(Rotation.from_rotvec([0.3, -1.1, 2.0]))
    t, v = np.linspace(0.0, 900.0, 40), np.random.default_rng(1).normal(size=(40, 3))
    y, slope = motion.slopes(t, v)
    close(y, motion.see(t, v), atol=1e-13, unit="1", because="rounding")
    h = 1e-7
    number = [(motion.moved(h * e).see(t, v) - motion.moved(-h * e).see(t, v)) / (2 * h) for e in np.eye(7)]
    close(slope / 900.0, np.stack(number, axis=2) / 900.0, atol=1e-7, unit="1", because="central difference over 900 s")


def test_the_normal_equations_are_the_written_ones(close: Callable[..., None]) -> None:
    motion, _ = st5_motion(Rotation.from_rotvec([0.3, -1.1, 2.0]))
    rows = some_rows(motion, 100.0, 200.0, 0.003)
    state = State(
        motion.moved(1e-3 * np.ones(7) * [1, 1, 1, 0, 0, 0, 0]),
        np.eye(3) + 0.01 * np.arange(9).reshape(3, 3),
        np.ones(3),
    )
    found = normal_equations(state, rows, Noise(200.0, 0.003))
    y, slope = state.motion.slopes(rows.t_s, rows.H_N_nT)
    J = np.zeros((len(y), 3, 19))
    J[:, :, :7] = state.G @ slope
    J[:, :, 7:10] = np.eye(3)
    for i in range(3):
        J[:, i, 10 + 3 * i : 13 + 3 * i] = y
    J = J.reshape(-1, 19) / 200.0
    r = (rows.B_nT - y @ state.G.T - state.o_nT).ravel() / 200.0
    sun, of_sun = state.motion.slopes(rows.pulse_s, rows.sun_N)
    K, q = np.zeros((sun.size, 19)), (rows.sun_B - sun).ravel() / 0.003
    K[:, :7] = of_sun.reshape(-1, 7) / 0.003
    matrix, vector = J.T @ J + K.T @ K, J.T @ r + K.T @ q
    scale = np.sqrt(np.diag(matrix))
    close(
        found.matrix / np.outer(scale, scale), matrix / np.outer(scale, scale), atol=1e-11, unit="1", because="rounding"
    )
    close(found.vector / scale, vector / scale, atol=1e-8, unit="sigma", because="rounding of sums of 2400")
    close(found.cost, r @ r + q @ q, atol=1e-7, unit="1", because="rounding")


def test_steps_of_the_filter(close: Callable[..., None]) -> None:
    J, R0 = ST5 / ST5[0], Rotation.from_rotvec([0.3, -1.1, 2.0])
    rate, h = np.array([0.08, -0.05, SPIN]), 0.7
    A = np.ascontiguousarray(R0.as_matrix())
    L = np.ascontiguousarray(A.T @ (J * rate))
    then, Phi = step(A, L, J[2], h)
    close(then, free(J, rate, np.array([h]), R0)[0], atol=1e-12, unit="1", because="closed form")
    slope = []
    for k in range(6):
        for sign in (1.0, -1.0):
            d = np.zeros(6)
            d[k] = sign * 1e-6
            moved, _ = step(np.ascontiguousarray(turn(-d[:3]) @ A), L + d[3:], J[2], h)
            slope.append(np.append(turn_vector((moved @ then.T).T), d[3:]))
    number = (np.array(slope[::2]) - np.array(slope[1::2])).T / 2e-6
    close(Phi, number, atol=1e-5, unit="1", because="central difference")


def test_alignment_is_wahbas(close: Callable[..., None]) -> None:
    rng = np.random.default_rng(4)
    v, w = rng.normal(size=(50, 3)), rng.uniform(0.5, 2.0, 50)
    R = Rotation.from_rotvec([0.02, -0.03, 0.01])
    m = R.apply(v / np.linalg.norm(v, axis=1)[:, None]) + 0.01 * rng.normal(size=(50, 3))
    unit = m / np.linalg.norm(m, axis=1)[:, None]
    witness, _ = Rotation.align_vectors(unit, v / np.linalg.norm(v, axis=1)[:, None], weights=w)
    found = align(m, v, w)
    close(found.R, witness.as_matrix(), atol=1e-12, unit="1", because="the same singular-value problem")
    assert np.abs(found.R.T - witness.as_matrix()).max() > 0.01
    loose, tight = (align_with_prior(m, v, w, sigma) for sigma in (1e3, 1e-9))
    close(loose.R, witness.as_matrix(), atol=1e-6, unit="1", because="a prior that says nothing, and its share")
    close(tight.R, np.eye(3), atol=1e-9, unit="1", because="a prior that says all")
    F, d = found.information, turn_vector(found.R)
    shrunk = np.linalg.solve(F + np.eye(3) / 0.1**2, F @ d)
    close(
        turn_vector(align_with_prior(m, v, w, 0.1).R),
        shrunk,
        atol=2e-4,
        unit="rad",
        because="linear for turns of 0.04 rad",
    )
    turned, _ = relative(found, tight)
    close(turned, found.R, atol=1e-8, unit="1", because="a sun sensor that is known not to be turned")


def test_a_line_that_a_sensor_does_not_tell_stays_with_the_prior(close: Callable[..., None]) -> None:
    """All directions alike: Wahba's turn about that line is anything; with a prior it is none, and the rest is right."""
    m = np.tile([1.0, 0.02, -0.01], (40, 1)) + 1e-4 * np.random.default_rng(5).normal(size=(40, 3))
    v = np.tile([1.0, 0.0, 0.0], (40, 1))
    known = align_with_prior(m, v, np.full(40, 1e6), 0.05)
    close(turn_vector(known.R), [0.0, 0.01, 0.02], atol=2e-4, unit="rad", because="noise 1e-4, turns to second order")


@pytest.mark.parametrize(("nutation_deg", "printed_deg"), [(2.0, 0.184), (0.2, 1.84)])
def test_the_trap_of_the_sun_line(close: Callable[..., None], nutation_deg: float, printed_deg: float) -> None:
    """A slit sees the sun in one line of the body, moved by nutation alone: 1562 pulses, 0.18 deg each, tell the turn
    about that line to 0.18/sqrt(1562)/tilt, and nutation's rms tilt across the line is 2 deg/sqrt 2 or so."""
    motion, _ = st5_motion(Rotation.identity(), nutation_deg)
    t = np.arange(0.0, 3600.0, 0.5)
    axis = motion.Om_N_rad_s / np.linalg.norm(motion.Om_N_rad_s)
    s = np.cross(axis, [0.0, 1.0, 0.0])
    s = s / np.linalg.norm(s)
    pulse_s, seen = SlitSunSensor().crossings(
        t, lambda at: motion.see(at, np.tile(s, (len(at), 1))), np.random.default_rng(0)
    )
    found = align(
        seen, motion.see(pulse_s, np.tile(s, (len(pulse_s), 1))), np.full(len(pulse_s), np.radians(0.18) ** -2)
    )
    line = np.linalg.eigh(found.information)[1][:, 0]
    close(
        np.degrees(found.weakest_rad),
        printed_deg,
        atol=0.05 * printed_deg,
        unit="deg",
        because="1562 or 1563 pulses, and phase",
    )
    close(abs(line[0]), 1.0, atol=0.01, unit="1", because="the slit looks along x")


def test_the_slit_of_a_uniform_spin(close: Callable[..., None]) -> None:
    """Sun at 20 deg elevation, spin 26 rpm about z from azimuth zero backward: crossings are evenly spaced."""
    slit, elevation = SlitSunSensor(azimuth_deg=40.0, noise_deg=0.18), np.radians(20.0)

    def sun_B(t: np.ndarray) -> np.ndarray:
        a = -SPIN * t
        return np.stack(
            [np.cos(elevation) * np.cos(a), np.cos(elevation) * np.sin(a), np.full_like(a, np.sin(elevation))], 1
        )

    exact = SlitSunSensor(azimuth_deg=40.0).crossings(np.arange(0.0, 3600.0, 0.1), sun_B, np.random.default_rng(0))
    expected = (2.0 * np.pi * np.arange(1, 1561) - np.radians(40.0)) / SPIN
    close(exact[0], expected, atol=1e-9, unit="s", because="root finding")
    close(exact[1], slit.direction(np.full(1560, elevation)), atol=1e-9, unit="1", because="root finding")
    noisy = slit.crossings(np.arange(0.0, 3600.0, 0.1), sun_B, np.random.default_rng(1))
    late_ms = 1e3 * np.std(noisy[0] - expected)
    close(late_ms, 1.15 / np.cos(elevation), atol=0.09, unit="ms", because="1560 pulses: 1.8 % a sigma, four of them")
    up_deg = np.degrees(np.arcsin(noisy[1][:, 2])) - 20.0
    close(np.std(up_deg), 0.18, atol=0.013, unit="deg", because="1560 pulses: 1.8 % a sigma, four of them")


@pytest.mark.parametrize("extended", [True, False])
def test_the_filter_is_consistent(extended: bool) -> None:
    """Ten runs of 300 s: squared innovations 1 +- 0.08 (21,600 of them: four sigma is 0.04), and
    the final attitude within its covariance (30 components: rms 1 +- 0.55 at 6e-5)."""
    J = ST5
    pulls, nis = [], []
    for seed in range(10):
        rng = np.random.default_rng([2, seed])
        R0 = Rotation.from_rotvec(rng.normal(size=3))
        rate = np.array([0.09, -0.06, SPIN])
        t = np.arange(0.0, 300.0, 0.125)
        A = free(J, rate, t, R0)
        a = 2.0 * np.pi * t / 300.0
        H = 30_000.0 * np.stack([np.cos(a), np.sin(a), 0.4 * np.cos(2 * a)], axis=1)
        B = np.einsum("kij,kj->ki", A, H) + 200.0 * rng.standard_normal(H.shape)
        seen = np.arange(0, len(t), 18)
        s = np.tile([0.6, -0.64, 0.48], (len(seen), 1))
        sun_B = np.einsum("kij,kj->ki", A[seen], s)
        azimuth = np.arctan2(sun_B[:, 1], sun_B[:, 0]) + 0.003 * rng.standard_normal(len(seen)) / np.hypot(
            *sun_B[:, :2].T
        )
        up = np.arcsin(sun_B[:, 2]) + 0.003 * rng.standard_normal(len(seen))
        sun_B = np.stack([np.cos(up) * np.cos(azimuth), np.cos(up) * np.sin(azimuth), np.sin(up)], axis=1)
        start = np.datetime64("2006-04-15", "ns")
        time = start + (t * 1e9).astype("timedelta64[ns]")
        rows = SpinRows(start, time, t, B, H, t[seen], sun_B, s, np.arange(len(t)), {})
        settings = FilterSettings(200.0, 0.003, first_attitude_rad=0.05, first_rate_rad_s=0.02, extended=extended)
        far = 1.0 if extended else 1e-3
        A0 = turn(far * 0.05 * rng.standard_normal(3)) @ A[0]
        found = spin_filter(rows, B, A0, rate + far * 0.01 * rng.standard_normal(3), J[2] / J[0], settings)
        off = turn_vector(found.A_last @ A[-1].T)
        pulls.append(np.linalg.solve(np.linalg.cholesky(found.P[:3, :3]), off))
        nis.append([found.field_nis, found.sun_nis])
    assert abs(np.mean(nis, axis=0)[0] - 1.0) < 0.08
    assert abs(np.mean(nis, axis=0)[1] - 1.0) < 0.25
    assert 0.45 < np.sqrt(np.mean(np.square(pulls))) < 1.55


def test_rotation_helpers(close: Callable[..., None]) -> None:
    v = np.array([0.4, -0.2, 0.7])
    close(turn(v), Rotation.from_rotvec(v).as_matrix(), atol=1e-14, unit="1", because="scipy's, active")
    close(turn_vector(turn(v)), v, atol=1e-14, unit="rad", because="inverse")
    close(skew(v) @ [1.0, 2.0, 3.0], np.cross(v, [1.0, 2.0, 3.0]), atol=1e-14, unit="1", because="the cross product")
