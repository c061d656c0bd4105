"""The compiled recursions of `error_model` and `covariance`.

The filter whitens all columns at once. State: error of the attitude (3) and slow error of the field (3), each in units
of its own standard deviation, at the end of a cell. What is seen of a cell is the mean over its length, U theta + h +
white noise; over a length L = x tau a Gauss-Markov process goes by f = exp(-x), its mean by a = (1 - f)/x, with noise of
variances 1 - f^2 and 2 (x - 1 + f)/x^2 - a^2 and covariance a (1 - f). Notation of Durbin & Koopman (2012), Time Series
Analysis by State Space Methods, 4.3.
"""

from __future__ import annotations

import numpy as np

from fluxtwin.sim.base.kernel_cache import kernel, part
from fluxtwin.sim.base.types import FloatArray


@part(error_model="numpy")
def _fill_steps(gap_s: FloatArray, length_s: FloatArray, tau_s: float, out: FloatArray) -> None:
    """out (K, 6): exp(-gap/tau), a, f, variance of the end, covariance, variance of the mean."""
    for k in range(gap_s.size):
        x = max(length_s[k] / tau_s, 1e-4)
        f = np.exp(-x)
        a = -np.expm1(-x) / x
        mean = 1.0 - x / 3.0 if x < 0.01 else 2.0 * (x - 1.0 + f) / (x * x)
        out[k, 0], out[k, 1], out[k, 2] = np.exp(-gap_s[k] / tau_s), a, f
        out[k, 3], out[k, 4], out[k, 5] = 1.0 - f * f, a * (1.0 - f), max(mean - a * a, 0.0)


@part(error_model="numpy", fastmath={"reassoc", "contract", "nsz"})
def _whiten(
    column: FloatArray, H: FloatArray, a0: float, a1: float, x: FloatArray, L: FloatArray, v: FloatArray
) -> None:
    """v (3, q): L^-1 times the innovations of a row."""
    q = v.shape[1]
    for i in range(3):
        one = 1.0 / L[i, i]
        for c in range(q):
            total = H[i, 0] * x[0, c] + H[i, 1] * x[1, c] + H[i, 2] * x[2, c]
            v[i, c] = column[i, c] - a1 * H[i, 3 + i] * x[3 + i, c] - a0 * total
        for n in range(i):
            for c in range(q):
                v[i, c] -= L[i, n] * v[n, c]
        for c in range(q):
            v[i, c] *= one


@part(error_model="numpy", fastmath={"reassoc", "contract", "nsz"})
def _add(v: FloatArray, gram: FloatArray) -> None:
    """Products of the columns of v (3, q), lower half."""
    q = v.shape[1]
    for c in range(q):
        for d in range(c + 1):
            gram[c, d] += v[0, c] * v[0, d] + v[1, c] * v[1, d] + v[2, c] * v[2, d]


@kernel(error_model="numpy", fastmath={"reassoc", "contract", "nsz"})
def whitened_gram(
    columns: FloatArray,
    image: FloatArray,
    noise: FloatArray,
    turned: FloatArray,
    gap_s: FloatArray,
    length_s: FloatArray,
    of: tuple[float, float, float, float, float],
    gram: FloatArray,
) -> float:
    """Fill gram (q, q) with C' V^-1 C and return log |V|.

    columns: (K, 3, q) C. image: (K, 3, 3) U. noise, turned: (K, 3, 3) white covariance of the reading, and of an attitude
    error of one. gap_s, length_s: (K,) before each cell, and its own. of: sigma and tau of the attitude's error, sigma of
    its white part, sigma and tau of the slow error.
    """
    rows, _, q = columns.shape
    P, x = np.eye(6), np.zeros((6, q))
    H, T, PH, K = np.zeros((3, 6)), np.zeros((6, 3)), np.zeros((6, 3)), np.zeros((6, 3))
    L, v = np.zeros((3, 3)), np.zeros((3, q))
    steps = np.empty((rows, 2, 6))
    _fill_steps(gap_s, length_s, of[1], steps[:, 0])
    _fill_steps(gap_s, length_s, of[4], steps[:, 1])
    gram[:] = 0.0
    logs, apart = 0.0, of[2] * of[2]
    for k in range(rows):
        for i in range(6):
            fi = steps[k, i // 3, 0]
            for c in range(q):
                x[i, c] *= fi
            for j in range(i + 1):
                P[i, j] *= fi * steps[k, j // 3, 0]
            P[i, i] += 1.0 - fi * fi
            for j in range(i):
                P[j, i] = P[i, j]
        for i in range(3):
            for j in range(3):
                H[i, j] = of[0] * image[k, i, j]
            H[i, 3 + i] = of[3]
        a0, a1 = steps[k, 0, 1], steps[k, 1, 1]
        for i in range(6):
            for j in range(3):
                T[i, j] = (
                    a0 * (P[i, 0] * H[j, 0] + P[i, 1] * H[j, 1] + P[i, 2] * H[j, 2]) + a1 * P[i, 3 + j] * H[j, 3 + j]
                )
                PH[i, j] = steps[k, i // 3, 2] * T[i, j] + steps[k, i // 3, 4] * H[j, i]
        for i in range(3):  # Cholesky of the covariance of the innovation
            for j in range(i + 1):
                total = noise[k, i, j] + apart * turned[k, i, j] + a1 * H[i, 3 + i] * T[3 + i, j]
                for n in range(3):
                    total += H[i, n] * (a0 * T[n, j] + steps[k, 0, 5] * H[j, n])
                if i == j:
                    total += steps[k, 1, 5] * H[i, 3 + i] ** 2
                for n in range(j):
                    total -= L[i, n] * L[j, n]
                L[i, j] = np.sqrt(total) if i == j else total / L[j, j]
            logs += np.log(L[i, i])
        for i in range(6):  # the gain, for whitened innovations
            for j in range(3):
                total = PH[i, j]
                for n in range(j):
                    total -= K[i, n] * L[j, n]
                K[i, j] = total / L[j, j]
        _whiten(columns[k], H, a0, a1, x, L, v)
        for i in range(6):
            for c in range(q):
                x[i, c] = steps[k, i // 3, 2] * x[i, c] + K[i, 0] * v[0, c] + K[i, 1] * v[1, c] + K[i, 2] * v[2, c]
            for j in range(i + 1):
                P[i, j] *= steps[k, i // 3, 2] * steps[k, j // 3, 2]
                P[i, j] -= K[i, 0] * K[j, 0] + K[i, 1] * K[j, 1] + K[i, 2] * K[j, 2]
            P[i, i] += steps[k, i // 3, 3]
        _add(v, gram)
    for c in range(q):
        for d in range(c):
            gram[d, c] = gram[c, d]
    return 2.0 * logs


@kernel(error_model="numpy")
def correlated_before(seconds: FloatArray, weighted: FloatArray, tau_s: FloatArray, out: FloatArray) -> None:
    """out (K, n, q): sum over earlier cells of weighted exp(-dt/tau); weighted (K, q)."""
    rows, q = weighted.shape
    for t in range(tau_s.size):
        for f in range(q):
            out[0, t, f] = 0.0
    for k in range(1, rows):
        for t in range(tau_s.size):
            fade = np.exp(-(seconds[k] - seconds[k - 1]) / tau_s[t])
            for f in range(q):
                out[k, t, f] = fade * (out[k - 1, t, f] + weighted[k - 1, f])
