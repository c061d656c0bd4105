"""The compiled steps of the filter for spinning spacecraft. Imported only where they are needed."""

from __future__ import annotations

import math

import numpy as np

from fluxtwin.sim.kernel_cache import kernel
from fluxtwin.sim.types import FloatArray


@kernel(fastmath=False)
def _skew(v: FloatArray) -> FloatArray:
    out = np.zeros((3, 3))
    out[0, 1], out[0, 2], out[1, 2] = -v[2], v[1], -v[0]
    out[1, 0], out[2, 0], out[2, 1] = v[2], -v[1], v[0]
    return out


@kernel(fastmath=False)
def _passive(v: FloatArray) -> FloatArray:
    """exp(-[v x])."""
    angle = math.sqrt(v[0] ** 2 + v[1] ** 2 + v[2] ** 2)
    if angle < 1e-12:
        return np.eye(3) - _skew(v)
    n = _skew(v / angle)
    return np.eye(3) - math.sin(angle) * n + (1.0 - math.cos(angle)) * (n @ n)


@kernel(fastmath=False)
def step_symmetric(A: FloatArray, L: FloatArray, J: FloatArray, h: float) -> tuple[FloatArray, FloatArray]:
    """A after h and the transition (6, 6) of [dtheta, dL], free axisymmetric body about z; exact in A.

    A(t+h) = Rz(lam h) A exp(-[L x] h / Jt), lam = L_B3 (1/Js - 1/Jt) (Markley & Sedlak 2008, in closed form).
    """
    rate = L / J[0]
    size = math.sqrt(rate[0] ** 2 + rate[1] ** 2 + rate[2] ** 2)
    g = 1.0 / J[2] - 1.0 / J[0]
    L_B = A @ L
    Rz = _passive(np.array([0.0, 0.0, L_B[2] * g * h]))
    new = Rz @ A @ _passive(rate * h)
    a = size * h
    Jl = np.eye(3)
    if a > 1e-9:
        n = -_skew(rate / size)  # of x = -L h / Jt
        Jl = Jl + (1.0 - math.cos(a)) / a * n + (1.0 - math.sin(a) / a) * (n @ n)
    Phi = np.eye(6)
    top = Rz.copy()
    cross = _skew(L_B)
    side = (Rz @ A @ Jl) * (h / J[0])
    for k in range(3):
        top[2, k] += h * g * cross[2, k]
        side[2, k] += h * g * A[2, k]
    Phi[:3, :3] = top
    Phi[:3, 3:] = side
    return new, Phi


@kernel(fastmath=False)
def _slope(A: FloatArray, Phi: FloatArray, L: FloatArray, J: FloatArray) -> tuple[FloatArray, FloatArray]:
    L_B = A @ L
    w = L_B / J
    W = _skew(w)
    F = np.zeros((6, 6))
    cross = _skew(L_B)
    for i in range(3):
        for k in range(3):
            F[i, k] = -W[i, k] + cross[i, k] / J[i]
            F[i, 3 + k] = A[i, k] / J[i]
    return -(W @ A), F @ Phi


@kernel(fastmath=False)
def step_triaxial(A: FloatArray, L: FloatArray, J: FloatArray, h: float) -> tuple[FloatArray, FloatArray]:
    """As `step_symmetric` for three different moments, by Runge and Kutta's fourth-order method, 0.02 rad a step."""
    rate = math.sqrt(L[0] ** 2 + L[1] ** 2 + L[2] ** 2) / min(J[0], min(J[1], J[2]))
    steps = max(1, math.ceil(abs(h) * rate / 0.02))
    d = h / steps
    Phi = np.eye(6)
    for _ in range(steps):
        a1, p1 = _slope(A, Phi, L, J)
        a2, p2 = _slope(A + 0.5 * d * a1, Phi + 0.5 * d * p1, L, J)
        a3, p3 = _slope(A + 0.5 * d * a2, Phi + 0.5 * d * p2, L, J)
        a4, p4 = _slope(A + d * a3, Phi + d * p3, L, J)
        A = A + d / 6.0 * (a1 + 2.0 * a2 + 2.0 * a3 + a4)
        Phi = Phi + d / 6.0 * (p1 + 2.0 * p2 + 2.0 * p3 + p4)
        A = 1.5 * A - 0.5 * (A @ A.T @ A)  # back to a rotation
    return A, Phi


