"""Short arcs of free flight between recorded attitudes: where the balance of the momentum leads from each to the next.

All arcs fly at once, from the smoothed attitude track and the momentum that it and the wheels have; their end against
the next point of the track, and how that end moves with the start, are what windows are made of (`momentum_windows`).
Momentum in N changes by outside torque alone; the body turns with the rate that the momentum leaves it beside the
recorded wheels.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from fluxtwin.gap.problem.problem import Problem
from fluxtwin.sim.attitude import smoothed_track as attitude_track
from fluxtwin.sim.attitude.recorded_motion import carried
from fluxtwin.sim.base.types import BoolArray, FloatArray
from fluxtwin.sim.earth import epoch, sun
from fluxtwin.sim.earth.atmosphere import density_along
from fluxtwin.sim.earth.constants import AU_KM
from fluxtwin.sim.earth.field import field_N_nT
from fluxtwin.sim.spacecraft.dynamics import layout
from fluxtwin.sim.spacecraft.dynamics.vehicle import Vehicle
from fluxtwin.sim.spacecraft.wheels import RPM_PER_RAD_S

MOST_NODES = 2400
_STEP_RAD = 0.15
"""A Runge-Kutta step turns by less: its error is then a millionth of a radian an arc, or less."""
_NUTATION_RAD = 0.3
"""The same of a nutation, which is small."""
_STEP_S = 30.0
_MOST_PARTS = 40
_TURN_RAD = 1e-5
_RATE_RAD_S = 1e-6
"""By these the start is moved for derivatives: far above rounding, far below anything that is not linear."""


@dataclass(frozen=True, eq=False)
class Craft:
    """What the balance wants to know of the spacecraft beside its telemetry."""

    vehicle: Vehicle
    """Body, wheels and torques as modelled."""
    tick_s: float = 1.0
    """The torquers hold what they do for so long."""


@dataclass(frozen=True, eq=False)
class Arcs:
    """A arcs, each over m steps between rows; K = A m steps in all."""

    craft: Craft
    problem: Problem
    rows: NDArray[np.intp]
    """(A, m + 1) rows of the problem, the first and the last are nodes."""
    parts: int
    """Runge-Kutta steps from row to row."""
    track: Rotation
    """Smoothed R_BN at all rows of the problem."""
    momentum_N: FloatArray
    """(N, 3) whole momentum [N m s] along the track, wheels included."""
    wheels_B: FloatArray
    """(N, 3) momentum of the wheels relative to the body."""
    dipole_B_Am2: FloatArray
    """(N, 3)."""
    resolved: bool
    """Whether rows are as close as the control's ticks: a dipole then holds, and a wheel's momentum goes straight, from
    each row to the next. Else both are drawn between the rows, and what they did there is not known."""
    held: BoolArray
    """(3,) whether a torquer's dipole holds until the next row; else it is drawn straight to the next one."""
    orbit: tuple[FloatArray, FloatArray]
    """(N, 3) position [km] and velocity [km/s] in N at all rows: as reported, or less what is named of its error."""

    def elsewhere(self, orbit: tuple[FloatArray, FloatArray]) -> Arcs:
        """The same arcs with the body at other places."""
        return self._beside(replace(self, orbit=orbit), "driven")

    def _beside(self, moved: Arcs, *same: str) -> Arcs:
        """Other arcs, with what is the same for them."""
        for name in same:
            moved.__dict__[name] = getattr(self, name)
        return moved

    def along(self, track: Rotation, momentum_N: FloatArray) -> Arcs:
        """The same arcs about another motion."""
        return self._beside(replace(self, track=track, momentum_N=momentum_N), "around", "driven")

    def of(self, vehicle: Vehicle) -> Arcs:
        """The same arcs with another vehicle in place of the modelled one, from the same rates."""
        moved = replace(self, craft=replace(self.craft, vehicle=vehicle), momentum_N=self.momentum_of(vehicle))
        return self._beside(moved, "around", "driven")

    @cached_property
    def seconds(self) -> FloatArray:
        """(A,) that each arc lasts."""
        t = self.problem.setting.seconds
        return np.asarray(t[self.rows[:, -1]] - t[self.rows[:, 0]])

    @cached_property
    def around(self) -> FloatArray:
        """(A, m, 2 parts + 1, 14) surroundings at the starts, middles and ends of all steps."""
        problem, first = self.problem, self.rows[:, :-1].ravel()
        t = problem.setting.seconds
        step = t[self.rows[:, 1:].ravel()] - t[first]
        share = np.linspace(0.0, 1.0, 2 * self.parts + 1)
        r, v = self.orbit
        after = (step[:, None] * share).ravel()
        start = np.repeat(first, share.size)
        r_km, v_km_s = carried(r[start], v[start], after)
        time = epoch.add_seconds(problem.time[0], t[start] + after)
        out = np.zeros((after.size, layout.FIELD - layout.POSITION))
        out[:, 0:3], out[:, 3:6] = 1e3 * r_km, 1e3 * v_km_s
        out[:, 6:9] = 1e-9 * field_N_nT(problem.setting.model, time, r_km)
        sun_km = sun.sun_N_km(problem.time)[start]
        towards = sun_km - r_km
        distance = np.linalg.norm(towards, axis=1)
        out[:, 9:12] = towards / distance[:, None]
        out[:, 12] = sun.illumination(r_km, sun_km) * (AU_KM / distance) ** 2
        out[:, 13] = density_along(time, r_km)
        return out.reshape(*self.rows[:, 1:].shape, share.size, -1)

    @cached_property
    def driven(self) -> tuple[FloatArray, FloatArray]:
        """(m, 2 parts + 1, A, 3) momentum of the wheels and dipole of the torquers at the starts, middles and ends of all
        steps."""
        shares = np.arange(2 * self.parts + 1) / (2.0 * self.parts)
        wheels = [[self._wheels(here, there, share) for share in shares] for here, there in self._steps]
        dipole = [[self._dipole(here, there, share) for share in shares] for here, there in self._steps]
        return np.array(wheels), np.array(dipole)

    def flown(
        self,
        vehicle: Vehicle,
        turn: FloatArray | None = None,
        push: FloatArray | None = None,
        wheels_B: FloatArray | None = None,
    ) -> FloatArray:
        """(A, 6) where arcs end: the turn [rad] against the track there, and the momentum less that along the track.

        vehicle: with its effects. turn (3,) [rad], push (3,) [N m s]: the start is moved by this much.
        wheels_B (N, 3): added to what is recorded.
        """
        from fluxtwin.sim.spacecraft.dynamics.arc_kernel import fly_arcs

        start, end = self.rows[:, 0], self.rows[:, -1]
        first = self.track[start] if turn is None else Rotation.from_rotvec(turn) * self.track[start]
        # A wrong tensor changes the momentum that goes with a rate: the start keeps the rate.
        momentum_N = self.momentum_of(vehicle)
        begun = momentum_N[start] if push is None else momentum_N[start] + push
        state = np.hstack([np.asarray(first.as_matrix()).reshape(-1, 9), begun])
        wheels, dipole = self.driven
        if wheels_B is not None:
            shares = np.linspace(0.0, 1.0, 2 * self.parts + 1)
            wheels = wheels + np.array(
                [[_between(wheels_B, here, there, share) for share in shares] for here, there in self._steps]
            )
        inverse = np.linalg.inv(np.asarray(vehicle.inertia_kg_m2, dtype=np.float64))
        step_s = np.diff(self.problem.setting.seconds[self.rows], axis=1) / self.parts
        fly_arcs(state, inverse, *vehicle.packed(), self.around, wheels, dipole, step_s)
        R = Rotation.from_matrix(state[:, :9].reshape(-1, 3, 3))
        return np.hstack([(R * self.track[end].inv()).as_rotvec(), state[:, 9:] - momentum_N[end]])

    @property
    def _steps(self) -> list[tuple[NDArray[np.intp], NDArray[np.intp]]]:
        """(A,) rows where each of the m steps of the arcs begins and ends."""
        return [(self.rows[:, step], self.rows[:, step + 1]) for step in range(self.rows.shape[1] - 1)]

    def holding(self, axis: int) -> Arcs:
        """The same arcs with the dipole about one axis held from row to row."""
        return self._beside(replace(self, held=self.held | (np.arange(3) == axis)), "around")

    def momentum_of(self, vehicle: Vehicle) -> FloatArray:
        """(N, 3) the momentum that another vehicle has at the same rates."""
        change = np.asarray(vehicle.inertia_kg_m2) - np.asarray(self.craft.vehicle.inertia_kg_m2)
        if not change.any():
            return self.momentum_N
        return np.asarray(self.momentum_N + self.track.inv().apply(self._rate_B @ change))

    @cached_property
    def _rate_B(self) -> FloatArray:
        inverse = np.linalg.inv(self.craft.vehicle.inertia_kg_m2)
        return np.asarray((self.track.apply(self.momentum_N) - self.wheels_B) @ inverse)

    def _dipole(self, here: NDArray[np.intp], there: NDArray[np.intp], share: float) -> FloatArray:
        return np.where(self.held, self.dipole_B_Am2[here], _between(self.dipole_B_Am2, here, there, share))

    def _wheels(self, here: NDArray[np.intp], there: NDArray[np.intp], share: float) -> FloatArray:
        """Straight, or by the cubic that has the slopes of the neighbours."""
        straight = _between(self.wheels_B, here, there, share)
        if self.resolved:
            return straight
        t = self.problem.setting.seconds
        step, change = (t[there] - t[here])[:, None], self.wheels_B[there] - self.wheels_B[here]
        first, last = step * self.wheel_slope[here] - change, step * self.wheel_slope[there] - change
        bend: FloatArray = share * (1.0 - share) * ((1.0 - share) * first - share * last)
        return straight + bend

    @cached_property
    def wheel_slope(self) -> FloatArray:
        """(N, 3) of the momentum of the wheels with time."""
        return np.asarray(np.gradient(self.wheels_B, self.problem.setting.seconds, axis=0))

    @cached_property
    def base(self) -> FloatArray:
        """(A, 6) as modelled."""
        return self.flown(self.craft.vehicle)

    @cached_property
    def transition(self) -> FloatArray:
        """(A, 6, 6) derivative of the end by the start: turn [rad], momentum [N m s]."""
        size = float(np.linalg.eigvalsh(self.craft.vehicle.inertia_kg_m2).max()) * _RATE_RAD_S
        vehicle, axes = self.craft.vehicle, np.eye(3)
        columns = [(self.flown(vehicle, turn=_TURN_RAD * axis) - self.base) / _TURN_RAD for axis in axes]
        columns += [(self.flown(vehicle, push=size * axis) - self.base) / size for axis in axes]
        return np.stack(columns, axis=2)

    def pushed(self, arc: slice, impulse_N: FloatArray) -> FloatArray:
        """(n, 6, p) how ends move by impulses (n, 3, p) [N m s] that are spread over the arcs."""
        turn = np.einsum("aij,ajp->aip", self.transition[arc, :3, 3:], 0.5 * impulse_N)
        return np.concatenate([turn, impulse_N], axis=1)


