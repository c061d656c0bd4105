"""The converter's codes: a coarser step than declared, a bit that never changes, bits that flip now and then."""

from __future__ import annotations

from typing import Literal, cast

import numpy as np
from scipy import stats
from scipy.special import gammaln

from fluxtwin.gap.detectors.finding import Finding
from fluxtwin.gap.noise.robust_rows import CUT_SIGMA
from fluxtwin.gap.selection.criterion import FEWEST
from fluxtwin.sim.base.types import BoolArray, FloatArray
from fluxtwin.sim.effects.digits import BitErrors, CoarseQuantization

_BITS = 24
_MOST = 0.9
"""Share of the readings that sit on a coarser step: the rest may have bit errors."""
_MOST_SPIKES = 0.8  # share of the spikes that are one bit, or the same bit
_OFF = 0.02  # of a step: readings this near to a multiple sit on it, 4 % by chance


def coarse_steps(reading_nT: FloatArray, declared_lsb_nT: float | None) -> Finding | None:
    """Are the readings (N, 3) all multiples of a step larger than declared? None without a declared LSB.

    The step is the commonest difference of neighbouring values, or a multiple of the declared one.
    """
    if declared_lsb_nT is None:
        return None
    values = reading_nT[np.isfinite(reading_nT)]
    spacing = np.diff(np.unique(np.round(values, 4)))
    floor = max(1.05 * declared_lsb_nT, 1e-3)
    spacing = spacing[spacing > floor]
    if values.size < FEWEST or not spacing.size:
        return None
    sizes, counts = np.unique(np.round(spacing, 2), return_counts=True)
    best = (0.0, 0.0)
    tried = [_refined(values, float(size)) for size in sizes[np.argsort(-counts)[:5]]]
    for step in [*tried, *_common_multiple(values, declared_lsb_nT)]:
        share = float(np.mean(_on_grid(values, step)))
        if step > floor and np.unique(np.rint(values / step)).size >= 5:
            best = max(best, (share, step))
    share, step = best
    if share < _MOST:
        return None
    near = _on_grid(values, step)
    off = values[near] - step * np.rint(values[near] / step)
    error = float(np.sqrt(np.mean(off**2) / np.sum((values / step) ** 2)))
    log_p = float(stats.binom.logsf(round(share * values.size) - 1, values.size, 2.0 * _OFF))
    what = f"{100 * share:.1f} % of the readings are multiples of {step:.6g} nT, the declared LSB is {declared_lsb_nT:g} nT"
    sigma = np.array([max(error, 1e-6 * step)])
    return Finding(CoarseQuantization(), np.array([step]), sigma, -2.0 * log_p, what)


def _on_grid(values: FloatArray, step: float) -> BoolArray:
    return np.asarray(np.abs(values / step - np.rint(values / step)) < _OFF)


