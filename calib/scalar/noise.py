"""The noise of the reading where no attitude is known: declared, or from short differences of the residual of |B|."""

from __future__ import annotations

import numpy as np

from fluxtwin.calib.common.moments import stretches
from fluxtwin.calib.common.noise import ReadingNoise, clipped_sigma, lsb_from_spacing_nT, per_axis
from fluxtwin.sim.base.types import FloatArray, TimeArray

_ROWS = 50_000
_FEWEST_PAIRS = 30


def scalar_noise(
    B_nT: FloatArray,
    time: TimeArray,
    residual_nT: FloatArray,
    noise_nT: float | FloatArray | None,
    lsb_nT: float | FloatArray | None,
) -> ReadingNoise:
    """Sigma_B: declared, or taken alike on the three axes from differences of neighbours.

    B_nT: (N, 3). residual_nT: (N,) |B| less |H| of a first fit. What lasts longer than a sample is not noise here; how
    much of the residual is of that kind goes into the covariance, as any part of it may be noise all the same.
    """
    some = stretches(len(time), _ROWS)
    lsb = lsb_from_spacing_nT(B_nT[some]) if lsb_nT is None else per_axis(lsb_nT, "lsb_nT")
    words = f"LSB {lsb.max():.4g} nT {'declared' if lsb_nT is not None else 'from the spacing of the readings'}"
    if noise_nT is not None:
        noise = per_axis(noise_nT, "noise_nT")
        size = "/".join(f"{v:.4g}" for v in (noise if np.ptp(noise) else noise[:1]))
        return ReadingNoise(noise**2 + lsb**2 / 12.0, f"noise {size} nT declared, {words}")
    floor = lsb**2 / 12.0
    r, step = residual_nT[some], np.diff(time[some]).astype("int64")
    near = np.flatnonzero(step <= 1.5 * np.median(step)) if step.size else np.zeros(0, dtype=int)
    if near.size < _FEWEST_PAIRS:
        return ReadingNoise(floor, f"{words}; too few neighbouring samples to find the noise beyond it")
    whole = clipped_sigma(r) ** 2
    white = min(0.5 * clipped_sigma(np.diff(r)[near]) ** 2, whole)
    variance = np.maximum(np.full(3, white), floor)
    hidden = max(0.0, whole * len(r) / max(len(r) - 9, 1) - white)
    spread = np.full((3, 3), hidden**2 / 12.0 + 3.0 * white**2 / near.size)
    text = f"{np.sqrt(white):.4g} nT an axis from short differences of the residual of |B|, taken alike; {words}"
    return ReadingNoise(variance, text, spread)
