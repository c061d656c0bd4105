"""Compiled loops of the smoothed attitude track: turns between many pairs of attitudes, summed as they are made.

Quaternions are scalar last, as scipy's: (p q) turns by q first. Loops over some 10^5 pairs, for which a batch of
rotations each would cost several times the arithmetic.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from fluxtwin.sim.base.kernel_cache import kernel, part
from fluxtwin.sim.base.types import FloatArray

LARGEST_TURN_RAD = 2.0
"""What is left of the turn to a neighbour, beyond which the short way is ambiguous."""


@part(error_model="numpy")
def _times(p: FloatArray, q: FloatArray, out: FloatArray) -> None:
    """out = p q; `out` may be either."""
    x = p[3] * q[0] + p[0] * q[3] + p[1] * q[2] - p[2] * q[1]
    y = p[3] * q[1] - p[0] * q[2] + p[1] * q[3] + p[2] * q[0]
    z = p[3] * q[2] + p[0] * q[1] - p[1] * q[0] + p[2] * q[3]
    w = p[3] * q[3] - p[0] * q[0] - p[1] * q[1] - p[2] * q[2]
    out[0], out[1], out[2], out[3] = x, y, z, w


@part(error_model="numpy")
def _inverse(q: FloatArray, out: FloatArray) -> None:
    out[0], out[1], out[2], out[3] = -q[0], -q[1], -q[2], q[3]


@part(error_model="numpy")
def _from_rotvec(x: float, y: float, z: float, out: FloatArray) -> None:
    angle = np.sqrt(x * x + y * y + z * z)
    scale = np.sin(0.5 * angle) / angle if angle > 1e-4 else 0.5 - angle * angle / 48.0
    out[0], out[1], out[2], out[3] = scale * x, scale * y, scale * z, np.cos(0.5 * angle)


@part(error_model="numpy")
def _as_rotvec(q: FloatArray, out: FloatArray) -> None:
    """The short way, at most pi."""
    sign = -1.0 if q[3] < 0.0 else 1.0
    length = np.sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2])
    half = np.arctan2(length, sign * q[3])
    scale = sign * (2.0 * half / length if length > 1e-4 else 2.0 + length * length / 3.0)
    out[0], out[1], out[2] = scale * q[0], scale * q[1], scale * q[2]


@kernel(error_model="numpy")
def moments(
    time_s: FloatArray,
    q_BN: FloatArray,
    course: Any,
    centres: NDArray[np.intp],
    windows: Any,
    degree: int,
    kept: FloatArray,
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Power sums (n, 2 degree + 1) and moments (n, degree + 1, 3) of the turns beside a course, about each centre (n,); the
    moments (n, K, degree + 1) of an error of one at the centre of which each later row keeps the share `kept` (K,) of the
    row before; and the turn (n, 3) of the row before the centre, NaN where the window has none.

    q_BN (N, 4): attitudes at stamps time_s (N,). course: `integrated` (N, 4) and rates (N, 3); it turns from one stamp to
    another as `integrated` does, or, where that has no rows, at each centre's rate. windows: first and last row of each,
    mid and span, (n,) each; z = (t - t_centre - mid) / span. Turns of `LARGEST_TURN_RAD` and more are left out.
    """
    integrated, rate_B_rad_s = course
    low, high, mid_s, span_s = windows
    sums = np.zeros((centres.size, 2 * degree + 1))
    moment = np.zeros((centres.size, degree + 1, 3))
    onward, before = np.zeros((centres.size, kept.size, degree + 1)), np.full((centres.size, 3), np.nan)
    left = np.empty(kept.size)
    back, course, turn, rotvec = np.empty(4), np.empty(4), np.empty(4), np.empty(3)
    for n in range(centres.size):
        centre = centres[n]
        _inverse(q_BN[centre], back)
        rate = rate_B_rad_s[centre]
        left[:] = 1.0
        for row in range(low[n], high[n] + 1):
            dt = time_s[row] - time_s[centre]
            if integrated.shape[0]:
                _inverse(integrated[row], turn)
                _times(integrated[centre], turn, course)
            else:
                _from_rotvec(rate[0] * dt, rate[1] * dt, rate[2] * dt, course)
            _times(course, q_BN[row], turn)
            _times(turn, back, turn)
            _as_rotvec(turn, rotvec)
            if rotvec[0] ** 2 + rotvec[1] ** 2 + rotvec[2] ** 2 >= LARGEST_TURN_RAD**2:
                continue
            if row == centre - 1:
                before[n] = rotvec
            z, power = (dt - mid_s[n]) / span_s[n], 1.0
            for order in range(2 * degree + 1):
                sums[n, order] += power
                if order <= degree:
                    if row >= centre:
                        for one in range(kept.size):
                            onward[n, one, order] += left[one] * power
                    for axis in range(3):
                        moment[n, order, axis] += power * rotvec[axis]
                power *= z
            if row >= centre:
                left *= kept
    return sums, moment, onward, before


