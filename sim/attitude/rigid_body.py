"""Torque-free motion of a rigid body, in closed form.

Rates are Jacobi elliptic functions of time (Landau & Lifshitz, Mechanics, section 37); the precession about
the angular momentum is an elliptic integral of the third kind, in Carlson's symmetric form (DLMF 19.25.14).
An axisymmetric or spherical body is the elementary case. There is no step, so no error grows but that of the
phase itself (rounding of rate times elapsed time). Only on the separatrix, where the elliptic functions lose
their period, the equations are integrated instead.

A body here is labelled by its principal axes 1, 2, 3: axis 3 is the one (of largest or smallest moment) that
the momentum circles about, 1 the opposite extreme, 2 the intermediate.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation
from scipy.special import ellipj, ellipkinc, ellipkm1, elliprf, elliprj

from fluxtwin.sim.base.errors import BadInput
from fluxtwin.sim.base.types import FloatArray

_EQUAL = 1e-12
"""Moments closer than this (relative) are one moment: they cannot be distinguished after 1e12 radians."""
_SEPARATRIX = 1e-9
"""Below this complementary parameter scipy's Jacobi functions are approximations; integrate instead."""


def torque_free(
    seconds: FloatArray, inertia_kg_m2: FloatArray, R_BN0: Rotation, rate0_B_rad_s: FloatArray
) -> tuple[Rotation, FloatArray]:
    """Attitude and rate of a free rigid body at each elapsed time.

    seconds (N,) since the initial state, any sign and order. inertia_kg_m2: three moments about the body axes
    or a symmetric (3, 3) tensor in B. R_BN0: one rotation; rate0_B_rad_s (3,). Returns R_BN (batch of N) and
    rate_B_rad_s (N, 3). Accuracy: 1e-11 rad, and 1e-14 of the angle turned through where that is more;
    within 1e-9 of the separatrix, where the motion is unstable, the integrator's 1e-12 a step as it grows.
    Raises BadInput for moments that no body has.
    """
    t = np.atleast_1d(np.asarray(seconds, dtype=np.float64))
    rate0 = np.asarray(rate0_B_rad_s, dtype=np.float64)
    moments, axes_B = principal_axes(inertia_kg_m2)
    order, kind = _label(moments, axes_B @ rate0)
    # Relabelled axes keep the right hand: an odd order turns the third axis over.
    axes_B = axes_B[list(order)]
    axes_B[2] *= np.linalg.det(axes_B)
    solve = {
        "sphere": _sphere,
        "axisymmetric": _axisymmetric,
        "triaxial": _triaxial,
        "separatrix": _integrated,
    }
    R_turn, rate_P = solve[kind](t, moments[list(order)], axes_B @ rate0)
    R_PB = Rotation.from_matrix(axes_B)
    return R_PB.inv() * R_turn * R_PB * R_BN0, R_PB.inv().apply(rate_P)


