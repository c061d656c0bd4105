"""One zone by itself: twelve parameters and the spin phase, which nobody gives, estimated together.

Reading = G Rz(phase) H + o, H in spin axes. The azimuth of the body is a convention (the first column of G and the
phase turn together), so of the phase the rate and what bends it are free. For a given phase everything else is linear:
the phase is found by Gauss-Newton steps with the linear part projected out (Golub & Pereyra 1973, SIAM J. Numer. Anal.
10, 413; the derivative without its second term: Kaufman 1975, BIT 15, 49).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from fluxtwin.scenarios.elfin.record import Zone
from fluxtwin.scenarios.elfin.settings import Settings
from fluxtwin.sim.base.types import FloatArray

ComplexArray: TypeAlias = NDArray[np.complex128]

KINDS = ("static", "linear", "quadratic", "harmonic")
"""Twelve parameters; all twelve drifting linearly; and quadratically; and a third harmonic of the spin beside."""
_ROUNDS = 15
_SPINS = 4
_FEWEST = 100


@dataclass(frozen=True)
class ZoneFit:
    """One kind of fit to the used rows of one zone."""

    kind: str
    rate_rad_s: float
    """Spin rate at the middle."""
    phase_rad: FloatArray
    """(N,) spin phase at all rows of the zone."""
    coefficients: FloatArray
    """(K, 3), of which the first four rows are G's columns and o."""
    residual_nT: FloatArray
    """(N, 3) at all rows, those left out too."""
    slope_nT: FloatArray
    """(N, 3) derivative of the reading by the phase."""
    rms_nT: float
    """Length of the residual vector, rms over the used rows."""


def spin_rate(zone: Zone, settings: Settings) -> float:
    """Right-handed about the reported axis, by a scan of periods with the static fit on thinned rows."""
    t = zone.seconds - zone.seconds.mean()
    rows = np.flatnonzero(zone.used)[::11]
    best = (np.inf, 0.0)
    for period_s in np.arange(settings.shortest_spin_s, settings.longest_spin_s, 2e-4):
        rate = 2.0 * np.pi / float(period_s)
        X = _columns("static", turning(zone.field_S_nT[rows], rate * t[rows]), zone.field_S_nT[rows, 2], t[rows])
        _, cost, *_ = np.linalg.lstsq(X, zone.reading_nT[rows], rcond=None)
        best = min(best, (float(cost.sum()), rate))
    return best[1]


def fit_zone(zone: Zone, kind: str, settings: Settings, rate_rad_s: float | None = None) -> ZoneFit:
    """The fit; the phase is a polynomial of `phase_degree`."""
    rate = spin_rate(zone, settings) if rate_rad_s is None else rate_rad_s
    t = zone.seconds - zone.seconds.mean()
    share = t / t[-1]
    bends = np.stack([share**power for power in range(1, settings.phase_degree + 1)], axis=1)
    fitted = _project(zone, kind, rate * t, share, bends)
    coefficients, residual, slope, p = fitted
    return ZoneFit(
        kind, rate + float(p[0]) / float(t[-1]), rate * t + bends @ p, coefficients, residual, slope,
        rms(residual[zone.used]),
    )  # fmt: skip


def rms(residual_nT: FloatArray) -> float:
    """Of the length of the residual vector."""
    return float(np.sqrt((residual_nT**2).sum(axis=1).mean()))


def turning(field_S_nT: FloatArray, phase_rad: FloatArray) -> ComplexArray:
    """(N,) field across the axis as seen in the body, x + i y."""
    turned: ComplexArray = (field_S_nT[:, 0] + 1j * field_S_nT[:, 1]) * np.exp(-1j * phase_rad)
    return turned


def local_noise_nT(zone: Zone, fit: ZoneFit) -> float:
    """Median over stretches of four spins of what a fit of their own leaves, with harmonics up to the fifth.

    rms length of the residual vector, corrected for the parameters.
    """
    found = []
    for rows in stretches(zone, fit, _SPINS):
        u = turning(zone.field_S_nT[rows], fit.phase_rad[rows])
        late = np.linspace(-0.5, 0.5, rows.size)
        unit = u / np.abs(u)
        columns = [np.ones(rows.size), late, u.real, u.imag, u.real * late, u.imag * late]
        for order in (2, 3, 4, 5):
            columns += [(unit**order).real, (unit**order).imag]
        X = np.stack(columns, axis=1)
        left = zone.reading_nT[rows] - X @ np.linalg.lstsq(X, zone.reading_nT[rows], rcond=None)[0]
        found.append(rms(left) * float(np.sqrt(rows.size / (rows.size - X.shape[1]))))
    return float(np.median(found))


