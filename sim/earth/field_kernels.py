"""Synthesis of the field from spherical harmonics: the numba kernel and the table it reads.

Cunningham's formulation (Cunningham 1970, doi 10.1007/BF01229495; Montenbruck & Gill 2000, section 3.2) in
the Gauss normalisation. With the position x, y, z [km], r its length and a the reference radius, put
u = a x / r**2, v = a y / r**2, w = a z / r**2, q = a**2 / r**2. Solid harmonics of degree k and order m are

    A + i B = p_km (a / r) (u + i v)**m,    p_mm = 1,
    p_(k+1)m = w p_km - beta_km q p_(k-1)m,    beta_km = (k**2 - m**2) / (4 k**2 - 1).

The gradient of a harmonic of degree n is a sum of harmonics of degree n + 1, so g and h fold, once per
epoch, into six numbers for each (k, m). No trigonometry, no division by cos(latitude): a pole is a point
like others.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from fluxtwin.sim.base import lanes
from fluxtwin.sim.base.kernel_cache import kernel, part
from fluxtwin.sim.base.lanes import LANES, every, fused, load, store
from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.earth import constants
from fluxtwin.sim.earth.constants import FIELD_RADIUS_KM

_FAST = {"contract"}  # fused multiply-add: one rounding instead of two, nothing is reordered

_REMEMBERED_SIZE = 1000
"""Tables of so many coefficients are remembered: to degree 30, 36 kB each."""


def fold(coefficients_nT: FloatArray) -> FloatArray:
    """Table of the field, for `synthesize`, from Gauss coefficients (K,). Shape (rows, 7).

    Row by row: m = 0..top, and within it k = m..top, with top = degree + 1; each row holds beta and the
    factors of A and B in B_x, B_y and B_z. The degrees above the last non-zero coefficient are left out.
    """
    if coefficients_nT.size > _REMEMBERED_SIZE:
        return _table(_gradient(*_gauss_normalised(coefficients_nT)))
    return _folded(np.asarray(coefficients_nT, dtype=np.float64).tobytes())


@lru_cache(maxsize=64)
def _folded(coefficients_nT: bytes) -> FloatArray:
    """A trend has few sets of coefficients, and is asked for at many times; nobody writes into the table."""
    return _table(_gradient(*_gauss_normalised(np.frombuffer(coefficients_nT))))


def fold_gradient(coefficients_nT: FloatArray) -> list[FloatArray]:
    """Tables of the gradients of B_x, B_y and B_z [nT/km], each as in `fold`, with top = degree + 2."""
    x_a, x_b, y_a, y_b, z_a, z_b = _gradient(*_gauss_normalised(coefficients_nT))
    tables = []
    for c, d in ((x_a, x_b), (y_a, y_b), (z_a, z_b)):
        tables.append(_table(_gradient(c, d) / -FIELD_RADIUS_KM))
    return tables


def _gradient(c: FloatArray, d: FloatArray) -> FloatArray:
    """Terms of -a grad(sum c A + d B), shape (6, n + 1, n + 1): [xA xB yA yB zA zB][degree, order].

    c, d: factors of the Gauss-normalised harmonics A, B, shape (n, n), indexed [degree, order].
    """
    size = c.shape[0]
    scale = 2.0 * np.arange(size)[:, None] + 1.0
    c, d = scale * c, scale * d
    terms = np.zeros((6, size + 1, size + 1))
    x_a, x_b, y_a, y_b, z_a, z_b = terms[:, 1:, :]  # one degree up
    z_a[:, :-1], z_b[:, :-1] = c, d
    x_a[:, 1], y_b[:, 1] = c[:, 0], c[:, 0]
    for first, sign in ((2, 0.5), (0, -0.5)):  # order m feeds orders m + 1 and m - 1
        orders = slice(first, first + size - 1)
        x_a[:, orders] += sign * c[:, 1:]
        x_b[:, orders] += sign * d[:, 1:]
        y_a[:, orders] -= 0.5 * d[:, 1:]
        y_b[:, orders] += 0.5 * c[:, 1:]
    return terms


def _table(terms: FloatArray) -> FloatArray:
    degree, order, beta = _rows(terms.shape[1])
    table = np.empty((order.size, 7))
    table[:, 0] = beta
    table[:, 1:] = terms[:, degree, order].T
    return table


@lru_cache(maxsize=64)
def _rows(size: int) -> tuple[np.ndarray, np.ndarray, FloatArray]:
    """Degree, order and beta of the rows of a table of so many degrees."""
    order, degree = np.triu_indices(size)
    k, m = degree.astype(np.float64), order.astype(np.float64)
    return degree, order, (k**2 - m**2) / (4.0 * k**2 - 1.0)


def _gauss_normalised(coefficients_nT: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Factors c, d of the Gauss-normalised harmonics, indexed [degree, order], from Schmidt's g and h."""
    used = np.flatnonzero(coefficients_nT)
    n_max = int(np.sqrt(used[-1] + 1)) if used.size else 1
    place, factor = _layout(n_max)
    both = np.zeros((2, n_max + 1, n_max + 1))
    both.ravel()[place] = factor * coefficients_nT[: place.size]
    return both[0], both[1]


