"""The compiled parts that Kalman filters share: small matrices, turns, one measurement.

Loops, not products of matrices: for so few numbers a library call costs more, and each costs the compiler a second. Nor
arrays for what is needed in between: to make one takes as long as to fill it.
"""

from __future__ import annotations

import math

import numpy as np

from fluxtwin.sim.base.kernel_cache import part
from fluxtwin.sim.base.types import FloatArray

TAIL = 4.0
"""Beyond the gate the likelihood of a component falls with this power of its square: above 1, so that too small a noise is
never likely; low, so that a percent of outliers hardly widens the noise."""


@part()
def product(a: FloatArray, b: FloatArray) -> FloatArray:
    """a b."""
    out = np.zeros((a.shape[0], b.shape[1]))
    for i in range(a.shape[0]):
        for k in range(a.shape[1]):
            for j in range(b.shape[1]):
                out[i, j] += a[i, k] * b[k, j]
    return out


@part()
def times(matrix: FloatArray, vector: FloatArray) -> FloatArray:
    """matrix vector."""
    out = np.zeros(matrix.shape[0])
    for i in range(matrix.shape[0]):
        for k in range(matrix.shape[1]):
            out[i] += matrix[i, k] * vector[k]
    return out


@part()
def skew(v: FloatArray) -> FloatArray:
    """[v x], (3, 3)."""
    out = np.zeros((3, 3))
    out[0, 1], out[0, 2], out[1, 2] = -v[2], v[1], -v[0]
    out[1, 0], out[2, 0], out[2, 1] = v[2], -v[1], v[0]
    return out


@part()
def passive(v: FloatArray) -> FloatArray:
    """exp(-[v x]), (3, 3): components in axes that are turned by v."""
    angle = math.sqrt(v[0] ** 2 + v[1] ** 2 + v[2] ** 2)
    first = math.sin(angle) / angle if angle > 1e-9 else 1.0
    second = 2.0 * (math.sin(0.5 * angle) / angle) ** 2 if angle > 1e-9 else 0.5
    x, y, z = v[0], v[1], v[2]
    out = np.empty((3, 3))  # 1 - first W + second W W, of W = skew(v)
    out[0, 0], out[1, 1] = 1.0 + second * (-z * z - y * y), 1.0 + second * (-z * z - x * x)
    out[2, 2] = 1.0 + second * (-y * y - x * x)
    out[0, 1], out[0, 2] = first * z + second * (y * x), -(first * y) + second * (z * x)
    out[1, 0], out[1, 2] = -(first * z) + second * (x * y), first * x + second * (z * y)
    out[2, 0], out[2, 1] = first * y + second * (x * z), -(first * x) + second * (y * z)
    return out


@part()
def whitened(V: FloatArray, r: FloatArray, L: FloatArray) -> tuple[float, float]:
    """r' V^-1 r and the logarithm of det V; fills L (m, m + 1): lower, L L' = V, and L^-1 r behind it."""
    total, log_det = 0.0, 0.0
    for i in range(r.size):
        for j in range(i + 1):
            value = V[i, j]
            for k in range(j):
                value -= L[i, k] * L[j, k]
            L[i, j] = math.sqrt(value) if i == j else value / L[j, j]
        y = r[i]
        for k in range(i):
            y -= L[i, k] * L[k, r.size]
        y /= L[i, i]
        L[i, r.size] = y
        total += y * y
        log_det += 2.0 * math.log(L[i, i])
    return total, log_det


@part()
def update(
    x: FloatArray, P: FloatArray, H: FloatArray, r: FloatArray, R: FloatArray, sigma: FloatArray, gate: float
) -> tuple[float, float, bool]:
    """Measurement r = H x + noise of covariance R (m, m); x and P in place, sigma (m,) of the innovation, predicted.

    R may be larger than (m, m): its first rows and columns count. P is symmetric, and leaves so to the last bit. Returns
    the squared innovation over its covariance, a component, minus twice the log likelihood, whether R was inflated.
    """
    n, m = x.size, r.size
    HP, V, L, left = np.zeros((m, n)), np.empty((m, m)), np.empty((m, m + 1)), np.empty(m)
    for j in range(m):
        left[j] = r[j]
        for i in range(n):
            if H[j, i] != 0.0:
                left[j] -= H[j, i] * x[i]
                for k in range(n):
                    HP[j, k] += P[i, k] * H[j, i]
    for j in range(m):
        for k in range(m):
            V[j, k] = R[j, k]
        for i in range(n):
            if H[j, i] != 0.0:
                for k in range(m):
                    V[j, k] += H[j, i] * HP[k, i]
        sigma[j] = math.sqrt(V[j, j])
    squared, log_det = whitened(V, left, L)
    nis = squared / m
    outlying = nis > gate**2
    cost = log_det + squared
    larger = 1.0
    if outlying:
        # A tail by a power law: were it the likelihood of the inflated noise, too small a noise would be likely.
        cost = log_det + m * (gate**2 + TAIL * math.log(nis / gate**2))
        larger = (nis / gate**2) ** 2  # the further out, the less it counts: a redescending weight
        for j in range(m):
            for k in range(m):
                V[j, k] += R[j, k] * (larger - 1.0)
        whitened(V, left, L)
    K = HP.copy()  # the gain, transposed
    for j in range(m):  # V K = H P by L and then by L'
        for k in range(j):
            for i in range(n):
                K[j, i] -= K[k, i] * L[j, k]
        for i in range(n):
            K[j, i] /= L[j, j]
    for j in range(m - 1, -1, -1):
        for k in range(j + 1, m):
            for i in range(n):
                K[j, i] -= K[k, i] * L[k, j]
        for i in range(n):
            K[j, i] /= L[j, j]
    for j in range(m):
        for i in range(n):
            x[i] += K[j, i] * left[j]
    # Joseph's form, (1 - K' H) P (1 - K' H)' + K' R K: P stays positive where it was wide and the measurement is sharp.
    for i in range(n):
        for j in range(m):
            for k in range(n):
                P[i, k] -= K[j, i] * HP[j, k]
    rest = np.zeros((m, n))
    for j in range(m):
        for k in range(n):
            if H[j, k] != 0.0:
                for i in range(n):
                    rest[j, i] -= P[k, i] * H[j, k]
        for k in range(m):
            for i in range(n):
                rest[j, i] += K[k, i] * (R[k, j] * larger)
    for i in range(n):
        for j in range(m):
            for k in range(n):
                P[i, k] += rest[j, i] * K[j, k]
    for i in range(n):
        for k in range(i):
            P[i, k] = P[k, i] = 0.5 * (P[i, k] + P[k, i])
    return nis, cost, outlying
