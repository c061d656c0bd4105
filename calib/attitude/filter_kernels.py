"""The compiled multiplicative Kalman filter of attitude, rate, slow errors and, if asked for, the magnetometer.

Error state, N to B attitude A_true = (I - [dtheta x]) A:

    0:3 dtheta [rad]   3:6 rate [rad/s]   6:9 slow error of the field [nT]   9:12 slow error of the attitude sensor [rad]
    12:21 S row by row   21:24 b [nT]     (the last twelve only where the calibration is uncertain or unknown)

The rate wanders at random; slow errors are first-order Gauss-Markov processes (Lefferts, Markley & Shuster 1982; Markley
& Crassidis 2014, chapter 6, with the random-walk rate in place of a gyro).
"""

from __future__ import annotations

import math

import numpy as np

from fluxtwin.calib.common import kalman_kernels
from fluxtwin.calib.common.kalman_kernels import passive, product, skew, times, update
from fluxtwin.sim.base.kernel_cache import kernel, part
from fluxtwin.sim.base.types import FloatArray

WALK, FIELD, SLOW, SLOW_S, SUN, WHITE, DRIFT, DRIFT_S = 0, 3, 4, 5, 6, 7, 8, 9
"""Places in the array of noises: rad/s per sqrt(s) (three, by body axis), nT, nT, s, rad, rad (white, of scanner or
reference), rad, s."""
GATE = 5.0
"""Innovations beyond so many sigma (of each component, rms) are inflated."""


@part()
def _turned(A: FloatArray, v: FloatArray) -> FloatArray:
    """exp(-[v x]) A, and a rotation again where rounding has made it none."""
    out = product(passive(v), A)
    far = np.empty((3, 3))  # of its columns from orthonormal ones
    for i in range(3):
        for k in range(3):
            far[i, k] = -0.5 * (out[0, i] * out[0, k] + out[1, i] * out[1, k] + out[2, i] * out[2, k])
        far[i, i] += 1.5
    return product(out, far)


@part()
def _propagate(A: FloatArray, w: FloatArray, x: FloatArray, P: FloatArray, h: float, noise: FloatArray) -> FloatArray:
    """A after h; x and P in place."""
    v = w * h
    angle = math.sqrt(v[0] ** 2 + v[1] ** 2 + v[2] ** 2)
    first, second = 0.5, 1.0 / 6.0
    if angle > 1e-4:
        first, second = (1.0 - math.cos(angle)) / angle**2, (angle - math.sin(angle)) / angle**3
    W = skew(v)
    turn, side = _turned(np.eye(3), v), product(W, W)
    for i in range(3):  # side: of the turn by an error of the rate
        for j in range(3):
            side[i, j] = h * ((1.0 if i == j else 0.0) - first * W[i, j] + second * side[i, j])
    new = np.zeros((3, x.size))  # rows first, each along its length, and then columns
    for i in range(3):
        for j in range(3):
            for k in range(x.size):
                new[i, k] += turn[i, j] * P[j, k] + side[i, j] * P[3 + j, k]
    for i in range(3):
        for k in range(x.size):
            P[i, k] = new[i, k]
    for k in range(x.size):
        for i in range(3):
            new[i, 0] = 0.0
            for j in range(3):
                new[i, 0] += turn[i, j] * P[k, j] + side[i, j] * P[k, 3 + j]
        for i in range(3):
            P[k, i] = new[i, 0]
    for i in range(3):
        q = noise[WALK + i] ** 2 * h
        P[i, i] += q * h * h / 3.0
        P[3 + i, 3 + i] += q
        P[i, 3 + i] += 0.5 * q * h
        P[3 + i, i] += 0.5 * q * h
    for i in range(6, 12):
        sigma, tau = (noise[SLOW], noise[SLOW_S]) if i < 9 else (noise[DRIFT], noise[DRIFT_S])
        keep = math.exp(-h / tau)
        x[i] *= keep
        for k in range(x.size):
            P[i, k] *= keep
        for k in range(x.size):
            P[k, i] *= keep
        P[i, i] += sigma**2 * (1.0 - keep * keep)
    return product(turn, A)


@part()
def _direction(y: FloatArray, seen: FloatArray, n: int) -> tuple[FloatArray, FloatArray]:
    """Two components of a measured unit vector across the predicted one y, and their derivative by dtheta (2, n)."""
    least = 0
    for i in range(1, 3):
        if abs(y[i]) < abs(y[least]):
            least = i
    W = skew(y)
    first = np.array([W[0, least], W[1, least], W[2, least]])
    size = math.sqrt(first[0] ** 2 + first[1] ** 2 + first[2] ** 2)
    for i in range(3):
        first[i] /= size
    second = times(W, first)
    H, r = np.zeros((2, n)), np.zeros(2)
    for j in range(3):
        r[0] += first[j] * (seen[j] - y[j])
        r[1] += second[j] * (seen[j] - y[j])
        for k in range(3):
            H[0, k] += first[j] * W[j, k]
            H[1, k] += second[j] * W[j, k]
    return H, r


