"""The one-shot batch for a free axisymmetric spinner: motion and magnetometer together, by least squares.

    B = G A(t) H + o,   sun seen = A(t) s

Unknowns: the seven numbers of the motion (`motion`), o (3) and G (9). One gauge is left by an axisymmetric body:
the azimuth of its x axis. The sun sensor defines it: its own misalignment about z goes into the magnetometer's.

The tilt of the sensors against z needs no gauge: the dynamics know the axis. Start: see `start`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fluxtwin.calib.common.regression import solve_scaled
from fluxtwin.calib.spin.motion import SpinMotion
from fluxtwin.calib.spin.rows import SpinRows
from fluxtwin.sim.base.types import FloatArray

_ROUNDS = 25
_SETTLED = 1e-6
"""Of the squared step in sigmas."""
_GAINED = 1e-3
"""Of the sum of squares."""
SIZE = 19


class State(NamedTuple):
    """What is estimated."""

    motion: SpinMotion
    G: FloatArray
    """(3, 3)."""
    o_nT: FloatArray
    """(3,)."""


class Noise(NamedTuple):
    """1 sigma of a component of each sensor."""

    field_nT: float
    sun_rad: float


class Prior(NamedTuple):
    """What is known of G and o beforehand."""

    G: FloatArray
    o_nT: FloatArray
    sigma_G: float
    sigma_o_nT: float


class Normal(NamedTuple):
    """Normal equations and costs at a state."""

    matrix: FloatArray
    """(19, 19) order d0, dOm, dlam, o, G row by row."""
    vector: FloatArray
    cost: float
    field_chi2: float
    """Per component."""
    sun_chi2: float
    """Per angle (two a pulse)."""


class Batch(NamedTuple):
    """Where the search ended."""

    state: State
    covariance: FloatArray
    """(19, 19)."""
    normal: Normal
    converged: bool
    rounds: int


def residuals(state: State, rows: SpinRows) -> tuple[FloatArray, FloatArray]:
    """(N, 3) nT of the readings, and (M, 3) of the sun's unit vectors."""
    y = state.motion.see(rows.t_s, rows.H_N_nT)
    return rows.B_nT - y @ state.G.T - state.o_nT, rows.sun_B - state.motion.see(rows.pulse_s, rows.sun_N)


def normal_equations(state: State, rows: SpinRows, noise: Noise, prior: Prior | None = None) -> Normal:
    """Sums over all rows."""
    N, v = np.zeros((SIZE, SIZE)), np.zeros(SIZE)
    y, slope = state.motion.slopes(rows.t_s, rows.H_N_nT)
    X, r, w = state.G @ slope, rows.B_nT - y @ state.G.T - state.o_nT, 1.0 / noise.field_nT**2
    seen, sun_slope = state.motion.slopes(rows.pulse_s, rows.sun_N)
    X_sun, r_sun, w_sun = sun_slope.reshape(-1, 7), rows.sun_B - seen, 1.0 / noise.sun_rad**2
    N[:7, :7] = w * X.reshape(-1, 7).T @ X.reshape(-1, 7) + w_sun * X_sun.T @ X_sun
    N[:7, 7:10] = w * X.sum(axis=0).T
    N[:7, 10:] = w * np.einsum("nim,nj->mij", X, y).reshape(7, 9)
    N[7:10, 7:10] = w * len(y) * np.eye(3)
    first, second = w * y.sum(axis=0), w * (y.T @ y)
    for i in range(3):
        N[7 + i, 10 + 3 * i : 13 + 3 * i] = first
        N[10 + 3 * i : 13 + 3 * i, 10 + 3 * i : 13 + 3 * i] = second
    v[:7] = w * r.ravel() @ X.reshape(-1, 7) + w_sun * r_sun.ravel() @ X_sun
    v[7:10], v[10:] = w * r.sum(axis=0), w * (r.T @ y).ravel()
    field, suns = w * float((r**2).sum()), w_sun * float((r_sun**2).sum())
    cost = field + suns
    if prior is not None:
        N[7:10, 7:10] += np.eye(3) / prior.sigma_o_nT**2
        N[10:, 10:] += np.eye(9) / prior.sigma_G**2
        back_o, back_G = prior.o_nT - state.o_nT, (prior.G - state.G).ravel()
        v[7:10] += back_o / prior.sigma_o_nT**2
        v[10:] += back_G / prior.sigma_G**2
        cost += float(back_o @ back_o) / prior.sigma_o_nT**2 + float(back_G @ back_G) / prior.sigma_G**2
    N = np.triu(N) + np.triu(N, 1).T
    return Normal(N, v, cost, field / max(rows.B_nT.size, 1), suns / max(2 * len(rows.pulse_s), 1))


def solve_batch(
    state: State, rows: SpinRows, noise: Noise, prior: Prior | None = None, *, rounds: int = _ROUNDS
) -> Batch:
    """Gauss-Newton with Marquardt's damping from a state that is within about 20 deg everywhere."""
    # Weak directions are weak by 1e-9 (precession and turn without nutation): no damping before it is needed.
    now, damping, converged, done = normal_equations(state, rows, noise, prior), 0.0, False, 0
    while done < rounds and damping < 1e8 and not converged:
        done += 1
        step = solve_scaled(now.matrix, now.vector, damping, rcond=1e-15)
        tried = State(state.motion.moved(step[:7]), state.G + step[10:].reshape(3, 3), state.o_nT + step[7:10])
        then = normal_equations(tried, rows, noise, prior)
        small = float(step @ now.matrix @ step) < _SETTLED * max(1.0, now.field_chi2)
        gained = now.cost - then.cost
        if gained >= 0.0:
            # Without nutation precession and turn are one: a step along their difference is large and gains nothing.
            small = small or (gained < _GAINED and damping < 1e-4)
            state, now, damping, converged = tried, then, 1e-3 * damping if damping > 1e-12 else 0.0, small
        else:
            converged = small and damping < 1e-3
            damping = max(100.0 * damping, 1e-10)
    return Batch(state, covariance_of_normal(now), now, converged, done)


def covariance_of_normal(now: Normal) -> FloatArray:
    """(19, 19) inverse of the normal matrix."""
    scale = np.sqrt(np.diag(now.matrix))
    inverse = np.linalg.pinv(now.matrix / np.outer(scale, scale), rcond=1e-14, hermitian=True)
    return np.asarray(inverse / np.outer(scale, scale))