def _between(values: FloatArray, here: NDArray[np.intp], there: NDArray[np.intp], share: float) -> FloatArray:
    return np.asarray((1.0 - share) * values[here] + share * values[there])


def arcs(
    problem: Problem, craft: Craft, node_s: float, orbit: tuple[FloatArray, FloatArray] | None = None
) -> Arcs | str:
    """Arcs of at least node_s seconds along the problem's rows; or why there are none, in words. orbit: as `Arcs` has it,
    by default as reported."""
    missing = lacking(problem, craft.vehicle)
    if missing is not None:
        return missing
    setting, columns = problem.setting, problem.setting.columns
    t, usable = setting.seconds, np.ones(problem.rows, dtype=bool)
    if setting.attitude_known is not None:
        usable &= setting.attitude_known
    wheels_B, spacing_s = np.zeros((problem.rows, 3)), [0.0]
    if craft.vehicle.wheels:
        speed = _filled(t, np.reshape(columns["wheel_speed_rpm"], (problem.rows, -1)), straight=True) / RPM_PER_RAD_S
        spacing_s.append(_spacing_s(t, columns["wheel_speed_rpm"]))
        rows = craft.vehicle.wheel_rows
        wheels_B = (speed * rows[:, layout.WHEEL_INERTIA]) @ rows[:, :3]
    dipole = columns.get("dipole_B_Am2")
    if dipole is not None:
        spacing_s.append(_spacing_s(t, dipole))
    dipole = np.zeros((problem.rows, 3)) if dipole is None else _filled(t, dipole, straight=False)
    usable &= np.isfinite(wheels_B).all(axis=1) & np.isfinite(dipole).all(axis=1)
    numbers = np.flatnonzero(usable)
    if numbers.size < 30:
        return "too few rows have attitude, wheel speeds and dipole"
    usual = float(np.median(np.diff(t[numbers])))
    every = max(int(np.ceil(node_s / usual - 1e-6)), int(np.ceil(numbers.size / MOST_NODES)), 1)
    rows_of_arcs = _rows_of_arcs(numbers, attitude_track.stretches(t[numbers]), every)
    if not rows_of_arcs.size:
        return "the record has no stretch without gaps that is long enough"
    track = setting.track(0.0)
    rate = setting.turning(0.0)
    longest = float(np.diff(t[rows_of_arcs], axis=1).max())
    fastest = float(np.linalg.norm(rate[numbers], axis=1).max())
    momentum_B = rate @ np.asarray(craft.vehicle.inertia_kg_m2) + wheels_B
    least = float(np.linalg.eigvalsh(craft.vehicle.inertia_kg_m2).min())
    nutation = float(np.linalg.norm(momentum_B[numbers], axis=1).max()) / least
    parts = int(np.ceil(max(fastest / _STEP_RAD, nutation / _NUTATION_RAD, 1.0 / _STEP_S) * longest))
    if parts > _MOST_PARTS:
        return f"between two rows the body turns or nutates too far to be followed ({np.degrees(fastest * longest):.0f} deg)"
    momentum_N = np.asarray(track.inv().apply(momentum_B))
    resolved = max(usual, *spacing_s) < 1.01 * craft.tick_s
    held = np.full(3, resolved)
    orbit = setting.given[:2] if orbit is None else orbit
    return Arcs(craft, problem, rows_of_arcs, parts, track, momentum_N, wheels_B, dipole, resolved, held, orbit)


