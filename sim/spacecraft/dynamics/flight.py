"""A flight: vehicles, surroundings and a start become motion, at any stamp."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from fluxtwin.sim.attitude.record import Attitude
from fluxtwin.sim.base.errors import BadInput
from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.earth import frames
from fluxtwin.sim.spacecraft.dynamics.environment import Environment
from fluxtwin.sim.spacecraft.dynamics.vehicle import Vehicle

_AT_A_ROW = 1e-9
"""Of the spacing: elapsed seconds are rounded to as much."""


@dataclass(frozen=True)
class Start:
    """The state of a vehicle when the flight begins."""

    q_NB: FloatArray
    """(4,) textbook quaternion of B relative to N, scalar last."""
    rate_B_rad_s: FloatArray
    """(3,) rate of B relative to N, in B."""
    wheel_speed_rad_s: FloatArray
    """(W,) relative to the body."""

    def state(self, vehicle: Vehicle) -> FloatArray:
        """(7 + W,): q_NB, whole momentum in N, momentum of each wheel about its axis."""
        wheels = vehicle.wheel_rows
        speed = np.asarray(self.wheel_speed_rad_s, dtype=np.float64).reshape(-1)
        if speed.size != len(wheels):
            raise BadInput(f"{speed.size} wheel speeds for {len(wheels)} wheels", where="start of the flight")
        q = np.asarray(self.q_NB, dtype=np.float64) / np.linalg.norm(self.q_NB)
        rate = np.asarray(self.rate_B_rad_s, dtype=np.float64)
        own = wheels[:, 3] * (speed + wheels[:, :3] @ rate)
        momentum_B = vehicle.bare_inertia_kg_m2 @ rate + own @ wheels[:, :3]
        return np.concatenate([q, frames.rotation_from_q(q[None])[0].inv().apply(momentum_B), own])


@dataclass(frozen=True)
class Flight:
    """Motion of a vehicle at R equally spaced rows."""

    start: np.datetime64
    spacing_s: float
    q_NB: FloatArray
    """(R, 4) textbook quaternions, scalar last."""
    rate_B_rad_s: FloatArray
    """(R, 3)."""
    dipole_B_Am2: FloatArray
    """(R, 3) of the torquers, from each row on."""
    wheel_speed_rad_s: FloatArray
    """(R, W) relative to the body."""
    field_B_nT: FloatArray
    """(R, 3) magnetic field in the body."""

    @property
    def seconds_s(self) -> FloatArray:
        return self.spacing_s * np.arange(len(self.q_NB), dtype=np.float64)

    def attitude(self, seconds: FloatArray) -> Attitude:
        """Attitude and rate at any elapsed time; beyond the ends the vehicle turns on at the rate it has there.

        Between two rows the rotation vector is a cubic that has the right turn and rate at both: error under
        (spacing)^4 / 384 times the third derivative of the rate.
        """
        row, share = self._rows(seconds)
        q, rate = self.q_NB[row], self.rate_B_rad_s[row]
        between = np.flatnonzero(share)  # samples mostly stand at rows
        if between.size:
            q[between], rate[between] = self._between(row[between], share[between])
        return Attitude(frames.rotation_from_q(q), rate)

    def _between(self, row: np.ndarray, share: FloatArray) -> tuple[FloatArray, FloatArray]:
        """q_NB and rate the share of the way from the row to the next."""
        q, rate = self.q_NB, self.rate_B_rad_s
        R0, R1 = frames.rotation_from_q(q[row]), frames.rotation_from_q(q[row + 1])
        turn = -np.atleast_2d(frames.product(R1, R0.inv()).as_rotvec())
        first, last = self.spacing_s * rate[row], self.spacing_s * _vector_rate(turn, rate[row + 1])
        s = np.clip(share, 0.0, 1.0)[:, None]
        vector = s * s * (3.0 - 2.0 * s) * turn + s * (1.0 - s) * ((1.0 - s) * first - s * last)
        slope = 6.0 * s * (1.0 - s) * turn + (1.0 - s) * (1.0 - 3.0 * s) * first - s * (2.0 - 3.0 * s) * last
        slope /= self.spacing_s
        beyond = (share - s[:, 0])[:, None] * self.spacing_s
        now = _body_rate(vector, slope)
        turned = frames.product(Rotation.from_rotvec(-beyond * now), Rotation.from_rotvec(-vector))
        return frames.q_from_rotation(frames.product(turned, R0)), now

    def dipole(self, seconds: FloatArray) -> FloatArray:
        """(N, 3) dipole that the torquers hold at each elapsed time."""
        held = np.clip(np.floor(np.asarray(seconds) / self.spacing_s + _AT_A_ROW), 0, len(self.q_NB) - 1)
        return np.asarray(self.dipole_B_Am2[held.astype(np.int64)])

    def wheel_speed(self, seconds: FloatArray) -> FloatArray:
        """(N, W) wheel speeds [rad/s] at each elapsed time, linear between rows."""
        row, share = self._rows(seconds)
        s = np.clip(share, 0.0, 1.0)[:, None]
        return np.asarray((1.0 - s) * self.wheel_speed_rad_s[row] + s * self.wheel_speed_rad_s[row + 1])

    def _rows(self, seconds: FloatArray) -> tuple[np.ndarray, FloatArray]:
        position = np.asarray(seconds, dtype=np.float64) / self.spacing_s
        nearest = np.rint(position)
        position = np.where(np.abs(position - nearest) < _AT_A_ROW, nearest, position)
        row = np.clip(np.floor(position), 0, len(self.q_NB) - 2).astype(np.int64)
        return row, position - row


def _vector_rate(vector: FloatArray, rate: FloatArray) -> FloatArray:
    """Rate of the rotation vector (N, 3) of a body that turns at `rate` (Bortz 1971), exact."""
    angle = np.linalg.norm(vector, axis=1)[:, None]
    half = 0.5 * angle
    with np.errstate(invalid="ignore", divide="ignore"):
        factor = np.where(angle < 1e-3, 1 / 12 + angle**2 / 720, (1.0 - half / np.tan(half)) / angle**2)
    across = np.cross(vector, rate)
    return np.asarray(rate + 0.5 * across + factor * np.cross(vector, across))


def _body_rate(vector: FloatArray, slope: FloatArray) -> FloatArray:
    """Rate of a body whose rotation vector changes at `slope`: the inverse of `_vector_rate`."""
    angle = np.linalg.norm(vector, axis=1)[:, None]
    with np.errstate(invalid="ignore", divide="ignore"):
        one = np.where(angle < 1e-3, 0.5 - angle**2 / 24, (1.0 - np.cos(angle)) / angle**2)
        two = np.where(angle < 1e-3, 1 / 6 - angle**2 / 120, (angle - np.sin(angle)) / angle**3)
    across = np.cross(vector, slope)
    return np.asarray(slope - one * across + two * np.cross(vector, across))


def fly(
    vehicle: Vehicle,
    environment: Environment,
    start: Start,
    *,
    duration_s: float,
    step_s: float = 1.0,
    control_every: int = 1,
    log_every: int = 1,
    dipoles_B_Am2: FloatArray | None = None,
    knowledge: FloatArray | None = None,
) -> Flight:
    """Fly a vehicle from its start.

    The spacing of the environment is a whole number of steps. control_every: steps between two ticks of the control;
    log_every: steps between two rows of the answer. dipoles_B_Am2 (ticks, 3): what the torquers do besides the law.
    knowledge (ticks, 6): errors of the attitude [rad] and of the field [T] that the law is given. Raises BadInput for what
    does not fit together.
    """
    from fluxtwin.sim.spacecraft.dynamics.kernels import fly as compiled

    spacing_s = environment.spacing_s
    substeps = round(spacing_s / step_s)
    rows = int(np.floor(duration_s / (step_s * log_every) + 1e-9)) + 1
    if substeps < 1 or abs(substeps * step_s - spacing_s) > 1e-9 * spacing_s:
        raise BadInput(f"step {step_s:g} s, nodes {spacing_s:g} s apart", where="flight", wanted="a whole ratio")
    length_s = (rows - 1) * log_every * step_s
    if (len(environment.nodes) - 3) * spacing_s < length_s - 1e-9:
        raise BadInput(f"the surroundings end before {length_s:g} s", where="flight")
    wheels = vehicle.wheel_rows
    out = np.empty((rows, 13 + len(wheels)))
    compiled(
        start.state(vehicle),
        wheels,
        np.asarray(np.linalg.inv(vehicle.bare_inertia_kg_m2), dtype=np.float64),
        *vehicle.packed(),
        environment.nodes,
        substeps,
        np.zeros((0, 3)) if dipoles_B_Am2 is None else np.ascontiguousarray(dipoles_B_Am2, dtype=np.float64),
        np.zeros((0, 6)) if knowledge is None else np.ascontiguousarray(knowledge, dtype=np.float64),
        np.array(vehicle.target.row),
        np.array(vehicle.compass_row),
        vehicle.share,
        float(step_s),
        np.array([control_every, log_every]),
        out,
    )
    parts = out[:, :4], out[:, 4:7], out[:, 7:10], out[:, 13:], 1e9 * out[:, 10:13]
    return Flight(environment.start, step_s * log_every, *parts)
