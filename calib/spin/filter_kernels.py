"""The compiled steps of the filter for spinning spacecraft. Imported only where they are needed."""

from __future__ import annotations

import math

import numpy as np

from fluxtwin.calib.common import kalman_kernels
from fluxtwin.calib.common.kalman_kernels import passive, product, skew, times, update
from fluxtwin.sim.base.kernel_cache import kernel, part
from fluxtwin.sim.base.types import FloatArray


@kernel(uses=(kalman_kernels,), fastmath=False)
def step(A: FloatArray, L: FloatArray, ratio: float, h: float) -> tuple[FloatArray, FloatArray]:
    """A after h and the transition (6, 6) of [dtheta, dL], free axisymmetric body about z; exact in A. ratio: Js/Jt.

    A(t+h) = Rz(lam h) A exp(-[L x] h), lam = L_B3 (Jt/Js - 1), L in units of Jt (Markley & Sedlak 2008, in closed form).
    """
    size = math.sqrt(L[0] ** 2 + L[1] ** 2 + L[2] ** 2)
    g = h * (1.0 / ratio - 1.0)
    L_B = times(A, L)
    Rz = passive(np.array([0.0, 0.0, L_B[2] * g]))
    turned = product(Rz, A)
    new = product(turned, passive(L * h))
    a = size * h
    Jl = np.eye(3)
    if a > 1e-9:  # of -L h / Jt: 1 + (1 - cos a) / a [n x] + (1 - sin a / a) [n x]^2
        turning, first, second = skew(-L / size), (1.0 - math.cos(a)) / a, 1.0 - math.sin(a) / a
        square = product(turning, turning)
        for i in range(3):
            for j in range(3):
                Jl[i, j] += first * turning[i, j] + second * square[i, j]
    side = product(turned, Jl)
    Phi = np.eye(6)
    for i in range(3):
        for j in range(3):
            Phi[i, j], Phi[i, 3 + j] = Rz[i, j], h * side[i, j]
    Phi[2, 0] -= g * L_B[1]
    Phi[2, 1] += g * L_B[0]
    for j in range(3):
        Phi[2, 3 + j] += g * A[2, j]
    return new, Phi


@part()
def _moved(L: FloatArray, error: FloatArray) -> FloatArray:
    """L after an error: what lies across L turns it and leaves its size, or the phase would slip far off."""
    size = math.sqrt(L[0] ** 2 + L[1] ** 2 + L[2] ** 2)
    n = L / size
    along = 0.0
    for i in range(3):
        along += n[i] * error[i]
    across = times(skew(error), n)
    for i in range(3):
        across[i] /= size
    out = times(passive(across), L)
    for i in range(3):
        out[i] *= 1.0 + along / size
    return out


@kernel(uses=(kalman_kernels,), fastmath=False)
def run_filter(
    t_s: FloatArray,
    kind: FloatArray,
    seen: FloatArray,
    ref_N: FloatArray,
    A: FloatArray,
    L: FloatArray,
    P: FloatArray,
    ratio: float,
    noise: FloatArray,
    extended: bool,
    history: FloatArray,
    nis: FloatArray,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Through all events in order of time; kind 0 a field vector, 1 a sun pulse.

    noise: field, sun [rad], then the variance of L a second. `extended`: each measurement is linearised
    about the latest estimate; else all about the motion given, which is then one step of Gauss and Newton. Fills history
    (n, 3, 3), and nis (n,). Returns A, L, P at the last event.
    """
    now = t_s[0]
    x, sigma = np.zeros(6), np.empty(3)
    of_field, of_sun = np.zeros((3, 6)), np.zeros((2, 6))
    R_field, R_sun = noise[0] ** 2 * np.eye(3), np.zeros((2, 2))
    left_field, left_sun = np.empty(3), np.empty(2)
    for k in range(t_s.size):
        h = t_s[k] - now
        now = t_s[k]
        if h > 0.0:
            A, Phi = step(A, L, ratio, h)
            P = Phi @ P @ Phi.T
            for i in range(6):
                for j in range(i):
                    P[i, j] = P[j, i] = 0.5 * (P[i, j] + P[j, i])
            x = times(Phi, x)
            for i in range(3):
                P[3 + i, 3 + i] += noise[2] * h
        y = times(A, ref_N[k])
        if kind[k] == 0.0:
            H, R, r = of_field, R_field, left_field
            for i in range(3):
                r[i] = seen[k, i] - y[i]
            H[0, 1], H[0, 2], H[1, 2] = -y[2], y[1], -y[0]  # [y x]
            H[1, 0], H[2, 0], H[2, 1] = y[2], -y[1], y[0]
        else:
            H, R, r = of_sun, R_sun, left_sun
            across = math.sqrt(y[0] ** 2 + y[1] ** 2)
            H[0, 0], H[0, 1], H[0, 2] = y[0] * y[2] / across**2, y[1] * y[2] / across**2, -1.0
            H[1, 0], H[1, 1] = -y[1] / across, y[0] / across
            turned = math.atan2(seen[k, 1], seen[k, 0]) - math.atan2(y[1], y[0])
            turned = math.atan2(math.sin(turned), math.cos(turned))
            r[0], r[1] = turned, math.asin(seen[k, 2]) - math.asin(min(max(y[2], -1.0), 1.0))
            R[0, 0], R[1, 1] = (noise[1] / across) ** 2, noise[1] ** 2
        nis[k] = r.size * update(x, P, H, r, R, sigma, np.inf)[0]
        if extended:
            A, L = product(passive(x[:3]), A), _moved(L, x[3:])
            for i in range(6):
                x[i] = 0.0
        history[k] = product(passive(x[:3]), A)
    return product(passive(x[:3]), A), _moved(L, x[3:]), P
