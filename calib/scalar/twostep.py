"""TWOSTEP: Alonso & Shuster (2002), J. Astronaut. Sci. 50, 433 (bias) and 475 (complete), without attitude.

    z = |B|^2 - |H|^2 = L theta - |b|^2 + v

    bias only   L = 2 B', theta = b
    complete    E = 2D + D^2, c = (I+D) b, theta = (c, E11 E22 E33 E12 E13 E23), |b|^2 = c'(I+E)^-1 c,
                L = [2B1 2B2 2B3 -B1^2 -B2^2 -B3^2 -2B1B2 -2B1B3 -2B2B3]

Step 1 takes weighted means off, which drops |b|^2 and is linear. Step 2 adds what the means know and iterates.

The noise term: the published mean of v is -tr Sigma, true if B were free of noise. As B is what is measured, B B'
stands Sigma too high on average and |B|^2 tr Sigma; `corrected` takes both off, and then v has mean zero.

Errors in variables: v, the rows L and their weights w are made of the same noisy B, so that E[w L v] is not zero even
then. With G = dL/dB a row adds G Sigma G' to LL and 2 G Sigma B to Lz that are no signal, and the weight, by its own
noise, shifts z by -16 w'Sigma(I+E)Sigma w / s^2, w = (I+D) y. On an arc in which the field hardly turns the first of
these is most of LL's weakest direction: b was wrong there by ten sigma. `corrected` takes all three off.

CENTER is the first of these alone, for the bias: differences of |B|^2 - |H|^2 (Gambhir 1975 in RESIDG),

    b = [sum 4 Bt Bt']^-1 sum 2 Bt zt,     Bt = B - <B>, zt = z - <z>

It needs no start, and throws away what the means know.

Where |H| hardly varies, step 1 of `complete` tends to the exact and useless solution E = -I, c = 0. Step 2 then starts
from the bias alone with E = 0. Numbers here are free of units.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fluxtwin.calib.common.conventions import PAIRS, symmetric
from fluxtwin.calib.common.regression import solve_scaled
from fluxtwin.calib.scalar.model import ScalarData
from fluxtwin.sim.base.types import FloatArray

TRIVIAL = 0.5
"""Smallest eigenvalue of I + E below which the centred solution is taken for the trivial one (E = -I: 0)."""
_WEIGHTINGS = 3
_ROUNDS = 50
_SETTLED = 1e-10


def center(data: ScalarData, a: FloatArray | None = None) -> FloatArray:
    """(3,) b, of least size where the readings do not span space; a: (N,) weights."""
    w = np.full(len(data.H), 1.0 / len(data.H)) if a is None else a / a.sum()
    z = (data.B**2).sum(axis=1) - data.H**2
    B = data.B - w @ data.B
    gram = 4.0 * ((B * w[:, None]).T @ B)
    right = 2.0 * ((B * w[:, None]).T @ (z - w @ z))
    return np.asarray(np.linalg.lstsq(gram, right, rcond=1e-10)[0])


def center_terms(
    b: FloatArray, data: ScalarData, a: FloatArray | None = None
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Scores (N, 3), their slope (3, 3) and its factors (N, 3): the error of b is slope^-1 times the sum of the scores.

    a: (N,) weights, one each where not given.
    """
    w = np.ones(len(data.H)) if a is None else a
    z = (data.B**2).sum(axis=1) - data.H**2
    rows = 2.0 * (data.B - w @ data.B / w.sum())
    left = z - w @ z / w.sum() - rows @ b
    return rows * (w * left)[:, None], np.asarray((rows * w[:, None]).T @ rows), rows


class Twostep(NamedTuple):
    """D, b of (I+D) B = O' A H + b, and how it was reached."""

    D: FloatArray
    """(3, 3) symmetric; zero for bias only."""
    b: FloatArray
    """(3,)."""
    centred_eigenvalue: float
    """Smallest eigenvalue of I + E after step 1; 1 for bias only."""
    converged: bool
    """False where step 2 did not settle, or I + E is not positive."""


class Moments(NamedTuple):
    """All that the solution needs of the rows."""

    total: float
    """Sum of the weights, 1 over the variance of v."""
    mean_L: FloatArray
    """(p,) weighted mean of L."""
    mean_z: float
    """Weighted mean of z - mu."""
    LL: FloatArray
    """(p, p) weighted sum of Lt Lt'."""
    Lz: FloatArray
    """(p,) weighted sum of Lt zt."""
    noise_LL: FloatArray
    """(p, p) what noise of B adds to LL on average."""
    noise_Lz: FloatArray
    """(p,) what it adds to Lz."""

    @property
    def signal(self) -> FloatArray:
        """(p, p) LL without the noise."""
        return self.LL - self.noise_LL


def twostep(data: ScalarData, a: FloatArray | None = None, *, noise_term: str = "corrected") -> Twostep:
    """Solve for b, and D where `data.with_D`. Columns of telemetry are not looked at. a: (N,) weights."""
    start = Twostep(np.zeros((3, 3)), center(data, a), 1.0, True)
    found = start
    for _ in range(_WEIGHTINGS):  # the variances depend on the solution; the third time nothing moves
        moments = moments_of(data, found.D, found.b, noise_term, a)
        found = solve_moments(moments, data.with_D, start.b)
        if not found.converged:
            break
    return found


