"""Compiled recursions of the whitening filter: gains, whitening, and what each reading's neighbours predict.

The state x (3,) is the attitude error in units of its standard deviation theta, body axes; a reading carries
theta J x plus white noise of variance sigma**2 / weight per axis, J (3, 3) the image of a turn in that reading
(`row_axes.turn_images`). The step from one stamp to the next is
exact for a first-order Gauss-Markov process: x <- phi x, P <- phi**2 P + (1 - phi**2) I. Notation of Durbin &
Koopman (2012), Time Series Analysis by State Space Methods, sections 4.3 to 4.5.
"""

from __future__ import annotations

import numpy as np

from fluxtwin.sim.base.kernel_cache import kernel
from fluxtwin.sim.base.types import FloatArray

GAIN_COLUMNS = 16
"""Row of the gain table: phi, the upper triangle of S**-1/2 (xx xy xz yy yz zz), K row by row."""


@kernel(error_model="numpy")
def _product(A: FloatArray, B: FloatArray, out: FloatArray) -> None:
    """out = A B, all (3, 3). Loops: a library call costs more than these few numbers."""
    for i in range(3):
        for j in range(3):
            out[i, j] = A[i, 0] * B[0, j] + A[i, 1] * B[1, j] + A[i, 2] * B[2, j]


@kernel(error_model="numpy")
def _sandwich(A: FloatArray, B: FloatArray, work: FloatArray, out: FloatArray) -> None:
    """out = A B A', all (3, 3); `out` may be B."""
    _product(A, B, work)
    for i in range(3):
        for j in range(3):
            out[i, j] = work[i, 0] * A[j, 0] + work[i, 1] * A[j, 1] + work[i, 2] * A[j, 2]


@kernel(error_model="numpy")
def _eigen_symmetric(A: FloatArray, U: FloatArray) -> None:
    """Jacobi rotations: A (3, 3) becomes diagonal (its eigenvalues), U (3, 3) has the eigenvectors as columns."""
    for i in range(3):
        for j in range(3):
            U[i, j] = 1.0 if i == j else 0.0
    for _ in range(30):
        off = abs(A[0, 1]) + abs(A[0, 2]) + abs(A[1, 2])
        if off <= 1e-17 * (abs(A[0, 0]) + abs(A[1, 1]) + abs(A[2, 2])):
            break
        for p in range(2):
            for q in range(p + 1, 3):
                if A[p, q] == 0.0:
                    continue
                ratio = (A[q, q] - A[p, p]) / (2.0 * A[p, q])
                t = 1.0 / (abs(ratio) + np.sqrt(1.0 + ratio * ratio))
                if ratio < 0.0:
                    t = -t
                c = 1.0 / np.sqrt(1.0 + t * t)
                s = t * c
                for k in range(3):
                    one, two = A[k, p], A[k, q]
                    A[k, p], A[k, q] = c * one - s * two, s * one + c * two
                for k in range(3):
                    one, two = A[p, k], A[q, k]
                    A[p, k], A[q, k] = c * one - s * two, s * one + c * two
                for k in range(3):
                    one, two = U[k, p], U[k, q]
                    U[k, p], U[k, q] = c * one - s * two, s * one + c * two
                A[p, q] = 0.0
                A[q, p] = 0.0


@kernel(error_model="numpy")
def _update(J: FloatArray, weight: FloatArray, ratio: float, P: FloatArray, m: FloatArray) -> float:
    """One measurement, in units of sigma: makes P the updated covariance and fills m (8, 3, 3), m[0] = S**-1/2,
    m[1] = K, m[2] = S**-1, m[3] = H, m[4] = I - K H; the rest is scratch.

    A component of weight 0 is not measured: its rows and columns of S**-1/2 and S**-1 and its column of K are zero.
    Returns log det S over the measured components.
    """
    M, K, Si, H, A, S, U, work = m[0], m[1], m[2], m[3], m[4], m[5], m[6], m[7]
    for i in range(3):
        for j in range(3):
            H[i, j] = ratio * J[i, j]
    _sandwich(H, P, work, S)
    for i in range(3):
        for j in range(i):
            S[i, j] = S[j, i]
        S[i, i] += 1.0 / weight[i] if weight[i] > 0.0 else 0.0
    for i in range(3):
        if weight[i] <= 0.0:
            for j in range(3):
                S[i, j] = 0.0
                S[j, i] = 0.0
            S[i, i] = 1.0
    _eigen_symmetric(S, U)
    log_det = np.log(S[0, 0] * S[1, 1] * S[2, 2])
    s0, s1, s2 = 1.0 / S[0, 0], 1.0 / S[1, 1], 1.0 / S[2, 2]
    r0, r1, r2 = np.sqrt(s0), np.sqrt(s1), np.sqrt(s2)
    for i in range(3):
        for j in range(3):
            there = 1.0 if weight[i] > 0.0 and weight[j] > 0.0 else 0.0
            u0, u1, u2 = U[i, 0] * U[j, 0], U[i, 1] * U[j, 1], U[i, 2] * U[j, 2]
            M[i, j] = there * (r0 * u0 + r1 * u1 + r2 * u2)
            Si[i, j] = there * (s0 * u0 + s1 * u1 + s2 * u2)
    for i in range(3):
        for j in range(3):
            work[i, j] = P[i, 0] * H[j, 0] + P[i, 1] * H[j, 1] + P[i, 2] * H[j, 2]
    _product(work, Si, K)
    _product(K, H, A)
    for i in range(3):
        for j in range(3):
            A[i, j] = (1.0 if i == j else 0.0) - A[i, j]
    # Joseph's form: P stays positive where the attitude error is far above the white noise.
    _sandwich(A, P, work, P)
    for k in range(3):
        if weight[k] > 0.0:
            for i in range(3):
                for j in range(3):
                    P[i, j] += K[i, k] * K[j, k] / weight[k]
    return float(log_det)


