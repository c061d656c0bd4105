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

from fluxtwin.sim.base.kernel_cache import kernel
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
    order, degree = np.triu_indices(terms.shape[1])
    k, m = degree.astype(np.float64), order.astype(np.float64)
    table = np.empty((order.size, 7))
    table[:, 0] = (k**2 - m**2) / (4.0 * k**2 - 1.0)
    table[:, 1:] = terms[:, degree, order].T
    return table


def _gauss_normalised(coefficients_nT: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Factors c, d of the Gauss-normalised harmonics, indexed [degree, order], from Schmidt's g and h."""
    used = np.flatnonzero(coefficients_nT)
    n_max = int(np.sqrt(used[-1] + 1)) if used.size else 1
    degree, order, factor = _layout(n_max)
    g = degree**2 - 1 + np.maximum(2 * order - 1, 0)
    c, d = np.zeros((2, n_max + 1, n_max + 1))
    c[degree, order] = factor * coefficients_nT[g]
    tesseral = order > 0
    d[degree[tesseral], order[tesseral]] = factor[tesseral] * coefficients_nT[g[tesseral] + 1]
    return c, d


@lru_cache(maxsize=64)
def _layout(n_max: int) -> tuple[np.ndarray, np.ndarray, FloatArray]:
    """Degree, order and Schmidt over Gauss factor of each (n, m), n = 1..n_max, m = 0..n."""
    degree = np.repeat(np.arange(1, n_max + 1), np.arange(2, n_max + 2))
    order = np.concatenate([np.arange(n + 1) for n in range(1, n_max + 1)])
    return degree, order, np.concatenate([_schmidt_factors(n) for n in range(1, n_max + 1)])


def _schmidt_factors(n: int) -> FloatArray:
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


@kernel(uses=[constants], fastmath=_FAST, error_model="numpy", nogil=True)
def synthesize(r_km: FloatArray, table: FloatArray, weight: FloatArray, out: FloatArray) -> None:
    """Add weight times the field of the folded table to `out` (N, 3), at positions (N, 3).

    weight: (N,), or (1,) for all. Sixty-four points are worked on together, so that their state (17 numbers
    each) stays in the first-level cache and the compiler finds vectors; two or three degrees are done in one
    pass over it. The offsets are literal because only then is it plain that reads and writes do not overlap.
    """
    top = int(np.sqrt(2.0 * table.shape[0])) - 1
    count = r_km.shape[0]
    raw = np.empty(17 * 64 + 8)
    state = raw[(64 - raw.ctypes.data % 64) // 8 :]  # on a cache line
    for start in range(0, count, 64):
        _begin(r_km, start, state)
        row = 0
        for m in range(top + 1):
            end = row + top + 1 - m
            row = _begin_order(table, row, end, state)
            while row < end:
                _three_degrees(table, row, state)
                row += 3
            _end_order(state)
        last = weight.shape[0] - 1
        for i in range(min(64, count - start)):
            j = start + i
            size = weight[min(j, last)]
            out[j, 0] += size * state[i + 384]
            out[j, 1] += size * state[i + 448]
            out[j, 2] += size * state[i + 512]


# State of a block: u 0, v 64, w 128, q 192, A 256, B 320 (of k = m), field 384 448 512,
# p of the two degrees before 576 640, sums over k of the six factors times p 704 768 832 896 960 1024.


@kernel(uses=[constants], fastmath=_FAST, error_model="numpy")
def _begin(r_km: FloatArray, start: int, state: FloatArray) -> None:
    last = r_km.shape[0] - 1
    for i in range(64):
        j = min(start + i, last)  # a short last block repeats its last point
        x, y, z = r_km[j, 0], r_km[j, 1], r_km[j, 2]
        s = FIELD_RADIUS_KM / (x * x + y * y + z * z)
        state[i] = x * s
        state[i + 64] = y * s
        state[i + 128] = z * s
        state[i + 192] = FIELD_RADIUS_KM * s
        state[i + 256] = np.sqrt(FIELD_RADIUS_KM * s)
        state[i + 320] = 0.0
        state[i + 384] = 0.0
        state[i + 448] = 0.0
        state[i + 512] = 0.0


@kernel(fastmath=_FAST, error_model="numpy")
def _begin_order(table: FloatArray, row: int, end: int, state: FloatArray) -> int:
    """Do the first degrees of an order, so many that a multiple of three is left; the next row."""
    left = end - row
    if left == 1:
        _first_degree(table, row, state)
        return row + 1
    if left % 3 == 0:
        _first_three_degrees(table, row, state)
        return row + 3
    _first_two_degrees(table, row, state)
    if left % 3 == 2:
        return row + 2
    _two_degrees(table, row + 2, state)
    return row + 4


@kernel(fastmath=_FAST, error_model="numpy")
def _first_degree(table: FloatArray, row: int, state: FloatArray) -> None:
    _, xa, xb, ya, yb, za, zb = _factors(table, row)
    for i in range(64):
        state[i + 704] = xa
        state[i + 768] = xb
        state[i + 832] = ya
        state[i + 896] = yb
        state[i + 960] = za
        state[i + 1024] = zb


@kernel(fastmath=_FAST, error_model="numpy")
def _first_two_degrees(table: FloatArray, row: int, state: FloatArray) -> None:
    _, xa0, xb0, ya0, yb0, za0, zb0 = _factors(table, row)
    beta1, xa1, xb1, ya1, yb1, za1, zb1 = _factors(table, row + 1)
    for i in range(64):
        p1 = state[i + 128]  # p of k = m is 1, of the next degree w
        state[i + 576] = p1
        state[i + 640] = p1 * p1 - beta1 * state[i + 192]
        state[i + 704] = xa0 + xa1 * p1
        state[i + 768] = xb0 + xb1 * p1
        state[i + 832] = ya0 + ya1 * p1
        state[i + 896] = yb0 + yb1 * p1
        state[i + 960] = za0 + za1 * p1
        state[i + 1024] = zb0 + zb1 * p1


@kernel(fastmath=_FAST, error_model="numpy")
def _first_three_degrees(table: FloatArray, row: int, state: FloatArray) -> None:
    _, xa0, xb0, ya0, yb0, za0, zb0 = _factors(table, row)
    beta1, xa1, xb1, ya1, yb1, za1, zb1 = _factors(table, row + 1)
    beta2, xa2, xb2, ya2, yb2, za2, zb2 = _factors(table, row + 2)
    for i in range(64):
        p1 = state[i + 128]
        q = state[i + 192]
        p2 = p1 * p1 - beta1 * q
        state[i + 576] = p2
        state[i + 640] = p1 * p2 - beta2 * q * p1
        state[i + 704] = xa0 + xa1 * p1 + xa2 * p2
        state[i + 768] = xb0 + xb1 * p1 + xb2 * p2
        state[i + 832] = ya0 + ya1 * p1 + ya2 * p2
        state[i + 896] = yb0 + yb1 * p1 + yb2 * p2
        state[i + 960] = za0 + za1 * p1 + za2 * p2
        state[i + 1024] = zb0 + zb1 * p1 + zb2 * p2


@kernel(fastmath=_FAST, error_model="numpy")
def _three_degrees(table: FloatArray, row: int, state: FloatArray) -> None:
    beta0, xa0, xb0, ya0, yb0, za0, zb0 = _factors(table, row)
    beta1, xa1, xb1, ya1, yb1, za1, zb1 = _factors(table, row + 1)
    beta2, xa2, xb2, ya2, yb2, za2, zb2 = _factors(table, row + 2)
    for i in range(64):
        w = state[i + 128]
        q = state[i + 192]
        p0 = state[i + 640]
        p1 = w * p0 - beta0 * q * state[i + 576]
        p2 = w * p1 - beta1 * q * p0
        state[i + 576] = p2
        state[i + 640] = w * p2 - beta2 * q * p1
        state[i + 704] = state[i + 704] + xa0 * p0 + xa1 * p1 + xa2 * p2
        state[i + 768] = state[i + 768] + xb0 * p0 + xb1 * p1 + xb2 * p2
        state[i + 832] = state[i + 832] + ya0 * p0 + ya1 * p1 + ya2 * p2
        state[i + 896] = state[i + 896] + yb0 * p0 + yb1 * p1 + yb2 * p2
        state[i + 960] = state[i + 960] + za0 * p0 + za1 * p1 + za2 * p2
        state[i + 1024] = state[i + 1024] + zb0 * p0 + zb1 * p1 + zb2 * p2


@kernel(fastmath=_FAST, error_model="numpy")
def _two_degrees(table: FloatArray, row: int, state: FloatArray) -> None:
    beta0, xa0, xb0, ya0, yb0, za0, zb0 = _factors(table, row)
    beta1, xa1, xb1, ya1, yb1, za1, zb1 = _factors(table, row + 1)
    for i in range(64):
        w = state[i + 128]
        q = state[i + 192]
        p0 = state[i + 640]
        p1 = w * p0 - beta0 * q * state[i + 576]
        state[i + 576] = p1
        state[i + 640] = w * p1 - beta1 * q * p0
        state[i + 704] = state[i + 704] + xa0 * p0 + xa1 * p1
        state[i + 768] = state[i + 768] + xb0 * p0 + xb1 * p1
        state[i + 832] = state[i + 832] + ya0 * p0 + ya1 * p1
        state[i + 896] = state[i + 896] + yb0 * p0 + yb1 * p1
        state[i + 960] = state[i + 960] + za0 * p0 + za1 * p1
        state[i + 1024] = state[i + 1024] + zb0 * p0 + zb1 * p1


@kernel(fastmath=_FAST, error_model="numpy")
def _factors(table: FloatArray, row: int) -> tuple[float, float, float, float, float, float, float]:
    return (
        table[row, 0],
        table[row, 1],
        table[row, 2],
        table[row, 3],
        table[row, 4],
        table[row, 5],
        table[row, 6],
    )


@kernel(fastmath=_FAST, error_model="numpy")
def _end_order(state: FloatArray) -> None:
    for i in range(64):
        u, v, a, b = state[i], state[i + 64], state[i + 256], state[i + 320]
        state[i + 384] = state[i + 384] + state[i + 704] * a + state[i + 768] * b
        state[i + 448] = state[i + 448] + state[i + 832] * a + state[i + 896] * b
        state[i + 512] = state[i + 512] + state[i + 960] * a + state[i + 1024] * b
        state[i + 256] = u * a - v * b
        state[i + 320] = u * b + v * a