def moments_of(
    data: ScalarData, D: FloatArray, b: FloatArray, noise_term: str = "corrected", a: FloatArray | None = None
) -> Moments:
    """Of the rows, weighted by the variance of v at D, b, and by a (N,)."""
    P = np.eye(3) + D
    w = (data.B @ P - b) @ P
    Sigma = data.Sigma
    variance = 4.0 * ((w @ Sigma) * w).sum(axis=1) + 2.0 * float(np.trace(Sigma @ Sigma))
    published = noise_term == "published"
    # z - mu, with E v = mu: -tr Sigma as published; zero once tr Sigma is off |B|^2
    z = (data.B**2).sum(axis=1) - data.H**2 + (1.0 if published else -1.0) * float(np.trace(Sigma))
    if not published:
        turned = w @ Sigma
        z = z + 16.0 * ((turned @ P) ** 2).sum(axis=1) / variance
    columns = [2.0 * data.B]
    if data.with_D:
        high = np.zeros((3, 3)) if published else Sigma
        columns += [_twice(i, j) * (high[i, j] - data.B[:, i : i + 1] * data.B[:, j : j + 1]) for i, j in PAIRS]
    L = np.hstack(columns)
    weight = 1.0 / variance if a is None else a / variance
    total = float(weight.sum())
    mean_L, mean_z = weight @ L / total, float(weight @ z) / total
    L = L - mean_L
    noise_LL, noise_Lz = _from_noise(data, np.zeros_like(weight) if published else weight)
    return Moments(
        total, mean_L, mean_z, (L * weight[:, None]).T @ L, L.T @ (weight * (z - mean_z)), noise_LL, noise_Lz
    )


def _from_noise(data: ScalarData, weight: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Weighted sums of G Sigma G' (p, p) and 2 G Sigma B (p,), G = dL/dB linear in B: G = G0 + sum_m B_m G_m."""
    size = 9 if data.with_D else 3
    slopes = np.zeros((4, size, 3))
    slopes[0, :3] = 2.0 * np.eye(3)
    for k, (i, j) in enumerate(PAIRS if data.with_D else ()):
        slopes[1 + i, 3 + k, j] -= _twice(i, j)
        slopes[1 + j, 3 + k, i] -= _twice(i, j)
    one = np.hstack([np.ones((len(data.B), 1)), data.B])
    second = (one * weight[:, None]).T @ one
    noise_LL = np.einsum("mn,mik,kl,njl->ij", second, slopes, data.Sigma, slopes, optimize=True)
    return noise_LL, 2.0 * np.einsum("mik,kl,ml->i", slopes, data.Sigma, second[:, 1:], optimize=True)


def solve_moments(moments: Moments, with_D: bool, bias: FloatArray) -> Twostep:
    """Both steps. bias: (3,) CENTER's, where step 1 is of no use."""
    centred = solve_scaled(moments.signal, moments.Lz - moments.noise_Lz)
    first = float(1.0 + np.linalg.eigvalsh(symmetric(centred[3:]))[0]) if with_D else 1.0
    start = np.concatenate([bias, np.zeros(6)]) if first < TRIVIAL else centred
    theta, converged = _second_step(moments, centred, start, with_D)
    if not converged:
        return Twostep(np.zeros((3, 3)), theta[:3], first, False)
    D, b = back(theta) if with_D else (np.zeros((3, 3)), theta)
    return Twostep(D, b, first, True)


def back(theta: FloatArray) -> tuple[FloatArray, FloatArray]:
    """D and b from theta: E = U e U', D = U (sqrt(1+e) - 1) U', b = (I+D)^-1 c. I + E must be positive."""
    value, vector = np.linalg.eigh(symmetric(theta[3:]))
    root = np.sqrt(np.maximum(1.0 + value, 1e-300))
    D = (vector * (root - 1.0)) @ vector.T
    return D, (vector / root) @ vector.T @ theta[:3]


def _twice(i: int, j: int) -> float:
    return 1.0 if i == j else 2.0


def _second_step(moments: Moments, centred: FloatArray, start: FloatArray, with_D: bool) -> tuple[FloatArray, bool]:
    """Gauss-Newton on the whole cost; returns theta and whether it settled at a positive I + E."""
    theta = start
    for _ in range(_ROUNDS):
        size, slope = _b_squared(theta, with_D)
        centre = moments.mean_L - slope
        left = moments.mean_z - float(moments.mean_L @ theta) + size
        gradient = moments.signal @ (theta - centred) - centre * left * moments.total
        whole = moments.signal + moments.total * np.outer(centre, centre)
        step = -solve_scaled(whole, gradient)
        theta = theta + step
        if with_D and np.linalg.eigvalsh(np.eye(3) + symmetric(theta[3:]))[0] <= 0:
            return theta, False
        if abs(float(step @ whole @ step)) < _SETTLED:
            return theta, _positive(whole)
    return theta, False


def _positive(matrix: FloatArray) -> bool:
    """Whether no direction is below zero beyond rounding: there the rows hold less than their noise."""
    scale = np.sqrt(np.maximum(np.diag(matrix), 1e-300))
    return bool((np.diag(matrix) > 0).all()) and bool(np.linalg.eigvalsh(matrix / np.outer(scale, scale))[0] > -1e-12)


def _b_squared(theta: FloatArray, with_D: bool) -> tuple[float, FloatArray]:
    """|b|^2 and its derivative with respect to theta."""
    if not with_D:
        return float(theta @ theta), 2.0 * theta
    u = np.linalg.solve(np.eye(3) + symmetric(theta[3:]), theta[:3])
    of_E = [-_twice(i, j) * u[i] * u[j] for i, j in PAIRS]
    return float(theta[:3] @ u), np.concatenate([2.0 * u, of_E])