@kernel(error_model="numpy", inline="always")
def _decay(seconds: FloatArray, segment: FloatArray, tau_s: float, t: int) -> float:
    """Share of the attitude error that is left since the row before; 0 at the start of a segment."""
    if t == 0 or tau_s <= 0.0 or segment[t] != segment[t - 1]:
        return 0.0
    return float(np.exp(-(seconds[t] - seconds[t - 1]) / tau_s))


@kernel(error_model="numpy")
def fill_gains(
    image_nT: FloatArray,
    seconds: FloatArray,
    segment: FloatArray,
    weights: FloatArray,
    ratio: float,
    tau_s: float,
    gains: FloatArray,
) -> float:
    """Fill `gains` (N, 16) in units of sigma; returns log det of the covariance in those units.

    image_nT (N, 3, 3); seconds, segment (N,); weights (N, 3), 0 for a component that is not measured; ratio
    theta / sigma [rad/nT].
    """
    P, m = np.eye(3), np.empty((8, 3, 3))
    M, K = m[0], m[1]
    log_det = 0.0
    for t in range(image_nT.shape[0]):
        phi = _decay(seconds, segment, tau_s, t)
        _forecast(phi, P)
        log_det += _update(image_nT[t], weights[t], ratio, P, m)
        row = gains[t]
        row[0] = phi
        row[1], row[2], row[3], row[4], row[5], row[6] = M[0, 0], M[0, 1], M[0, 2], M[1, 1], M[1, 2], M[2, 2]
        for i in range(3):
            for j in range(3):
                row[7 + 3 * i + j] = K[i, j]
    return log_det


@kernel(error_model="numpy")
def _forecast(phi: float, P: FloatArray) -> None:
    """P from just after one row to just before the next."""
    for i in range(3):
        for j in range(3):
            P[i, j] *= phi * phi
        P[i, i] += 1.0 - phi * phi


@kernel(fastmath={"contract"}, error_model="numpy")
def whiten(
    image_nT: FloatArray,
    gains: FloatArray,
    sigma_nT: float,
    ratio: float,
    state: FloatArray,
    columns: FloatArray,
    out: FloatArray,
) -> None:
    """Whiten `columns` (n, 3, P) into `out` (may be the same array); `state` (3, P) is carried from call to call."""
    scale = 1.0 / sigma_nT
    for t in range(columns.shape[0]):
        g = gains[t]
        phi = g[0]
        J = image_nT[t]
        h0, h1, h2 = ratio * J[0, 0], ratio * J[0, 1], ratio * J[0, 2]
        h3, h4, h5 = ratio * J[1, 0], ratio * J[1, 1], ratio * J[1, 2]
        h6, h7, h8 = ratio * J[2, 0], ratio * J[2, 1], ratio * J[2, 2]
        for p in range(columns.shape[2]):
            x, y, z = phi * state[0, p], phi * state[1, p], phi * state[2, p]
            ex = scale * columns[t, 0, p] - (h0 * x + h1 * y + h2 * z)
            ey = scale * columns[t, 1, p] - (h3 * x + h4 * y + h5 * z)
            ez = scale * columns[t, 2, p] - (h6 * x + h7 * y + h8 * z)
            state[0, p] = x + g[7] * ex + g[8] * ey + g[9] * ez
            state[1, p] = y + g[10] * ex + g[11] * ey + g[12] * ez
            state[2, p] = z + g[13] * ex + g[14] * ey + g[15] * ez
            out[t, 0, p] = g[1] * ex + g[2] * ey + g[3] * ez
            out[t, 1, p] = g[2] * ex + g[4] * ey + g[5] * ez
            out[t, 2, p] = g[3] * ex + g[5] * ey + g[6] * ez


