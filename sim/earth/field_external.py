"""The magnetospheric field of a CHAOS model: what currents far outside add, and what they induce in the Earth.

Parametrisation of CHAOS (Olsen et al. 2014, doi 10.1093/gji/ggu033, section 3.2; Finlay et al. 2020, doi
10.1186/s40623-020-01252-9): to degree 2,

* near currents (the ring current) in solar magnetic coordinates SM: degree 1 follows the RC index plus an offset
  for each bin of days, degree 2 is constant;
* far currents in geocentric solar magnetospheric coordinates GSM: q10 and q20, constant.

SM has z along the northern dipole pole and the sun in the half-plane +x; GSM has x to the sun and the dipole in
the half-plane +z. The dipole is that of the model file.

What is constant in SM or GSM turns and nods once a day as the Earth feels it, and so induces currents: each degree
n of the external potential calls up an internal one, larger by the response

    Q_n(f) = n / (n + 1) * (c(f) / a) ** (2 n + 1),

c(f) the complex radius of the perfect conductor that would answer alike. The part that follows RC brings its own
induced part in the index.

A potential of degree 1 and 2 is a vector q and a symmetric traceless matrix Q, V = a (q.u + u.Q u), u = r/a: they
turn with the frame like any vector and matrix, so no spherical harmonics are needed.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from fluxtwin.sim.base.errors import BadInput, OutOfRange
from fluxtwin.sim.base.types import FloatArray, TimeArray
from fluxtwin.sim.earth import epoch, frames
from fluxtwin.sim.earth.constants import FIELD_RADIUS_KM
from fluxtwin.sim.earth.field_models import mat_variables, stamps_mjd2000
from fluxtwin.sim.earth.sun import sun_direction_N

RESPONSE_PER_DAY = np.array([1 / 365.25, 2 / 365.25, 1 / 30, 1 / 27, 1.0, 2.0, 3.0])
RESPONSE_RADIUS_KM = np.array(
    [4396 + 850j, 4859 + 732j, 5436 + 380j, 5458 + 367j, 5997 + 275j, 6133 + 244j, 6200 + 214j]
)
"""c(f) of the layered conductivity of Grayver et al. 2017 (doi 10.1002/2017GL074120) with an ocean layer of 7000 S,
for degree 1; degree 2 differs by 1 % at a year and 0.03 % at a day. Computed by ChaosMagPy 0.16 (`q_response`)."""

_COEFFICIENTS = ("model_ext.m_sm", "model_ext.m_gsm", "model_ext.m_Dst", "params.igrf_dipole")
_OFFSETS, _BREAKS = ("model_ext.q10", "model_ext.qs11"), ("model_ext.t_break_q10", "model_ext.t_break_qs11")
_WINDOW_HOURS = 8766  # 365.25 days: the daily turn and the seasons both close
_HALF = np.sqrt(3.0) / 2.0


@dataclass(frozen=True, eq=False)
class MagnetosphericModel:
    """The external part of a CHAOS model; coefficients in the order q10 q11 s11 q20 q21 s21 q22 s22."""

    name: str
    dipole_nT: FloatArray = field(repr=False)
    """(3,) g10, g11, h11 that define SM and GSM."""
    sm_nT: FloatArray = field(repr=False)
    """(5,) degree 2 in SM."""
    gsm_nT: FloatArray = field(repr=False)
    """(2,) q10 and q20 in GSM."""
    rc_weights: tuple[float, float, float]
    """q10, q11, s11 in SM for each nT of RC."""
    bins: tuple[TimeArray, TimeArray] = field(repr=False)
    """Edges of the bins of q10, and of q11 and s11."""
    offsets_nT: tuple[FloatArray, FloatArray] = field(repr=False)
    """Offsets in those bins, (P,) and (P', 2)."""

    def offset_nT(self, time: np.datetime64) -> FloatArray:
        """(3,) offsets of q10, q11, s11. Raises OutOfRange, naming the range, outside the bins."""
        stamp = epoch.as_times(time)[0]
        found = []
        for edges, values in zip(self.bins, self.offsets_nT, strict=True):
            if not edges[0] <= stamp <= edges[-1]:
                raise OutOfRange(
                    f"{epoch.iso(stamp)} is outside the external field of {self.name}",
                    where="time",
                    wanted=f"{epoch.iso(edges[0])} to {epoch.iso(edges[-1])}",
                )
            row = min(int(np.searchsorted(edges, stamp, side="right")) - 1, values.shape[0] - 1)
            found.append(np.atleast_1d(values[row]))
        return np.concatenate(found)


def read_magnetosphere(path: Path | str) -> MagnetosphericModel:
    """The external part of a CHAOS .mat file. Raises BadInput for a file without one."""
    where = str(path)
    if not Path(path).is_file():
        raise BadInput("no such file", where=where, wanted="a CHAOS file, .mat")
    found = mat_variables(path, [*_COEFFICIENTS, *_OFFSETS, *_BREAKS])
    sm, gsm, dst, dipole = (np.ravel(found[name]) for name in _COEFFICIENTS)
    edges = tuple(stamps_mjd2000(np.ravel(found[name])) for name in _BREAKS)
    offsets = (np.ravel(found["model_ext.q10"]), np.atleast_2d(found["model_ext.qs11"]))
    sizes = (sm.size, gsm.size, dst.size, dipole.size)
    bins_fit = all(e.size == o.shape[0] + 1 for e, o in zip(edges, offsets, strict=True))
    if sizes != (8, 2, 3, 3) or not bins_fit:
        raise BadInput(f"external coefficients of sizes {sizes}", where=where, wanted="(8, 2, 3, 3), bins that fit")
    weights = (float(dst[0]), float(dst[1]), float(dst[2]))
    return MagnetosphericModel(Path(path).stem, dipole, sm[3:], gsm, weights, (edges[0], edges[1]), offsets)


def magnetospheric_field_E_nT(
    model: MagnetosphericModel,
    time: TimeArray,
    r_E_km: FloatArray,
    rc_external_nT: FloatArray,
    rc_induced_nT: FloatArray,
) -> FloatArray:
    """External and induced field (N, 3) in Earth-fixed components [nT], at positions (N, 3).

    time: (N,), all within half a year. rc_external_nT, rc_induced_nT: (N,) the RC index at those times. The offsets
    of the bin in the middle of the record hold for all of it. Raises OutOfRange outside the model.
    """
    stamps = epoch.as_times(time)
    middle = stamps[0] + (stamps[-1] - stamps[0]) // 2
    offset_nT = model.offset_nT(middle)
    rc = np.asarray(rc_external_nT)[:, None] * np.array(model.rc_weights)
    R_SM, R_GSM = solar_frames_E(stamps, model.dipole_nT)
    q, Q = _steady(model, offset_nT, R_SM, R_GSM)
    ring = np.einsum("nji,nj->ni", R_SM, _vector(rc))
    u = np.asarray(r_E_km) / FIELD_RADIUS_KM
    external: FloatArray = -(q + ring + 2.0 * np.einsum("nij,nj->ni", Q, u))
    induced_ring = np.asarray(rc_induced_nT)[:, None] * np.array(model.rc_weights)
    q_i, Q_i = _induced(model, offset_nT, middle, stamps)
    q_i = q_i + np.einsum("nji,nj->ni", R_SM, _vector(induced_ring))
    return external + _internal_field(q_i, Q_i, u)


def solar_frames_E(time: TimeArray, dipole_nT: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Matrices (N, 3, 3) that turn Earth-fixed components into SM and into GSM.

    dipole_nT: g10, g11, h11.
    """
    sun = frames.rotation_EN(time).apply(sun_direction_N(time))
    g10, g11, h11 = dipole_nT
    pole = np.broadcast_to(-np.array([g11, h11, g10]) / np.linalg.norm(dipole_nT), sun.shape)
    y = np.cross(pole, sun)
    y = y / np.linalg.norm(y, axis=1)[:, None]
    R_SM = np.stack([np.cross(y, pole), y, pole], axis=1)
    R_GSM = np.stack([sun, y, np.cross(sun, y)], axis=1)
    return R_SM, R_GSM


def _vector(degree1: FloatArray) -> FloatArray:
    """(..., 3) x, y, z of q.u from q10, q11, s11."""
    return np.asarray(degree1[..., [1, 2, 0]])


def _matrix(q20: float, q21: float, s21: float, q22: float, s22: float) -> FloatArray:
    """(3, 3) Q of u.Q u from the Schmidt coefficients of degree 2."""
    return np.array(
        [
            [-0.5 * q20 + _HALF * q22, _HALF * s22, _HALF * q21],
            [_HALF * s22, -0.5 * q20 - _HALF * q22, _HALF * s21],
            [_HALF * q21, _HALF * s21, q20],
        ]
    )


def _steady(
    model: MagnetosphericModel, offset_nT: FloatArray, R_SM: FloatArray, R_GSM: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Earth-fixed q (N, 3) and Q (N, 3, 3) of what is constant in SM and GSM."""
    near, far = _matrix(*model.sm_nT), _matrix(float(model.gsm_nT[1]), 0.0, 0.0, 0.0, 0.0)
    q = np.einsum("nji,j->ni", R_SM, _vector(offset_nT)) + model.gsm_nT[0] * R_GSM[:, 2, :]
    Q = np.einsum("nji,jk,nkl->nil", R_SM, near, R_SM) + np.einsum("nji,jk,nkl->nil", R_GSM, far, R_GSM)
    return q, Q


def _induced(
    model: MagnetosphericModel, offset_nT: FloatArray, middle: np.datetime64, time: TimeArray
) -> tuple[FloatArray, FloatArray]:
    """Internal q (N, 3) and Q (N, 3, 3) that the steady part calls up as the Earth turns under it.

    A year of hourly values around the record goes through the response, frequency by frequency.
    """
    hours = np.arange(_WINDOW_HOURS) - _WINDOW_HOURS // 2
    grid = epoch.as_times(middle) + hours * np.timedelta64(3600, "s")
    q, Q = _steady(model, offset_nT, *solar_frames_E(grid, model.dipole_nT))
    frequency: FloatArray = np.arange(_WINDOW_HOURS // 2 + 1) / (_WINDOW_HOURS / 24.0)
    at = (time - grid[0]).astype("int64") / 3600e9
    return (
        _answer(q, _response(frequency, 1), at),
        _answer(Q.reshape(-1, 9), _response(frequency, 2), at).reshape(-1, 3, 3),
    )


def _answer(series: FloatArray, response: np.ndarray, at_hours: FloatArray) -> FloatArray:
    """The filtered series at times [hours from its start]: local cubic interpolation between hours."""
    from scipy.interpolate import CubicSpline

    filtered = np.fft.irfft(np.fft.rfft(series, axis=0) * response[:, None], n=series.shape[0], axis=0)
    first = max(int(at_hours.min()) - 6, 0)
    last = min(int(at_hours.max()) + 8, series.shape[0])
    return np.asarray(CubicSpline(np.arange(first, last), filtered[first:last], axis=0)(at_hours))


def _response(per_day: FloatArray, degree: int) -> np.ndarray:
    """Q_n at the frequencies; zero at frequency zero: what never changes induces nothing."""
    x = np.log(np.maximum(per_day, RESPONSE_PER_DAY[0]))
    known = np.log(RESPONSE_PER_DAY)
    c = np.interp(x, known, RESPONSE_RADIUS_KM.real) + 1j * np.interp(x, known, RESPONSE_RADIUS_KM.imag)
    response = degree / (degree + 1.0) * (c / FIELD_RADIUS_KM) ** (2 * degree + 1)
    return np.where(per_day > 0.0, response, 0.0)


def _internal_field(q: FloatArray, Q: FloatArray, u: FloatArray) -> FloatArray:
    """-grad of a [(a/r)**2 q.e + (a/r)**3 e.Q e], e = r/|r|, at u = r/a; (N, 3)."""
    size = np.linalg.norm(u, axis=1)[:, None]
    e = u / size
    dipole = 3.0 * np.sum(q * e, axis=1)[:, None] * e - q
    Qe = np.einsum("nij,nj->ni", Q, e)
    quadrupole = 5.0 * np.sum(e * Qe, axis=1)[:, None] * e - 2.0 * Qe
    return np.asarray(dipole / size**3 + quadrupole / size**4)
