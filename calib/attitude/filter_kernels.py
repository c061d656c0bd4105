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

from fluxtwin.sim.base.kernel_cache import kernel, part
from fluxtwin.sim.base.types import FloatArray

WALK, FIELD, SLOW, SLOW_S, SUN, WHITE, DRIFT, DRIFT_S = 0, 3, 4, 5, 6, 7, 8, 9
"""Places in the array of noises: rad/s per sqrt(s) (three, by body axis), nT, nT, s, rad, rad (white, of scanner or
reference), rad, s."""
GATE = 5.0
"""Innovations beyond so many sigma (of each component, rms) are inflated."""
TAIL = 4.0
"""Beyond the gate the likelihood of a component falls with this power of its square: above 1, so that too small a noise is
never likely; low, so that a percent of outliers hardly widens the noise."""


@part(fastmath=False)
def _product(a: FloatArray, b: FloatArray) -> FloatArray:
    """a @ b of small matrices: a call of a library costs more than the sum."""
    out = np.zeros((a.shape[0], b.shape[1]))
    for i in range(a.shape[0]):
        for k in range(a.shape[1]):
            for j in range(b.shape[1]):
                out[i, j] += a[i, k] * b[k, j]
    return out


@part(fastmath=False)
def _skew(v: FloatArray) -> FloatArray:
    """[v x], (3, 3)."""
    out = np.zeros((3, 3))
    out[0, 1], out[0, 2], out[1, 2] = -v[2], v[1], -v[0]
    out[1, 0], out[2, 0], out[2, 1] = v[2], -v[1], v[0]
    return out


@part(fastmath=False)
def _image(a: FloatArray, v: FloatArray) -> FloatArray:
    """a @ v, (3,)."""
    out = np.empty(3)
    for i in range(3):
        out[i] = a[i, 0] * v[0] + a[i, 1] * v[1] + a[i, 2] * v[2]
    return out


@part(fastmath=False)
def _turned(A: FloatArray, v: FloatArray) -> FloatArray:
    """exp(-[v x]) A, and a rotation again where rounding has made it none."""
    angle = math.sqrt(v[0] ** 2 + v[1] ** 2 + v[2] ** 2)
    first = math.sin(angle) / angle if angle > 1e-9 else 1.0
    second = 2.0 * (math.sin(0.5 * angle) / angle) ** 2 if angle > 1e-9 else 0.5
    W = _skew(v)
    out = _product(np.eye(3) - first * W + second * _product(W, W), A)
    return 1.5 * out - 0.5 * _product(out, _product(out.T, out))


@part(fastmath=False)
def _propagate(A: FloatArray, w: FloatArray, x: FloatArray, P: FloatArray, h: float, noise: FloatArray) -> FloatArray:
    """A after h; x and P in place."""
    v = w * h
    angle = math.sqrt(v[0] ** 2 + v[1] ** 2 + v[2] ** 2)
    first, second = 0.5, 1.0 / 6.0
    if angle > 1e-4:
        first, second = (1.0 - math.cos(angle)) / angle**2, (angle - math.sin(angle)) / angle**3
    W = _skew(v)
    turn = _turned(np.eye(3), v)
    side = h * (np.eye(3) - first * W + second * _product(W, W))  # of the turn by an error of the rate
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
    return _product(turn, A)


@part(fastmath=False)
def _squared(V: FloatArray, r: FloatArray, L: FloatArray) -> tuple[float, float]:
    """r'V^-1 r and the log of det V; fills L, lower, L L' = V. By hand: m is 2 or 3, and a library call costs more."""
    total, log_det = 0.0, 0.0
    y = np.empty(r.size)
    for i in range(r.size):
        for j in range(i + 1):
            value = V[i, j]
            for k in range(j):
                value -= L[i, k] * L[j, k]
            L[i, j] = math.sqrt(value) if i == j else value / L[j, j]
        y[i] = r[i]
        for k in range(i):
            y[i] -= L[i, k] * y[k]
        y[i] /= L[i, i]
        total += y[i] * y[i]
        log_det += 2.0 * math.log(L[i, i])
    return total, log_det