@kernel(error_model="numpy")
def predict_each(
    image_nT: FloatArray,
    seconds: FloatArray,
    segment: FloatArray,
    weights: FloatArray,
    own: FloatArray,
    ratio: float,
    tau_s: float,
    residual: FloatArray,
    out: FloatArray,
    plain: FloatArray,
) -> None:
    """Fill `plain` (N, 3): each component less what all others predict for it; `out`: over its standard deviation.

    residual (N, 3) in units of sigma; weights (N, 3) as in `fill_gains` decide what predicts; own (N, 3): weights
    the components themselves would have if measured. Leave-one-out residuals from the disturbance smoother
    (de Jong & Penzer 1998, doi 10.1080/01621459.1998.10473714); where a component is not measured, from the
    smoothed state.
    """
    rows = image_nT.shape[0]
    P, m = np.eye(3), np.empty((8, 3, 3))
    K, Si, H = m[1], m[2], m[3]
    a, e, u = np.zeros(3), np.zeros(3), np.zeros(3)
    kept = np.empty((rows, 16))  # phi, state and S**-1 innovation, P before each row, for the way back
    for t in range(rows):
        phi = _decay(seconds, segment, tau_s, t)
        _forecast(phi, P)
        row = kept[t]
        row[0] = phi
        for i in range(3):
            a[i] *= phi
            row[1 + i] = a[i]
            for j in range(3):
                row[7 + 3 * i + j] = P[i, j]
        _update(image_nT[t], weights[t], ratio, P, m)
        for i in range(3):
            seen = residual[t, i] if weights[t, i] > 0.0 else 0.0
            e[i] = seen - (H[i, 0] * a[0] + H[i, 1] * a[1] + H[i, 2] * a[2])
        _times(Si, e, u)
        for i in range(3):
            row[4 + i] = u[i]
            a[i] += K[i, 0] * e[0] + K[i, 1] * e[1] + K[i, 2] * e[2]
    _backward(image_nT, weights, own, ratio, residual, kept, out, plain)


@kernel(error_model="numpy")
def _times(A: FloatArray, v: FloatArray, out: FloatArray) -> None:
    """out = A v, (3, 3) and (3,)."""
    for i in range(3):
        out[i] = A[i, 0] * v[0] + A[i, 1] * v[1] + A[i, 2] * v[2]


@kernel(error_model="numpy")
def _backward(
    image_nT: FloatArray,
    weights: FloatArray,
    own: FloatArray,
    ratio: float,
    residual: FloatArray,
    kept: FloatArray,
    out: FloatArray,
    plain: FloatArray,
) -> None:
    """The way back of `predict_each`: r and N carry what the later rows say, as score and as information."""
    r, u, x, lead = np.zeros(3), np.zeros(3), np.zeros(3), np.zeros(3)
    N, P, before, m = np.zeros((3, 3)), np.empty((3, 3)), np.empty((3, 3)), np.empty((8, 3, 3))
    D, V, work = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3))
    K, Si, H, A = m[1], m[2], m[3], m[4]
    for t in range(image_nT.shape[0] - 1, -1, -1):
        row = kept[t]
        for i in range(3):
            for j in range(3):
                P[i, j] = row[7 + 3 * i + j]
                before[i, j] = P[i, j]
        _update(image_nT[t], weights[t], ratio, P, m)
        _sandwich(K.T, N, work, D)
        for i in range(3):
            u[i] = row[4 + i] - (K[0, i] * r[0] + K[1, i] * r[1] + K[2, i] * r[2])
            for j in range(3):
                D[i, j] += Si[i, j]
        for i in range(3):
            r[i] += H[0, i] * u[0] + H[1, i] * u[1] + H[2, i] * u[2]
        _sandwich(A.T, N, work, N)
        _sandwich(H.T, Si, work, V)
        for i in range(3):
            for j in range(3):
                N[i, j] += V[i, j]
        _times(before, r, lead)
        for i in range(3):
            x[i] = row[1 + i] + lead[i]
        _sandwich(before, N, work, V)
        for i in range(3):
            for j in range(3):
                V[i, j] = before[i, j] - V[i, j]
        _times(H, x, lead)
        _sandwich(H, V, work, V)
        for i in range(3):
            noise = 1.0 / own[t, i]
            if weights[t, i] > 0.0 and D[i, i] > 0.0:
                variance = 1.0 / D[i, i] - 1.0 / weights[t, i] + noise
                plain[t, i] = u[i] / D[i, i]
            else:
                variance = noise + max(V[i, i], 0.0)
                plain[t, i] = residual[t, i] - lead[i]
            out[t, i] = plain[t, i] / np.sqrt(variance)
        phi = row[0]
        for i in range(3):
            r[i] *= phi
            for j in range(3):
                N[i, j] *= phi * phi
