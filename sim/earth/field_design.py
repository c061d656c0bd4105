"""The design matrix of the field: the sum of `field_kernels`, coefficient by coefficient, in plain numpy."""

from __future__ import annotations

import numpy as np

from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.earth.constants import FIELD_RADIUS_KM


def design_matrix(degree: int, r_E_km: FloatArray) -> FloatArray:
    """A of shape (N, 3, K): A @ coefficients is the field [nT] at positions (N, 3) [km].

    Column g of (n, m) is -a grad[(a/r)**(n + 1) P_n^m(sin latitude) cos(m longitude)] with Schmidt's P;
    column h is the same with the sine.
    """
    design = np.empty((r_E_km.shape[0], 3, degree * (degree + 2)))
    harmonics = _harmonics(degree + 1, r_E_km)  # A + i B, [degree, order]
    for n in range(1, degree + 1):
        factors = (2 * n + 1) * np.array(_schmidt_factors(n))
        above = harmonics[n + 1]
        for m, factor in enumerate(factors):
            column = n * n - 1 + max(2 * m - 1, 0)
            if m == 0:
                design[:, 0, column] = factor * above[1].real
                design[:, 1, column] = factor * above[1].imag
                design[:, 2, column] = factor * above[0].real
                continue
            gain, loss = 0.5 * factor * above[m + 1], 0.5 * factor * above[m - 1]
            design[:, 0, column], design[:, 0, column + 1] = (gain - loss).real, (gain - loss).imag
            design[:, 1, column], design[:, 1, column + 1] = (gain + loss).imag, -(gain + loss).real
            design[:, 2, column], design[:, 2, column + 1] = factor * above[m].real, factor * above[m].imag
    return design


def _harmonics(top: int, r_E_km: FloatArray) -> list[list[np.ndarray]]:
    """Gauss-normalised solid harmonics A + i B, each (N,), as [degree][order], degrees 0..top."""
    x, y, z = r_E_km.T
    s = FIELD_RADIUS_KM / (x * x + y * y + z * z)
    w, q = z * s, FIELD_RADIUS_KM * s
    sectoral = [np.sqrt(q) + 0j]
    for _ in range(top):
        sectoral.append(sectoral[-1] * (x + 1j * y) * s)
    rows: list[list[np.ndarray]] = []
    for k in range(top + 1):
        row = []
        for m in range(k):
            beta = ((k - 1) ** 2 - m**2) / (4 * (k - 1) ** 2 - 1)
            before = rows[k - 2][m] if m < k - 1 else 0.0
            row.append(w * rows[k - 1][m] - beta * q * before)
        rows.append([*row, sectoral[k]])
    return rows


def _schmidt_factors(n: int) -> list[float]:
    """Schmidt semi-normalised over Gauss-normalised functions of degree n, orders 0..n.

    (2n - 1)!! / (n - m)! sqrt((2 - delta_m0) (n - m)! / (n + m)!), without large factorials.
    """
    factors = [float(np.prod([(2 * j - 1) / j for j in range(1, n + 1)]))]
    for m in range(1, n + 1):
        factors.append(factors[-1] * float(np.sqrt((n - m + 1) * (2 if m == 1 else 1) / (n + m))))
    return factors
