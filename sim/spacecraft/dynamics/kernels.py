"""The compiled flight: classical Runge-Kutta of order four for attitude, momentum and wheels.

The state of a vehicle is its attitude quaternion q_NB, its whole angular momentum H in N (wheels included) and the
momentum of each wheel about its own axis, measured in N. Then dH/dt is the outside torque alone: what no torque
acts on is conserved to the last bit, and wheels only pass momentum to and fro. The turn within a step is followed
as a rotation vector (Munthe-Kaas 1999, doi 10.1016/S0168-9274(98)00030-0), whose rate for the components in the
body is w + f x w / 2 + f x (f x w) / 12 + ..., so a steady spin has no error at all and the attitude needs no care
to stay one; with the terms kept the order is four.

Torques and control laws are plain functions elsewhere, listed there; here they are compiled, and each
is called where its parameters are present (packed[slot] is where they begin, 0 for absent).
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from math import cos, sin, sqrt
from types import FunctionType
from typing import Any

import numpy as np

from fluxtwin.sim.base.kernel_cache import kernel, part
from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.earth import constants
from fluxtwin.sim.spacecraft import control, torques
from fluxtwin.sim.spacecraft.control import CONTROLS
from fluxtwin.sim.spacecraft.dynamics import layout
from fluxtwin.sim.spacecraft.dynamics.layout import (
    COMMAND_DIPOLE,
    COMMAND_SIZE,
    COMMAND_TORQUE,
    COULOMB_SPEED_RAD_S,
    DIPOLE,
    FIELD,
    FIELD_N,
    MEMORY_SIZE,
    POSITION,
    RATE,
    READING_SIZE,
    ROTATION,
    STAGE_SIZE,
    TORQUE,
    VELOCITY,
)
from fluxtwin.sim.spacecraft.torques import TORQUES

_FAST = {"contract"}  # fused multiply-add: one rounding instead of two, nothing is reordered
_TWELFTH = 1.0 / 12.0


OPTIONS: dict[str, Any] = {"fastmath": _FAST, "error_model": "numpy", "forceinline": True}
PART: dict[str, Any] = OPTIONS | {"_nrt": False}
"""Of a function that makes no arrays: it counts no references to those that it is given, which took half of a flight."""
PARTS = [layout, constants, torques, control]
"""What is compiled into the kernels besides this file."""
_LAWS = len(TORQUES)
_CURIOUS = tuple(t.needs_field or t.needs_sun or t.needs_air for t in TORQUES)
_TORQUERS = [torque.name for torque in TORQUES].index("torquers")


@cache
def _compiled(function: FunctionType) -> Any:
    """A plain function for the kernels, and with it those that it calls."""
    called = [name for name in function.__code__.co_names if isinstance(function.__globals__.get(name), FunctionType)]
    inner = {name: _compiled(function.__globals__[name]) for name in called}
    return part(**PART)(FunctionType(function.__code__, function.__globals__ | inner))


def _chain(functions: Sequence[Any], slot: int) -> Any:
    """One function that calls, of these, each one whose parameters are present; compiled, every call is direct."""
    if not functions:
        return part()(lambda slots, packed, *rest: None)
    first, following = _compiled(functions[0]), _chain(functions[1:], slot + 1)

    @part(**PART)
    def run(slots: Any, packed: Any, *rest: Any) -> None:
        if slots[slot] > 0:
            first(packed, slots[slot], *rest)
        following(slots, packed, *rest)

    return run


torque_chain = _chain([torque.add for torque in TORQUES], 0)
_decide = _chain([law.decide for law in CONTROLS], _LAWS)
_drive = _compiled(torques.drive)
_to_body = _compiled(layout.to_body)


@kernel(uses=PARTS, nogil=True, **OPTIONS)
def fly(
    start: FloatArray,
    wheels: FloatArray,
    inverse: FloatArray,
    packed: FloatArray,
    slots: Any,
    nodes: FloatArray,
    substeps: int,
    dipoles: FloatArray,
    knowledge: FloatArray,
    target: FloatArray,
    compass: FloatArray,
    share: FloatArray,
    step_s: float,
    every: Any,
    out: FloatArray,
) -> None:
    """Fly a vehicle.

    start (7 + W,): q_NB, momentum in N, momenta of the W wheels. wheels (W, WHEEL_SIZE). inverse (3, 3): of the inertia
    tensor less that of the wheels about their axes. packed (P,), slots (torques + laws,): parameters and where they begin.
    nodes (K, columns): the surroundings, so many `substeps` apart. dipoles (ticks or 0, 3): what the torquers do besides
    the law [A m2]. knowledge (ticks or 0, 6): errors of the attitude [rad] and the field [T] that the law is given.
    target (13,), see `_seen_attitude`. compass (12,): field to reading, and what is added [T]. share (W, 3): wheel torques
    for a torque on the body. every: steps from tick to tick and from row to row. out (rows, 13 + W): q_NB, rate in B,
    dipole, field in B [T], wheel speeds relative to the body.
    """
    count = wheels.shape[0]
    state, stage = start.copy(), np.zeros(STAGE_SIZE)
    motor, memory, reading = np.zeros(count), np.zeros(MEMORY_SIZE), np.empty(READING_SIZE)
    command = np.empty(COMMAND_SIZE)
    body = wheels, inverse, packed, slots, motor
    work = np.zeros(4), np.empty(7 + count), stage, np.empty(6 + count), np.empty(6 + count)
    inner, steered, acted = 3, False, slots[_TORQUERS] > 0 or count > 0
    for slot in range(slots.shape[0]):
        if slots[slot] > 0:
            steered = steered or slot >= _LAWS
            if slot < _LAWS and _CURIOUS[slot]:
                inner = nodes.shape[1]  # what the torques want of the surroundings
    _between(nodes, 1, 0.0, nodes.shape[1], stage)
    steps = (out.shape[0] - 1) * every[1]
    node, sub, tick, row = 1, 0, 0, 0
    for i in range(steps + 1):
        _begin(state, wheels, inverse, stage)
        _feel(stage)
        if acted and i == tick * every[0]:
            reading[layout.TICK], reading[layout.PERIOD] = tick, every[0] * step_s
            tick += 1
            for k in range(COMMAND_SIZE):  # a slice would be shorter, and two seconds of the compiler's time
                command[k] = 0.0
            if steered:
                _see(knowledge, target, compass, wheels, state, stage, reading)
                _decide(slots, packed, reading, memory, command)
            _act(dipoles, share, body, state, reading, command, stage)
        if i == row * every[1]:
            _log(state, wheels, stage, out[row])
            row += 1
        if i < steps:
            _step(nodes, node, (sub + 0.5) / substeps, (sub + 1.0) / substeps, inner, body, step_s, state, work)
            sub += 1
            if sub == substeps:
                node, sub = node + 1, 0


@part(**PART)
def _step(
    nodes: FloatArray,
    node: int,
    half: float,
    end: float,
    inner: int,
    body: Any,
    step_s: float,
    state: FloatArray,
    work: Any,
) -> None:
    """One step of order four; slope and total hold the rotation vector's rate, the torque in N, the wheels'.

    half, end: where between `node` and the next the middle and the end of the step lie. inner: how many columns of the
    surroundings are wanted in the middle. body: wheels, inverse, packed, slots as of `fly`, and the motors' torques. work:
    the rounding that is carried on, and arrays to write in.
    """
    wheels, inverse, _, _, _ = body
    carry, trial, stage, slope, total = work
    count = wheels.shape[0]
    _slope(0.0, 0.0, 0.0, body, stage, state, slope)
    ax, ay, az, hx, hy, hz = slope[0], slope[1], slope[2], slope[3], slope[4], slope[5]
    for j in range(count):
        total[j] = slope[6 + j]
    for number in range(3):
        if number == 0:
            _between(nodes, node, half, inner, stage)
        elif number == 2:
            _at_end(nodes, node, end, stage)
        reach = step_s if number == 2 else 0.5 * step_s
        weight = 1.0 if number == 2 else 2.0
        x, y, z = reach * slope[0], reach * slope[1], reach * slope[2]
        trial[4] = state[4] + reach * slope[3]
        trial[5] = state[5] + reach * slope[4]
        trial[6] = state[6] + reach * slope[5]
        for j in range(count):
            trial[7 + j] = state[7 + j] + reach * slope[6 + j]
        _turn(state, x, y, z, trial)
        _begin(trial, wheels, inverse, stage)
        if inner > 3:
            _feel(stage)
        _slope(x, y, z, body, stage, trial, slope)
        ax, ay, az = ax + weight * slope[0], ay + weight * slope[1], az + weight * slope[2]
        hx, hy, hz = hx + weight * slope[3], hy + weight * slope[4], hz + weight * slope[5]
        for j in range(count):
            total[j] += weight * slope[6 + j]
    sixth = step_s / 6.0
    _advance(state, carry, sixth * ax, sixth * ay, sixth * az)
    state[4] += sixth * hx
    state[5] += sixth * hy
    state[6] += sixth * hz
    for j in range(count):
        state[7 + j] += sixth * total[j]


@part(**PART)
def _begin(state: FloatArray, wheels: FloatArray, inverse: FloatArray, stage: FloatArray) -> None:
    """Attitude matrix and rate."""
    x, y, z, w = state[0], state[1], state[2], state[3]
    stage[ROTATION] = 1.0 - 2.0 * (y * y + z * z)
    stage[ROTATION + 1] = 2.0 * (x * y + z * w)
    stage[ROTATION + 2] = 2.0 * (x * z - y * w)
    stage[ROTATION + 3] = 2.0 * (x * y - z * w)
    stage[ROTATION + 4] = 1.0 - 2.0 * (x * x + z * z)
    stage[ROTATION + 5] = 2.0 * (y * z + x * w)
    stage[ROTATION + 6] = 2.0 * (x * z + y * w)
    stage[ROTATION + 7] = 2.0 * (y * z - x * w)
    stage[ROTATION + 8] = 1.0 - 2.0 * (x * x + y * y)
    hx, hy, hz = _to_body(stage, state[4], state[5], state[6])
    for j in range(wheels.shape[0]):
        momentum = state[7 + j]
        hx -= wheels[j, 0] * momentum
        hy -= wheels[j, 1] * momentum
        hz -= wheels[j, 2] * momentum
    stage[RATE] = inverse[0, 0] * hx + inverse[0, 1] * hy + inverse[0, 2] * hz
    stage[RATE + 1] = inverse[1, 0] * hx + inverse[1, 1] * hy + inverse[1, 2] * hz
    stage[RATE + 2] = inverse[2, 0] * hx + inverse[2, 1] * hy + inverse[2, 2] * hz


@part(**PART)
def _feel(stage: FloatArray) -> None:
    """Field in the body."""
    bx, by, bz = _to_body(stage, stage[FIELD_N], stage[FIELD_N + 1], stage[FIELD_N + 2])
    stage[FIELD], stage[FIELD + 1], stage[FIELD + 2] = bx, by, bz


@part(**PART)
def _slope(x: float, y: float, z: float, body: Any, stage: FloatArray, state: FloatArray, slope: FloatArray) -> None:
    """Rates of the rotation vector (which stands at x, y, z), of the momentum in N, and of the wheels' momenta."""
    wheels, _, packed, slots, motor = body
    wx, wy, wz = stage[RATE], stage[RATE + 1], stage[RATE + 2]
    cx, cy, cz = y * wz - z * wy, z * wx - x * wz, x * wy - y * wx
    slope[0] = wx + 0.5 * cx + (y * cz - z * cy) * _TWELFTH
    slope[1] = wy + 0.5 * cy + (z * cx - x * cz) * _TWELFTH
    slope[2] = wz + 0.5 * cz + (x * cy - y * cx) * _TWELFTH
    stage[TORQUE], stage[TORQUE + 1], stage[TORQUE + 2] = 0.0, 0.0, 0.0
    torque_chain(slots, packed, stage)
    tx, ty, tz = stage[TORQUE], stage[TORQUE + 1], stage[TORQUE + 2]
    slope[3] = stage[ROTATION] * tx + stage[ROTATION + 3] * ty + stage[ROTATION + 6] * tz
    slope[4] = stage[ROTATION + 1] * tx + stage[ROTATION + 4] * ty + stage[ROTATION + 7] * tz
    slope[5] = stage[ROTATION + 2] * tx + stage[ROTATION + 5] * ty + stage[ROTATION + 8] * tz
    for j in range(wheels.shape[0]):
        speed = _wheel_speed(wheels[j], state[7 + j], stage)
        friction = wheels[j, 6] * speed + wheels[j, 7] * speed / sqrt(speed * speed + COULOMB_SPEED_RAD_S**2)
        slope[6 + j] = motor[j] - friction