def responses(zone: Zone, fit: ZoneFit, spins: int = 8) -> tuple[FloatArray, ComplexArray]:
    """Seconds (M,) and each channel's complex response (M, 3) to the field across the axis, nT per nT, by stretches.

    Relative to channel Z's azimuth, which is put on +y: the phase of the spin is nobody's.
    """
    middle, found = [], []
    for rows in stretches(zone, fit, spins):
        u = turning(zone.field_S_nT[rows], fit.phase_rad[rows])
        late = np.linspace(-0.5, 0.5, rows.size)
        X = np.stack([u.real, u.imag, np.ones(rows.size), late, u.real * late, u.imag * late], axis=1)
        C = np.linalg.lstsq(X, zone.reading_nT[rows], rcond=None)[0]
        g = C[0] + 1j * C[1]
        found.append(g * 1j * abs(g[2]) / g[2])
        middle.append(float(zone.seconds[rows].mean()))
    return np.array(middle), np.array(found)


def stretches(zone: Zone, fit: ZoneFit, spins: int) -> list[np.ndarray]:
    """Used rows of each stretch of so many spins that is nearly whole."""
    length_s = spins * 2.0 * np.pi / fit.rate_rad_s
    rows = np.flatnonzero(zone.used)
    place = ((zone.seconds[rows] - zone.seconds[rows[0]]) // length_s).astype(int)
    every = [rows[place == number] for number in range(int(place[-1]) + 1)]
    return [one for one in every if one.size >= _FEWEST]


def _columns(kind: str, u: ComplexArray, along_nT: FloatArray, share: FloatArray, constant: float = 1.0) -> FloatArray:
    """(N, K) design; constant 0 and along 0 give its derivative when u is that of the turning field."""
    base = np.stack([u.real, u.imag, along_nT, np.full(u.size, constant)], axis=1)
    powers = {"static": 0, "linear": 1, "quadratic": 2, "harmonic": 2}[kind]
    blocks = [base * (share**power)[:, None] for power in range(powers + 1)]
    if kind == "harmonic":
        third = constant * (u / np.abs(u)) ** 3
        blocks.append(np.stack([third.real, third.imag], axis=1))
    return np.concatenate(blocks, axis=1)


def _project(
    zone: Zone, kind: str, phase_rad: FloatArray, share: FloatArray, bends: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    H, B, used = zone.field_S_nT, zone.reading_nT, zone.used

    def at(p: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        u = turning(H, phase_rad + bends @ p)
        X = _columns(kind, u, H[:, 2], share)
        C = np.linalg.lstsq(X[used], B[used], rcond=None)[0]
        slope = _columns(kind, np.asarray(-1j * u), 0.0 * H[:, 2], share, 0.0) @ C
        return np.asarray(C, dtype=np.float64), np.asarray(B - X @ C), np.asarray(slope), X[used]

    p = np.zeros(bends.shape[1])
    now = at(p)
    cost = rms(now[1][used])
    for _ in range(_ROUNDS):
        Q = np.linalg.qr(now[3])[0]
        tangents = []
        for bend in bends.T:
            moved = now[2][used] * bend[used, None]
            tangents.append((moved - Q @ (Q.T @ moved)).ravel())
        step = np.linalg.lstsq(np.stack(tangents, axis=1), now[1][used].ravel(), rcond=None)[0]
        tried = [at(p + part * step) for part in (1.0, 0.5, 0.1)]
        costs = [rms(one[1][used]) for one in tried]
        best = int(np.argmin(costs))
        if costs[best] >= cost * (1.0 - 1e-9):
            break
        p, now, gained = p + (1.0, 0.5, 0.1)[best] * step, tried[best], cost - costs[best]
        cost = costs[best]
        if gained < 1e-5 * cost:
            break
    return now[0], now[1], now[2], p
