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
from fluxtwin.sim.earth import constants
from fluxtwin.sim.earth.constants import EARTH_RADIUS_KM, GM_EARTH_KM3_S2, J2_EARTH

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
    row: NDArray[np.intp],
    after_s: FloatArray,
    reach_s: FloatArray,
    mid_s: FloatArray,
    span_s: FloatArray,
    coefficients_rad: FloatArray,
    onward: FloatArray,
    q_BN: FloatArray,
) -> FloatArray:
    """(M, 4) attitudes `after_s` (M,) after the stamps `row` (M,) of N.

    coefficients_rad (N, d + 1, 3) of the turn beside the course in powers of z = (t - mid) / span, in a straight line
    beyond reach_s (N,); onward (M, 4): turn of the course.
    """
    out = np.empty((after_s.size, 4))
    turn, slope, own = np.empty(3), np.empty(3), np.empty(4)
    for m in range(after_s.size):
        n = row[m]
        within = min(max(after_s[m], -reach_s[n]), reach_s[n])
        z = (within - mid_s[n]) / span_s[n]
        turn[:], slope[:] = 0.0, 0.0
        for power in range(coefficients_rad.shape[1] - 1, -1, -1):
            for axis in range(3):
                slope[axis] = slope[axis] * z + turn[axis]
                turn[axis] = turn[axis] * z + coefficients_rad[n, power, axis]
        beyond = (after_s[m] - within) / span_s[n]
        for axis in range(3):
            turn[axis] += slope[axis] * beyond
        _from_rotvec(turn[0], turn[1], turn[2], own)
        _times(own, q_BN[n], own)
        _times(onward[m], own, out[m])
    return out


@kernel(error_model="numpy")
def steady(row: NDArray[np.intp], after_s: FloatArray, rate_B_rad_s: FloatArray) -> FloatArray:
    """(M, 4) turn of the axes of a body over after_s (M,) at the rate (N, 3) of each `row` (M,)."""
    out = np.empty((after_s.size, 4))
    for m in range(after_s.size):
        x, y, z = rate_B_rad_s[row[m]]
        _from_rotvec(-x * after_s[m], -y * after_s[m], -z * after_s[m], out[m])
    return out


@kernel(error_model="numpy")
def turned(
    breaks_s: FloatArray, pieces_rad_s: FloatArray, from_s: FloatArray, after_s: FloatArray, parts: int
) -> FloatArray:
    """(M, 4) turn of the axes of a body over after_s (M,) from moments from_s (M,), in so many steps of fourth order each
    (Magnus: Iserles & Norsett 1999, Phil. Trans. R. Soc. A 357, 983).

    pieces_rad_s (k, n, 3): body rates in falling powers of the time since each of the rising breaks (n,); before the first
    they are those there.
    """
    out = np.zeros((after_s.size, 4))
    own, rates, piece, last = np.empty(4), np.empty((2, 3)), 0, pieces_rad_s.shape[1] - 1
    for m in range(after_s.size):
        step_s = after_s[m] / parts
        half, bent = -0.5 * step_s, np.sqrt(3.0) / 12.0 * step_s**2
        out[m, 3] = 1.0
        for step in range(parts):
            for side in range(2):  # the two points of Gauss
                moment_s = from_s[m] + (step + 0.5) * step_s + (2 * side - 1) * step_s / np.sqrt(12.0)
                moment_s = max(moment_s, breaks_s[0])
                while piece < last and moment_s >= breaks_s[piece + 1]:
                    piece += 1
                while moment_s < breaks_s[piece]:
                    piece -= 1
                since_s = moment_s - breaks_s[piece]
                rates[side] = 0.0
                for power in range(pieces_rad_s.shape[0]):
                    for axis in range(3):
                        rates[side, axis] = rates[side, axis] * since_s + pieces_rad_s[power, piece, axis]
            a, b = rates
            _from_rotvec(
                half * (a[0] + b[0]) + bent * (b[1] * a[2] - b[2] * a[1]),
                half * (a[1] + b[1]) + bent * (b[2] * a[0] - b[0] * a[2]),
                half * (a[2] + b[2]) + bent * (b[0] * a[1] - b[1] * a[0]),
                own,
            )
            _times(own, out[m], out[m])
    return out


@kernel(error_model="numpy")
def turn_between(before_q: FloatArray, after_q: FloatArray) -> FloatArray:
    """(M, 3) rotation vector of the short way from `before_q` to `after_q` (M, 4)."""
    out, apart = np.empty((before_q.shape[0], 3)), np.empty(4)
    for m in range(before_q.shape[0]):
        _inverse(before_q[m], apart)
        _times(after_q[m], apart, apart)
        _as_rotvec(apart, out[m])
    return out


@part(error_model="numpy")
def _pull(r_km: FloatArray, pull: FloatArray) -> None:
    """km/s2, the Earth's axis taken along z of GCRS."""
    square = r_km[0] * r_km[0] + r_km[1] * r_km[1] + r_km[2] * r_km[2]
    axial = 5.0 * r_km[2] ** 2 / square
    flat = 1.5 * J2_EARTH * EARTH_RADIUS_KM**2 / square
    for axis in range(3):
        own = 3.0 if axis == 2 else 1.0
        pull[axis] = GM_EARTH_KM3_S2 * r_km[axis] / (square * np.sqrt(square)) * (flat * (axial - own) - 1.0)


@kernel(uses=(constants,), error_model="numpy")
def carried(r_N_km: FloatArray, v_N_km_s: FloatArray, step_s: FloatArray, steps: int) -> tuple[FloatArray, FloatArray]:
    """Position and velocity (M, 3) so many steps of step_s (M,) later, by the pull of the Earth with its flattening
    (Runge-Kutta)."""
    r_out, v_out = r_N_km.copy(), v_N_km_s.copy()
    pull, speed, place = np.empty((4, 3)), np.empty((4, 3)), np.empty(3)
    for m in range(step_s.size):
        r, v, h = r_out[m], v_out[m], step_s[m]
        for _ in range(steps):
            pull[-1], speed[-1] = 0.0, 0.0  # the first stage adds none
            for stage in range(4):
                share = (0.0, 0.5, 0.5, 1.0)[stage] * h
                for axis in range(3):
                    place[axis] = r[axis] + share * speed[stage - 1, axis]
                    speed[stage, axis] = v[axis] + share * pull[stage - 1, axis]
                _pull(place, pull[stage])
            for axis in range(3):
                r[axis] += h / 6.0 * (speed[0, axis] + 2.0 * speed[1, axis] + 2.0 * speed[2, axis] + speed[3, axis])
                v[axis] += h / 6.0 * (pull[0, axis] + 2.0 * pull[1, axis] + 2.0 * pull[2, axis] + pull[3, axis])
    return r_out, v_out


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