@part(**PART)
def _wheel_speed(wheel: FloatArray, momentum: float, stage: FloatArray) -> float:
    """Speed relative to the body [rad/s] from the momentum about the axis."""
    along = wheel[0] * stage[RATE] + wheel[1] * stage[RATE + 1] + wheel[2] * stage[RATE + 2]
    speed: float = momentum / wheel[3] - along
    return speed


@part(**PART)
def _half_turn(x: float, y: float, z: float) -> tuple[float, float]:
    """Of the rotation vector: cosine of half the angle, less 1, and its sine over the angle."""
    squared = 0.25 * (x * x + y * y + z * z)
    if squared < 0.01:
        c = squared * (-1 / 2 + squared * (1 / 24 + squared * (-1 / 720 + squared * (1 / 40320))))
        s = 0.5 + squared * (-1 / 12 + squared * (1 / 240 + squared * (-1 / 10080 + squared * (1 / 725760))))
        return c, s
    half = sqrt(squared)
    return cos(half) - 1.0, 0.5 * sin(half) / half


@part(**PART)
def _turn(state: FloatArray, x: float, y: float, z: float, out: FloatArray) -> None:
    """out[:4]: the attitude of `state` turned by the rotation vector x, y, z in the body."""
    c, s = _half_turn(x, y, z)
    a, b, d = s * x, s * y, s * z
    q0, q1, q2, q3 = state[0], state[1], state[2], state[3]
    out[0] = q0 + (q0 * c + q3 * a + q1 * d - q2 * b)
    out[1] = q1 + (q1 * c + q3 * b - q0 * d + q2 * a)
    out[2] = q2 + (q2 * c + q3 * d + q0 * b - q1 * a)
    out[3] = q3 + (q3 * c - q0 * a - q1 * b - q2 * d)


