"""Outliers of a spinner in |B|: bit errors mislead a blind start, and no attitude is needed to see them."""

from __future__ import annotations

import numpy as np

from fluxtwin.calib.common.robust import TUKEY_AT, find_outliers, robust_distance, robust_weights
from fluxtwin.calib.scalar.maximum_likelihood import solve
from fluxtwin.calib.scalar.model import ScalarData, residual
from fluxtwin.calib.spin.rows import SpinRows
from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.earth import epoch

LOOSE_NOISE = 0.005
"""In parts of the field: the least that is taken before any is found; as a weight it has no effect here."""


def outlying_readings(rows: SpinRows) -> np.ndarray:
    """(N,) readings whose |B| is an outlier after a robust fit of b and S to |H|."""
    H = np.linalg.norm(rows.H_N_nT, axis=1)
    scale = float(np.sqrt((H**2).mean()))
    data = ScalarData(rows.B_nT / scale, H / scale, np.zeros((len(H), 0)), LOOSE_NOISE**2 * np.eye(3), True)
    p = np.zeros(data.size)

    def refit(weights: FloatArray) -> FloatArray:
        nonlocal p
        p = solve(p, data, weights, adjusted=False).p
        return residual(p, data)[:, None]

    robust_weights(residual(p, data)[:, None], refit, "tukey")
    return find_outliers(residual(p, data)[:, None])


def beyond(residuals_nT: FloatArray) -> np.ndarray:
    """(N,) residuals (N, 3) of more than six robust sigma, where Tukey's weight is zero."""
    r = residuals_nT - np.median(residuals_nT, axis=0)
    return robust_distance(r) > TUKEY_AT


def outlier_words(rows: SpinRows, *, left_out: bool) -> str:
    """How many outliers there are, and what to do; empty where there are none."""
    outlying = np.flatnonzero(outlying_readings(rows))
    if not outlying.size:
        return ""
    first = ", ".join(epoch.iso(rows.time[k], "ms") for k in outlying[:3])
    return f"{outlying.size} of {len(rows)} readings are outliers in |B| (bit errors?), the first at {first}. " + (
        "They were left out, and others that |B| does not show may remain: leave those readings empty"
        if left_out
        else "--robust tukey leaves them out"
    )
