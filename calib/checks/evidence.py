"""Which of several predictions a reading supports, while its errors are serially correlated.

A reading m is calibrated by (I + S) m + b. That is linear in S and b, whatever their size, so each prediction p of the
body field gives a linear model p - m = S m + b + error. The errors are white, slow, and slow rotations of the
attitude (theta x B, first-order Gauss-Markov); their sizes and memory are found in the record itself. S, b and the
errors are integrated out or maximised alike for all predictions, so the differences of the log evidence compare
the predictions alone (marginal likelihood: Rasmussen and Williams, Gaussian Processes for Machine Learning, 2.7 and 5.4).
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from fluxtwin.calib.common.direction import of_parameters
from fluxtwin.sim.base.types import FloatArray

S_SIGMA, BIAS_SIGMA_nT = 0.05, 30_000.0
"""Widths of the prior: preflight matrices err by a few per cent, uncompensated satellites fly with up to 50,000 nT."""
_SLOW, _TURNS = (0.0, 2.0), (0.0, 3.0, 20.0, 100.0)
"""Sizes of slow errors and of turns of the attitude, in parts of the white error of one row."""
_SLOW_SIZES = (1.0, 6.0, 25.0)
"""Of slow errors where no attitude is known."""
_MEMORIES_S = (100.0, 600.0, 3000.0)
_SCALES_nT = np.exp(np.linspace(np.log(0.5), np.log(50_000.0), 70))
MODEL_nT = 5.0
"""The least white error: no field model knows the crust, the ring current and the day's currents better."""
FLAT = 1e-3
"""The least slope of a form, against division by zero: that of a calibrated magnetometer is 1."""
SCALE_nT = 1e4
"""Unit of the regressors, so that all columns are of order one."""


@dataclass(frozen=True)
class Evidence:
    """What K predictions are worth; the first is what the file says."""

    log: FloatArray
    """(K,) log marginal likelihood."""
    misfit_nT: FloatArray
    """(K,) rms of a component after S and b are fitted under their prior."""
    coefficients_nT: FloatArray
    """(c, K) of the regressors, which are pure numbers, in that fit."""


def vector_evidence(seconds: FloatArray, mag_nT: FloatArray, predicted_nT: FloatArray) -> Evidence:
    """Evidence of predictions (K, n, 3) of the body field for readings (n, 3) at `seconds` (n,)."""
    design = of_parameters(mag_nT / SCALE_nT)
    return compare(seconds, design, np.moveaxis(predicted_nT - mag_nT, 0, 2), VECTOR_SIGMAS_nT, mag_nT, step_nT(mag_nT))


VECTOR_SIGMAS_nT = np.array([S_SIGMA * SCALE_nT] * 9 + [BIAS_SIGMA_nT] * 3)


def scalar_evidence(seconds: FloatArray, mag_nT: FloatArray, size_nT: FloatArray) -> Evidence:
    """Evidence of predictions (K, n) of |B| for readings (n, 3): |B|^2 is a quadratic form of the reading.

    Readings on a short arc leave the form free to be as flat there as it likes, and then it takes up their noise too. So
    the misfit is theirs: the rms that is left, over the slope of the form (Sampson's distance; see `slope_of_form`).
    """
    m, typical = mag_nT / SCALE_nT, 2.0 * size_nT[0]
    pairs = [m[:, i] * m[:, j] for i, j in itertools.combinations_with_replacement(range(3), 2)]
    design = np.column_stack([*pairs, m, np.ones(len(m))]) * (SCALE_nT / typical)[:, None]
    off = (size_nT**2 - np.sum(mag_nT**2, axis=1)) / typical
    quadratic, linear, constant = 3.0 * S_SIGMA, 2.0 * BIAS_SIGMA_nT / SCALE_nT, (BIAS_SIGMA_nT / SCALE_nT) ** 2
    sigmas = SCALE_nT * np.array([quadratic] * 6 + [linear] * 3 + [3.0 * constant])
    found = compare(seconds, design[:, None, :], off.T[:, None, :], sigmas, None, step_nT(mag_nT))
    forms = found.coefficients_nT.T / SCALE_nT + np.repeat([1.0, 0.0, 1.0, 0.0, 1.0, 0.0], [1, 2, 1, 1, 1, 4])
    slopes = [slope_of_form(m, form[:9]) / (typical / SCALE_nT)[:, None] for form in forms]
    steep = np.array([np.sqrt(np.mean(np.sum(slope**2, axis=1))) for slope in slopes])
    return replace(found, misfit_nT=found.misfit_nT / np.maximum(steep, FLAT))