@part(**PART)
def _advance(state: FloatArray, carry: FloatArray, x: float, y: float, z: float) -> None:
    """Turn the state itself, keep its length, and carry the rounding on (Kahan 1965): millions of steps add up."""
    c, s = _half_turn(x, y, z)
    a, b, d = s * x, s * y, s * z
    q0, q1, q2, q3 = state[0], state[1], state[2], state[3]
    c += 0.5 * (1.0 - (q0 * q0 + q1 * q1 + q2 * q2 + q3 * q3))
    change = (
        q0 * c + q3 * a + q1 * d - q2 * b,
        q1 * c + q3 * b - q0 * d + q2 * a,
        q2 * c + q3 * d + q0 * b - q1 * a,
        q3 * c - q0 * a - q1 * b - q2 * d,
    )
    for k in range(4):
        whole = change[k] - carry[k]
        following = state[k] + whole
        carry[k] = (following - state[k]) - whole
        state[k] = following


@part(**PART)
def _between(nodes: FloatArray, node: int, s: float, columns: int, stage: FloatArray) -> None:
    """Surroundings the share s of the way from `node` to the next: Lagrange's cubic through four nodes."""
    a, b = s * (s - 1.0) * (2.0 - s) / 6.0, (s + 1.0) * (s - 1.0) * (s - 2.0) / 2.0
    c, d = (s + 1.0) * s * (2.0 - s) / 2.0, (s + 1.0) * s * (s - 1.0) / 6.0
    n = node
    x = a * nodes[n - 1, 0] + b * nodes[n, 0] + c * nodes[n + 1, 0] + d * nodes[n + 2, 0]
    y = a * nodes[n - 1, 1] + b * nodes[n, 1] + c * nodes[n + 1, 1] + d * nodes[n + 2, 1]
    z = a * nodes[n - 1, 2] + b * nodes[n, 2] + c * nodes[n + 1, 2] + d * nodes[n + 2, 2]
    stage[POSITION], stage[POSITION + 1], stage[POSITION + 2] = x, y, z
    for k in range(3, columns):
        stage[POSITION + k] = a * nodes[n - 1, k] + b * nodes[n, k] + c * nodes[n + 1, k] + d * nodes[n + 2, k]


