"""One zone by itself: twelve parameters and the spin phase, which no file gives, estimated together.

Reading = G Rz(phase) H + o, H in spin axes. The azimuth of the body is a convention (the first column of G and the
phase turn together), so of the phase the rate and what bends it are free. For a given phase everything else is linear,
and is projected out (Golub & Pereyra 1973, SIAM J. Numer. Anal. 10, 413).
"""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from fluxtwin.scenarios.elfin.record import Zone
from fluxtwin.scenarios.flights import Numbers
from fluxtwin.scenarios.recorded_files import Settings
from fluxtwin.sim.base.types import FloatArray

ComplexArray: TypeAlias = NDArray[np.complex128]

KINDS = ("static", "linear", "quadratic", "harmonic")
"""Twelve parameters; all twelve drifting linearly; and quadratically; and a third harmonic of the spin as well."""
_SPINS = 4
_FEWEST = 100


def spin_rate(zone: Zone, settings: Settings) -> float:
    """Right-handed about the reported axis, by a scan of periods with the static fit on thinned rows."""
    rows = np.flatnonzero(zone.used)[::11]
    H, t, costs = zone.field_S_nT[rows], zone.late_s[rows], {}
    for period_s in np.arange(settings.shortest_spin_s, settings.longest_spin_s, 2e-4):
        rate = 2.0 * np.pi / float(period_s)
        X = _columns("static", turning(H, rate * t), H[:, 2], t)
        costs[rate] = float(np.linalg.lstsq(X, zone.reading_nT[rows], rcond=None)[1].sum())
    return min(costs, key=lambda rate: costs[rate])


def fit_zone(zone: Zone, kind: str, settings: Settings, rate_rad_s: float | None = None) -> Numbers:
    """One kind of fit to the used rows of one zone; the phase is a polynomial of `phase_degree`."""
    rate = spin_rate(zone, settings) if rate_rad_s is None else rate_rad_s
    H, B, used, share = zone.field_S_nT, zone.reading_nT, zone.used, zone.share
    bends = np.vander(share, settings.phase_degree + 1, increasing=True)[:, 1:]

    def at(p: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Coefficients of the columns, and the residual."""
        X = _columns(kind, turning(H, rate * zone.late_s + bends @ p), H[:, 2], share)
        C = np.linalg.lstsq(X[used], B[used], rcond=None)[0]
        return np.asarray(C), np.asarray(B - X @ C)

    def slope(p: FloatArray, C: FloatArray) -> FloatArray:
        u = turning(H, rate * zone.late_s + bends @ p)
        return np.asarray(_columns(kind, np.asarray(-1j * u), 0.0 * H[:, 2], share, 0.0) @ C)

    def unexplained(p: FloatArray) -> FloatArray:
        return at(p)[1][used].ravel()

    p: FloatArray = least_squares(unexplained, np.zeros(bends.shape[1])).x
    C, residual = at(p)
    phase = rate * zone.late_s + bends @ p
    middle_rate = rate + float(p[0]) / float(zone.late_s[-1])
    return Numbers(
        # Spin rate at the middle, and (N,) spin phase, at all rows of the zone.
        rate_rad_s=middle_rate,
        phase_rad=phase,
        # (K, 3), of which the first four rows are G's columns and o.
        coefficients=C,
        # (N, 3) at all rows, those left out too, and the derivative of the reading by the phase.
        residual_nT=residual,
        slope_nT=slope(p, C),
        # Length of the residual vector, rms over the used rows.
        rms_nT=rms(residual[used]),
    )


def rms(residual_nT: FloatArray) -> float:
    """Of the length of the residual vector."""
    return float(np.sqrt((residual_nT**2).sum(axis=1).mean()))


def turning(field_S_nT: FloatArray, phase_rad: FloatArray) -> ComplexArray:
    """(N,) field across the axis as seen in the body, x + i y."""
    turned: ComplexArray = (field_S_nT[:, 0] + 1j * field_S_nT[:, 1]) * np.exp(-1j * phase_rad)
    return turned


def local_noise_nT(zone: Zone, fit: Numbers) -> float:
    """Median over stretches of four spins of the residual of a fit of their own, with harmonics up to the fifth.

    rms length of the residual vector, corrected for the parameters.
    """
    found = []
    for rows, u, base in _stretches(zone, fit, _SPINS):
        unit = u / np.abs(u)
        harmonics = [part for order in (2, 3, 4, 5) for part in ((unit**order).real, (unit**order).imag)]
        X = np.concatenate([base, np.stack(harmonics, axis=1)], axis=1)
        residual = zone.reading_nT[rows] - X @ np.linalg.lstsq(X, zone.reading_nT[rows], rcond=None)[0]
        found.append(rms(residual) * float(np.sqrt(rows.size / (rows.size - X.shape[1]))))
    return float(np.median(found))


def responses(zone: Zone, fit: Numbers, spins: int = 8) -> tuple[FloatArray, ComplexArray]:
    """Seconds (M,) and each channel's complex response (M, 3) to the field across the axis, nT per nT, by stretches.

    Relative to channel Z's azimuth, which is put on +y: the zero of the spin phase is arbitrary.
    """
    middle, found = [], []
    for rows, _, X in _stretches(zone, fit, spins):
        C = np.linalg.lstsq(X, zone.reading_nT[rows], rcond=None)[0]
        g = C[0] + 1j * C[1]
        found.append(g * 1j * abs(g[2]) / g[2])
        middle.append(float(zone.seconds[rows].mean()))
    return np.array(middle), np.array(found)


def _stretches(zone: Zone, fit: Numbers, spins: int) -> list[tuple[np.ndarray, ComplexArray, FloatArray]]:
    """Used rows of each stretch of so many spins that is nearly whole, the turning field, and six columns."""
    length_s = spins * 2.0 * np.pi / fit.rate_rad_s
    used, found = np.flatnonzero(zone.used), []
    place = ((zone.seconds[used] - zone.seconds[used[0]]) // length_s).astype(int)
    for number in range(int(place[-1]) + 1):
        rows = used[place == number]
        if rows.size >= _FEWEST:
            u, late = turning(zone.field_S_nT[rows], fit.phase_rad[rows]), np.linspace(-0.5, 0.5, rows.size)
            columns = [u.real, u.imag, np.ones(rows.size), late, u.real * late, u.imag * late]
            found.append((rows, u, np.stack(columns, axis=1)))
    return found


def _columns(kind: str, u: ComplexArray, along_nT: FloatArray, share: FloatArray, constant: float = 1.0) -> FloatArray:
    """(N, K) design; constant 0 and along 0 give its derivative when u is that of the turning field."""
    base = np.stack([u.real, u.imag, along_nT, np.full(u.size, constant)], axis=1)
    degree = {"static": 0, "linear": 1, "quadratic": 2, "harmonic": 2}[kind]
    blocks = [base * (share**power)[:, None] for power in range(degree + 1)]
    if kind == "harmonic":
        third = constant * (u / np.abs(u)) ** 3
        blocks.append(np.stack([third.real, third.imag], axis=1))
    return np.concatenate(blocks, axis=1)
