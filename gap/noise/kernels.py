"""Compiled recursions of the whitening filter: gains, whitening, and what each reading's neighbours predict.

The state x (n,) is the attitude error in units of its standard deviation, body axes, and after it, where there is one, a
bias that walks, in units of sigma; n is 3 or 6. A component of a reading, in units of sigma, is h x plus white noise of
variance 1 / weight. The step from one stamp to the next is exact for a first-order Gauss-Markov process and for a walk.
The three components of a row are taken one after the other, so that no matrix is inverted. Notation of Durbin & Koopman
(2012), Time Series Analysis by State Space Methods, sections 4.3 to 4.5 and 6.4.
"""

from __future__ import annotations

import numpy as np

from fluxtwin.sim.base.kernel_cache import kernel, part
from fluxtwin.sim.base.types import FloatArray


@part(error_model="numpy", inline="always")
def _inner(a: FloatArray, b: FloatArray) -> float:
    """a' b: a loop, as a library call costs more than these few numbers."""
    total = 0.0
    for k in range(b.size):
        total += a[k] * b[k]
    return total


@kernel(error_model="numpy")
def fill_gains(
    load: FloatArray,
    decay: FloatArray,
    step: FloatArray,
    weights: FloatArray,
    gains: FloatArray,
    covariance: FloatArray,
) -> float:
    """Fill `gains` (N, 3, n + 1); returns log det of the covariance of the measured components, in units of sigma**2.

    load (N, 3, n): h of each component; decay (N,): share of the attitude error that is left since the row before, 0 at
    the start of a segment; step (N,): variance that the walk gains since the row before; weights (N, 3), 0 for a
    component that is not measured. gains: what one sigma of a component's innovation adds to the state, and one over
    that sigma. covariance: (N, n, n) of the state before each row, or of no rows where it is not wanted.
    """
    n = load.shape[2]
    P, lead = np.zeros((n, n)), np.empty(n)
    log_det = 0.0
    for t in range(load.shape[0]):
        phi = decay[t]
        for i in range(n):
            for j in range(n):
                P[i, j] *= (phi if i < 3 else 1.0) * (phi if j < 3 else 1.0)
            P[i, i] += 1.0 - phi * phi if i < 3 else step[t]
        if covariance.shape[0]:
            covariance[t] = P
        det = 1.0
        for i in range(3):
            if weights[t, i] <= 0.0:
                for k in range(n + 1):
                    gains[t, i, k] = 0.0
                continue
            for k in range(n):
                lead[k] = _inner(P[k], load[t, i])
            variance = 1.0 / weights[t, i] + max(_inner(lead, load[t, i]), 0.0)
            det *= variance
            root = 1.0 / np.sqrt(variance)
            gains[t, i, n] = root
            for k in range(n):
                gains[t, i, k] = lead[k] * root
            for k in range(n):
                for j in range(n):
                    P[k, j] -= gains[t, i, k] * gains[t, i, j]
        log_det += np.log(det)
    return log_det


@kernel(error_model="numpy")
def fill_turns(load: FloatArray, gains: FloatArray, turns: FloatArray) -> None:
    """Fill `turns` (N, 3, 3): from innovations of components taken one after the other to the symmetric root of a row's
    covariance, whose axes are nearest the row's own. With L the lower triangular root this is the transpose of its
    orthogonal polar factor, by Newton's iteration, scaled by the determinant: nine steps are enough with the best scaling
    (Higham 1986, SIAM J. Sci. Stat. Comput. 7, 1160)."""
    n = load.shape[2]
    X, C = np.empty((3, 3)), np.empty((3, 3))
    for t in range(load.shape[0]):
        for i in range(3):
            for j in range(3):
                X[i, j] = 0.0
                if j < i and gains[t, i, n] > 0.0:
                    for k in range(n):
                        X[i, j] += load[t, i, k] * gains[t, j, k]
            X[i, i] = 1.0 / gains[t, i, n] if gains[t, i, n] > 0.0 else 1.0
        for _ in range(12):
            for i in range(3):
                a, b = (i + 1) % 3, (i + 2) % 3
                for j in range(3):
                    c, d = (j + 1) % 3, (j + 2) % 3
                    C[i, j] = X[a, c] * X[b, d] - X[a, d] * X[b, c]
            det = X[0, 0] * C[0, 0] + X[0, 1] * C[0, 1] + X[0, 2] * C[0, 2]
            scale = np.abs(det) ** (-1.0 / 3.0)
            change = 0.0
            for i in range(3):
                for j in range(3):
                    new = 0.5 * (scale * X[i, j] + C[i, j] / (scale * det))
                    change = max(change, abs(new - X[i, j]))
                    X[i, j] = new
            if change < 1e-15:
                break
        turns[t] = X