@kernel(uses=(kalman_kernels,), fastmath=False)
def run_filter(
    t_s: FloatArray,
    field_B: FloatArray,
    coupling_B: FloatArray,
    field_N: FloatArray,
    nadir_B: FloatArray,
    nadir_N: FloatArray,
    sun_B: FloatArray,
    sun_N: FloatArray,
    A_seen: FloatArray,
    A: FloatArray,
    w: FloatArray,
    p: FloatArray,
    P: FloatArray,
    noise: FloatArray,
    field_R: FloatArray,
    inverse_M0: FloatArray,
    history: FloatArray,
    spread: FloatArray,
    rates: FloatArray,
    nis: FloatArray,
    outlying: FloatArray,
    innovation: FloatArray,
) -> tuple[float, FloatArray, FloatArray]:
    """Through the rows of one stretch in order of time; a measurement that is NaN is not there.

    field_B: (N, 3) readings [nT]; coupling_B: (N, 3) T D; field_N, nadir_N, sun_N: (N, 3) models; nadir_B, sun_B: (N, 3);
    A_seen: (N, 3, 3) reference attitude; A, w, p (12,), P (n, n) at the first row; field_R: (3, 3) covariance of the white
    noise of the calibrated field; inverse_M0: (3, 3) of 1 + S of the start. Fills history (N, 3, 3), spread
    (N, 3, 3) [rad^2], rates (N, 3), nis and outlying (N, 3 sensors), innovation (N, 3) of the field over its sigma.
    Returns minus twice the log likelihood, p and P at the end. The reading that multiplies an error of S is the predicted
    one, by p of the start: so its noise does not attenuate S, and no early error of the estimate freezes in.
    """
    n = P.shape[0]
    with_p = n > 12
    start, p, w = p, p.copy(), w.copy()
    white_R, sun_R = noise[WHITE] ** 2 * np.eye(3), noise[SUN] ** 2 * np.eye(3)
    x, sigma, total, cost = np.zeros(n), np.zeros(3), 0.0, 0.0
    for k in range(t_s.size):
        if k > 0:
            A = _propagate(A, w, x, P, t_s[k] - t_s[k - 1], noise)
        if not math.isnan(A_seen[k, 0, 0]):
            H, r = np.zeros((3, n)), np.zeros(3)
            for i in range(3):
                H[i, i] = H[i, 9 + i] = 1.0
                one, two = (i + 1) % 3, (i + 2) % 3
                for j in range(3):
                    r[i] += 0.5 * (A_seen[k, one, j] * A[two, j] - A_seen[k, two, j] * A[one, j])
            nis[k, 1], cost, outlying[k, 1] = update(x, P, H, r, white_R, sigma, GATE)
            total += cost
        if not math.isnan(nadir_B[k, 0]):
            H, r = _direction(times(A, nadir_N[k]), nadir_B[k], n)
            for i in range(2):
                for j in range(3):
                    H[i, 9 + j] = H[i, j]
            nis[k, 1], cost, outlying[k, 1] = update(x, P, H, r, white_R, sigma, GATE)
            total += cost
        if not math.isnan(sun_B[k, 0]):
            H, r = _direction(times(A, sun_N[k]), sun_B[k], n)
            nis[k, 2], cost, outlying[k, 2] = update(x, P, H, r, sun_R, sigma, GATE)
            total += cost
        if not math.isnan(field_B[k, 0]) and not math.isnan(coupling_B[k, 0]):
            y = times(A, field_N[k])
            W = skew(y)
            H, r = np.zeros((3, n)), np.empty(3)
            for i in range(3):
                r[i] = field_B[k, i] + p[9 + i] + coupling_B[k, i] - y[i]
                H[i, 6 + i] = 1.0
                for j in range(3):
                    H[i, j] = W[i, j]
                    r[i] += p[3 * i + j] * field_B[k, j]
                    if with_p:
                        for m in range(3):
                            H[i, 12 + 3 * i + j] -= inverse_M0[j, m] * (y[m] - start[9 + m] - coupling_B[k, m])
                if with_p:
                    H[i, 21 + i] = -1.0
            for j in range(3):
                innovation[k, j] = r[j]
                for i in range(n):
                    innovation[k, j] -= H[j, i] * x[i]
            nis[k, 0], cost, outlying[k, 0] = update(x, P, H, r, field_R, sigma, GATE)
            for j in range(3):
                innovation[k, j] /= sigma[j]
            total += cost
        A = _turned(A, x)
        for i in range(3):
            w[i] += x[3 + i]
            rates[k, i] = w[i]
            for j in range(3):
                history[k, i, j], spread[k, i, j] = A[i, j], P[i, j]
        for i in range(6):
            x[i] = 0.0
        if with_p:
            for i in range(12):
                p[i] += x[12 + i]
                x[12 + i] = 0.0
    return total, p, P
