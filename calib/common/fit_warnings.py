"""What about a finished fit should make a person look again, in words; whether it is good says `verdict`."""

from __future__ import annotations

import numpy as np

from fluxtwin.calib.common.records import Calibration
from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.telemetry.record import Telemetry

LARGE_S = 0.3
"""No magnetometer is off by 30 %; wrong units, axes and attitudes are."""
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
    if not robust:
        wild = int(standing_out(residuals_nT).sum())
        if wild:
            found.append(f"{wild} rows stand far out of the others (bit errors?): compare with robust weights (tukey)")
    return found
