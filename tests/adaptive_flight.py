"""The same flight by another way: Euler's equations and an adaptive method of order eight, to check the kernel.

State and equations differ from the kernel's (rate and wheel speeds instead of momenta, the quaternion's own equation,
the surroundings from a spline), the formulas of torques and control laws are the same functions, not compiled.
"""

from __future__ import annotations

import numpy as np
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

from fluxtwin.sim.attitude.record import Attitude
from fluxtwin.sim.base.errors import BadInput
from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.earth import frames
from fluxtwin.sim.spacecraft.dynamics import layout
from fluxtwin.sim.spacecraft.dynamics.environment import Environment
from fluxtwin.sim.spacecraft.dynamics.flight import Flight, Start
from fluxtwin.sim.spacecraft.dynamics.vehicle import Vehicle, part_names
from fluxtwin.sim.spacecraft.torques import drive


class _Problem:
    """One vehicle in its surroundings, with what its actuators do at the moment."""

    def __init__(self, vehicle: Vehicle, environment: Environment, dipoles_B_Am2: FloatArray | None) -> None:
        seconds = environment.spacing_s * np.arange(-1.0, len(environment.nodes) - 1.0)
        self.surroundings = CubicSpline(seconds, environment.nodes)
        self.vehicle, self.dipoles = vehicle, np.zeros((0, 3)) if dipoles_B_Am2 is None else dipoles_B_Am2
        self.wheels, self.inverse = vehicle.wheel_rows, np.linalg.inv(vehicle.bare_inertia_kg_m2)
        self.packed, slots = vehicle.packed()
        self.slots = dict(zip(part_names(), slots.tolist(), strict=True))
        self.dipole, self.motor = np.zeros(3), np.zeros(len(self.wheels))
        self.memory = np.zeros(layout.MEMORY_SIZE)

    def stage(self, t: float, state: FloatArray) -> FloatArray:
        """The instant as torques see it; state: q_NB, rate, wheel speeds."""
        stage = np.zeros(layout.STAGE_SIZE)
        A = frames.rotation_from_q(state[None, :4]).as_matrix()[0]
        stage[layout.ROTATION : layout.ROTATION + 9] = A.ravel()
        stage[layout.RATE : layout.RATE + 3] = state[4:7]
        around = self.surroundings(t)
        stage[layout.POSITION : layout.POSITION + around.size] = around
        stage[layout.FIELD : layout.FIELD + 3] = A @ stage[layout.FIELD_N : layout.FIELD_N + 3]
        stage[layout.DIPOLE : layout.DIPOLE + 3] = self.dipole
        return stage

    def slope(self, t: float, state: FloatArray) -> FloatArray:
        """Euler's equations with wheels (Markley & Crassidis 2014, section 3.3)."""
        stage = self.stage(t, state)
        for torque in self.vehicle.torques:
            type(torque).add(self.packed, self.slots[torque.name], stage)
        q, w, speed = state[:4], state[4:7], state[7:]
        axes, own = self.wheels[:, :3], self.wheels[:, 3]
        friction = self.wheels[:, 6] * speed
        friction += self.wheels[:, 7] * speed / np.sqrt(speed**2 + layout.COULOMB_SPEED_RAD_S**2)
        on_wheel = self.motor - friction
        momentum = self.vehicle.bare_inertia_kg_m2 @ w + (own * (speed + axes @ w)) @ axes
        torque_B = stage[layout.TORQUE : layout.TORQUE + 3]
        w_dot = self.inverse @ (torque_B - on_wheel @ axes - np.cross(w, momentum))
        q_dot = 0.5 * np.append(q[3] * w + np.cross(q[:3], w), -q[:3] @ w)
        return np.concatenate([q_dot, w_dot, on_wheel / own - axes @ w_dot])

    def tick(self, number: int, period_s: float, state: FloatArray) -> None:
        """Let the law decide; dipole and motor torques hold until the next tick."""
        stage, command = self.stage(number * period_s, state), np.zeros(layout.COMMAND_SIZE)
        law = self.vehicle.control
        if law is not None:
            reading = self.reading(number, period_s, stage, state)
            type(law).decide(self.packed, self.slots[law.name], reading, self.memory, command)
        self.dipole = np.zeros(3)
        if self.slots["torquers"]:
            drive(self.packed, self.slots["torquers"], command)
            self.dipole = command[:3] + (self.dipoles[number] if number < len(self.dipoles) else 0.0)
        self.motor = self.limited(-self.vehicle.share @ command[3:6], period_s, state[7:])

    def reading(self, number: int, period_s: float, stage: FloatArray, state: FloatArray) -> FloatArray:
        """What the law is given, without errors."""
        reading = np.zeros(layout.READING_SIZE)
        A, target = stage[:9].reshape(3, 3), self.vehicle.target
        r, v = stage[layout.POSITION : layout.VELOCITY], stage[layout.VELOCITY : layout.FIELD_N]
        frame, rate_N = np.eye(3), np.zeros(3)
        if target.frame == "orbital":
            frame, rate_N = frames.rotation_ON(r[None], v[None]).as_matrix()[0], np.cross(r, v) / (r @ r)
        turn = Rotation.from_matrix(A @ (target.attitude.as_matrix() @ frame).T).inv().as_quat()
        compass = np.array(self.vehicle.compass_row)
        field_T = compass[:9].reshape(3, 3) @ stage[layout.FIELD : layout.FIELD + 3] + compass[9:]
        reading[layout.SEEN_FIELD : layout.ERROR] = field_T
        reading[layout.ERROR : layout.RATE_ERROR] = 2.0 * turn[:3] * np.sign(turn[3])
        reading[layout.RATE_ERROR : layout.SEEN_RATE] = state[4:7] - A @ rate_N
        reading[layout.SEEN_RATE : layout.TARGET_RATE] = state[4:7]
        reading[layout.TARGET_RATE : layout.WHEEL_MOMENTUM] = A @ rate_N
        reading[layout.WHEEL_MOMENTUM : layout.AXIS] = (self.wheels[:, 3] * state[7:]) @ self.wheels[:, :3]
        reading[layout.AXIS : layout.PERIOD] = A @ frame.T @ np.asarray(target.row[10:])
        reading[layout.PERIOD], reading[layout.TICK] = period_s, number
        return reading

    def limited(self, motor: FloatArray, period_s: float, speed: FloatArray) -> FloatArray:
        """Motor torques within the wheels' limits of torque and speed."""
        for j, wheel in enumerate(self.wheels):
            if wheel[4] > 0.0:
                room = wheel[3] / period_s
                motor[j] = np.clip(motor[j], room * (-wheel[4] - speed[j]), room * (wheel[4] - speed[j]))
            if wheel[5] > 0.0:
                motor[j] = np.clip(motor[j], -wheel[5], wheel[5])
        return motor


