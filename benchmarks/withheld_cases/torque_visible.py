"""How much of a torque is to be seen in a recorded attitude, once the start of each window is free.

visible = rms per component of what the torque turns the body by, in windows of twenty-five minutes, less what another
start and a constant error of the attitude make, over the sigma of the attitude. chi_square = the same against attitude
errors of their true correlation, summed over the record: what the best test there is would have to go by.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import solve_triangular
from scipy.spatial.transform import Rotation

from fluxtwin.sim.base.types import FloatArray
from withheld_cases.flight import Body, Flown, Surroundings, Torque, fly

WINDOW_S = 1500.0
LEAST_CHI_SQUARE = 60.0
"""For three to six parameters among some thirty names: less may be chance."""
_POINTS, _WINDOWS = 40, 4
_TURN_RAD, _RATE_RAD_S = 1e-4, 1e-6


@dataclass(frozen=True, eq=False)
class Seen:
    """Of one truth at one size; W windows of M moments."""

    turn_rad: list[FloatArray]
    """W of (M, 3): with the truth less without it, from the same start."""
    design: list[FloatArray]
    """W of (3 M, 9): the same of six changes of the start, and a constant error."""
    moments_s: FloatArray
    """(M,) within a window."""
    length_s: float

    def visible(self, sigma_rad: float) -> float:
        """The figure."""
        left = [_left(A, turn.ravel()) for A, turn in zip(self.design, self.turn_rad, strict=True)]
        return float(np.sqrt(np.mean(np.square(left)))) / sigma_rad

    def chi_square(self, sigma_rad: float, tau_s: float) -> float:
        """Against errors correlated over tau_s; scaled to the whole record."""
        apart = np.abs(self.moments_s[:, None] - self.moments_s)
        step = self.moments_s[1] - self.moments_s[0]
        like = np.exp(-apart / tau_s) if tau_s > 0.1 * step else np.eye(len(apart))
        root = np.linalg.cholesky(np.kron(like, np.eye(3)))
        total = 0.0
        for A, turn in zip(self.design, self.turn_rad, strict=True):
            white = solve_triangular(root, np.column_stack([turn.ravel() / sigma_rad, A]), lower=True)
            total += float(np.sum(_left(white[:, 1:], white[:, 0]) ** 2))
        return total * self.length_s / (len(self.design) * WINDOW_S)


@dataclass(frozen=True, eq=False)
class Ground:
    """What the ground can fly: the vehicle as it has it."""

    body: Body
    torques: list[Torque]
    around: Surroundings

    def window(self, start: Rotation, rate: FloatArray, moments_s: FloatArray) -> Rotation:
        """R_BN at those moments, from the attitude R_NB and rate at the first of them."""
        begin, end = float(moments_s[0]), float(moments_s[-1])
        flown = fly(self.body, self.around, self.torques, start.as_quat(), rate, begin, end)
        return flown.attitude(moments_s)[0]


def seen(flown: Flown, ground: Ground, length_s: float, before: Seen | None = None) -> Seen:
    """What the truth in `flown` does beside the ground's vehicle. before: whose design is taken over."""
    within, turns, designs = np.linspace(0.0, WINDOW_S, _POINTS), [], []
    for begin in np.arange(0.0, length_s - WINDOW_S, max(WINDOW_S, length_s / _WINDOWS)):
        moments = begin + within
        R, rate = flown.attitude(moments)
        plain = ground.window(R[0].inv(), rate[0], moments)
        turns.append((R.inv() * plain).as_rotvec())
        if before is None:
            designs.append(_design(ground, R[0].inv(), rate[0], moments, plain))
    return Seen(turns, designs if before is None else before.design, within, length_s)


def _design(ground: Ground, start: Rotation, rate: FloatArray, moments: FloatArray, plain: Rotation) -> FloatArray:
    """(3 M, 9) what another start does, and a constant error of the attitude."""
    others = [ground.window(start * Rotation.from_rotvec(_TURN_RAD * e), rate, moments) for e in np.eye(3)]
    others += [ground.window(start, rate + _RATE_RAD_S * e, moments) for e in np.eye(3)]
    free = np.stack([(plain.inv() * other).as_rotvec().ravel() for other in others], axis=1)
    return np.hstack([free / np.linalg.norm(free, axis=0), np.tile(np.eye(3), (moments.size, 1))])


def _left(A: FloatArray, values: FloatArray) -> FloatArray:
    rest: FloatArray = values - A @ np.linalg.lstsq(A, values, rcond=1e-9)[0]
    return rest