@part(**PART)
def _at_end(nodes: FloatArray, node: int, s: float, stage: FloatArray) -> None:
    """All the surroundings at the end of a step, which mostly is a node."""
    if s < 1.0:
        _between(nodes, node, s, nodes.shape[1], stage)
        return
    for k in range(nodes.shape[1]):
        stage[POSITION + k] = nodes[node + 1, k]


@part(**PART)
def _log(state: FloatArray, wheels: FloatArray, stage: FloatArray, out: FloatArray) -> None:
    for k in range(4):
        out[k] = state[k]
    for k in range(3):
        out[4 + k] = stage[RATE + k]
        out[7 + k] = stage[DIPOLE + k]
        out[10 + k] = stage[FIELD + k]
    for j in range(wheels.shape[0]):
        out[13 + j] = _wheel_speed(wheels[j], state[7 + j], stage)


@part(**PART)
def _see(
    knowledge: FloatArray,
    target: FloatArray,
    compass: FloatArray,
    wheels: FloatArray,
    state: FloatArray,
    stage: FloatArray,
    reading: FloatArray,
) -> None:
    """Fill the reading: what the sensors tell the law at this tick."""
    _seen_attitude(target, stage, reading)
    tick = int(reading[layout.TICK])
    for k in range(3):
        reading[layout.SEEN_FIELD + k] = compass[9 + k]
        for j in range(3):
            reading[layout.SEEN_FIELD + k] += compass[3 * k + j] * stage[FIELD + j]
        reading[layout.SEEN_RATE + k] = stage[RATE + k]
        reading[layout.RATE_ERROR + k] = stage[RATE + k] - reading[layout.TARGET_RATE + k]
        reading[layout.WHEEL_MOMENTUM + k] = 0.0
        if tick < knowledge.shape[0]:
            reading[layout.ERROR + k] += knowledge[tick, k]
            reading[layout.SEEN_FIELD + k] += knowledge[tick, 3 + k]
    for j in range(wheels.shape[0]):
        momentum = wheels[j, 3] * _wheel_speed(wheels[j], state[7 + j], stage)
        for k in range(3):
            reading[layout.WHEEL_MOMENTUM + k] += momentum * wheels[j, k]