def _common_multiple(values: FloatArray, lsb_nT: float) -> list[float]:
    """The largest multiple of the declared LSB on which nine readings in ten sit; few readings rarely neighbour."""
    if lsb_nT <= 0:
        return []
    few = values[:: max(values.size // 20_000, 1)]
    if np.mean(_on_grid(few, lsb_nT)) < _MOST:
        return []
    whole = np.rint(few / lsb_nT)
    good = [m for m in range(2, 257) if np.mean(whole % m == 0) >= _MOST]
    return [good[-1] * lsb_nT] if good else []


def _refined(values: FloatArray, step: float) -> float:
    # From the small multiples outwards: a step known to 1 % says which multiple only as far as the fiftieth.
    for reach in (20, 200, 2000, 1e9):
        number = np.rint(values / step)
        near = (np.abs(number) <= reach) & (number != 0) & (np.abs(values / step - number) < 0.2)
        if near.sum() >= 3:
            step = float(np.sum(values[near] * number[near]) / np.sum(number[near] ** 2))
    return step


def stuck_bit(reading_nT: FloatArray, predicted_nT: FloatArray, lsb_nT: float, step_nT: float) -> Finding | None:
    """A bit of an axis' code that never changes though the prediction says it should.

    Readings and prediction (N, 3); step_nT: true step of the readings, bits below it are not looked at.
    """
    found: list[tuple[float, int, str, int]] = []
    for axis in range(3):
        code, wanted = (np.rint(v[:, axis] / lsb_nT).astype(np.int64) for v in (reading_nT, predicted_nT))
        for bit in range(round(np.log2(max(step_nT / lsb_nT, 1.0))), _BITS):
            actual, expected = float(np.mean(code >> bit & 1)), float(np.mean(wanted >> bit & 1))
            if 0.05 < expected < 0.95 and min(actual, 1 - actual) < 0.005:
                log_p = code.size * np.log(max(expected, 1 - expected)) / 4  # neighbours are not independent
                found.append((float(log_p), bit, "xyz"[axis], int(actual > 0.5)))
    if not found:
        return None
    log_p, bit, letter, value = min(found, key=lambda item: item[0])
    alone = not any(other[1] == bit and other[2] != letter and other[3] == value for other in found)
    what = f"bit {bit} of {f'axis {letter}' if alone else 'several axes'} is always {value}"
    which = cast(Literal["x", "y", "z", "all"], letter if alone else "all")
    effect = BitErrors(bit, "stuck_1" if value else "stuck_0", lsb_nT, which)
    return Finding(effect, np.ones(1), np.zeros(1), -2.0 * log_p, what)


def flipped_bits(reading_nT: FloatArray, residual_nT: FloatArray, cut: BoolArray, lsb_nT: float) -> Finding | None:
    """Do the spikes become ordinary readings when one bit of their code is turned round?

    All (N, 3); cut: the components that stand out. Bayes factor of "the nearest single bit, then noise" (with
    unknown shares of the bits) against spikes of any size, even in its logarithm.
    """
    count = int(cut.sum())
    if count < 2 or not lsb_nT > 0:
        return None
    quiet = np.where(cut, np.nan, residual_nT)
    sigma = 1.4826 * np.nanmedian(np.abs(quiet - np.nanmedian(quiet, axis=0)), axis=0)
    rounding_nT = lsb_nT / np.sqrt(12.0)
    spread = np.broadcast_to(np.maximum(sigma, rounding_nT), cut.shape)[cut]
    code = np.rint(reading_nT[cut] / lsb_nT).astype(np.int64)
    spike = residual_nT[cut]
    powers = np.left_shift(1, np.arange(_BITS))
    turned = np.where(code[:, None] & powers, powers, -powers) * lsb_nT
    top = int(np.abs(np.rint(reading_nT[np.isfinite(reading_nT)] / lsb_nT)).max()).bit_length() - 1
    turned[:, top:] = np.sign(spike)[:, None] * powers[top:] * lsb_nT  # the sign's bit may be any of the highest
    miss = (spike[:, None] - turned) / spread[:, None]
    bit = np.argmin(np.abs(miss), axis=1)
    rest = miss[np.arange(count), bit]
    low, high = 0.8 * np.abs(spike).min(), 1.25 * np.abs(spike).max()
    any_size = -np.log(2 * np.abs(spike) * np.log(high / low))
    one_bit = stats.norm.logpdf(rest) - np.log(spread)
    shares = np.bincount(bit, minlength=_BITS)
    log_shares = gammaln(1.0) - gammaln(1.0 + count) + np.sum(gammaln(shares + 1 / _BITS) - gammaln(1 / _BITS))
    log_bayes = float(np.sum(np.maximum(one_bit, -20.0) - any_size) + log_shares)
    fitting = float(np.mean(np.abs(rest) < 4))
    dominant = int(np.argmax(shares))
    single = shares[dominant] >= _MOST_SPIKES * count
    total = int(np.isfinite(residual_nT).sum())
    large = lsb_nT * powers[: top + 2] > CUT_SIGMA * float(
        np.median(spread)
    )  # a flip of a lower bit does not stand out
    visible = 1.0 if single else max(int(large.sum()), 1) / (top + 2)
    rate, error = (np.array([size / total / visible]) for size in (count, np.sqrt(count)))
    what = f"{count} spikes, {100 * fitting:.0f} % of them a single flipped bit"
    faults = () if fitting >= _MOST_SPIKES else ("the others are not",)
    return Finding(BitErrors(dominant if single else None, "flip", lsb_nT), rate, error, 2.0 * log_bayes, what, faults)
