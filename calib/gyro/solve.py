"""The least squares behind `calibrate_gyro`: S, b and the gyro's bias, with the field of every stretch eliminated.

In a stretch the field, in the axes of its first row, is a polynomial P(t) a of time, whatever it is; R_k turns it into body
axes. A reading m, with M = I + S and c = -b, then fulfils

    M m_k - c - R_k P_k a = noise

which is linear in S, c and a, and in the fields of columns d of telemetry: M (m_k - s d_k) in the place of M m_k, with M s
for s; a bias of the gyro turns R_k by Psi_k bias. For a field that does not change it is the
integral of dB/dt + w x (B - b) = 0 (Troni and Whitcomb, Field sensor bias calibration with angular-rate sensors, IEEE/ASME
Transactions on Mechatronics 24, 2019), without the noise of a derivative. S and the gyro's bias beside b are found as in
Rodriguez-Martinez and Troni (full magnetometer and gyroscope bias estimation using angular rates, IEEE Journal of Oceanic
Engineering, 2025). The common factor of M, c and a cannot be seen: the trace of S is zero.

Errors are correlated within a stretch, because the gyro's noise adds up there, and start anew in the next: a white error of
each rate turns the field in all rows after it. Its size is found by restricted likelihood beside that of the reading's. The
errors themselves are found with the parameters, and R_k follows the rates without them: with the measured rates the columns
of S, of the bias and of the field would not cancel where they do in truth, and seem to tell of S what they do not. The
covariance is that of these two, widened where the stretches scatter by more (`shrinkage`), with their leverage allowed for
(CR2: Bell and McCaffrey 2002, Survey Methodology 28, 169).

How the body turned, from the gyro: rotations within a stretch, and what a bias of the gyro does to them.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.linalg import solve_triangular
from scipy.optimize import minimize_scalar
from scipy.spatial.transform import Rotation

from fluxtwin.calib.common.conventions import of_S
from fluxtwin.calib.common.design import of_turns
from fluxtwin.calib.common.drivers import drops_of
from fluxtwin.calib.common.records import seconds_of
from fluxtwin.calib.common.shrinkage import SURE, widening
from fluxtwin.sim.base.errors import NoAnswer
from fluxtwin.sim.base.types import FloatArray, TimeArray

_ROUNDS = 6  # of Gauss-Newton: the gyro's noise is found in the middle of them
_LEAST_WEIGHT = 1e-6
_RATIOS = np.geomspace(1e-4, 1e4, 9)  # variance of the turn in a step over that of a reading, in parts of the field
_FOR_RATIO = 30
"""Stretches, evenly spread, that it is found in: of 30 rows each they tell a variance to 3 %, and more only take time."""
_MOST_SHARE = 0.9  # of the information, that one stretch may have
_FEWEST_BLOCKS = 12


def _basis_of_S() -> FloatArray:
    """(9, 8) from trace-free parameters to S row by row."""
    basis = np.zeros((9, 8))
    for k, at in enumerate((1, 2, 3, 5, 6, 7)):
        basis[at, k] = 1.0
    basis[[0, 4], 6] = np.array([1.0, -1.0]) / np.sqrt(2.0)
    basis[[0, 4, 8], 7] = np.array([1.0, 1.0, -2.0]) / np.sqrt(6.0)
    return basis


BASIS_S = _basis_of_S()


class GyroRows(NamedTuple):
    """What is solved for: N rows of readings and rates, cut into stretches, with J columns that a field follows."""

    time: TimeArray
    reading_nT: FloatArray
    """(N, 3)."""
    rate_B_rad_s: FloatArray
    """(N, 3)."""
    cuts: Sequence[np.ndarray]
    """Rows of each stretch."""
    length_s: float
    """Of a stretch."""
    columns: FloatArray
    """(N, J)."""
    with_S: bool

    @property
    def in_stretches(self) -> np.ndarray:
        """(n,) rows that belong to a stretch."""
        return np.concatenate(self.cuts)

    @property
    def scale_nT(self) -> float:
        """The unit of readings here, their rms."""
        return float(np.sqrt((self.reading_nT**2).sum(axis=1).mean()))

    def followed(self, bias_rad_s: FloatArray, errors_rad_s: FloatArray) -> list[Stretch]:
        """The stretches, by the rates without a bias (3,) and errors (N, 3)."""
        degree = degree_for(self.length_s)
        return [follow(self.time, self.rate_B_rad_s - bias_rad_s, errors_rad_s, one, degree) for one in self.cuts]


class Solved(NamedTuple):
    """The answer for one cut into stretches."""

    S: FloatArray
    """(3, 3), of trace zero."""
    b_nT: FloatArray
    """(3,)."""
    fields_nT: FloatArray
    """(J, 3) in the reading, per unit of each column."""
    bias_rad_s: FloatArray
    """(3,) of the gyro."""
    covariance: FloatArray
    """(12, 12) of S row by row and b."""
    fields_covariance: FloatArray
    """(3 J, 3 J), column by column."""
    bias_sigma_rad_s: FloatArray
    """(3,)."""
    residual_nT: FloatArray
    """(n, 3) field minus calibrated reading, body axes."""
    deleted: FloatArray
    """(n, 3) standardized deletion residual: the reading minus what all others predict, in units of its sigma."""
    variance_nT2: float
    """Of the reading, white."""
    gyro_noise_rad_s: float
    """Of one rate, white from row to row."""
    errors_rad_s: FloatArray
    """(N, 3) of each rate, found; zero in rows of no stretch."""


class Cleared(NamedTuple):
    """One stretch, whitened and cleared of its own field."""

    G: FloatArray
    """(3 n, p) derivatives by S, the fields of columns, c and the gyro's bias."""
    y: FloatArray
    """(3 n,) readings, or (3 n, t)."""
    weight: FloatArray
    """(n, 3, 3) information of each row about an error of its own reading."""
    log_determinant: float
    """Of the whitening and of the field's columns, for the likelihood."""
    back: FloatArray
    """(3 n, 3 n) from whitened residuals to scores, the inverse of their covariance times residuals."""
    to_errors: FloatArray
    """(3 n, 3 n) from scores to errors of the rates."""

    def scores(self, theta: FloatArray) -> FloatArray:
        """(3 n,) of the readings, for parameters (p,)."""
        return np.asarray(self.back @ (self.y - self.G @ theta))


