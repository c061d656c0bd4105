"""The compiled flight against closed solutions, conservation laws, an adaptive integrator, and its own order."""

from __future__ import annotations

import numpy as np
import pytest
from adaptive_flight import fly_adaptive
from scipy.spatial.transform import Rotation

from fluxtwin.sim.attitude.rigid_body import torque_free
from fluxtwin.sim.base.errors import BadInput
from fluxtwin.sim.earth import frames
from fluxtwin.sim.spacecraft.control import ThreeAxis
from fluxtwin.sim.spacecraft.dynamics.environment import Environment
from fluxtwin.sim.spacecraft.dynamics.flight import Flight, Start, fly
from fluxtwin.sim.spacecraft.dynamics.vehicle import Target, Vehicle, Wheel
from fluxtwin.sim.spacecraft.torques import GravityGradient, ResidualDipole

pytestmark = pytest.mark.reference

EPOCH = np.datetime64("2022-01-01T00:00:00", "ns")
SPIN_RAD_S = 26.0 * 2.0 * np.pi / 60.0
Q0 = frames.q_from_rotation(Rotation.from_euler("xyz", [0.3, -1.1, 2.0]))[0]
TURN = Rotation.from_euler("xyz", [0.5, 0.2, -0.9]).as_matrix()


def empty_space(duration_s: float) -> Environment:
    return Environment(EPOCH, duration_s, np.zeros((4, 6)))


def still_field(duration_s: float, field_nT: tuple[float, float, float], r_m: float = 7e6) -> Environment:
    """A constant field, and a place that does not move."""
    nodes = np.tile([r_m, 0.0, 0.0, 0.0, 7.5e3, 0.0, *(1e-9 * np.array(field_nT))], (4, 1))
    return Environment(EPOCH, duration_s, nodes)


def apart_deg(one: Flight, other: Flight | np.ndarray) -> np.ndarray:
    q = other.q_NB if isinstance(other, Flight) else other
    R = frames.rotation_from_q(one.q_NB) * frames.rotation_from_q(q).inv()
    return np.degrees(R.magnitude())


def momentum_N(flight: Flight, vehicle: Vehicle) -> np.ndarray:
    """(R, 3) whole momentum, from the rates and wheel speeds that came out."""
    wheels, rate = vehicle.wheel_rows, flight.rate_B_rad_s
    own = wheels[:, 3] * flight.wheel_speed_rad_s
    momentum_B = rate @ np.asarray(vehicle.inertia_kg_m2).T + own @ wheels[:, :3]
    return frames.rotation_from_q(flight.q_NB).inv().apply(momentum_B)


BODIES = {
    "axisymmetric, nutation 2 deg": ([0.8, 0.8, 1.12], [np.tan(np.radians(2.0)) * 1.4 * SPIN_RAD_S, 0.0, SPIN_RAD_S]),
    "tri-axial": ([1.0, 1.4, 1.9], [0.5, 0.3, SPIN_RAD_S]),
    "tri-axial about the smallest moment": ([1.9, 1.4, 1.0], [0.5, 0.3, SPIN_RAD_S]),
}


@pytest.mark.parametrize("name", BODIES)
def test_torque_free_motion_after_an_hour_at_26_rpm(name: str, close) -> None:
    """Against the closed solutions (elliptic functions for the tri-axial body), which have tests of their own."""
    moments, rate0 = (np.array(v) for v in BODIES[name])
    step_s = 1.0 / 1000.0
    vehicle = Vehicle(np.diag(moments))
    start = Start(Q0, rate0, np.zeros(0))
    flight = fly(vehicle, empty_space(3600.0), start, duration_s=3600.0, step_s=step_s, log_every=300_000)
    R_BN, _ = torque_free(flight.seconds_s, np.diag(moments), frames.rotation_from_q(Q0[None])[0], rate0)
    close(apart_deg(flight, frames.q_from_rotation(R_BN)), 0.0, atol=1e-6, unit="deg", because="fifth order in 1 ms")
    momentum = momentum_N(flight, vehicle)
    size = np.linalg.norm(momentum[0])
    energy = np.einsum("ij,j,ij->i", flight.rate_B_rad_s, moments, flight.rate_B_rad_s)
    close((momentum - momentum[0]) / size, 0.0, atol=1e-12, unit="1", because="it is the state itself")
    close(energy / energy[0], 1.0, atol=1e-12, unit="1", because="fifth order in 1 ms")
    wrong, _ = torque_free(flight.seconds_s, np.diag(moments * [1.01, 1, 1]), R_BN[0], rate0)
    with pytest.raises(AssertionError):
        close(
            apart_deg(flight, frames.q_from_rotation(wrong)), 0.0, atol=1e-6, unit="deg", because="a mutant must fail"
        )