@part(**PART)
def _seen_attitude(target: FloatArray, stage: FloatArray, reading: FloatArray) -> None:
    """Turn and rate of B relative to the target, and the wanted axis in B.

    target: 0 for a target that stays with the orbital frame O, 1 for one at rest in N; its attitude matrix from that
    frame, row by row (9); the wanted axis of the momentum in that frame (3).
    """
    x, y, z = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)  # axes of the frame, in N
    rate = (0.0, 0.0, 0.0)
    if target[0] == 0.0:
        x, y, z, rate = _orbital_frame(stage)
    a, b, c = _to_body(stage, x[0], x[1], x[2]), _to_body(stage, y[0], y[1], y[2]), _to_body(stage, z[0], z[1], z[2])
    # With f[j] the axes of the frame in B, the turn from target to B is sum_k f[k][i] target[j, k].
    scale = 1.0 + target[1] * a[0] + target[2] * b[0] + target[3] * c[0]
    scale += target[4] * a[1] + target[5] * b[1] + target[6] * c[1]
    scale += target[7] * a[2] + target[8] * b[2] + target[9] * c[2]
    scale = 1.0 / sqrt(max(scale, 1e-12))
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        ahead = target[1 + 3 * k] * a[j] + target[2 + 3 * k] * b[j] + target[3 + 3 * k] * c[j]
        behind = target[1 + 3 * j] * a[k] + target[2 + 3 * j] * b[k] + target[3 + 3 * j] * c[k]
        reading[layout.ERROR + i] = scale * (ahead - behind)
        reading[layout.AXIS + i] = target[10] * a[i] + target[11] * b[i] + target[12] * c[i]
    turning = _to_body(stage, rate[0], rate[1], rate[2])
    for i in range(3):
        reading[layout.TARGET_RATE + i] = turning[i]


