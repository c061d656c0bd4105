"""Every control law flown by the kernel and by the adaptive reference path: other equations, the same flight."""

from __future__ import annotations

import numpy as np
import pytest
from adaptive_flight import fly_adaptive, torques_B_Nm

from fluxtwin.sim.earth import frames
from fluxtwin.sim.earth.field import load_field
from fluxtwin.sim.earth.orbit import Orbit
from fluxtwin.sim.spacecraft.control import CONTROLS, BDot, Control, MomentumBias, Spin, ThreeAxis
from fluxtwin.sim.spacecraft.dynamics.environment import environment_along
from fluxtwin.sim.spacecraft.dynamics.flight import Start, fly
from fluxtwin.sim.spacecraft.dynamics.vehicle import Target, Vehicle, Wheel
from fluxtwin.sim.spacecraft.sensors.magnetometer import Magnetometer
from fluxtwin.sim.spacecraft.torques import (
    TORQUES,
    Aerodynamic,
    DragMoment,
    EddyCurrents,
    GravityGradient,
    Plate,
    ResidualDipole,
    SolarPressure,
    SunlightMoment,
    Torque,
    Torquers,
)

pytestmark = pytest.mark.reference

EPOCH = np.datetime64("2022-03-01T00:00:00", "ns")
ORBIT = Orbit(epoch_utc=EPOCH, altitude_km=420.0, inclination_rad=1.3, raan_rad=0.5)
TURN = frames.rotation_BO(np.array([0.1]), np.array([0.2]), np.array([-0.3]))
LAWS: dict[str, Control | None] = {
    "none": None,
    "b_dot": BDot(gain_Am2_s_per_T=5e6),
    "three_axis": ThreeAxis(frequency_rad_s=0.05, unloading_per_s=1e-3, integral_s=100.0),
    "momentum_bias": MomentumBias(
        momentum_Nms=5.0,
        nutation_gain_Am2_s_per_T=1e6,
        precession_gain_Am2_per_rad=50.0,
        momentum_gain_per_T=10.0,
        field_use="proportional",
    ),
    "spin": Spin(rate_rpm=1.0, axis_gain_Am2_per_T=1e5, rate_gain_Am2_s_per_T=1e7, nutation_gain_Am2_s_per_T=1e6),
}


PLATES = (
    Plate(area_m2=3.0, normal_B=(1.0, 0.0, 0.0), centre_m=(0.5, 0.1, 0.2)),
    Plate(area_m2=2.0, normal_B=(0.0, 1.0, 1.0), centre_m=(0.0, 0.4, 0.1)),
    Plate(area_m2=4.0, normal_B=(-1.0, 0.2, -1.0), centre_m=(-0.3, 0.2, 0.4)),
)
ALL_TORQUES: tuple[Torque, ...] = (
    GravityGradient(),
    ResidualDipole(dipole_Am2=(1.0, 0.5, -0.3)),
    Torquers(dipole_Am2=10.0),
    EddyCurrents(K_Am2_s_per_T=((1e4, 0.0, 0.0), (0.0, 2e4, 0.0), (0.0, 0.0, 1e4))),
    Aerodynamic(plates=PLATES),
    SolarPressure(plates=PLATES),
    DragMoment(moment_m3=(3.0, -2.0, 1.0)),
    SunlightMoment(moment_m3=(20.0, 10.0, -30.0)),
)


def test_every_law_and_torque_is_flown() -> None:
    assert {law.name for law in CONTROLS} | {"none"} == set(LAWS)
    assert {torque.name for torque in TORQUES} == {torque.name for torque in ALL_TORQUES}


def test_what_a_compass_reads_is_corrected_to_the_field_by_equation_1() -> None:
    """(I + S) reading + b = B."""
    S, b_nT, B_nT = (
        np.array([[0.02, -0.01, 0.0], [0.01, -0.03, 0.005], [0.0, 0.01, 0.01]]),
        [7e3, -3e3, -6e3],
        [2e4, 1e4, -3e4],
    )
    row = np.array(Vehicle(np.eye(3), compass=Magnetometer(S, np.array(b_nT))).compass_row)
    reading_nT = row[:9].reshape(3, 3) @ B_nT + 1e9 * row[9:]
    assert (np.eye(3) + S) @ reading_nT + b_nT == pytest.approx(np.array(B_nT))