def slope_of_form(m: FloatArray, form: FloatArray) -> FloatArray:
    """(n, k) gradient at m (n, k) of a form with k (k + 3) / 2 coefficients: those of m_i m_j with i <= j, then of m_i.

    What is left of a form, over its slope, is to first order the distance of m from where nothing is left (Sampson 1982,
    Computer Graphics and Image Processing 18, 97).
    """
    width = m.shape[1]
    matrix = np.zeros((width, width))
    matrix[np.triu_indices(width)] = form[:-width]
    return np.asarray(m @ (matrix + matrix.T) + form[-width:])


def step_nT(mag_nT: FloatArray) -> float:
    """The step in which readings (n, 3) come: the smallest difference of two; 0 where it is finer than 0.01 nT."""
    steps = np.diff(np.sort(mag_nT, axis=0), axis=0)
    steps = steps[steps > 1e-6]
    least = float(steps.min()) if steps.size else 0.0
    return least if least > 0.01 else 0.0


def compare(
    seconds: FloatArray,
    design: FloatArray,
    rhs: FloatArray,
    sigmas_nT: FloatArray,
    lever: FloatArray | None,
    least_step_nT: float,
) -> Evidence:
    """The evidence of right-hand sides (n, d, K) under regressors (n, d, c) with prior `sigmas_nT` (c,).

    lever: (n, 3), the field across which a turn of the attitude acts, for d = 3. least_step_nT: of the readings; its
    rounding is a white error at the least, which no mean over rows takes away where the reading moves slowly.
    """
    from scipy.linalg import cholesky, solve_triangular

    n, d, count = rhs.shape
    scales = _SCALES_nT[_SCALES_nT >= max(MODEL_nT, least_step_nT / np.sqrt(12.0))]
    squared = scales[:, None] ** 2
    X = (design * sigmas_nT).reshape(n * d, -1)
    Y = rhs.reshape(n * d, count)
    both = np.asfortranarray(np.hstack([X, Y]))  # as LAPACK wants it
    best = np.full(count, -np.inf)
    misfit, coefficients = np.zeros(count), np.zeros((X.shape[1], count))
    for number, covariance in enumerate(_covariances(seconds, lever, n, d)):
        # Its transpose, which is the same, has the order that LAPACK wants.
        factor = cholesky(covariance.T, lower=True, overwrite_a=True, check_finite=False)
        whitened = solve_triangular(factor, both, lower=True, check_finite=False)
        Xw, Yw = whitened[:, : X.shape[1]], whitened[:, X.shape[1] :]
        # The normal equations in the axes where the prior is one and the design is diagonal.
        weights, axes = np.linalg.eigh(Xw.T @ Xw)
        weights, cross = np.maximum(weights, 0.0), axes.T @ (Xw.T @ Yw)
        squares = np.sum(Yw**2, axis=0)
        left = squares - np.einsum("ck,sc->sk", cross**2, 1.0 / (weights + squared))  # at each scale, S and b fitted
        size = len(X) * np.log(squared[:, 0]) + np.sum(np.log1p(weights / squared), axis=1)
        log = -0.5 * (size[:, None] + left / squared) - np.sum(np.log(np.diag(factor)))
        if number == 0:
            shrunk = cross / (weights[:, None] + scales[np.argmax(log, axis=0)] ** 2)
            rest = squares - np.sum(shrunk * (2.0 * cross - weights[:, None] * shrunk), axis=0)
            misfit = np.sqrt(np.maximum(rest, 0.0) / (n * d))
            coefficients = sigmas_nT[:, None] * (axes @ shrunk)
        best = np.maximum(best, log.max(axis=0))
    return Evidence(best, misfit, coefficients)


def _covariances(seconds: FloatArray, lever: FloatArray | None, n: int, d: int) -> Iterator[FloatArray]:
    """Shapes of the covariance of the errors, each an array of its own; the white one first."""
    yield np.eye(n * d)
    for memory in _MEMORIES_S:
        ou = np.exp(-np.abs(seconds[:, None] - seconds) / memory)
        slow = np.kron(ou, np.eye(d))
        sizes = _SLOW_SIZES if lever is None else _SLOW
        slower = [np.eye(n * d) + size**2 * slow for size in sizes]
        if lever is None:
            yield from slower
            continue
        b = lever / np.sqrt(np.mean(np.sum(lever**2, axis=1)))
        turns = np.einsum("ij,kl->ikjl", b @ b.T, np.eye(3)) - np.einsum("jk,il->ikjl", b, b)
        turn = (turns * ou[:, None, :, None]).reshape(n * d, n * d)
        turned = [size**2 * turn for size in _TURNS]
        pairs = itertools.product(slower, turned)
        next(pairs)  # neither slow nor turned: the white one again
        yield from (errors + of_turns for errors, of_turns in pairs)