def busy_vehicle() -> tuple[Vehicle, Start]:
    """Products of inertia, two skew wheels with friction, gravity gradient and a large dipole."""
    inertia = TURN @ np.diag([10.0, 14.0, 8.0]) @ TURN.T
    wheels = (
        Wheel((0.0, 1.0, 0.0), 0.05, viscous_Nm_s=1e-3),
        Wheel((1.0, 0.0, 1.0), 0.03, viscous_Nm_s=2e-3, coulomb_Nm=1e-3),
    )
    torques = (GravityGradient(), ResidualDipole(dipole_Am2=(300.0, -200.0, 100.0)))
    start = Start(Q0, np.array([0.1, -0.2, 0.15]), np.array([30.0, -40.0]))
    return Vehicle(inertia, wheels, torques), start


def test_the_order_is_four() -> None:
    """Halving the step divides the error by 2^4, against DOP853 on Euler's equations."""
    vehicle, start = busy_vehicle()
    around = still_field(40.0, (20_000.0, -30_000.0, 25_000.0))
    exact = fly_adaptive(vehicle, around, start, duration_s=40.0, period_s=20.0, rtol=1e-13)
    errors = []
    for halvings in range(3):
        step_s = 1.0 / 2**halvings
        every = round(20.0 / step_s)
        flight = fly(vehicle, around, start, duration_s=40.0, step_s=step_s, log_every=every)
        errors.append(float(apart_deg(flight, exact)[-1]))
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    assert errors[-1] > 1e-8, "the errors must stand above the reference's own"
    assert (orders > 3.7).all() and (orders < 4.6).all(), (errors, orders)


def test_the_wheels_only_pass_momentum_on(close) -> None:
    """Wheels that slew the body against friction and limits change nothing of the whole momentum."""
    inertia = TURN @ np.diag([10.0, 14.0, 8.0]) @ TURN.T
    wheels = tuple(Wheel(a, 0.05, 100.0, 0.05, 1e-4, 1e-3) for a in ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.2, 0.0, 1.0)))
    law = ThreeAxis(frequency_rad_s=0.2, damping=0.8)
    vehicle = Vehicle(inertia, wheels, control=law, target=Target("inertial"))
    start = Start(Q0, np.array([0.01, -0.02, 0.015]), np.array([30.0, -40.0, 0.0]))
    flight = fly(vehicle, empty_space(200.0), start, duration_s=200.0, step_s=0.1, control_every=5, log_every=10)
    momentum = momentum_N(flight, vehicle)
    close(momentum, momentum[0], atol=1e-12, unit="N m s", because="rounding of 5 N m s")
    assert np.abs(flight.wheel_speed_rad_s - start.wheel_speed_rad_s).max() > 5.0, "they did something"
    # The limit holds where the torque command is held; friction and the body's turn move the speed a little within it.
    assert np.abs(flight.wheel_speed_rad_s).max() <= 100.0 + 0.5


def test_friction_runs_a_wheel_down(close) -> None:
    """A free body and a coasting wheel on one axis: d(speed)/dt = -c (1/I + 1/J) speed, in closed form."""
    own, bare, friction = 0.05, 2.0, 1e-3
    vehicle = Vehicle(np.diag([3.0, bare + own, 4.0]), (Wheel((0.0, 1.0, 0.0), own, viscous_Nm_s=friction),))
    start = Start(Q0, np.zeros(3), np.array([100.0]))
    flight = fly(vehicle, empty_space(100.0), start, duration_s=100.0, step_s=0.5, log_every=10)
    decay = np.exp(-friction * (1.0 / own + 1.0 / bare) * flight.seconds_s)
    close(flight.wheel_speed_rad_s[:, 0], 100.0 * decay, atol=1e-8, unit="rad/s", because="fourth order in 0.01")
    body = own * 100.0 * (1.0 - decay) / (bare + own)
    close(flight.rate_B_rad_s[:, 1], body, atol=1e-10, unit="rad/s", because="momentum is conserved")


