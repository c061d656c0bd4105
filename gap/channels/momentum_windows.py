"""Windows: where the balance of the momentum leads from one start, against the recorded attitudes.

In each window start and momentum are free, so a balance holds from window to window in every case; what is compared is
how the attitude goes on within it. That is the weak form of dh/dt = torque (integrated twice), in which no recorded
attitude is ever differentiated.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from fluxtwin.gap.channels.momentum_arcs import Arcs
from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.spacecraft.dynamics.vehicle import Vehicle

WINDOW_S = 2000.0
"""A third of an orbit: what turns with the orbit or with the field shows within it."""
MOST_NODES = 120
_FEWEST_NODES = 8
_SLOW = 9


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


@dataclass(frozen=True, eq=False)
class Windows:
    """All windows of a record; M nodes together."""

    arcs: Arcs
    windows: Sequence[Window]

    @cached_property
    def rows(self) -> NDArray[np.intp]:
        """(M,) rows of the problem."""
        return np.concatenate([window.rows for window in self.windows])

    @cached_property
    def led(self) -> FloatArray:
        """(M, 3) where the balance leads from each window's first point of the track, against the track [rad]."""
        return np.asarray(self.chained(self.arcs.base[:, :, None])[:, :, 0])

    def residual(self, R_BN: Rotation | None = None) -> FloatArray:
        """(M, 3) attitude less where the balance leads [rad]; R_BN: of all rows, default as recorded."""
        given = self.arcs.problem.setting.given[2] if R_BN is None else R_BN
        turned = (given[self.rows] * self.arcs.track[self.rows].inv()).as_rotvec()
        return np.asarray(turned - self.led)

    def chained(self, forcing: FloatArray) -> FloatArray:
        """(M, 3, p) turns of the nodes by what happens in the arcs, forcing (A, 6, p)."""
        out = np.zeros((self.rows.size, 3, forcing.shape[2]))
        for window in self.windows:
            states = self._course(window, np.zeros((6, forcing.shape[2])), forcing)
            out[window.place] = states[:, :3]
        return out

    def _course(self, window: Window, start: FloatArray, forcing: FloatArray) -> FloatArray:
        """(n, 6, p) turn and momentum at the nodes of a window against the track, from a start (6, p)."""
        states = [start]
        for arc in range(window.first, window.first + window.size - 1):
            states.append(self.arcs.transition[arc] @ states[-1] + forcing[arc])
        return np.stack(states)

    def followed(self, slow: bool = False) -> Windows:
        """The same windows about the motion that the balance makes of each, from its best start.

        The rate of a smoothed track has errors that are in the recorded attitudes too; along it an image would repeat
        them, and noise look like a cause. The balance's own motion has errors in its start alone, which is free in every
        test. slow: with a torque beside, a parabola in N, which brings it to where the body was even where an effect
        turns it far from the balance.
        """
        columns = _SLOW if slow else 0
        turn, momentum = np.zeros((self.arcs.problem.rows, 3)), np.array(self.arcs.momentum_N)
        residual = self.residual()
        for window in self.windows:
            forcing = np.zeros((len(self.arcs.rows), 6, 6 + columns))
            arc = slice(window.first, window.first + window.size - 1)
            if slow:
                forcing[arc, :, 6:] = self._slow_torques(arc)
            start = np.hstack([np.eye(6), np.zeros((6, columns))])
            courses = self._course(window, start, forcing)
            flat = courses[:, :3].reshape(3 * window.size, -1)
            size = np.linalg.norm(flat, axis=0)
            best = np.linalg.lstsq(flat / size, residual[window.place].ravel(), rcond=1e-9)[0] / size
            led = self._course(window, np.zeros((6, 1)), self.arcs.base[:, :, None])[:, :, 0]
            states = led + courses @ best
            turn[window.rows] = states[:, :3]
            momentum[window.rows] += states[:, 3:]
        track = Rotation.from_rotvec(turn) * self.arcs.track
        return Windows(self.arcs.along(track, momentum), self.windows)

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
        found = []
        for window in self.windows:
            state, blocks = np.eye(6), [np.eye(6)[:3]]
            for number in range(window.size - 1):
                state = self.arcs.transition[window.first + number] @ state
                blocks.append(state[:3])
            found.append(np.stack(blocks))
        return found

    @cached_property
    def wander(self) -> list[tuple[FloatArray, FloatArray]]:
        """Of each window, covariance (3n, 3n) by white torque and by white rate in all arcs, mean diagonal 1."""
        made = [self._wander(window) for window in self.windows]
        scales = [np.mean(np.concatenate([np.diag(pair[kind]) for pair in made])) for kind in range(2)]
        return [(pair[0] / scales[0], pair[1] / scales[1]) for pair in made]

    def _wander(self, window: Window) -> tuple[FloatArray, FloatArray]:
        n = window.size
        state = np.zeros((6, 6 * (n - 1)))
        rows = np.zeros((n, 3, 6 * (n - 1)))
        for number in range(n - 1):
            arc = window.first + number
            state = self.arcs.transition[arc] @ state
            state[:, 6 * number : 6 * number + 6] = np.eye(6) * np.sqrt(self.arcs.seconds[arc])
            rows[number + 1] = state[:3]
        by = rows.reshape(3 * n, n - 1, 6)
        torque, rate = by[:, :, 3:].reshape(3 * n, -1), by[:, :, :3].reshape(3 * n, -1)
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
        count = max(round(span / WINDOW_S), int(np.ceil(nodes.size / MOST_NODES)), least)
        for part in np.array_split(np.arange(nodes.size), count):
            if part.size >= _FEWEST_NODES:
                rows = nodes[part]
                place = slice(at, at + part.size)
                found.append(Window(begin + int(part[0]), rows, np.asarray(seconds[rows]), place))
                at += part.size
    if len(found) < 2:
        return "the record is too short: two windows of eight attitudes each are needed"
    return Windows(arcs, tuple(found))