def fly_adaptive(
    vehicle: Vehicle,
    environment: Environment,
    start: Start,
    *,
    duration_s: float,
    period_s: float,
    dipoles_B_Am2: FloatArray | None = None,
    rtol: float = 1e-12,
) -> Flight:
    """The flight with a row at each tick, `period_s` apart; slow (about 10,000 evaluations a second).

    DOP853 (Hairer, Norsett & Wanner 1993) from tick to tick, relative tolerance rtol.
    """
    problem = _Problem(vehicle, environment, dipoles_B_Am2)
    state = np.concatenate([start.q_NB / np.linalg.norm(start.q_NB), start.rate_B_rad_s, start.wheel_speed_rad_s])
    small = rtol * np.array(
        [1.0] * 4 + [max(1e-3, float(np.linalg.norm(start.rate_B_rad_s)))] * 3 + [1.0] * len(state[7:])
    )
    rows, dipoles, fields = [], [], []
    for number in range(int(np.floor(duration_s / period_s + 1e-9)) + 1):
        problem.tick(number, period_s, state)
        rows.append(state)
        dipoles.append(problem.dipole)
        fields.append(1e9 * problem.stage(number * period_s, state)[layout.FIELD : layout.FIELD + 3])
        span = (number * period_s, (number + 1) * period_s)
        state = solve_ivp(problem.slope, span, state, method="DOP853", rtol=rtol, atol=small).y[:, -1]
        state = np.concatenate([state[:4] / np.linalg.norm(state[:4]), state[4:]])
    history = np.array(rows)
    parts = history[:, :4], history[:, 4:7], np.array(dipoles), history[:, 7:], np.array(fields)
    return Flight(environment.start, period_s, *parts)


def torques_B_Nm(
    vehicle: Vehicle, motion: Attitude, surroundings: FloatArray, dipole_B_Am2: FloatArray | None = None
) -> FloatArray:
    """(N, 3) the sum of the vehicle's torques, in B, at each stamp of a motion (simulated or recorded).

    surroundings (N, 14): columns as in `Environment.nodes`, for instance `Environment.at`. dipole_B_Am2 (N, 3): what
    the torquers did. Raises BadInput for numbers of rows that differ.
    """
    from fluxtwin.sim.spacecraft.dynamics.kernels import torque_chain

    rows = len(motion)
    dipole = np.zeros((rows, 3)) if dipole_B_Am2 is None else np.asarray(dipole_B_Am2, dtype=np.float64)
    if surroundings.shape != (rows, layout.FIELD - layout.POSITION) or dipole.shape != (rows, 3):
        raise BadInput(
            f"{rows} attitudes, surroundings {surroundings.shape}, dipole {dipole.shape}",
            where="torques along a motion",
            wanted=f"({rows}, {layout.FIELD - layout.POSITION}) and ({rows}, 3)",
        )
    stages = np.zeros((rows, layout.STAGE_SIZE))
    stages[:, layout.ROTATION : layout.RATE] = motion.R_BN.as_matrix().reshape(-1, 9)
    stages[:, layout.RATE : layout.POSITION] = motion.rate_B_rad_s
    stages[:, layout.POSITION : layout.FIELD] = surroundings
    stages[:, layout.FIELD : layout.DIPOLE] = motion.R_BN.apply(surroundings[:, 6:9])
    stages[:, layout.DIPOLE : layout.TORQUE] = dipole
    packed, slots = vehicle.packed()
    for stage in stages:
        torque_chain(slots, packed, stage)
    return stages[:, layout.TORQUE : layout.TORQUE + 3].copy()