def principal_axes(inertia_kg_m2: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Principal moments (3,) and the matrix of B to principal components (3, 3), right-handed.

    Three moments are taken about the body axes as they stand. Raises BadInput for a tensor that is not
    symmetric, or moments that are not positive or break the triangle rule (one above the sum of the others).
    """
    inertia = np.asarray(inertia_kg_m2, dtype=np.float64)
    if inertia.shape == (3,):
        moments, axes = inertia, np.eye(3)
    elif inertia.shape == (3, 3) and np.abs(inertia - inertia.T).max() <= 1e-9 * np.abs(inertia).max():
        moments, vectors = np.linalg.eigh(inertia)
        axes = vectors.T * np.array([1.0, 1.0, np.linalg.det(vectors)])[:, None]
    else:
        raise BadInput(
            "not symmetric" if inertia.shape == (3, 3) else f"shape {inertia.shape}",
            where="inertia_kg_m2",
            wanted="three moments or a symmetric 3 x 3 tensor",
        )
    if not (moments > 0).all() or 2.0 * moments.max() > moments.sum() * (1.0 + 1e-9):
        raise BadInput(
            f"principal moments {np.array2string(moments, precision=6)}",
            where="inertia_kg_m2",
            wanted="positive moments, none above the sum of the other two",
        )
    return moments, axes


def _label(moments: FloatArray, rate_P: FloatArray) -> tuple[tuple[int, int, int], str]:
    """Which principal axis plays 1, 2, 3 (see the module), and which solution applies."""
    low, mid, high = (int(i) for i in np.argsort(moments))
    i1, i2, i3 = moments[low], moments[mid], moments[high]
    if i3 - i1 <= _EQUAL * i3:
        return (0, 1, 2), "sphere"
    if i2 - i1 <= _EQUAL * i3:
        return (low, mid, high), "axisymmetric"
    if i3 - i2 <= _EQUAL * i3:
        return (high, mid, low), "axisymmetric"
    about_high = i3 * (i3 - i2) * rate_P[high] ** 2
    about_low = i1 * (i2 - i1) * rate_P[low] ** 2
    if not rate_P.any():
        return (0, 1, 2), "sphere"
    scale = max(about_high, about_low) + min(i3 - i2, i2 - i1) * i2 * rate_P[mid] ** 2
    if abs(about_high - about_low) <= _SEPARATRIX * scale:
        return (low, mid, high), "separatrix"
    return ((low, mid, high) if about_high > about_low else (high, mid, low)), "triaxial"


def _sphere(t: FloatArray, moments: FloatArray, rate0: FloatArray) -> tuple[Rotation, FloatArray]:
    return Rotation.from_rotvec(-t[:, None] * rate0), np.repeat(rate0[None], t.size, axis=0)


def _axisymmetric(t: FloatArray, moments: FloatArray, rate0: FloatArray) -> tuple[Rotation, FloatArray]:
    """Axis 3 is the axis of symmetry: steady precession at L/It, the rate turning in the body about 3.

    Markley & Sedlak 2008, and any textbook: the body turn is (1 - I3/It) w3 about 3.
    """
    transverse = 0.5 * (moments[0] + moments[1])
    momentum = np.array([transverse, transverse, moments[2]]) * rate0
    in_body = (1.0 - moments[2] / transverse) * rate0[2] * t
    turn_body = Rotation.from_euler("z", -in_body[:, None]) if t.size else Rotation.identity(0)
    turn = turn_body * Rotation.from_rotvec(-t[:, None] * momentum / transverse)
    return turn, turn_body.apply(rate0)


def _triaxial(t: FloatArray, moments: FloatArray, rate0: FloatArray) -> tuple[Rotation, FloatArray]:
    """Jacobi's solution. Energies enter as sums of like signs, so that nothing cancels near an axis."""
    i1, i2, i3 = moments
    w1, w2, w3 = rate0
    across = i1 * (i3 - i1) * w1**2 + i2 * (i3 - i2) * w2**2  # 2 T I3 - L^2
    along = i2 * (i2 - i1) * w2**2 + i3 * (i3 - i1) * w3**2  # L^2 - 2 T I1
    m = (i2 - i1) * across / ((i3 - i2) * along)
    complement = (i3 - i1) * (i3 * (i3 - i2) * w3**2 - i1 * (i2 - i1) * w1**2) / ((i3 - i2) * along)
    speed = np.sqrt((i3 - i2) * along / (i1 * i2 * i3))
    # w = (a1 cn, a2 sn, a3 dn); a2 / a1 is fixed by the moments alone, which keeps a pure spin regular.
    ratio = np.sign(w3) * np.sign(i3 - i2) * np.sqrt(i1 * (i3 - i1) / (i2 * (i3 - i2)))
    a1 = np.sqrt(across / (i1 * (i3 - i1)))
    a3 = np.sign(w3) * np.sqrt(along / (i3 * (i3 - i1)))
    u0 = float(ellipkinc(np.arctan2(w2 / ratio, w1), m)) if a1 > 0 else 0.0

    quarter = float(ellipkm1(complement))
    u = speed * np.concatenate([[0.0], t]) + u0
    sn, cn, dn, half_turns = _jacobi(u, m, quarter)
    rate = np.stack([a1 * cn, a1 * ratio * sn, a3 * dn], axis=1)

    characteristic = -i3 * (i2 - i1) / (i1 * (i3 - i2))
    third = _third_kind(characteristic, complement, (sn, cn, dn), half_turns)
    momentum = float(np.linalg.norm(moments * rate0))
    precession = momentum * np.concatenate([[0.0], t]) / i3
    precession += momentum * (i3 - i1) / (speed * i1 * i3) * (third - third[0])
    node = np.arctan2(i1 * cn, i2 * ratio * sn)
    tilt = np.arctan2(np.hypot(moments[0] * rate[:, 0], moments[1] * rate[:, 1]), moments[2] * rate[:, 2])
    R_PH = Rotation.from_euler("ZXZ", np.stack([precession, tilt, node], axis=1)).inv()
    return R_PH[1:] * R_PH[0].inv(), rate[1:]


def _jacobi(u: FloatArray, m: float, quarter: float) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """sn, cn, dn at u, and the whole number of half periods 2K taken off u first."""
    half_turns: FloatArray = np.rint(u / (2.0 * quarter))
    sn, cn, dn = (np.asarray(f, dtype=np.float64) for f in ellipj(u - 2.0 * quarter * half_turns, m)[:3])
    sign = 1.0 - 2.0 * np.mod(half_turns, 2.0)
    return sign * sn, sign * cn, dn, half_turns


def _third_kind(
    n: float, complement: float, jacobi: tuple[FloatArray, FloatArray, FloatArray], half_turns: FloatArray
) -> FloatArray:
    """Elliptic integral of the third kind Pi(n; am u, m), n <= 0 (DLMF 19.25.14; whole periods 19.2.8)."""
    sn, cn, dn = jacobi
    s = sn * (1.0 - 2.0 * np.mod(half_turns, 2.0))
    c2, d2 = cn**2, dn**2
    partial = s * elliprf(c2, d2, 1.0) + n / 3.0 * s**3 * elliprj(c2, d2, 1.0, 1.0 - n * s**2)
    complete = elliprf(0.0, complement, 1.0) + n / 3.0 * elliprj(0.0, complement, 1.0, 1.0 - n)
    return np.asarray(partial + 2.0 * half_turns * complete)


def _integrated(t: FloatArray, moments: FloatArray, rate0: FloatArray) -> tuple[Rotation, FloatArray]:
    """Euler's equations and the turn's kinematics by an eighth-order method, relative tolerance 1e-12."""
    from scipy.integrate import solve_ivp  # here: slow to load, and seldom wanted

    def slope(_: float, state: FloatArray) -> FloatArray:
        v, s, w = state[:3], state[3], state[4:]
        turn = 0.5 * np.append(s * w + np.cross(v, w), -v @ w)
        return np.concatenate([turn, np.cross(moments * w, w) / moments])

    start = np.concatenate([[0.0, 0.0, 0.0, 1.0], rate0])
    state = np.tile(start, (t.size, 1))
    small = 1e-13 * np.array([1.0] * 4 + [float(np.linalg.norm(rate0))] * 3)
    for sense in (1.0, -1.0):
        rows = sense * t > 0
        stops, back = np.unique(sense * t[rows], return_inverse=True)
        if stops.size:
            span = (0.0, sense * stops[-1])
            run = solve_ivp(slope, span, start, method="DOP853", t_eval=sense * stops, rtol=1e-12, atol=small)
            state[rows] = run.y.T[back]
    return Rotation.from_quat(state[:, :4]).inv(), state[:, 4:]
