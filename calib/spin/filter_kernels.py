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
        turning = skew(-L / size)
        Jl += (1.0 - math.cos(a)) / a * turning + (1.0 - math.sin(a) / a) * product(turning, turning)
    side = product(turned, Jl)
    Phi = np.eye(6)
    Phi[:3, :3], Phi[:3, 3:] = Rz, h * side
    Phi[2, 0] -= g * L_B[1]
    Phi[2, 1] += g * L_B[0]
    Phi[2, 3:] += g * A[2]
    return new, Phi


@part()
def _moved(L: FloatArray, error: FloatArray) -> FloatArray:
    """L after an error: what lies across L turns it and leaves its size, or the phase would slip far off."""
    size = math.sqrt(L[0] ** 2 + L[1] ** 2 + L[2] ** 2)
    n = L / size
    longer: float = 1.0 + (n * error).sum() / size
    return longer * times(passive(times(skew(error), n) / size), L)


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
    x = np.zeros(6)
    for k in range(t_s.size):
        h = t_s[k] - now
        now = t_s[k]
        if h > 0.0:
            A, Phi = step(A, L, ratio, h)
            P = Phi @ P @ Phi.T
            P = 0.5 * (P + P.T)
            x = times(Phi, x)
            for i in range(3):
                P[3 + i, 3 + i] += noise[2] * h
        y = times(A, ref_N[k])
        if kind[k] == 0.0:
            H, R, r = np.zeros((3, 6)), noise[0] ** 2 * np.eye(3), seen[k] - y
            H[:, :3] = skew(y)
        else:
            across = math.sqrt(y[0] ** 2 + y[1] ** 2)
            H = np.zeros((2, 6))
            H[0, 0], H[0, 1], H[0, 2] = y[0] * y[2] / across**2, y[1] * y[2] / across**2, -1.0
            H[1, 0], H[1, 1] = -y[1] / across, y[0] / across
            turned = math.atan2(seen[k, 1], seen[k, 0]) - math.atan2(y[1], y[0])
            turned = math.atan2(math.sin(turned), math.cos(turned))
            r, R = np.empty(2), np.zeros((2, 2))
            r[0], r[1] = turned, math.asin(seen[k, 2]) - math.asin(min(max(y[2], -1.0), 1.0))
            R[0, 0], R[1, 1] = (noise[1] / across) ** 2, noise[1] ** 2
        nis[k] = r.size * update(x, P, H, r, R, np.empty(3), np.inf)[0]
        if extended:
            A, L = product(passive(x[:3]), A), _moved(L, x[3:])
            x = np.zeros(6)
        history[k] = product(passive(x[:3]), A)
    return product(passive(x[:3]), A), _moved(L, x[3:]), P