@part(**PART)
def _orbital_frame(stage: FloatArray) -> Any:
    """Axes of O in N (z nadir, y negative orbit normal), and the rate r x v / r^2."""
    rx, ry, rz = stage[POSITION], stage[POSITION + 1], stage[POSITION + 2]
    vx, vy, vz = stage[VELOCITY], stage[VELOCITY + 1], stage[VELOCITY + 2]
    nx, ny, nz = ry * vz - rz * vy, rz * vx - rx * vz, rx * vy - ry * vx
    squared = rx * rx + ry * ry + rz * rz
    r, n = sqrt(squared), sqrt(nx * nx + ny * ny + nz * nz)
    y, z = (-nx / n, -ny / n, -nz / n), (-rx / r, -ry / r, -rz / r)
    x = (y[1] * z[2] - y[2] * z[1], y[2] * z[0] - y[0] * z[2], y[0] * z[1] - y[1] * z[0])
    return x, y, z, (nx / squared, ny / squared, nz / squared)


@part(**PART)
def _act(
    dipoles: FloatArray,
    share: FloatArray,
    body: Any,
    state: FloatArray,
    reading: FloatArray,
    command: FloatArray,
    stage: FloatArray,
) -> None:
    """What torquers and wheels make of the command until the next tick."""
    wheels, _, packed, slots, motor = body
    tick = int(reading[layout.TICK])
    if slots[_TORQUERS] > 0:
        _drive(packed, slots[_TORQUERS], command)
        for k in range(3):
            stage[DIPOLE + k] = command[COMMAND_DIPOLE + k]
            if tick < dipoles.shape[0]:
                stage[DIPOLE + k] += dipoles[tick, k]
    for j in range(wheels.shape[0]):
        wanted = 0.0
        for k in range(3):
            wanted -= share[j, k] * command[COMMAND_TORQUE + k]
        limit, fastest = wheels[j, 5], wheels[j, 4]
        if fastest > 0.0:  # a wheel at its limit is held there, not driven past it before the next tick
            speed, per_torque = _wheel_speed(wheels[j], state[7 + j], stage), reading[layout.PERIOD] / wheels[j, 3]
            wanted = min(max(wanted, (-fastest - speed) / per_torque), (fastest - speed) / per_torque)
        if limit > 0.0:  # the last word: one that is too fast is braked by no more than the motor can
            wanted = min(max(wanted, -limit), limit)
        motor[j] = wanted