@pytest.mark.parametrize("name", LAWS)
def test_the_kernel_flies_as_the_reference_does(name: str, close) -> None:
    J = TURN.as_matrix()[0] @ np.diag([100.0, 120.0, 80.0]) @ TURN.as_matrix()[0].T
    wheels = tuple(
        Wheel(axis, 0.05, 300.0, 0.05, 1e-5, 1e-3) for axis in ((0.0, 1.0, 0.0), (1.0, 0.0, 0.2), (0.0, 0.0, 1.0))
    )
    target = Target(attitude=frames.rotation_BO(np.array([0.02]), np.array([-0.01]), np.array([0.03]))[0])
    compass = Magnetometer(
        np.array([[0.02, -0.01, 0.0], [0.01, -0.03, 0.005], [0.0, 0.01, 0.01]]), np.array([7e3, -3e3, -6e3])
    )
    vehicle = Vehicle(J, wheels, ALL_TORQUES, LAWS[name], target, compass)
    around = environment_along(
        ORBIT.propagate, EPOCH, 120.0, spacing_s=5.0, field=load_field(), with_sun=True, with_air=True
    )
    assert around.nodes[:, 12].min() > 0.9, "in sunlight: a shadow's edge has no spline"
    q = frames.q_from_rotation(TURN * frames.rotation_ON(*ORBIT.propagate(EPOCH)))[0]
    start = Start(q, np.radians([0.5, -0.3, 0.8]), np.array([-50.0, 10.0, 20.0]))
    exact = fly_adaptive(vehicle, around, start, duration_s=120.0, period_s=5.0, rtol=1e-11)
    flight = fly(vehicle, around, start, duration_s=120.0, step_s=0.25, control_every=20, log_every=20)
    apart = frames.rotation_from_q(flight.q_NB) * frames.rotation_from_q(exact.q_NB).inv()
    why = "fourth order in 0.25 s, a wheel's friction passing through zero"
    close(np.degrees(apart.magnitude()), 0.0, atol=1e-6, unit="deg", because=why)
    close(flight.wheel_speed_rad_s, exact.wheel_speed_rad_s, atol=1e-6, unit="rad/s", because=why)
    close(flight.dipole_B_Am2, exact.dipole_B_Am2, atol=1e-4, unit="A m2", because="1e-8 rad in the field, by the gain")
    close(flight.field_B_nT, exact.field_B_nT, atol=1e-2, unit="nT", because="the attitude, and a spline for a cubic")
    if name != "none":
        idle = fly(Vehicle(J, wheels, ALL_TORQUES), around, start, duration_s=120.0, step_s=0.25, log_every=20)
        with pytest.raises(AssertionError):
            close(idle.q_NB, flight.q_NB, atol=1e-6, unit="1", because="without the law it is another flight")


@pytest.mark.parametrize("left_out", ALL_TORQUES, ids=lambda torque: torque.name)
def test_each_torque_is_felt_in_that_flight(left_out: Torque) -> None:
    """So that the comparison above says something of each: it moves the body by far more than the tolerance."""
    around = environment_along(
        ORBIT.propagate, EPOCH, 120.0, spacing_s=5.0, field=load_field(), with_sun=True, with_air=True
    )
    start = Start(np.array([0.1, 0.2, 0.3, 0.9]), np.radians([0.5, -0.3, 0.8]), np.zeros(0))
    fewer = tuple(torque for torque in ALL_TORQUES if torque is not left_out)
    law = LAWS["b_dot"] if left_out.name == "torquers" else None
    ends = []
    for torques in (ALL_TORQUES, fewer):
        vehicle = Vehicle(np.diag([100.0, 120.0, 80.0]), (), torques, law)
        flight = fly(vehicle, around, start, duration_s=120.0, step_s=0.25, control_every=20, log_every=480)
        ends.append(frames.rotation_from_q(flight.q_NB[-1:]))
    assert np.degrees((ends[0] * ends[1].inv()).magnitude()[0]) > 1e-5


def test_the_momentum_balances_the_torques_along_the_flight(close) -> None:
    """H(t2) - H(t1) is the integral of the torque in N, which is worked out anew from what the flight recorded."""
    J = np.diag([100.0, 120.0, 80.0])
    torques = (
        GravityGradient(),
        ResidualDipole(dipole_Am2=(1.0, 0.5, -0.3)),
        Torquers(dipole_Am2=10.0),
        Aerodynamic(plates=PLATES),
        SolarPressure(plates=PLATES),
    )
    wheel = Wheel((0.0, 1.0, 0.0), 0.05, 300.0, 0.05, 1e-5, 1e-3)
    vehicle = Vehicle(J, (wheel,), torques, LAWS["b_dot"])
    around = environment_along(
        ORBIT.propagate, EPOCH, 1200.0, spacing_s=5.0, field=load_field(), with_sun=True, with_air=True
    )
    start = Start(np.array([0.1, 0.2, 0.3, 0.9]), np.radians([0.5, -0.3, 0.8]), np.array([-50.0]))
    flight = fly(vehicle, around, start, duration_s=1200.0, step_s=0.5, control_every=20)
    motion = flight.attitude(flight.seconds_s)
    torque_B = torques_B_Nm(vehicle, motion, around.at(flight.seconds_s), flight.dipole_B_Am2)
    R_NB = motion.R_BN.inv()
    own = wheel.inertia_kg_m2 * flight.wheel_speed_rad_s
    momentum_N = R_NB.apply(motion.rate_B_rad_s @ J + own * [0.0, 1.0, 0.0])
    torque_N = R_NB.apply(torque_B)
    # Simpson over each tick of 20 steps, in which the dipole is held: at its end the new one is already on.
    held = np.repeat(flight.dipole_B_Am2[:-1:20], 21, axis=0)
    rows = (np.arange(0, 2400, 20)[:, None] + np.arange(21)).ravel()
    change_B = np.cross(held - flight.dipole_B_Am2[rows], 1e-9 * flight.field_B_nT[rows])
    torque_N = torque_N[rows] + R_NB[rows].apply(change_B)
    weights = np.array([1.0, *[4.0, 2.0] * 9, 4.0, 1.0]) * 0.5 / 3.0
    gained = np.cumsum(np.einsum("k,ikj->ij", weights, torque_N.reshape(-1, 21, 3)), axis=0)
    size = float(np.abs(gained).max())
    close(momentum_N[20::20] - momentum_N[0], gained, atol=1e-5 * size, unit="N m s", because="Simpson in 0.5 s")
    without = Vehicle(J, (wheel,), torques[:3], LAWS["b_dot"])
    poor = torques_B_Nm(without, motion, around.at(flight.seconds_s), flight.dipole_B_Am2)
    assert np.abs(poor - torque_B).max() > 1e-6, "the air and the light matter"
