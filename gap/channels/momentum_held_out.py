"""How far the balance of the momentum closes on windows that the parameters have not seen."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from fluxtwin.gap.records.diagnosis import MomentumGap
from fluxtwin.sim.base.types import FloatArray

if TYPE_CHECKING:
    from fluxtwin.gap.channels.momentum_search import Balance, Refit

_PARTS = 5
_DRAWS = 400
_SURE_RAD = np.radians(5.0)


def how_far(balance: Balance, fit: Refit | None, noise: str, standing: tuple[FloatArray, FloatArray]) -> MomentumGap:
    """The figures. Parameters come from four fifths of the windows, the start of each window from itself."""
    cut, plain = balance.windows, balance.whitener.by_attitude
    before = plain.left(_held_out(balance, balance.residual, balance.nuisance))
    after = before
    if fit is not None:
        after = plain.left(_held_out(balance, fit.residual, np.concatenate([balance.nuisance, *fit.columns], axis=2)))
    sums = np.array(
        [[float(np.sum(before[w.place] ** 2)), float(np.sum(after[w.place] ** 2)), 3.0 * w.size] for w in cut.windows]
    )
    floor = plain.floor_rad(balance.whitener.noise)
    rng = np.random.default_rng(len(sums))
    drawn = sums[rng.integers(0, len(sums), size=(_DRAWS, len(sums)))].sum(axis=1)
    b2, a2 = drawn[:, 0] / drawn[:, 2], drawn[:, 1] / drawn[:, 2]
    rms_before, rms_after = (float(np.sqrt(sums[:, k].sum() / sums[:, 2].sum())) for k in range(2))
    closed: float | None = None
    interval: tuple[float, float] | None = None
    if fit is not None and rms_before**2 - floor**2 > 0.2 * floor**2:
        closed = _closed(rms_before**2, rms_after**2, floor)
        spread = [_closed(b, a, floor) for b, a in zip(b2, a2, strict=True)]
        low, high = np.percentile(spread, [5.0, 95.0])
        interval = (float(min(low, closed)), float(max(high, closed)))
    errors = {
        axis: (float(np.degrees(value)), float(np.degrees(sigma)))
        for axis, value, sigma in zip("xyz", *standing, strict=True)
        if sigma < _SURE_RAD
    }
    longest = max(float(w.seconds[-1] - w.seconds[0]) for w in cut.windows)
    return MomentumGap(
        float(np.degrees(rms_before)),
        float(np.degrees(rms_after)),
        float(np.degrees(floor)),
        closed,
        interval,
        len(cut.windows),
        longest,
        noise,
        errors,
    )


def _held_out(balance: Balance, residual: FloatArray, columns: FloatArray) -> FloatArray:
    """(M, 3) [rad] what is left of each window with the parameters that the others give."""
    whitener, cut = balance.whitener, balance.windows
    white = whitener.apply(columns)
    live = np.any(white != 0.0, axis=(0, 1))
    white, raw, target = white[:, :, live], columns[:, :, live], whitener.apply(residual)
    out = np.array(residual)
    for part in np.array_split(np.arange(len(cut.windows)), min(_PARTS, len(cut.windows))):
        held = np.concatenate([np.arange(cut.rows.size)[cut.windows[n].place] for n in part])
        train = np.ones(cut.rows.size, dtype=bool)
        train[held] = False
        design = white[train].reshape(-1, white.shape[2])
        length = np.maximum(np.linalg.norm(design, axis=0), 1e-300)
        theta = np.linalg.lstsq(design / length, target[train].reshape(-1), rcond=1e-6)[0] / length
        out[held] = residual[held] - raw[held] @ theta
    return out


def _closed(before2: float, after2: float, floor: float) -> float:
    below = before2 - floor**2
    if below <= 0:
        return 0.0
    return float(np.clip(1.0 - max(after2 - floor**2, 0.0) / below, 0.0, 1.0))
