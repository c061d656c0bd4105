"""A flight: vehicles, surroundings and a start become motion, at any stamp."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.spatial.transform import Rotation

from fluxtwin.sim.attitude.record import Attitude
from fluxtwin.sim.base.errors import BadInput
from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.earth import frames
from fluxtwin.sim.spacecraft.dynamics.environment import Environment
from fluxtwin.sim.spacecraft.dynamics.vehicle import Vehicle, stacked


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
    """Motion of V vehicles at R equally spaced rows."""

    start: np.datetime64
    spacing_s: float
    q_NB: FloatArray
    """(V, R, 4) textbook quaternions, scalar last."""
    rate_B_rad_s: FloatArray
    """(V, R, 3)."""
    dipole_B_Am2: FloatArray
    """(V, R, 3) of the torquers, from each row on."""
    wheel_speed_rad_s: FloatArray
    """(V, R, W) relative to the body."""
    field_B_nT: FloatArray
    """(V, R, 3) magnetic field in the body."""

    @property
    def seconds_s(self) -> FloatArray:
        """(R,) since the start."""
        return self.spacing_s * np.arange(self.q_NB.shape[1], dtype=np.float64)

    def attitude(self, seconds: FloatArray, vehicle: int = 0) -> Attitude:
        """Attitude and rate at any elapsed time; beyond the ends the vehicle turns on at the rate it has there.

        Between two rows the rotation vector is a cubic that has the right turn and rate at both: error under
        (spacing)^4 / 384 times the third derivative of the rate.
        """
        row, share = self._rows(seconds)
        q, rate = self.q_NB[vehicle], self.rate_B_rad_s[vehicle]
        R0, R1 = frames.rotation_from_q(q[row]), frames.rotation_from_q(q[row + 1])
        turn = -np.atleast_2d((R1 * R0.inv()).as_rotvec())
        first, last = self.spacing_s * rate[row], self.spacing_s * _vector_rate(turn, rate[row + 1])
        s = np.clip(share, 0.0, 1.0)[:, None]
        vector = s * s * (3.0 - 2.0 * s) * turn + s * (1.0 - s) * ((1.0 - s) * first - s * last)
        slope = 6.0 * s * (1.0 - s) * turn + (1.0 - s) * (1.0 - 3.0 * s) * first - s * (2.0 - 3.0 * s) * last
        slope /= self.spacing_s
        beyond = (share - s[:, 0])[:, None] * self.spacing_s
        now = _body_rate(vector, slope)
        R = Rotation.from_rotvec(-beyond * now) * Rotation.from_rotvec(-vector) * R0
        return Attitude(R, now)

    def dipole(self, seconds: FloatArray, vehicle: int = 0) -> FloatArray:
        """(N, 3) dipole that the torquers hold at each elapsed time."""
        held = np.clip(np.floor(np.asarray(seconds) / self.spacing_s + 1e-9), 0, self.q_NB.shape[1] - 1)
        dipole: FloatArray = self.dipole_B_Am2[vehicle][held.astype(np.int64)]
        return dipole

    def wheel_speed(self, seconds: FloatArray, vehicle: int = 0) -> FloatArray:
        """(N, W) wheel speeds [rad/s] at each elapsed time, linear between rows."""
        row, share = self._rows(seconds)
        s = np.clip(share, 0.0, 1.0)[:, None]
        speed: FloatArray = (1.0 - s) * self.wheel_speed_rad_s[vehicle][row] + s * self.wheel_speed_rad_s[vehicle][
            row + 1
        ]
        return speed

    def _rows(self, seconds: FloatArray) -> tuple[np.ndarray, FloatArray]:
        position = np.asarray(seconds, dtype=np.float64) / self.spacing_s
        row = np.clip(np.floor(position), 0, self.q_NB.shape[1] - 2).astype(np.int64)
        return row, position - row


def _vector_rate(vector: FloatArray, rate: FloatArray) -> FloatArray:
    """Rate of the rotation vector (N, 3) of a body that turns at `rate` (Bortz 1971), exact."""
    angle = np.linalg.norm(vector, axis=1)[:, None]
    half = 0.5 * angle
    with np.errstate(invalid="ignore", divide="ignore"):
        factor = np.where(angle < 1e-3, 1 / 12 + angle**2 / 720, (1.0 - half / np.tan(half)) / angle**2)
    across = np.cross(vector, rate)
    result: FloatArray = rate + 0.5 * across + factor * np.cross(vector, across)
    return result


def _body_rate(vector: FloatArray, slope: FloatArray) -> FloatArray:
    """Rate of a body whose rotation vector changes at `slope`: the inverse of `_vector_rate`."""
    angle = np.linalg.norm(vector, axis=1)[:, None]
    with np.errstate(invalid="ignore", divide="ignore"):
        one = np.where(angle < 1e-3, 0.5 - angle**2 / 24, (1.0 - np.cos(angle)) / angle**2)
        two = np.where(angle < 1e-3, 1 / 6 - angle**2 / 120, (angle - np.sin(angle)) / angle**3)
    across = np.cross(vector, slope)
    rate: FloatArray = slope - one * across + two * np.cross(vector, across)
    return rate


def fly(
    vehicles: Sequence[Vehicle],
    environments: Sequence[Environment],
    starts: Sequence[Start],
    *,
    duration_s: float,
    step_s: float = 1.0,
    control_every: int = 1,
    log_every: int = 1,
    dipoles_B_Am2: FloatArray | None = None,
    knowledge: FloatArray | None = None,
    threads: int = 1,
) -> Flight:
    """Fly vehicles of one kind (same parts, any parameters), each from its own start.

    environments: one for all, or one each, of equal spacing; the spacing is a whole number of steps. control_every:
    steps between two ticks of the control; log_every: steps between two rows of the answer. dipoles_B_Am2 (ticks, 3):
    what the torquers do besides the law. knowledge (ticks, 6): errors of the attitude [rad] and of the field [T] that
    the law is given. The answer does not depend on `threads`. Raises BadInput for what does not fit together.
    """
    from fluxtwin.sim.spacecraft.dynamics.kernels import fly as compiled

    parts = stacked(vehicles)
    substeps = round(environments[0].spacing_s / step_s)
    rows = int(np.floor(duration_s / (step_s * log_every) + 1e-9)) + 1
    _check(vehicles, environments, starts, step_s, substeps, (rows - 1) * log_every * step_s)
    begin = np.stack([start.state(vehicle) for start, vehicle in zip(starts, vehicles, strict=True)])
    nodes = environments[0].nodes[None]
    if len(environments) > 1:
        nodes = np.stack([environment.nodes for environment in environments])
    out = np.empty((len(vehicles), rows, 13 + parts["wheels"].shape[1]))
    extra = np.zeros((0, 3)) if dipoles_B_Am2 is None else np.ascontiguousarray(dipoles_B_Am2, dtype=np.float64)
    errors = np.zeros((0, 6)) if knowledge is None else np.ascontiguousarray(knowledge, dtype=np.float64)
    every = np.array([control_every, log_every])

    def run(v: slice) -> None:
        compiled(
            begin[v],
            parts["wheels"][v],
            parts["inverse"][v],
            parts["packed"][v],
            parts["slots"],
            nodes if len(nodes) == 1 else nodes[v],
            substeps,
            extra,
            errors,
            parts["targets"][v],
            parts["compasses"][v],
            parts["share"][v],
            float(step_s),
            every,
            out[v],
        )

    edges = np.linspace(0, len(vehicles), min(threads, len(vehicles)) + 1).astype(int)
    slices = [slice(a, b) for a, b in pairwise(edges)]
    if len(slices) == 1:
        run(slices[0])
    else:
        with ThreadPoolExecutor(len(slices)) as pool:
            list(pool.map(run, slices))
    return Flight(
        environments[0].start,
        step_s * log_every,
        out[..., :4],
        out[..., 4:7],
        out[..., 7:10],
        out[..., 13:],
        1e9 * out[..., 10:13],
    )


def _check(
    vehicles: Sequence[Vehicle],
    environments: Sequence[Environment],
    starts: Sequence[Start],
    step_s: float,
    substeps: int,
    length_s: float,
) -> None:
    if len(starts) != len(vehicles) or len(environments) not in (1, len(vehicles)):
        raise BadInput(
            f"{len(vehicles)} vehicles, {len(starts)} starts, {len(environments)} environments",
            where="flight",
            wanted="a start each, and one environment or one each",
        )
    spacing_s = environments[0].spacing_s
    if substeps < 1 or abs(substeps * step_s - spacing_s) > 1e-9 * spacing_s:
        raise BadInput(f"step {step_s:g} s, nodes {spacing_s:g} s apart", where="flight", wanted="a whole ratio")
    if any(environment.duration_s < length_s - 1e-9 for environment in environments):
        raise BadInput(f"the surroundings end before {length_s:g} s", where="flight")