@kernel(fastmath={"contract"}, error_model="numpy")
def whiten(
    load: FloatArray,
    decay: FloatArray,
    gains: FloatArray,
    turns: FloatArray,
    scale: float,
    columns: FloatArray,
    out: FloatArray,
) -> None:
    """Whiten `columns` (N, 3, P), times a scale, into `out` (may be the same array); turns: as from `fill_turns`, or of no
    rows, which leaves the innovations of components taken one after the other."""
    n, width = load.shape[2], columns.shape[2]
    state, e = np.zeros((n, width)), np.empty((3, width))
    for t in range(columns.shape[0]):
        phi = decay[t]
        for k in range(3):
            for p in range(width):
                state[k, p] *= phi
        for i in range(3):
            root = gains[t, i, n]
            for p in range(width):
                e[i, p] = scale * columns[t, i, p]
            for k in range(n):
                h = load[t, i, k]
                for p in range(width):
                    e[i, p] -= h * state[k, p]
            for p in range(width):
                e[i, p] *= root
            for k in range(n):
                gain = gains[t, i, k]
                for p in range(width):
                    state[k, p] += gain * e[i, p]
        for i in range(3):
            if turns.shape[0]:
                a, b, c = turns[t, i, 0], turns[t, i, 1], turns[t, i, 2]
                for p in range(width):
                    out[t, i, p] = a * e[0, p] + b * e[1, p] + c * e[2, p]
            else:
                for p in range(width):
                    out[t, i, p] = e[i, p]


@kernel(error_model="numpy")
def predict_each(
    load: FloatArray,
    decay: FloatArray,
    gains: FloatArray,
    covariance: FloatArray,
    weights: FloatArray,
    own: FloatArray,
    residual: FloatArray,
    out: FloatArray,
    plain: FloatArray,
) -> None:
    """Fill `plain` (N, 3): each component less what all others predict for it; `out`: over its standard deviation.

    load, decay, gains, covariance, weights as in `fill_gains`; residual (N, 3) in units of sigma; own (N, 3): weights
    the components themselves would have if measured. Leave-one-out residuals from the disturbance smoother
    (de Jong & Penzer 1998, doi 10.1080/01621459.1998.10473714); where a component is not measured, from the
    smoothed state.
    """
    rows, n = load.shape[0], load.shape[2]
    x, r, N = np.zeros(n), np.zeros(n), np.zeros((n, n))
    lead, Ng = np.empty(n), np.empty(n)
    before, e = np.empty((rows, n)), np.zeros((rows, 3))
    for t in range(rows):
        for k in range(n):
            x[k] *= decay[t] if k < 3 else 1.0
            before[t, k] = x[k]
        for i in range(3):
            if weights[t, i] > 0.0:
                e[t, i] = gains[t, i, n] * (residual[t, i] - _inner(load[t, i], x))
                for k in range(n):
                    x[k] += gains[t, i, k] * e[t, i]
    for t in range(rows - 1, -1, -1):  # r and N carry what the later components say, as score and as information
        for i in range(2, -1, -1):
            if weights[t, i] > 0.0:
                h, gain, root = load[t, i], gains[t, i], gains[t, i, n]
                for k in range(n):
                    Ng[k] = _inner(gain, N[k])
                u = root * (e[t, i] - _inner(gain, r))
                D = root * root * (1.0 + _inner(gain, Ng))
                variance = 1.0 / D - 1.0 / weights[t, i] + 1.0 / own[t, i]
                plain[t, i] = u / D
                out[t, i] = plain[t, i] / np.sqrt(variance)
                for k in range(n):
                    r[k] += h[k] * u
                    for j in range(n):
                        N[k, j] += D * h[k] * h[j] - root * (h[k] * Ng[j] + Ng[k] * h[j])
        for i in range(3):
            if weights[t, i] <= 0.0:
                for k in range(n):
                    lead[k] = _inner(covariance[t, k], load[t, i])
                for k in range(n):
                    Ng[k] = _inner(N[k], lead)
                seen = _inner(lead, load[t, i]) - _inner(lead, Ng)
                plain[t, i] = residual[t, i] - _inner(load[t, i], before[t]) - _inner(lead, r)
                out[t, i] = plain[t, i] / np.sqrt(1.0 / own[t, i] + max(seen, 0.0))
        for k in range(n):
            r[k] *= decay[t] if k < 3 else 1.0
            for j in range(n):
                N[k, j] *= (decay[t] if k < 3 else 1.0) * (decay[t] if j < 3 else 1.0)
