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
    return 1.5 * out - 0.5 * product(out, product(out.T, out))


@part()
def _propagate(A: FloatArray, w: FloatArray, x: FloatArray, P: FloatArray, h: float, noise: FloatArray) -> FloatArray:
    """A after h; x and P in place."""
    v = w * h
    angle = math.sqrt(v[0] ** 2 + v[1] ** 2 + v[2] ** 2)
    first, second = 0.5, 1.0 / 6.0
    if angle > 1e-4:
        first, second = (1.0 - math.cos(angle)) / angle**2, (angle - math.sin(angle)) / angle**3
    W = skew(v)
    turn = _turned(np.eye(3), v)
    side = h * (np.eye(3) - first * W + second * product(W, W))  # of the turn by an error of the rate
    for side_of_P in range(2):  # rows, then columns
        for k in range(x.size):
            old = np.empty(6)
            for i in range(6):
                old[i] = P[i, k] if side_of_P == 0 else P[k, i]
            for i in range(3):
                value = 0.0
                for j in range(3):
                    value += turn[i, j] * old[j] + side[i, j] * old[3 + j]
                if side_of_P == 0:
                    P[i, k] = value
                else:
                    P[k, i] = value
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
        P[i, :] *= keep
        P[:, i] *= keep
        P[i, i] += sigma**2 * (1.0 - keep * keep)
    return product(turn, A)


@part()
def _direction(y: FloatArray, seen: FloatArray, n: int) -> tuple[FloatArray, FloatArray]:
    """Two components of a measured unit vector across the predicted one y, and their derivative by dtheta (2, n)."""
    axis = np.zeros(3)
    axis[np.argmin(np.abs(y))] = 1.0
    basis = np.zeros((2, 3))
    basis[0] = times(skew(y), axis)
    basis[0] /= math.sqrt((basis[0] ** 2).sum())
    basis[1] = times(skew(y), basis[0])
    H, r = np.zeros((2, n)), np.zeros(2)
    H[:, :3] = product(basis, skew(y))
    for i in range(2):
        for j in range(3):
            r[i] += basis[i, j] * (seen[j] - y[j])
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
    history: FloatArray,
    spread: FloatArray,
    rates: FloatArray,
    nis: FloatArray,
    outlying: FloatArray,
    innovation: FloatArray,
) -> tuple[float, FloatArray, FloatArray]:
    """Through the rows of one stretch in order of time; a measurement that is NaN is not there.

    field_B: (N, 3) readings [nT]; coupling_B: (N, 3) T D; field_N, nadir_N, sun_N: (N, 3) models; nadir_B, sun_B: (N, 3);
    A_seen: (N, 3, 3) reference attitude; A, w, p (12,), P (n, n) at the first row. Fills history (N, 3, 3), spread
    (N, 3, 3) [rad^2], rates (N, 3), nis and outlying (N, 3 sensors), innovation (N, 3) of the field over its sigma.
    Returns minus twice the log likelihood, p and P at the end. The reading that multiplies an error of S is the predicted
    one, by p of the start: so its noise does not attenuate S, and no early error of the estimate freezes in.
    """
    n = P.shape[0]
    with_p = n > 12
    start = p.copy()
    M0 = np.eye(3) + start[:9].copy().reshape(3, 3)
    inverse_M0 = np.linalg.inv(M0)
    field_R, white_R = noise[FIELD] ** 2 * (M0 @ M0.T), noise[WHITE] ** 2 * np.eye(3)
    x, sigma, total, cost = np.zeros(n), np.zeros(3), 0.0, 0.0
    for k in range(t_s.size):
        if k > 0:
            A = _propagate(A, w, x, P, t_s[k] - t_s[k - 1], noise)
        if not math.isnan(A_seen[k, 0, 0]):
            D = product(A_seen[k], A.T)
            H = np.zeros((3, n))
            for i in range(3):
                H[i, i] = H[i, 9 + i] = 1.0
            r = 0.5 * np.array([D[1, 2] - D[2, 1], D[2, 0] - D[0, 2], D[0, 1] - D[1, 0]])
            nis[k, 1], cost, outlying[k, 1] = update(x, P, H, r, white_R, sigma, GATE)
            total += cost
        if not math.isnan(nadir_B[k, 0]):
            H, r = _direction(times(A, nadir_N[k]), nadir_B[k], n)
            H[:, 9:12] = H[:, :3]
            nis[k, 1], cost, outlying[k, 1] = update(x, P, H, r, white_R[:2, :2], sigma, GATE)
            total += cost
        if not math.isnan(sun_B[k, 0]):
            H, r = _direction(times(A, sun_N[k]), sun_B[k], n)
            nis[k, 2], cost, outlying[k, 2] = update(x, P, H, r, noise[SUN] ** 2 * np.eye(2), sigma, GATE)
            total += cost
        if not math.isnan(field_B[k, 0]) and not math.isnan(coupling_B[k, 0]):
            y = times(A, field_N[k])
            r = field_B[k] + p[9:] + coupling_B[k] - y
            predicted = y - start[9:] - coupling_B[k]
            H = np.zeros((3, n))
            H[:, :3] = skew(y)
            for i in range(3):
                H[i, 6 + i] = 1.0
                for j in range(3):
                    r[i] += p[3 * i + j] * field_B[k, j]
                    if with_p:
                        for m in range(3):
                            H[i, 12 + 3 * i + j] -= inverse_M0[j, m] * predicted[m]
                if with_p:
                    H[i, 21 + i] = -1.0
            innovation[k] = r
            for i in range(n):
                for j in range(3):
                    innovation[k, j] -= H[j, i] * x[i]
            nis[k, 0], cost, outlying[k, 0] = update(x, P, H, r, field_R, sigma, GATE)
            innovation[k] /= sigma
            total += cost
        A = _turned(A, x[:3])
        w = w + x[3:6]
        x[:6] = 0.0
        if with_p:
            p = p + x[12:]
            x[12:] = 0.0
        history[k], spread[k], rates[k] = A, P[:3, :3], w
    return total, p, P
