"""How the body turned, from the gyro: rotations within a stretch, and what a bias of the gyro does to them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

from fluxtwin.calib.common.records import seconds_of
from fluxtwin.sim.base.types import FloatArray, TimeArray

LARGEST_TURN_RAD = 1.0
"""Between two rows: a faster turn is not followed by its rates at the two ends."""
_FIELD_NT = 40_000.0
_ORBIT_RAD_S = 0.0023  # of the field of a dipole: twice the rate of a low orbit
_REMAINDER_NT = 2.0
_DEGREES = 6


class Stretch(NamedTuple):
    """Rows over which the gyro is integrated."""

    rows: np.ndarray
    """(n,) indices."""
    R: FloatArray
    """(n, 3, 3) from body axes at the first row to those at each."""
    turned: FloatArray
    """(n, 3, 3) integral of R_k R_s' ds [s]: turned @ bias is the angle by which R_k is off, in body axes at k."""
    basis: FloatArray
    """(n, J) polynomials in time for the field in the axes of the first row."""
    steps_s: FloatArray
    """(n - 1, n) integral over each step of a rate that is 1 at one row."""
    errors_rad_s: FloatArray
    """(n, 3) that were taken off the rates."""


def cut(time: TimeArray, rate_B_rad_s: FloatArray, length_s: float) -> list[np.ndarray]:
    """Rows of each stretch of about `length_s`, without gaps and without turns that cannot be followed."""
    seconds = seconds_of(time)
    step = np.diff(seconds)
    usual = float(np.median(step)) if step.size else 1.0
    speed = np.linalg.norm(rate_B_rad_s, axis=1)
    turn = 0.5 * (speed[1:] + speed[:-1]) * step
    broken = np.flatnonzero((step > 3.0 * usual) | (turn > LARGEST_TURN_RAD)) + 1
    found = []
    for run in np.split(np.arange(len(seconds)), broken):
        pieces = max(1, round((seconds[run[-1]] - seconds[run[0]]) / length_s))
        found += list(np.array_split(run, pieces))
    fewest = degree_for(length_s) + 3  # rows: the polynomial takes one of every three numbers
    return [rows for rows in found if len(rows) >= fewest]


def degree_for(length_s: float) -> int:
    """The least degree of a polynomial that a field along a low orbit leaves by no more than 2 nT in a stretch.

    With x = rate length / 2 the remainder of a Chebyshev series of degree J is x^(J+1) / (2^J (J+1)!).
    """
    x, remainder = 0.5 * _ORBIT_RAD_S * length_s, _FIELD_NT
    for degree in range(_DEGREES + 1):
        remainder *= x / (degree + 1) / (1.0 if degree == 0 else 2.0)
        if degree and remainder < _REMAINDER_NT:
            return degree
    return _DEGREES


def follow(
    time: TimeArray, rate_B_rad_s: FloatArray, errors_rad_s: FloatArray, rows: np.ndarray, degree: int
) -> Stretch:
    """One stretch integrated: over a step with rates w1 and w2 the turn is the integral of a cubic spline through the rates,
    + (w1 x w2) dt^2 / 12.

    That is the Magnus series to fourth order, for the rotation from body axes to body axes (Iserles and Norsett 1999).
    """
    seconds = seconds_of(time[rows])
    rate, dt = rate_B_rad_s[rows] - errors_rad_s[rows], np.diff(seconds)
    steps_s = np.diff(CubicSpline(seconds, np.eye(len(rows))).antiderivative()(seconds), axis=0)
    turn = steps_s @ rate + np.cross(rate[:-1], rate[1:]) * (dt**2 / 12.0)[:, None]
    forward = Rotation.from_rotvec(-turn).as_matrix()
    half = Rotation.from_rotvec(-0.5 * turn).as_matrix()
    R, turned = np.empty((len(rows), 3, 3)), np.zeros((len(rows), 3, 3))
    R[0] = np.eye(3)
    for k in range(len(dt)):
        R[k + 1] = forward[k] @ R[k]
        turned[k + 1] = forward[k] @ turned[k] + half[k] * dt[k]
    x = 2.0 * seconds / max(seconds[-1], 1e-9) - 1.0
    return Stretch(rows, R, turned, np.polynomial.chebyshev.chebvander(x, degree), steps_s, errors_rad_s[rows])