@kernel(fastmath=False)
def _update(
    x: FloatArray, P: FloatArray, r: FloatArray, H: FloatArray, R: FloatArray
) -> tuple[FloatArray, FloatArray, float]:
    """One measurement r = H [dtheta, dL] + noise R (diagonal (m,)) on the error x (6,): x, P after it (Joseph), r'S^-1 r."""
    left = r - H @ x
    PH = P @ H.T
    S = H @ PH
    for i in range(R.size):
        S[i, i] += R[i]
    inverse = np.linalg.inv(S)
    K = PH @ inverse
    I_KH = np.eye(6) - K @ H
    P = I_KH @ P @ I_KH.T
    for i in range(6):
        for k in range(6):
            for m in range(R.size):
                P[i, k] += K[i, m] * R[m] * K[k, m]
    return x + K @ left, 0.5 * (P + P.T), float(left @ (inverse @ left))


@kernel(fastmath=False)
def _moved(L: FloatArray, d: FloatArray) -> FloatArray:
    """L after an error d: what lies across L turns it and leaves its size, or the phase would slip far off."""
    size = math.sqrt(L[0] ** 2 + L[1] ** 2 + L[2] ** 2)
    n = L / size
    along = n[0] * d[0] + n[1] * d[1] + n[2] * d[2]
    turned = np.array([n[1] * d[2] - n[2] * d[1], n[2] * d[0] - n[0] * d[2], n[0] * d[1] - n[1] * d[0]]) / size
    out: FloatArray = _passive(-turned) @ L * (1.0 + along / size)
    return out


@kernel(fastmath=False)
def run_filter(
    t_s: FloatArray,
    kind: FloatArray,
    seen: FloatArray,
    ref_N: FloatArray,
    A: FloatArray,
    L: FloatArray,
    P: FloatArray,
    J: FloatArray,
    noise: FloatArray,
    symmetric: bool,
    extended: bool,
    history: FloatArray,
    nis: FloatArray,
    spread: FloatArray,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Through all events in order of time; kind 0 a field vector, 1 a sun pulse.

    noise: field, sun [rad], then variances a second of L and of the attitude. `extended`: each measurement is linearised
    about the latest estimate; else all about the motion given, which is then one step of Gauss and Newton. Fills history
    (n, 3, 3), nis (n,) and spread (n, 3, 3), the attitude's covariance. Returns A, L, P at the last event.
    """
    now = t_s[0]
    x = np.zeros(6)
    for k in range(t_s.size):
        h = t_s[k] - now
        now = t_s[k]
        if h > 0.0:
            if symmetric:
                A, Phi = step_symmetric(A, L, J, h)
            else:
                A, Phi = step_triaxial(A, L, J, h)
            P = Phi @ P @ Phi.T
            x = Phi @ x
            for i in range(3):
                P[i, i] += noise[3] * h
                P[3 + i, 3 + i] += noise[2] * h
        y = A @ ref_N[k]
        if kind[k] == 0.0:
            H = np.zeros((3, 6))
            H[:, :3] = _skew(y)
            R = np.full(3, noise[0] ** 2)
            x, P, nis[k] = _update(x, P, seen[k] - y, H, R)
        else:
            across = math.sqrt(y[0] ** 2 + y[1] ** 2)
            slope = _skew(y)
            H = np.zeros((2, 6))
            for m in range(3):
                H[0, m] = (y[0] * slope[1, m] - y[1] * slope[0, m]) / across**2
                H[1, m] = slope[2, m] / across
            turned = math.atan2(seen[k, 1], seen[k, 0]) - math.atan2(y[1], y[0])
            turned = math.atan2(math.sin(turned), math.cos(turned))
            r = np.array([turned, math.asin(seen[k, 2]) - math.asin(min(max(y[2], -1.0), 1.0))])
            R = np.array([(noise[1] / across) ** 2, noise[1] ** 2])
            x, P, nis[k] = _update(x, P, r, H, R)
        if extended:
            A, L = _passive(x[:3]) @ A, _moved(L, x[3:])
            x = np.zeros(6)
            history[k] = A
        else:
            history[k] = _passive(x[:3]) @ A
        spread[k] = P[:3, :3]
    return _passive(x[:3]) @ A, _moved(L, x[3:]), P