def solve(rows: GyroRows, weights: FloatArray, *, start: Solved | None = None, corrected: bool = True) -> Solved:
    """Gauss-Newton over the gyro's bias and the errors of its rates; all else is linear. Their size is found by restricted
    likelihood.

    weights: (N,) of the rows, 1 at the most. start: a solution with other weights, of which one step is made. corrected:
    for noise in the regressors; not before outliers have lost their weight. Raises NoAnswer where a combination of the
    parameters is moved by noise alone.
    """
    scale, with_S = rows.scale_nT, rows.with_S
    m = rows.reading_nT / scale
    bias, S, c, u = np.zeros(3), np.zeros((3, 3)), np.zeros(3), np.zeros((rows.columns.shape[1], 3))
    errors = np.zeros((len(m), 3))
    rms = np.sqrt((rows.columns**2).mean(axis=0))
    d = rows.columns / rms
    variance = 0.0 if start is None else start.variance_nT2 / scale**2
    ratio = 0.0 if start is None else start.gyro_noise_rad_s**2 * scale**2 / start.variance_nT2
    if start is not None:
        bias, S, c, errors = start.bias_rad_s, start.S, -start.b_nT / scale, start.errors_rad_s.copy()
        u = (start.fields_nT * rms[:, None] / scale) @ (np.eye(3) + S).T
    free = 8 if with_S else 0
    size = free + u.size + 6
    of_fields = 3.0 * (degree_for(rows.length_s) + 1) * len(rows.cuts)
    freedom = max(1.0, 3.0 * float(weights[rows.in_stretches].sum()) - of_fields - size)
    for turn in range(_ROUNDS if start is None else 1):
        stretches = rows.followed(bias, errors)
        true = m + m @ S.T - c - d @ u
        if start is None and turn == _ROUNDS // 2:
            some = stretches[:: -(-len(stretches) // _FOR_RATIO)]
            ratio = _ratio(some, m, true, d, weights, freedom * len(some) / len(stretches), with_S=with_S)
        parts = [_cleared(_uncleared(one, m, true, d, weights, with_S=with_S), ratio) for one in stretches]
        theta, normal = _least_squares(parts, variance if corrected and with_S else 0.0)
        variance = sum(float(((one.y - one.G @ theta) ** 2).sum()) for one in parts) / freedom
        S = (BASIS_S @ theta[:free]).reshape(3, 3) if with_S else S
        u = theta[free:-6].reshape(-1, 3)
        c, bias = theta[-6:-3], bias + theta[-3:]
        for one, part in zip(stretches, parts, strict=True):
            errors[one.rows] = (part.to_errors @ part.scores(theta)).reshape(-1, 3)
    covariance = _covariance(parts, theta, normal, variance)
    back = np.zeros((12, size))
    if with_S:
        back[:9, :8] = BASIS_S
    back[9:, -6:-3] = -scale * np.eye(3)
    inverse = np.linalg.inv(np.eye(3) + S)
    s = u @ inverse.T
    of_columns = np.zeros((u.size, size))  # M s = u
    of_columns[:, free:-6] = np.kron(np.eye(len(u)), inverse)
    if with_S:
        of_columns[:, :8] = -(inverse @ of_S(s) @ BASIS_S).reshape(-1, 8)
    of_columns *= np.repeat(scale / rms, 3)[:, None]
    bare_nT = rows.reading_nT - d @ s * scale
    return Solved(
        S=S,
        b_nT=-c * scale,
        fields_nT=s * (scale / rms)[:, None],
        bias_rad_s=bias,
        covariance=back @ covariance @ back.T,
        fields_covariance=of_columns @ covariance @ of_columns.T,
        bias_sigma_rad_s=np.sqrt(np.diag(covariance)[-3:]),
        residual_nT=np.vstack([_residual(one, bare_nT, S, c * scale, weights) for one in stretches]),
        deleted=np.vstack([_deleted(one, part, theta, weights) for one, part in zip(stretches, parts, strict=True)])
        / np.sqrt(variance),
        variance_nT2=variance * scale**2,
        gyro_noise_rad_s=float(np.sqrt(ratio * variance)),
        errors_rad_s=errors,
    )


def _least_squares(parts: Sequence[Cleared], variance: float) -> tuple[FloatArray, FloatArray]:
    """The parameters and the normal matrix, corrected for noise in the regressors.

    The reading stands on both sides. With D the sum of the rows' `weight`, noise of `variance` adds
    variance D (x) 1 to the information about S, and -variance D to its score: taken off.
    """
    normal = np.sum([one.G.T @ one.G for one in parts], axis=0)
    right = np.sum([one.G.T @ one.y for one in parts], axis=0)
    if variance > 0.0:
        D = variance * np.sum([one.weight.sum(axis=0) for one in parts], axis=0)
        normal[:8, :8] -= BASIS_S.T @ np.kron(D, np.eye(3)) @ BASIS_S
        right[:8] += BASIS_S.T @ D.reshape(9)
    return np.linalg.lstsq(normal, right, rcond=1e-14)[0], np.asarray(normal)


def _ratio(
    stretches: Sequence[Stretch],
    m: FloatArray,
    true: FloatArray,
    d: FloatArray,
    weights: FloatArray,
    freedom: float,
    *,
    with_S: bool,
) -> float:
    """Variance of a rate [rad^2/s^2] over that of a reading in parts of the field, of the greatest restricted likelihood."""

    uncleared = [_uncleared(one, m, true, d, weights, with_S=with_S) for one in stretches]

    def minus_log(log_ratio: float) -> float:
        parts = [_cleared(one, float(np.exp(log_ratio)), scored=False) for one in uncleared]
        theta, normal = _least_squares(parts, 0.0)
        left = sum(float(((one.y - one.G @ theta) ** 2).sum()) for one in parts)
        logs = sum(one.log_determinant for one in parts)
        return 0.5 * (logs + float(np.linalg.slogdet(normal)[1]) + freedom * float(np.log(left)))

    step_s = float(np.median(np.concatenate([one.steps_s.sum(axis=1) for one in stretches])))
    grid = np.log(_RATIOS / step_s**2)
    values = [minus_log(x) for x in grid]
    at = int(np.argmin(values))
    if at in (0, len(grid) - 1):
        return float(np.exp(grid[at]))
    found = minimize_scalar(minus_log, bracket=tuple(grid[at - 1 : at + 2]), tol=0.02)
    return float(np.exp(found.x))


class _Uncleared(NamedTuple):
    """One stretch before its noises are known."""

    whole: FloatArray
    """(3 n, q + p + t) derivatives by the field, by the parameters, and what is fitted."""
    fields: int
    """q."""
    fitted: int
    """t."""
    of_noise: FloatArray
    """(3 n, 3 n) of unit errors of each rate."""
    of_turns: FloatArray
    """(3 n, 3 n) covariance of what errors of each rate do, for unit variance."""
    of_readings: FloatArray
    """(3 n, 3 n) of the readings, likewise."""


def _uncleared(
    one: Stretch,
    m: FloatArray,
    true: FloatArray,
    d: FloatArray,
    weights: FloatArray,
    *,
    with_S: bool,
    fitted: FloatArray | None = None,
) -> _Uncleared:
    """The stretch's rows for its field, S, fields of columns d (N, J), c and a change of the gyro's bias, and the reading,
    or what is `fitted` (N, 3, t) in its place."""
    n, here, B = len(one.rows), m[one.rows], true[one.rows]
    columns = []
    if with_S:
        columns.append(-of_S(here).reshape(n * 3, 9) @ BASIS_S)
    columns += [np.kron(part[:, None], np.eye(3)) for part in (*d[one.rows].T, np.ones(n))]
    # R turns by (I + [Psi d]x) for a bias larger by d: the field by (Psi d) x B = -[B]x Psi d
    cross = np.ascontiguousarray(-of_turns(B))
    columns.append(-(cross @ one.turned).reshape(n * 3, 3))
    field = np.einsum("nij,np->nipj", one.R, one.basis).reshape(n * 3, -1)
    of_noise = _of_gyro_noise(one, cross)
    reading = here.reshape(3 * n, 1) if fitted is None else fitted[one.rows].reshape(3 * n, -1)
    whole = np.hstack([field, *columns, reading - of_noise @ one.errors_rad_s.reshape(3 * n, 1)])
    of_readings = np.diag(np.repeat(1.0 / np.maximum(weights[one.rows], _LEAST_WEIGHT), 3))
    return _Uncleared(whole, field.shape[1], reading.shape[1], of_noise, of_noise @ of_noise.T, of_readings)


def _cleared(one: _Uncleared, ratio: float, *, scored: bool = True) -> Cleared:
    """Whitened and cleared of its own field. scored: whether scores, errors or weights of its rows are wanted."""
    half = np.linalg.cholesky(one.of_readings + ratio * one.of_turns)
    white = solve_triangular(half, one.whole, lower=True)
    q, at = one.fields, one.whole.shape[1] - one.fields - one.fitted
    Q, triangle = np.linalg.qr(white[:, :q])
    rest = white[:, q:] - Q @ (Q.T @ white[:, q:])
    log = 2.0 * float(np.log(np.diag(half)).sum() + np.log(np.abs(np.diag(triangle))).sum())
    weight = back = to_errors = np.zeros((0, 0, 0))
    if scored:
        size = len(half)
        down = solve_triangular(half, np.eye(size), lower=True)
        back = (down - Q @ (Q.T @ down)).T
        weight = np.einsum("kia,kja->kij", *[back.reshape(-1, 3, size)] * 2)
        to_errors = -ratio * one.of_noise.T
    y = rest[:, at] if one.fitted == 1 else rest[:, at:]
    return Cleared(rest[:, :at], y, weight, log, back, to_errors)


def _of_gyro_noise(one: Stretch, cross: FloatArray) -> FloatArray:
    """(3 n, 3 n) of unit errors of each rate: in the steps near it, they turn the field in all later rows."""
    n = len(one.rows)
    later = np.tril(np.ones((n, n)), -1)[:, :-1]
    R = np.einsum("kij,lmj->klim", one.R, one.R[1:])  # from body axes after a step to those at k
    steps = np.einsum("kij,kljm,kl->kiml", cross, R, later, optimize=True)
    return np.ascontiguousarray((steps @ one.steps_s).swapaxes(2, 3)).reshape(3 * n, 3 * n)


def fields_without_errors(rows: GyroRows, weights: FloatArray) -> FloatArray:
    """(n, 3) field in body axes at the rows of the stretches, if S and b were zero."""
    none, m = np.zeros((3, 3)), rows.reading_nT
    stretches = rows.followed(none[0], np.zeros_like(m))
    return np.vstack([m[one.rows] + _residual(one, m, none, none[0], weights) for one in stretches])


def drops(
    rows: GyroRows, solved: Solved, fixed: FloatArray, tried: FloatArray, far_nT: FloatArray, beyond: FloatArray
) -> FloatArray:
    """(c,) by how much each of `tried` (N, c) lowers chi-square beside all else and `fixed` (N, k); see `drivers.Drops`.

    solved: the answer of `solve`; far_nT: (n, 3, t) and beyond: (t,) of `drivers.drawn_in` in the rows of its stretches.
    """
    scale, with_S = rows.scale_nT, bool(solved.S.any())
    M, d = np.eye(3) + solved.S, np.hstack([fixed, tried])
    true = ((rows.reading_nT - rows.columns @ solved.fields_nT) @ M.T + solved.b_nT) / scale
    y = np.repeat(rows.reading_nT[:, :, None] / scale, len(beyond), axis=2)
    y[rows.in_stretches] -= far_nT / scale
    ratio = (solved.gyro_noise_rad_s * scale) ** 2 / solved.variance_nT2
    whole, at = np.ones(len(y)), (8 if with_S else 0) + 3 * fixed.shape[1]
    gram = np.zeros((at + 6 + 3 * tried.shape[1] + len(beyond),) * 2)
    for one in rows.followed(solved.bias_rad_s, solved.errors_rad_s):
        clear = _cleared(_uncleared(one, y[..., 0], true, d, whole, with_S=with_S, fitted=y), ratio, scored=False)
        seen = np.column_stack([clear.G[:, :at], clear.G[:, -6:], clear.G[:, at:-6], clear.y])
        gram += seen.T @ seen
    return drops_of(gram * scale**2 / solved.variance_nT2, at + 6, beyond)


def _residual(one: Stretch, reading_nT: FloatArray, S: FloatArray, c: FloatArray, weights: FloatArray) -> FloatArray:
    """(n, 3) R P a - (M m - c)."""
    here = reading_nT[one.rows]
    calibrated = (here + here @ S.T - c).reshape(-1)
    root = np.repeat(np.sqrt(np.maximum(weights[one.rows], 1e-12)), 3)
    columns = np.einsum("nij,np->nipj", one.R, one.basis).reshape(len(one.rows) * 3, -1)
    Q = np.linalg.qr(columns * root[:, None])[0]
    return np.asarray((Q @ (Q.T @ (calibrated * root)) / root - calibrated).reshape(-1, 3))


def _deleted(one: Stretch, part: Cleared, theta: FloatArray, weights: FloatArray) -> FloatArray:
    """(n, 3) of readings and what the others in the stretch predict, over the root of the covariance, for unit variance."""
    scores = part.scores(theta).reshape(-1, 3)
    value, vector = np.linalg.eigh(np.linalg.inv(part.weight))
    # as if the row had its whole weight; its own noise is one
    value = np.maximum(value - 1.0 / np.maximum(weights[one.rows], _LEAST_WEIGHT)[:, None] + 1.0, 1.0)
    off = np.linalg.solve(part.weight, scores[:, :, None])[:, :, 0]
    return np.asarray(np.einsum("kij,kj,klj,kl->ki", vector, value**-0.5, vector, off))


def _covariance(parts: Sequence[Cleared], theta: FloatArray, normal: FloatArray, variance: float) -> FloatArray:
    """That of the two noises; wider where stretches, or pairs of them, scatter by more than chance."""
    values = np.linalg.eigvalsh(normal)
    if not values[0] > len(values) * np.finfo(np.float64).eps * values[-1]:  # none is left of it but rounding
        raise NoAnswer(
            "S is not determined: the body turned too little, or about too few axes, and nothing but noise moves a "
            "combination of S, b and the gyro's bias. Use --parameters b, or a longer record",
        )
    down = np.linalg.inv(np.linalg.cholesky(normal))
    moved = np.empty((len(parts), len(theta)))
    for k, one in enumerate(parts):
        half = one.G @ down.T
        share, vector = np.linalg.eigh(half.T @ half)
        freed = vector / np.sqrt(1.0 - np.clip(share, 0.0, _MOST_SHARE))
        moved[k] = freed @ (vector.T @ (down @ (one.G.T @ (one.y - one.G @ theta))))
    # in units in which the covariance of the two noises is one
    by_ones = (moved - moved.mean(axis=0)) * np.sqrt(len(moved) / variance)
    by_pairs = by_ones[: len(moved) // 2 * 2].reshape(-1, 2, len(theta)).sum(axis=1) / np.sqrt(2.0)
    W = np.eye(len(theta))
    for h in (by_ones, by_pairs):
        if len(h) >= _FEWEST_BLOCKS and float((h**2).mean()) > 1.0 + SURE * np.sqrt(2.0 / h.size):
            wider = widening(h)
            W = wider if np.trace(wider) > np.trace(W) else W
    return np.asarray(variance * down.T @ W @ down)


LARGEST_TURN_RAD = 1.0
"""Between two rows: a faster turn is not followed by its rates at the two ends."""
_FIELD_NT = 40_000.0
_ORBIT_RAD_S = 0.0023  # of the field of a dipole: twice the rate of a low orbit
_REMAINDER_NT = 2.0
_DEGREES = 6


class Stretch(NamedTuple):
    """Rows over which the gyro is integrated."""

    rows: np.ndarray
    """(n,) indices."""
    R: FloatArray
    """(n, 3, 3) from body axes at the first row to those at each."""
    turned: FloatArray
    """(n, 3, 3) integral of R_k R_s' ds [s]: turned @ bias is the angle by which R_k is off, in body axes at k."""
    basis: FloatArray
    """(n, J) polynomials in time for the field in the axes of the first row."""
    steps_s: FloatArray
    """(n - 1, n) integral over each step of a rate that is 1 at one row."""
    errors_rad_s: FloatArray
    """(n, 3) that were taken off the rates."""


def cut(time: TimeArray, rate_B_rad_s: FloatArray, length_s: float) -> list[np.ndarray]:
    """Rows of each stretch of about `length_s`, without gaps and without turns that cannot be followed."""
    seconds = seconds_of(time)
    step = np.diff(seconds)
    usual = float(np.median(step)) if step.size else 1.0
    speed = np.linalg.norm(rate_B_rad_s, axis=1)
    turn = 0.5 * (speed[1:] + speed[:-1]) * step
    broken = np.flatnonzero((step > 3.0 * usual) | (turn > LARGEST_TURN_RAD)) + 1
    found = []
    for run in np.split(np.arange(len(seconds)), broken):
        pieces = max(1, round((seconds[run[-1]] - seconds[run[0]]) / length_s))
        found += list(np.array_split(run, pieces))
    fewest = degree_for(length_s) + 3  # rows: the polynomial takes one of every three numbers
    return [rows for rows in found if len(rows) >= fewest]


def degree_for(length_s: float) -> int:
    """The least degree of a polynomial that a field along a low orbit leaves by no more than 2 nT in a stretch.

    With x = rate length / 2 the remainder of a Chebyshev series of degree J is x^(J+1) / (2^J (J+1)!).
    """
    x, remainder = 0.5 * _ORBIT_RAD_S * length_s, _FIELD_NT
    for degree in range(_DEGREES + 1):
        remainder *= x / (degree + 1) / (1.0 if degree == 0 else 2.0)
        if degree and remainder < _REMAINDER_NT:
            return degree
    return _DEGREES


def follow(
    time: TimeArray, rate_B_rad_s: FloatArray, errors_rad_s: FloatArray, rows: np.ndarray, degree: int
) -> Stretch:
    """One stretch integrated: over a step with rates w1 and w2 the turn is the integral of a cubic spline through the rates,
    + (w1 x w2) dt^2 / 12.

    That is the Magnus series to fourth order, for the rotation from body axes to body axes (Iserles and Norsett 1999).
    """
    seconds = seconds_of(time[rows])
    rate, dt = rate_B_rad_s[rows] - errors_rad_s[rows], np.diff(seconds)
    steps_s = np.diff(CubicSpline(seconds, np.eye(len(rows))).antiderivative()(seconds), axis=0)
    turn = steps_s @ rate + np.cross(rate[:-1], rate[1:]) * (dt**2 / 12.0)[:, None]
    forward = Rotation.from_rotvec(-turn).as_matrix()
    half = Rotation.from_rotvec(-0.5 * turn).as_matrix()
    R, turned = np.empty((len(rows), 3, 3)), np.zeros((len(rows), 3, 3))
    R[0] = np.eye(3)
    for k in range(len(dt)):
        R[k + 1] = forward[k] @ R[k]
        turned[k + 1] = forward[k] @ turned[k] + half[k] * dt[k]
    x = 2.0 * seconds / max(seconds[-1], 1e-9) - 1.0
    return Stretch(rows, R, turned, np.polynomial.chebyshev.chebvander(x, degree), steps_s, errors_rad_s[rows])