@kernel(error_model="numpy")
def about(
    after_s: FloatArray,
    reach_s: FloatArray,
    mid_s: FloatArray,
    span_s: FloatArray,
    coefficients_rad: FloatArray,
    onward_B_rad: FloatArray,
    q_BN: FloatArray,
) -> FloatArray:
    """(M, 4) attitudes `after_s` (M,) after the stamps whose fits are given, one a row.

    coefficients_rad (M, d + 1, 3) of the turn beside the course in powers of z = (t - mid) / span, in a straight line
    beyond reach_s (M,); onward_B_rad (M, 3): rotation vector of the course, in body axes.
    """
    out = np.empty((after_s.size, 4))
    turn, slope, own = np.empty(3), np.empty(3), np.empty(4)
    for m in range(after_s.size):
        within = min(max(after_s[m], -reach_s[m]), reach_s[m])
        z = (within - mid_s[m]) / span_s[m]
        turn[:], slope[:] = 0.0, 0.0
        for power in range(coefficients_rad.shape[1] - 1, -1, -1):
            for axis in range(3):
                slope[axis] = slope[axis] * z + turn[axis]
                turn[axis] = turn[axis] * z + coefficients_rad[m, power, axis]
        beyond = (after_s[m] - within) / span_s[m]
        for axis in range(3):
            turn[axis] += slope[axis] * beyond
        _from_rotvec(turn[0], turn[1], turn[2], own)
        _times(own, q_BN[m], own)
        _from_rotvec(-onward_B_rad[m, 0], -onward_B_rad[m, 1], -onward_B_rad[m, 2], out[m])
        _times(out[m], own, out[m])
    return out


@kernel(error_model="numpy")
def turned(rates_B_rad_s: FloatArray, step_s: FloatArray) -> FloatArray:
    """(M, 4) turn of the axes of a body over P steps of step_s (M,) each, to fourth order in a step.

    rates_B_rad_s (P, 2, M, 3): body rates at the two points of Gauss in each step.
    """
    out = np.zeros((step_s.size, 4))
    own = np.empty(4)
    for m in range(step_s.size):
        half, bent = -0.5 * step_s[m], np.sqrt(3.0) / 12.0 * step_s[m] ** 2
        out[m, 3] = 1.0
        for step in range(rates_B_rad_s.shape[0]):
            a, b = rates_B_rad_s[step, 0, m], rates_B_rad_s[step, 1, m]
            _from_rotvec(
                half * (a[0] + b[0]) + bent * (b[1] * a[2] - b[2] * a[1]),
                half * (a[1] + b[1]) + bent * (b[2] * a[0] - b[0] * a[2]),
                half * (a[2] + b[2]) + bent * (b[0] * a[1] - b[1] * a[0]),
                own,
            )
            _times(own, out[m], out[m])
    return out


@kernel(error_model="numpy")
def blended(first_q: FloatArray, second_q: FloatArray, weights: FloatArray) -> FloatArray:
    """(M, 4) attitudes a share of the short way from `first_q` to `second_q` (M, 4); weights (M,) from 0 to 1."""
    out = np.empty_like(first_q)
    apart, rotvec = np.empty(4), np.empty(3)
    for m in range(first_q.shape[0]):
        _inverse(first_q[m], apart)
        _times(second_q[m], apart, apart)
        _as_rotvec(apart, rotvec)
        _from_rotvec(weights[m] * rotvec[0], weights[m] * rotvec[1], weights[m] * rotvec[2], apart)
        _times(apart, first_q[m], out[m])
    return out
