"""The motion that the balance of the momentum makes: short arcs of free flight, and windows of them.

All arcs fly at once, from the smoothed attitude track and the momentum that it and the wheels have; their end against
the next point of the track, and how that end moves with the start, are what windows are made of. Momentum in N changes by
outside torque alone; the body turns with the rate that the momentum leaves it beside the recorded wheels. In each window
start and momentum are free, so a balance holds from window to window in every case; what is compared is how the attitude
goes on within it. That is the weak form of dh/dt = torque (integrated twice), in which no recorded attitude is ever
differentiated.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import Any

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

WINDOW_S = 2000.0
"""A third of an orbit: what turns with the orbit or with the field shows within it."""
_MOST_IN_A_WINDOW = 120


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

    def but(self, **changes: Any) -> Arcs:
        """The same arcs with other fields, and what does not follow from these as it was made."""
        moved = replace(self, **changes)
        for made, of in (("around", "orbit"), ("driven", "held")):
            if of not in changes:
                moved.__dict__[made] = getattr(self, made)
        return moved

    def of(self, vehicle: Vehicle) -> Arcs:
        """The same arcs with another vehicle in place of the modelled one, from the same rates."""
        return self.but(craft=replace(self.craft, vehicle=vehicle), momentum_N=self.momentum_of(vehicle))

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
        share = self._shares.ravel()
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
        wheels, dipole = self._straight(self.wheels_B), self._straight(self.dipole_B_Am2)
        here, there = self._ends
        if not self.resolved:  # the cubic that has the slopes of the neighbours
            t, share = self.problem.setting.seconds, self._shares
            step, change = (t[there] - t[here])[:, None, :, None], (self.wheels_B[there] - self.wheels_B[here])[:, None]
            slope = np.gradient(self.wheels_B, t, axis=0)
            first, last = (step * slope[end][:, None] - change for end in (here, there))
            wheels = wheels + share * (1.0 - share) * ((1.0 - share) * first - share * last)
        return wheels, np.where(self.held, self.dipole_B_Am2[here][:, None], dipole)

    @property
    def _ends(self) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """(m, A) rows where the steps of the arcs begin and end."""
        return self.rows[:, :-1].T, self.rows[:, 1:].T

    @property
    def _shares(self) -> FloatArray:
        """(2 parts + 1, 1, 1) of a step, at the starts, middles and ends of its parts."""
        return np.linspace(0.0, 1.0, 2 * self.parts + 1)[:, None, None]

    def _straight(self, values: FloatArray) -> FloatArray:
        """(m, 2 parts + 1, A, 3) values (N, 3) drawn straight from row to row."""
        here, there = self._ends
        return np.asarray((1.0 - self._shares) * values[here][:, None] + self._shares * values[there][:, None])

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
            wheels = wheels + self._straight(wheels_B)
        inverse = np.linalg.inv(np.asarray(vehicle.inertia_kg_m2, dtype=np.float64))
        step_s = np.diff(self.problem.setting.seconds[self.rows], axis=1) / self.parts
        fly_arcs(state, inverse, *vehicle.packed(), self.around, wheels, dipole, step_s)
        R = Rotation.from_matrix(state[:, :9].reshape(-1, 3, 3))
        return np.hstack([(R * self.track[end].inv()).as_rotvec(), state[:, 9:] - momentum_N[end]])

    def momentum_of(self, vehicle: Vehicle) -> FloatArray:
        """(N, 3) the momentum that another vehicle has at the same rates."""
        change = np.asarray(vehicle.inertia_kg_m2) - np.asarray(self.craft.vehicle.inertia_kg_m2)
        if not change.any():
            return self.momentum_N
        inverse = np.linalg.inv(self.craft.vehicle.inertia_kg_m2)
        rate_B = (self.track.apply(self.momentum_N) - self.wheels_B) @ inverse
        return np.asarray(self.momentum_N + self.track.inv().apply(rate_B @ change))

    @cached_property
    def base(self) -> FloatArray:
        """(A, 6) as modelled."""
        return self.flown(self.craft.vehicle)

    @cached_property
    def transition(self) -> FloatArray:
        """(A, 6, 6) derivative of the end by the start: turn [rad], momentum [N m s]."""
        vehicle, axes = self.craft.vehicle, np.eye(3)
        # Far above rounding, far below anything that is not linear: the second is a rate of 1e-6 rad/s.
        turn, size = 1e-5, 1e-6 * float(np.linalg.eigvalsh(vehicle.inertia_kg_m2).max())
        columns = [(self.flown(vehicle, turn=turn * axis) - self.base) / turn for axis in axes]
        columns += [(self.flown(vehicle, push=size * axis) - self.base) / size for axis in axes]
        return np.stack(columns, axis=2)

    def pushed(self, arc: slice, impulse_N: FloatArray) -> FloatArray:
        """(n, 6, p) how ends move by impulses (n, 3, p) [N m s] that are spread over the arcs."""
        turn = np.einsum("aij,ajp->aip", self.transition[arc, :3, 3:], 0.5 * impulse_N)
        return np.concatenate([turn, impulse_N], axis=1)


def arcs(problem: Problem, craft: Craft, orbit: tuple[FloatArray, FloatArray]) -> Arcs | str:
    """Arcs along the problem's rows, long enough for a window to hold; or why there are none, in words. orbit: as `Arcs`
    has it."""
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
    every = max(int(np.ceil(WINDOW_S / _MOST_IN_A_WINDOW / usual - 1e-6)), int(np.ceil(numbers.size / 2400)), 1)
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
    # A Runge-Kutta step turns by less: its error is then a millionth of a radian an arc, or less. A nutation is small.
    parts = int(np.ceil(max(fastest / 0.15, nutation / 0.3, 1.0 / 30.0) * longest))
    if parts > 40:
        return f"between two rows the body turns or nutates too far to be followed ({np.degrees(fastest * longest):.0f} deg)"
    momentum_N = np.asarray(track.inv().apply(momentum_B))
    resolved = max(usual, *spacing_s) < 1.01 * craft.tick_s
    held = np.full(3, resolved)
    return Arcs(craft, problem, rows_of_arcs, parts, track, momentum_N, wheels_B, dipole, resolved, held, orbit)


def _filled(t: FloatArray, values: FloatArray, *, straight: bool) -> FloatArray:
    """(N, k) with the blanks of sensors that sample at their own rate filled: straight between two values, or the value
    before. Before the first value and after the last one nothing is known."""
    filled = np.full(values.shape, np.nan)
    for column, given in enumerate(values.T):
        if (known := np.flatnonzero(np.isfinite(given))).size:
            rows = np.arange(known[0], known[-1] + 1)
            before = known[np.searchsorted(known, rows, side="right") - 1]
            filled[rows, column] = np.interp(t[rows], t[known], given[known]) if straight else given[before]
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


@dataclass(frozen=True, eq=False)
class Window:
    """Consecutive nodes; n nodes, n - 1 arcs."""

    first: int
    """Number of the first arc."""
    rows: NDArray[np.intp]
    """(n,) rows of the problem."""
    seconds: FloatArray
    """(n,)."""
    place: slice
    """Where its nodes stand among those of all windows."""

    @property
    def size(self) -> int:
        return int(self.rows.size)

    @property
    def arcs(self) -> slice:
        """The numbers of its arcs."""
        return slice(self.first, self.first + self.size - 1)


@dataclass(frozen=True, eq=False)
class Windows:
    """All windows of a record; M nodes together."""

    arcs: Arcs
    windows: Sequence[Window]

    @cached_property
    def rows(self) -> NDArray[np.intp]:
        """(M,) rows of the problem."""
        return np.concatenate([window.rows for window in self.windows])

    def residual(self, R_BN: Rotation | None = None) -> FloatArray:
        """(M, 3) attitude less where the balance leads from each window's first point of the track [rad]; R_BN: of all rows,
        default as recorded."""
        given = self.arcs.problem.setting.given[2] if R_BN is None else R_BN
        turned = (given[self.rows] * self.arcs.track[self.rows].inv()).as_rotvec()
        return np.asarray(turned - self.chained(self.arcs.base[:, :, None])[:, :, 0])

    def chained(self, forcing: FloatArray) -> FloatArray:
        """(M, 3, p) turns of the nodes by what happens in the arcs, forcing (A, 6, p)."""
        out = np.zeros((self.rows.size, 3, forcing.shape[2]))
        for window in self.windows:
            states = self._course(window, np.zeros((6, forcing.shape[2])), forcing[window.arcs])
            out[window.place] = states[:, :3]
        return out

    def _course(self, window: Window, start: FloatArray, forcing: FloatArray) -> FloatArray:
        """(n, 6, p) turn and momentum at the nodes of a window against the track, from a start (6, p); forcing
        (n - 1, 6, p)."""
        states = [start]
        for transition, push in zip(self.arcs.transition[window.arcs], forcing, strict=True):
            states.append(transition @ states[-1] + push)
        return np.stack(states)

    def followed(self, slow: bool = False) -> Windows:
        """The same windows about the motion that the balance makes of each, from its best start.

        The rate of a smoothed track has errors that are in the recorded attitudes too; along it an image would repeat
        them, and noise look like a cause. The balance's own motion has errors in its start alone, which is free in every
        test. slow: with a torque beside, a parabola in N, which brings it to where the body was even where an effect
        turns it far from the balance.
        """
        columns = 9 if slow else 0  # a parabola along three axes
        turn, momentum = np.zeros((self.arcs.problem.rows, 3)), np.array(self.arcs.momentum_N)
        residual = self.residual()
        for window in self.windows:
            forcing = np.zeros((window.size - 1, 6, 6 + columns))
            if slow:
                forcing[:, :, 6:] = self._slow_torques(window.arcs)
            start = np.hstack([np.eye(6), np.zeros((6, columns))])
            courses = self._course(window, start, forcing)
            flat = courses[:, :3].reshape(3 * window.size, -1)
            size = np.linalg.norm(flat, axis=0)
            best = np.linalg.lstsq(flat / size, residual[window.place].ravel(), rcond=1e-9)[0] / size
            led = self._course(window, np.zeros((6, 1)), self.arcs.base[window.arcs, :, None])[:, :, 0]
            states = led + courses @ best
            turn[window.rows] = states[:, :3]
            momentum[window.rows] += states[:, 3:]
        track = Rotation.from_rotvec(turn) * self.arcs.track
        return Windows(self.arcs.but(track=track, momentum_N=momentum), self.windows)

    def _slow_torques(self, arc: slice) -> FloatArray:
        """(n, 6, 9) what torques in N that stand, grow and bend over a window do in each of its arcs."""
        seconds = self.arcs.seconds[arc]
        place = np.linspace(-1.0, 1.0, seconds.size)
        courses = [seconds * place**power for power in range(3)]
        impulse = np.concatenate([np.eye(3) * course[:, None, None] for course in courses], axis=2)
        return self.arcs.pushed(arc, impulse)

    def image(self, vehicle: Vehicle) -> FloatArray:
        """(M, 3) turns of the nodes with another vehicle, less those with the one that is modelled."""
        return np.asarray(self.chained((self.arcs.flown(vehicle) - self.arcs.base)[:, :, None])[:, :, 0])

    @cached_property
    def starts(self) -> list[FloatArray]:
        """Of each window (n, 3, 6) turns by its start: turn and momentum, each in its own scale."""
        return [self._course(each, np.eye(6), np.zeros((each.size - 1, 6, 6)))[:, :3] for each in self.windows]

    @cached_property
    def wander(self) -> list[tuple[FloatArray, FloatArray]]:
        """Of each window, covariance (3n, 3n) by white torque and by white rate in all arcs, mean diagonal 1."""
        made = [self._wander(window) for window in self.windows]
        scales = [np.mean(np.concatenate([np.diag(pair[kind]) for pair in made])) for kind in range(2)]
        return [(pair[0] / scales[0], pair[1] / scales[1]) for pair in made]

    def _wander(self, window: Window) -> tuple[FloatArray, FloatArray]:
        count = window.size - 1
        forcing = np.zeros((count, 6, count, 6))
        every = np.arange(count)
        forcing[every, :, every] = np.eye(6) * np.sqrt(self.arcs.seconds[window.arcs])[:, None, None]
        states = self._course(window, np.zeros((6, 6 * count)), forcing.reshape(count, 6, 6 * count))
        by = states[:, :3].reshape(3 * window.size, count, 6)
        torque, rate = by[:, :, 3:].reshape(len(by), -1), by[:, :, :3].reshape(len(by), -1)
        return torque @ torque.T, rate @ rate.T


def windows(arcs: Arcs) -> Windows | str:
    """The record in windows of about WINDOW_S; or why there are none, in words."""
    ends, starts = arcs.rows[:-1, -1], arcs.rows[1:, 0]
    edges = [0, *(np.flatnonzero(ends != starts) + 1).tolist(), len(arcs.rows)]
    seconds, found, at = arcs.problem.setting.seconds, [], 0
    for begin, end in pairwise(edges):
        nodes = np.concatenate([arcs.rows[begin:end, 0], arcs.rows[end - 1 : end, -1]])
        span = float(seconds[nodes[-1]] - seconds[nodes[0]])
        least = 2 if len(edges) == 2 else 1  # one window alone has nothing to be held against
        count = max(round(span / WINDOW_S), int(np.ceil(nodes.size / _MOST_IN_A_WINDOW)), least)
        for part in np.array_split(np.arange(nodes.size), count):
            if part.size >= 8:
                rows = nodes[part]
                place = slice(at, at + part.size)
                found.append(Window(begin + int(part[0]), rows, np.asarray(seconds[rows]), place))
                at += part.size
    if len(found) < 2:
        return "the record is too short: two windows of eight attitudes each are needed"
    return Windows(arcs, tuple(found))