@lru_cache(maxsize=64)
def _layout(n_max: int) -> tuple[np.ndarray, FloatArray]:
    """Place in [g or h, degree, order], flat, and Schmidt over Gauss factor of each coefficient to degree n_max."""
    degree = np.repeat(np.arange(1, n_max + 1), 2 * np.arange(1, n_max + 1) + 1)
    within = np.arange(1, degree.size + 1) - degree**2
    order, is_h = (within + 1) // 2, (within > 0) & (within % 2 == 0)
    factor = np.concatenate([schmidt_factors(n) for n in range(1, n_max + 1)])[degree * (degree + 1) // 2 - 1 + order]
    return np.ravel_multi_index((is_h.astype(int), degree, order), (2, n_max + 1, n_max + 1)), factor


def schmidt_factors(n: int) -> FloatArray:
    """Schmidt semi-normalised over Gauss-normalised functions of degree n, orders 0..n. Shape (n + 1,).

    (2n - 1)!! / (n - m)! sqrt((2 - delta_m0) (n - m)! / (n + m)!), as products without large factorials.
    """
    j = np.arange(1.0, n + 1.0)
    zonal = np.prod((2.0 * j - 1.0) / j)
    ratio = (n - j + 1.0) / (n + j)
    ratio[0] *= 2.0
    factors: FloatArray = zonal * np.sqrt(np.concatenate([[1.0], np.cumprod(ratio)]))
    return factors


@kernel(error_model="numpy")
def first_outside(r_km: FloatArray, lowest_km: float) -> int:
    """First row of positions (N, 3) that is nearer than `lowest_km` to the origin or not finite; or -1."""
    for i in range(r_km.shape[0]):
        x, y, z = r_km[i, 0], r_km[i, 1], r_km[i, 2]
        squared = x * x + y * y + z * z
        if not (lowest_km * lowest_km <= squared < np.inf):
            return i
    return -1


@kernel(uses=[constants, lanes], fastmath=_FAST, error_model="numpy", nogil=True)
def synthesize(
    r_km: FloatArray,
    table: FloatArray,
    trend: FloatArray | None,
    tau: FloatArray | None,
    weight: FloatArray,
    out: FloatArray,
) -> None:
    """Add weight times the field of the folded table + tau trend to `out` (N, 3), at positions (N, 3).

    trend: a table as long as the other, and tau (N,); or None and None. weight: (N,), or (1,) for all. Sixty-four points are
    made ready together, then summed over all harmonics in as many lanes as the machine has, without leaving its registers.
    """
    count = r_km.shape[0]
    last = weight.shape[0] - 1
    state = np.empty(9 * 64)
    for start in range(0, count, 64):
        here = min(64, count - start)
        _begin(r_km, tau, start, state)
        for first in range(0, here, LANES):
            _add_up(table, trend, state, first)
        for i in range(here):
            j = start + i
            size = weight[min(j, last)]
            out[j, 0] += size * state[i + 384]
            out[j, 1] += size * state[i + 448]
            out[j, 2] += size * state[i + 512]


# State of a block: u 0, v 64, w 128, -q 192, a / r 256, tau 320, field 384 448 512.


@part(fastmath=_FAST, error_model="numpy")
def _begin(r_km: FloatArray, tau: FloatArray | None, start: int, state: FloatArray) -> None:
    last = r_km.shape[0] - 1
    for i in range(64):
        j = min(start + i, last)  # a short last block repeats its last point
        x, y, z = r_km[j, 0], r_km[j, 1], r_km[j, 2]
        s = FIELD_RADIUS_KM / (x * x + y * y + z * z)
        state[i] = x * s
        state[i + 64] = y * s
        state[i + 128] = z * s
        state[i + 192] = -FIELD_RADIUS_KM * s
        state[i + 256] = np.sqrt(FIELD_RADIUS_KM * s)
        state[i + 320] = 0.0
        if tau is not None:
            state[i + 320] = tau[j]


@part(error_model="numpy")
def _add_up(table: FloatArray, trend: FloatArray | None, state: FloatArray, first: int) -> None:
    """The field of LANES points of the block, from `first` on."""
    top = int(np.sqrt(2.0 * table.shape[0])) - 1
    u, v, w = load(state, first), load(state, first + 64), load(state, first + 128)
    minus_q, A, tau = load(state, first + 192), load(state, first + 256), load(state, first + 320)
    nothing = every(0.0)
    B, x, y, z = nothing, nothing, nothing, nothing
    row = 0
    for m in range(top + 1):
        xa, xb = _factor(table, trend, tau, row, 1), _factor(table, trend, tau, row, 2)
        ya, yb = _factor(table, trend, tau, row, 3), _factor(table, trend, tau, row, 4)
        za, zb = _factor(table, trend, tau, row, 5), _factor(table, trend, tau, row, 6)
        before, p = every(1.0), w  # p of k = m is 1, of the next degree w
        for _ in range(m, top):
            row += 1
            xa = fused(_factor(table, trend, tau, row, 1), p, xa)
            xb = fused(_factor(table, trend, tau, row, 2), p, xb)
            ya = fused(_factor(table, trend, tau, row, 3), p, ya)
            yb = fused(_factor(table, trend, tau, row, 4), p, yb)
            za = fused(_factor(table, trend, tau, row, 5), p, za)
            zb = fused(_factor(table, trend, tau, row, 6), p, zb)
            before, p = p, fused(w, p, every(table[row, 0]) * minus_q * before)
        row += 1
        x = fused(xa, A, fused(xb, B, x))
        y = fused(ya, A, fused(yb, B, y))
        z = fused(za, A, fused(zb, B, z))
        A, B = fused(u, A, every(-1.0) * v * B), fused(u, B, v * A)
    store(state, first + 384, x)
    store(state, first + 448, y)
    store(state, first + 512, z)


@part(error_model="numpy")
def _factor(table: FloatArray, trend: FloatArray | None, tau: FloatArray, row: int, column: int) -> FloatArray:
    """A number of the table for each point, at its own time where there is a trend."""
    if trend is None:
        return every(table[row, column])
    return fused(every(trend[row, column]), tau, every(table[row, column]))