@part(fastmath=False)
def _update(
    x: FloatArray, P: FloatArray, H: FloatArray, r: FloatArray, R: FloatArray, sigma: FloatArray
) -> tuple[float, float, bool]:
    """Measurement r = H x + noise of covariance R (m, m); x and P in place, sigma (m,) of the innovation, predicted.

    Returns the squared innovation over its covariance, a component, minus twice the log likelihood, whether R was inflated.
    """
    n, m = x.size, r.size
    PH, V, L, left = np.zeros((n, m)), R.copy(), np.zeros((m, m)), r.copy()
    for j in range(m):
        for i in range(n):
            if H[j, i] != 0.0:
                left[j] -= H[j, i] * x[i]
                for k in range(n):
                    PH[k, j] += P[k, i] * H[j, i]
    for j in range(m):
        for i in range(n):
            if H[j, i] != 0.0:
                for k in range(m):
                    V[j, k] += H[j, i] * PH[i, k]
        sigma[j] = math.sqrt(V[j, j])
    squared, log_det = _squared(V, left, L)
    nis = squared / m
    wild = nis > GATE**2
    cost = log_det + squared
    if wild:
        # A tail by a power law: were it the likelihood of the inflated noise, too small a noise would be likely.
        cost = log_det + m * (GATE**2 + TAIL * math.log(nis / GATE**2))
        more = (nis / GATE**2) ** 2  # the further out, the less it counts: a redescending weight
        V += R * (more - 1.0)
        R = R * more
        squared, log_det = _squared(V, left, L)
    K = PH.copy()
    for i in range(n):  # K V = PH by L and then by L'
        for j in range(m):
            for k in range(j):
                K[i, j] -= K[i, k] * L[j, k]
            K[i, j] /= L[j, j]
        for j in range(m - 1, -1, -1):
            for k in range(j + 1, m):
                K[i, j] -= K[i, k] * L[k, j]
            K[i, j] /= L[j, j]
    for i in range(n):
        for j in range(m):
            x[i] += K[i, j] * left[j]
    # Joseph's form, (1 - K H) P (1 - K H)' + K R K': P stays positive where it was wide and the measurement is sharp.
    for i in range(n):
        for k in range(n):
            for j in range(m):
                P[i, k] -= K[i, j] * PH[k, j]
    rest = np.zeros((n, m))
    for j in range(m):
        for k in range(n):
            if H[j, k] != 0.0:
                for i in range(n):
                    rest[i, j] -= P[i, k] * H[j, k]
    for i in range(n):
        for j in range(m):
            for k in range(m):
                rest[i, j] += K[i, k] * R[k, j]
    for i in range(n):
        for k in range(i + 1):
            one, other = P[i, k], P[k, i]
            for j in range(m):
                one += rest[i, j] * K[k, j]
                other += rest[k, j] * K[i, j]
            P[i, k] = 0.5 * (one + other)
            P[k, i] = P[i, k]
    return nis, cost, wild


@part(fastmath=False)
def _direction(y: FloatArray, seen: FloatArray, n: int) -> tuple[FloatArray, FloatArray]:
    """Two components of a measured unit vector across the predicted one y, and their derivative by dtheta (2, n)."""
    axis = np.zeros(3)
    axis[np.argmin(np.abs(y))] = 1.0
    basis = np.zeros((2, 3))
    basis[0] = _image(_skew(y), axis)
    basis[0] /= math.sqrt((basis[0] ** 2).sum())
    basis[1] = _image(_skew(y), basis[0])
    H, r = np.zeros((2, n)), np.zeros(2)
    H[:, :3] = _product(basis, _skew(y))
    for i in range(2):
        for j in range(3):
            r[i] += basis[i, j] * (seen[j] - y[j])
    return H, r


@kernel(fastmath=False)
def run_filter(
    t_s: FloatArray, field_B: FloatArray, coupling_B: FloatArray, field_N: FloatArray, nadir_B: FloatArray,
    nadir_N: FloatArray, sun_B: FloatArray, sun_N: FloatArray, A_seen: FloatArray, A: FloatArray, w: FloatArray,
    p: FloatArray, P: FloatArray, noise: FloatArray, history: FloatArray, spread: FloatArray, rates: FloatArray,
    nis: FloatArray, wild: FloatArray, innovation: FloatArray,
) -> tuple[float, FloatArray, FloatArray]:  # fmt: skip
    """Through the rows of one stretch in order of time; a measurement that is NaN is not there.

    field_B: (N, 3) readings [nT]; coupling_B: (N, 3) T D; field_N, nadir_N, sun_N: (N, 3) models; nadir_B, sun_B: (N, 3);
    A_seen: (N, 3, 3) reference attitude; A, w, p (12,), P (n, n) at the first row. Fills history (N, 3, 3), spread
    (N, 3, 3) [rad^2], rates (N, 3), nis and wild (N, 3 sensors), innovation (N, 3) of the field over its predicted sigma.
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
            D = _product(A_seen[k], A.T)
            H = np.zeros((3, n))
            for i in range(3):
                H[i, i] = H[i, 9 + i] = 1.0
            r = 0.5 * np.array([D[1, 2] - D[2, 1], D[2, 0] - D[0, 2], D[0, 1] - D[1, 0]])
            nis[k, 1], cost, wild[k, 1] = _update(x, P, H, r, white_R, sigma)
            total += cost
        if not math.isnan(nadir_B[k, 0]):
            H, r = _direction(_image(A, nadir_N[k]), nadir_B[k], n)
            H[:, 9:12] = H[:, :3]
            nis[k, 1], cost, wild[k, 1] = _update(x, P, H, r, white_R[:2, :2], sigma)
            total += cost
        if not math.isnan(sun_B[k, 0]):
            H, r = _direction(_image(A, sun_N[k]), sun_B[k], n)
            nis[k, 2], cost, wild[k, 2] = _update(x, P, H, r, noise[SUN] ** 2 * np.eye(2), sigma)
            total += cost
        if not math.isnan(field_B[k, 0]) and not math.isnan(coupling_B[k, 0]):
            y = _image(A, field_N[k])
            r = field_B[k] + p[9:] + coupling_B[k] - y
            predicted = y - start[9:] - coupling_B[k]
            H = np.zeros((3, n))
            H[:, :3] = _skew(y)
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
            nis[k, 0], cost, wild[k, 0] = _update(x, P, H, r, field_R, sigma)
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
