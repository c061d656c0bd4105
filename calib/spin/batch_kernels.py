"""Compiled sums over the rows of a spinning spacecraft. Imported only where they are needed."""

from __future__ import annotations

import math

import numpy as np

from fluxtwin.sim.base.kernel_cache import kernel
from fluxtwin.sim.base.types import FloatArray


@kernel(fastmath=False)
def accumulate(
    t_s: FloatArray,
    seen: FloatArray,
    ref_N: FloatArray,
    A0: FloatArray,
    Om: FloatArray,
    lam: float,
    G: FloatArray,
    o: FloatArray,
    weight: float,
    full: bool,
    N: FloatArray,
    v: FloatArray,
) -> float:
    """Add the normal equations of seen = G A(t) ref + o to the upper half of N (19, 19) and to v (19,).

    Order: d0, dOm, dlam, o, G row by row; with `full` False only the first seven are touched. Returns the weighted sum
    of squared residuals. The motion is `motion.Motion`, its slopes to first order in errors (d0 a turn in B at t = 0)

        d(t) = Rz d0 + Rz A0 Jl(-Om t) t dOm + z t dlam,   Jl(x) = 1 + (1-cos x)/x^2 [x x] + (x - sin x)/x^3 [x x]^2
    """
    rate = max(math.sqrt(Om[0] ** 2 + Om[1] ** 2 + Om[2] ** 2), 1e-300)
    n0, n1, n2 = Om[0] / rate, Om[1] / rate, Om[2] / rate
    d = np.empty((3, 7))
    X = np.empty((3, 7))
    y = np.empty(3)
    r = np.empty(3)
    jl = np.empty(3)
    total = 0.0
    for k in range(t_s.size):
        t = t_s[k]
        a = rate * t
        sa, ca = math.sin(a), math.cos(a)
        sl, cl = math.sin(lam * t), math.cos(lam * t)
        h0, h1, h2 = ref_N[k, 0], ref_N[k, 1], ref_N[k, 2]
        c0, c1, c2 = n1 * h2 - n2 * h1, n2 * h0 - n0 * h2, n0 * h1 - n1 * h0
        e0, e1, e2 = n1 * c2 - n2 * c1, n2 * c0 - n0 * c2, n0 * c1 - n1 * c0
        b0 = h0 - sa * c0 + (1.0 - ca) * e0
        b1 = h1 - sa * c1 + (1.0 - ca) * e1
        b2 = h2 - sa * c2 + (1.0 - ca) * e2
        u0 = A0[0, 0] * b0 + A0[0, 1] * b1 + A0[0, 2] * b2
        u1 = A0[1, 0] * b0 + A0[1, 1] * b1 + A0[1, 2] * b2
        u2 = A0[2, 0] * b0 + A0[2, 1] * b1 + A0[2, 2] * b2
        y[0], y[1], y[2] = cl * u0 + sl * u1, cl * u1 - sl * u0, u2
        # u x axis, then the turn about z: the columns of d0
        d[0, 0], d[1, 0], d[2, 0] = sl * u2, cl * u2, -u1
        d[0, 1], d[1, 1], d[2, 1] = -cl * u2, sl * u2, u0
        d[0, 2], d[1, 2], d[2, 2] = cl * u1 - sl * u0, -sl * u1 - cl * u0, 0.0
        slow, fast = (1.0 - ca) / rate, t - sa / rate
        for axis in range(3):
            x0, x1, x2 = 1.0 if axis == 0 else 0.0, 1.0 if axis == 1 else 0.0, 1.0 if axis == 2 else 0.0
            p0, p1, p2 = n1 * x2 - n2 * x1, n2 * x0 - n0 * x2, n0 * x1 - n1 * x0
            q0, q1, q2 = n1 * p2 - n2 * p1, n2 * p0 - n0 * p2, n0 * p1 - n1 * p0
            jl[0], jl[1], jl[2] = (
                t * x0 - slow * p0 + fast * q0,
                t * x1 - slow * p1 + fast * q1,
                t * x2 - slow * p2 + fast * q2,
            )
            f0, f1, f2 = b1 * jl[2] - b2 * jl[1], b2 * jl[0] - b0 * jl[2], b0 * jl[1] - b1 * jl[0]
            g0 = A0[0, 0] * f0 + A0[0, 1] * f1 + A0[0, 2] * f2
            g1 = A0[1, 0] * f0 + A0[1, 1] * f1 + A0[1, 2] * f2
            g2 = A0[2, 0] * f0 + A0[2, 1] * f1 + A0[2, 2] * f2
            d[0, 3 + axis], d[1, 3 + axis], d[2, 3 + axis] = cl * g0 + sl * g1, cl * g1 - sl * g0, g2
        d[0, 6], d[1, 6], d[2, 6] = y[1] * t, -y[0] * t, 0.0
        for i in range(3):
            r[i] = seen[k, i] - (G[i, 0] * y[0] + G[i, 1] * y[1] + G[i, 2] * y[2]) - o[i]
            total += weight * r[i] * r[i]
            for m in range(7):
                X[i, m] = G[i, 0] * d[0, m] + G[i, 1] * d[1, m] + G[i, 2] * d[2, m]
        _add(X, y, r, weight, full, N, v)
    return total


@kernel(fastmath=False)
def _add(X: FloatArray, y: FloatArray, r: FloatArray, weight: float, full: bool, N: FloatArray, v: FloatArray) -> None:
    """One row's part, upper half."""
    for m in range(7):
        v[m] += weight * (X[0, m] * r[0] + X[1, m] * r[1] + X[2, m] * r[2])
        for p in range(m, 7):
            N[m, p] += weight * (X[0, m] * X[0, p] + X[1, m] * X[1, p] + X[2, m] * X[2, p])
        if full:
            for i in range(3):
                N[m, 7 + i] += weight * X[i, m]
                for j in range(3):
                    N[m, 10 + 3 * i + j] += weight * X[i, m] * y[j]
    if full:
        for i in range(3):
            v[7 + i] += weight * r[i]
            N[7 + i, 7 + i] += weight
            for j in range(3):
                v[10 + 3 * i + j] += weight * r[i] * y[j]
                N[7 + i, 10 + 3 * i + j] += weight * y[j]
                for p in range(j, 3):
                    N[10 + 3 * i + j, 10 + 3 * i + p] += weight * y[j] * y[p]
