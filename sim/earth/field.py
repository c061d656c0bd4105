"""The geomagnetic field at given epochs and positions.

Frames as in `frames`: E Earth-fixed, N GCRS; NEC local geocentric north, east, centre. Positions in km, field
in nT, epochs datetime64[ns] UTC: one per position in any order, or one for all. Time convention and validity:
`field_models`; formulas: `field_kernels`.

Epochs that differ from sample to sample cost less than one synthesis for each power of time in the knot interval (two
for IGRF: K0 + tau K1), whatever the number of samples; nothing of size samples x coefficients is ever made.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from scipy.spatial.transform import Rotation

from fluxtwin.sim.base.errors import BadInput, OutOfRange
from fluxtwin.sim.base.processes import stop_if_asked
from fluxtwin.sim.base.types import FloatArray, TimeArray
from fluxtwin.sim.earth import epoch, frames
from fluxtwin.sim.earth.constants import FIELD_RADIUS_KM
from fluxtwin.sim.earth.field_models import FieldModel, load_field

LOWEST_RADIUS_KM = 3485.0
"""Core-mantle boundary: below it the field has sources and the series means nothing."""
_Rows = slice | np.ndarray
__all__ = [
    "FieldModel",
    "design_matrix_E",
    "field_E_nT",
    "field_NEC_nT",
    "field_N_nT",
    "field_beyond_E_nT",
    "field_gradient_E_nT_km",
    "load_field",
]


def field_E_nT(model: FieldModel, time: TimeArray | np.datetime64, r_E_km: FloatArray) -> FloatArray:
    """Field in Earth-fixed Cartesian components, shape (N, 3), at positions (N, 3).

    time: (N,) or one epoch. Raises OutOfRange for an epoch outside the model or a position below 3485 km,
    BadInput for positions that are not finite and for shapes that do not fit.
    """
    from fluxtwin.sim.earth.field_kernels import fold

    r, stamps = _checked(time, r_E_km)
    b_E_nT = np.zeros_like(r)
    for rows, powers_nT, tau in _terms(model, stamps):
        _add(r, rows, [fold(coefficients_nT) for coefficients_nT in powers_nT], tau, b_E_nT)
    return b_E_nT


def field_beyond_E_nT(model: FieldModel, time: TimeArray, r_E_km: FloatArray) -> FloatArray:
    """`field_E_nT`, and outside the model's validity the change of its outermost year carried on; (N, 3).

    For a model that is linear between knots, such as IGRF, that is the straight line of the outermost interval.
    """
    first, last, year = model.valid_from, model.valid_to, epoch.years(1.0)
    field_nT = field_E_nT(model, np.clip(time, first, last), r_E_km)
    for outside, edge, inner in (
        (time > last, last, max(last - year, first)),
        (time < first, first, min(first + year, last)),
    ):
        if outside.any():
            there = r_E_km[outside]
            change = field_E_nT(model, edge, there) - field_E_nT(model, inner, there)
            share = (time[outside] - edge) / (edge - inner)
            field_nT[outside] += share[:, None] * change
    return field_nT


def field_N_nT(
    model: FieldModel, time: TimeArray | np.datetime64, r_N_km: FloatArray, R_EN: Rotation | None = None
) -> FloatArray:
    """Field in GCRS components, shape (N, 3), at GCRS positions (N, 3).

    R_EN: GCRS to Earth-fixed at the same epochs, if it is at hand. Raises as `field_E_nT`.
    """
    r, stamps = _checked(time, r_N_km)
    turn = frames.rotation_EN(stamps) if R_EN is None else R_EN
    return np.asarray(turn.inv().apply(field_E_nT(model, stamps, turn.apply(r))))


def field_NEC_nT(model: FieldModel, time: TimeArray | np.datetime64, r_E_km: FloatArray) -> FloatArray:
    """Field in local geocentric north, east, centre components, shape (N, 3). Raises as `field_E_nT`.

    At a pole there is no north: the components are those at longitude 0, so that east is the y axis of E.
    """
    b_E_nT = field_E_nT(model, time, r_E_km)
    return np.asarray(frames.rotation_NEC_E(r_E_km).apply(b_E_nT))


def field_gradient_E_nT_km(model: FieldModel, time: TimeArray | np.datetime64, r_E_km: FloatArray) -> FloatArray:
    """Gradient of the field, shape (N, 3, 3): element [i, j] is dB_i/dr_j in nT/km, both Earth-fixed.

    Exact, by folding the coefficients twice (no differences). Symmetric and traceless. Raises as
    `field_E_nT`.
    """
    from fluxtwin.sim.earth.field_kernels import fold_gradient

    r, stamps = _checked(time, r_E_km)
    gradient = np.zeros((3, r.shape[0], 3))
    for rows, powers_nT, tau in _terms(model, stamps):
        tables = [fold_gradient(coefficients_nT) for coefficients_nT in powers_nT]
        for i in range(3):
            _add(r, rows, [table[i] for table in tables], tau, gradient[i])
    return np.ascontiguousarray(gradient.transpose(1, 0, 2))


def design_matrix_E(degree: int, r_E_km: FloatArray) -> FloatArray:
    """A, shape (N, 3, K), with A @ coefficients_nT the field in Earth-fixed components: `field_E_nT`'s twin.

    Column g of (n, m) is -a grad[(a/r)**(n + 1) P_n^m(sin latitude) cos(m longitude)] with Schmidt's P;
    column h is the same with the sine: the sum of `field_kernels`, coefficient by coefficient, in plain numpy.
    K = degree (degree + 2), in the order of `field_models`. Raises as `field_E_nT` for positions.
    """
    from fluxtwin.sim.earth.field_kernels import schmidt_factors

    r = _positions(r_E_km)
    design = np.empty((r.shape[0], 3, degree * (degree + 2)))
    harmonics = _harmonics(degree + 1, r)  # A + i B, [degree, order]
    for n in range(1, degree + 1):
        factors = (2 * n + 1) * schmidt_factors(n)
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


def _terms(model: FieldModel, stamps: TimeArray) -> Iterator[tuple[_Rows, FloatArray, FloatArray]]:
    """Rows, coefficients (J, K) of the powers of tau, and tau (n,): the field is their sum."""
    if stamps.size and (stamps[0] == stamps[-1]) and (stamps == stamps[0]).all():
        yield slice(None), model.coefficients_nT(stamps[:1]), np.zeros(1)
        return
    piece, tau = model.pieces(stamps)
    present = np.flatnonzero(np.bincount(piece))
    for p in present:
        rows = slice(None) if present.size == 1 else np.flatnonzero(piece == p)
        powers_nT = np.zeros((model.polynomial_nT.shape[1], model.static_nT.size))
        powers_nT[0] = model.static_nT
        powers_nT[:, : model.polynomial_nT.shape[2]] += model.polynomial_nT[p]
        yield rows, powers_nT, tau[rows]


def _add(r_km: FloatArray, rows: _Rows, tables: list[FloatArray], tau: FloatArray, out: FloatArray) -> None:
    """Add the fields of folded tables, one a power of tau, to the rows of `out`; two at a time where they are alike."""
    from fluxtwin.sim.earth.field_kernels import synthesize

    there = isinstance(rows, slice)
    r, part = (r_km, out) if there else (r_km[rows], np.zeros((tau.size, 3)))
    power = 0
    while power < len(tables):
        weight = tau**power if power else np.ones(1)
        two = tables[power : power + 2]
        if len(two) == 2 and two[0].shape == two[1].shape:
            synthesize(r, two[0], two[1], tau, weight, part)
            power += 2
        else:
            synthesize(r, two[0], None, None, weight, part)
            power += 1
    if not there:
        out[rows] += part


def _checked(time: TimeArray | np.datetime64, r_km: FloatArray) -> tuple[FloatArray, TimeArray]:
    stop_if_asked()  # every verb that takes long comes through here, often
    r, stamps = _positions(r_km), epoch.as_times(time)
    if stamps.ndim != 1 or stamps.size not in (1, r.shape[0]):
        raise BadInput(
            f"epochs of shape {stamps.shape} for {r.shape[0]} positions",
            where="field",
            wanted="one epoch, or one for each position",
        )
    return r, stamps


def _positions(r_km: FloatArray) -> FloatArray:
    # writeable as well: numba would compile once more for a read-only array
    r = np.require(np.atleast_2d(np.asarray(r_km)), np.float64, ["C", "W"])
    if r.ndim != 2 or r.shape[1] != 3:
        raise BadInput(f"shape {np.shape(r_km)}", where="positions", wanted="(N, 3) in km")
    from fluxtwin.sim.earth.field_kernels import first_outside

    row = first_outside(r, LOWEST_RADIUS_KM)
    if row >= 0 and not np.isfinite(r[row]).all():
        raise BadInput(f"row {row + 1} is not finite: {r[row]}", where="positions", wanted="numbers in km")
    if row >= 0:
        wanted = f"{LOWEST_RADIUS_KM:g} km or more"
        if not r[row].any():
            wanted += "; where a position is missing, a blank (in a column map: invalid = [0])"
        raise OutOfRange(
            f"row {row + 1} lies {np.linalg.norm(r[row]):.6g} km from the centre of the Earth",
            where="positions",
            wanted=wanted,
        )
    return r
