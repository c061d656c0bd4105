"""What about a finished fit should make a person look again, in words."""

from __future__ import annotations

import numpy as np

from fluxtwin.calib.records import Calibration
from fluxtwin.sim.telemetry import Telemetry
from fluxtwin.sim.types import FloatArray

LARGE_S = 0.3
"""No magnetometer is off by 30 %; wrong units, axes and attitudes are."""
LARGE_RESIDUAL = 0.1
"""Residual over field, rms: a tenth is an attitude wrong by six degrees."""
STANDING_OUT_SIGMA = 8.0
"""Robust sigmas: of Gaussian rows none, of correlated errors next to none."""
_MAD_TO_SIGMA = 1.4826


def standing_out(residuals: FloatArray) -> np.ndarray:
    """(N,) rows of (N, k) residuals that stand far out of the others, by a scale that half of them may spoil."""
    r = residuals - np.median(residuals, axis=0)
    scale = _MAD_TO_SIGMA * np.median(np.abs(r))
    return np.asarray((np.linalg.norm(r, axis=1) > STANDING_OUT_SIGMA * scale) & (scale > 0))


def suspicions(telemetry: Telemetry, calibration: Calibration, residuals_nT: FloatArray, *, robust: bool) -> list[str]:
    """Sentences for the fit's messages; none for a fit that looks sound.

    telemetry: the record that was fitted. residuals_nT (N, 3).
    """
    found = []
    dipole = telemetry.dipole_B_Am2
    if calibration.T_nT_per_Am2 is None and dipole is not None and bool((np.nanstd(dipole, axis=0) > 0).any()):
        found.append("the torquers fired in these data and T was not asked for: compare with parameters b,S,T")
    largest = float(np.abs(calibration.S).max())
    if largest > LARGE_S:
        found.append(
            f"an element of S is {largest:.2g}: no magnetometer is that wrong; unit, axes or attitude may be. "
            "Run `fluxtwin check`"
        )
    field_nT = float(np.sqrt(np.nanmean(np.sum(telemetry.mag_B_nT**2, axis=1))))
    size = float(np.sqrt(np.mean(np.sum(residuals_nT**2, axis=1))))
    if size > LARGE_RESIDUAL * field_nT:
        found.append(
            f"the residual is {100 * size / field_nT:.0f} % of the field: attitude, position or unit may be wrong. "
            "Run `fluxtwin check`"
        )
    if not robust:
        wild = int(standing_out(residuals_nT).sum())
        if wild:
            found.append(f"{wild} rows stand far out of the others (bit errors?): compare with robust weights (tukey)")
    return found
