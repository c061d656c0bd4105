"""Readings of a spinner that stand out in |B|: bit errors spoil a blind start, and attitude is not needed to see them."""

from __future__ import annotations

import numpy as np

from fluxtwin.calib.robust import robust_weights
from fluxtwin.calib.scalar_ml import solve
from fluxtwin.calib.scalar_model import ScalarData, residual
from fluxtwin.calib.spin_rows import SpinRows
from fluxtwin.calib.suspicion import standing_out
from fluxtwin.sim import epoch
from fluxtwin.sim.types import FloatArray

_LOOSE = 0.005
"""Noise in parts of the field; it sets no weight here."""


def wild_readings(rows: SpinRows) -> np.ndarray:
    """(N,) readings whose |B| stands out after a robust fit of b and S to |H|."""
    H = np.linalg.norm(rows.H_N_nT, axis=1)
    scale = float(np.sqrt((H**2).mean()))
    data = ScalarData(rows.B_nT / scale, H / scale, np.zeros((len(H), 0)), _LOOSE**2 * np.eye(3), True)
    state = {"p": np.zeros(data.size)}

    def refit(weights: FloatArray) -> FloatArray:
        state["p"] = solve(state["p"], data, weights, adjusted=False).p
        return residual(state["p"], data)[:, None]

    robust_weights(residual(state["p"], data)[:, None], refit, "tukey")
    return standing_out(residual(state["p"], data)[:, None])


def wild_words(rows: SpinRows) -> str:
    """How many stand out, and what to do; empty where none does."""
    wild = np.flatnonzero(wild_readings(rows))
    if not wild.size:
        return ""
    first = ", ".join(epoch.iso(rows.time[k], "ms") for k in wild[:3])
    return (
        f"{wild.size} of {len(rows)} readings stand far out of the others in |B| (bit errors?), the first at {first}. "
        "This method has no robust weights: leave those readings empty and calibrate again"
    )