def _filled(t: FloatArray, values: FloatArray, *, straight: bool) -> FloatArray:
    """(N, k) with the blanks of sensors that sample at their own rate filled: straight between two values, or the value
    before. Before the first value and after the last one nothing is known."""
    filled = np.array(values, dtype=np.float64)
    for column in filled.T:
        known = np.flatnonzero(np.isfinite(column))
        if not known.size or known.size == column.size:
            continue
        inside = slice(known[0], known[-1] + 1)
        if straight:
            column[inside] = np.interp(t[inside], t[known], column[known])
        else:
            latest = known[np.searchsorted(known, np.arange(column.size)[inside], side="right") - 1]
            column[inside] = column[latest]
    return filled


def _spacing_s(t: FloatArray, values: FloatArray) -> float:
    """Usual time between two rows that have the values."""
    known = np.isfinite(np.reshape(values, (t.size, -1))).all(axis=1)
    return float(np.median(np.diff(t[known]))) if known.sum() > 1 else np.inf


def lacking(problem: Problem, vehicle: Vehicle) -> str | None:
    """What the record lacks for a balance of the momentum, in words; None when it has it."""
    columns = problem.setting.columns
    if problem.axes is not None and not problem.axes.known.any():
        return "no row has a reference attitude"
    if vehicle.wheels:
        speed = columns.get("wheel_speed_rpm")
        if speed is None or not np.isfinite(speed).any():
            return "the scenario has wheels, the telemetry no wheel speeds"
        if np.reshape(speed, (problem.rows, -1)).shape[1] != len(vehicle.wheels):
            return "telemetry and scenario have different numbers of wheels"
    if any(torque.name == "torquers" for torque in vehicle.torques):
        dipole = columns.get("dipole_B_Am2")
        if dipole is None or not np.isfinite(dipole).any():
            return "the scenario has torquers, the telemetry does not say what they do"
    return None


def _rows_of_arcs(numbers: NDArray[np.intp], stretch: NDArray[np.intp], every: int) -> NDArray[np.intp]:
    """(A, every + 1) rows of consecutive arcs within each stretch."""
    found = []
    for number in np.unique(stretch):
        rows = numbers[stretch == number]
        count = (rows.size - 1) // every
        if count:
            found.append(rows[np.arange(count)[:, None] * every + np.arange(every + 1)])
    return np.concatenate(found) if found else np.zeros((0, every + 1), dtype=np.intp)