def test_a_wheel_that_is_too_fast_is_braked_by_no_more_than_its_motor_can(close) -> None:
    """Above its greatest speed, on one axis: d(speed)/dt = -(1/I + 1/J) of the greatest torque, by both paths."""
    own, bare, most = 0.05, 2.0, 0.05
    wheel = Wheel((0.0, 1.0, 0.0), own, max_speed_rad_s=100.0, max_torque_Nm=most)
    vehicle = Vehicle(np.diag([3.0, bare + own, 4.0]), (wheel,))
    start, around = Start(Q0, np.zeros(3), np.array([150.0])), empty_space(20.0)
    flight = fly(vehicle, around, start, duration_s=20.0, step_s=0.5, control_every=2, log_every=2)
    expected = 150.0 - most * (1.0 / own + 1.0 / bare) * flight.seconds_s
    close(flight.wheel_speed_rad_s[:, 0], expected, atol=1e-9, unit="rad/s", because="a constant torque")
    exact = fly_adaptive(vehicle, around, start, duration_s=20.0, period_s=1.0)
    close(exact.wheel_speed_rad_s[:, 0], expected, atol=1e-9, unit="rad/s", because="a constant torque")


def test_a_gyrostat_nutates_at_the_textbook_rate(close) -> None:
    """A body with a wheel on its axis of symmetry: the transverse rate turns at h / J_t + (J_3 / J_t - 1) w_3."""
    across, along, own = 5.0, 6.0, 0.04
    speed, w3 = 250.0, 0.05
    vehicle = Vehicle(np.diag([across, across, along]), (Wheel((0.0, 0.0, 1.0), own),))
    start = Start(Q0, np.array([0.02, 0.0, w3]), np.array([speed]))
    flight = fly(vehicle, empty_space(60.0), start, duration_s=60.0, step_s=0.01, log_every=100)
    nutation = (own * speed + along * w3) / across - w3
    x, y, _ = flight.rate_B_rad_s.T
    expected = 0.02 * np.stack([np.cos(nutation * flight.seconds_s), np.sin(nutation * flight.seconds_s)])
    close(
        np.stack([x, y]),
        expected,
        atol=1e-8,
        unit="rad/s",
        because="(2 rad/s 0.01 s)^4 / 120 over 120 rad, of 0.02 rad/s",
    )
    with pytest.raises(AssertionError):
        close(np.stack([x, -y]), expected, atol=1e-8, unit="rad/s", because="a mutant must fail")


def test_between_two_rows_the_motion_is_as_good_as_on_them(close) -> None:
    vehicle, start = busy_vehicle()
    around = still_field(40.0, (20_000.0, -30_000.0, 25_000.0))
    every_second = fly(vehicle, around, start, duration_s=40.0, step_s=0.05, log_every=10)
    fine = fly(vehicle, around, start, duration_s=40.0, step_s=0.05, log_every=1)
    between = every_second.attitude(fine.seconds_s)
    apart = np.degrees((between.R_BN * frames.rotation_from_q(fine.q_NB).inv()).magnitude())
    close(apart, 0.0, atol=2e-5, unit="deg", because="0.5^4 / 384 of the rate's third derivative, 1e-3 rad/s^4")
    close(between.rate_B_rad_s, fine.rate_B_rad_s, atol=3e-6, unit="rad/s", because="the slope of the same cubic")


def test_what_does_not_fit_together_is_refused() -> None:
    vehicle, start = busy_vehicle()
    around = still_field(20.0, (0.0, 0.0, 0.0))
    with pytest.raises(BadInput, match="surroundings end"):
        fly(vehicle, around, start, duration_s=30.0, step_s=1.0)
    with pytest.raises(BadInput, match="whole ratio"):
        fly(vehicle, around, start, duration_s=20.0, step_s=0.3)
    with pytest.raises(BadInput, match="wheel speeds"):
        fly(vehicle, around, Start(Q0, np.zeros(3), np.zeros(1)), duration_s=20.0)
    with pytest.raises(BadInput, match="more inertia"):
        Vehicle(np.eye(3), (Wheel((1.0, 0.0, 0.0), 1.0),))
    with pytest.raises(BadInput, match="sum of the other two"):
        Vehicle(np.diag([1.0, 1.0, 3.0]))
