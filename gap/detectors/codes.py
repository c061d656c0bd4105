"""What is new in every row: the converter's codes (a coarser step, bits that stick or flip), and the level of the noise."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, cast

import numpy as np
from scipy import stats
from scipy.special import gammaln

from fluxtwin.calib.common.robust import MAD_TO_SIGMA
from fluxtwin.gap.detectors.finding import Finding, gaussian
from fluxtwin.gap.linear.projection import ProjectedResidual, projected
from fluxtwin.gap.noise.choice import NOISE_LOG_SD, NoiseModel, Whitener, complete_budget
from fluxtwin.gap.noise.robust_rows import CUT_SIGMA, RobustRows
from fluxtwin.gap.problem.problem import Budget, Problem
from fluxtwin.gap.selection.criterion import FEWEST, SHAPE_DIRECTIONS, THRESHOLD, worth
from fluxtwin.sim.base.types import BoolArray, FloatArray
from fluxtwin.sim.effects.chain import Active
from fluxtwin.sim.effects.digits import BitErrors, CoarseQuantization, ExcessNoise

_BITS = 24
_MOST = 0.9
"""Share of the readings that sit on a coarser step: the rest may have bit errors."""
_MOST_SPIKES = 0.8  # share of the spikes that are one bit, or the same bit
_SPIKE = float(stats.norm.pdf(CUT_SIGMA))  # what stands out further is as likely as this by causes that nobody models
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
    sigma_nT = np.maximum(_scatter(np.where(cut, np.nan, residual_nT)), lsb_nT / np.sqrt(12.0))
    spread = np.broadcast_to(sigma_nT, cut.shape)[cut]
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
    # A flip of a lower bit does not stand out.
    large = lsb_nT * powers[: top + 2] > CUT_SIGMA * float(np.median(spread))
    visible = 1.0 if single else max(int(large.sum()), 1) / (top + 2)
    rate, error = (np.array([size / total / visible]) for size in (count, np.sqrt(count)))
    what = f"{count} spikes, {100 * fitting:.0f} % of them a single flipped bit"
    faults = () if fitting >= _MOST_SPIKES else ("the others are not",)
    return Finding(BitErrors(dominant if single else None, "flip", lsb_nT), rate, error, 2.0 * log_bayes, what, faults)


@dataclass(frozen=True, eq=False)
class _Mixture:
    """The likeliest mixture of noise, and of noise about what is added to some readings."""

    rate: float
    sigma: float
    share: FloatArray
    """(N, 3) probability that something is added; 0 where there is no residual."""
    log_likelihood: float


def _mixture(moves_nT: Sequence[FloatArray], residual_nT: FloatArray, sigma_nT: FloatArray) -> _Mixture:
    """moves_nT (N, 3) each: what may be added to a reading, all of them with equal chance, if any; sigma_nT (3,): about that
    of the noise."""
    known = np.isfinite(residual_nT)
    off, *by = (np.where(known, one / sigma_nT, 0.0)[known] for one in (residual_nT, *moves_nT))
    rate, variance, before = 0.01 if by else 0.0, 1.0, -np.inf
    for _ in range(200):
        squares = [off**2, *((off - one) ** 2 for one in by)]
        chances = [1.0 - rate, *(rate / len(by) for _ in by)]
        densities = [np.exp(-0.5 * square / variance) / np.sqrt(2.0 * np.pi * variance) for square in squares]
        whole = _SPIKE + sum(chance * density for chance, density in zip(chances, densities, strict=True))
        shares = [chance * density / whole for chance, density in zip(chances, densities, strict=True)]
        log_likelihood, moved = float(np.sum(np.log(whole))), np.asarray(sum(shares[1:]) + np.zeros(off.size))
        if log_likelihood - before < 0.1:  # far below anything a decision turns on
            break
        before, rate = log_likelihood, float(moved.mean())
        variance = float(
            sum(np.sum(share * square) for share, square in zip(shares, squares, strict=True)) / np.sum(shares)
        )
    slope = (sum(densities[1:]) / max(len(by), 1) - densities[0]) / whole
    every = np.zeros(residual_nT.shape)
    every[known] = moved
    return _Mixture(rate, float(np.sum(slope**2)) ** -0.5, every, log_likelihood)


def hidden_flips(
    reading_nT: FloatArray, residual_nT: FloatArray, cut: BoolArray, lsb_nT: float
) -> tuple[Finding, FloatArray] | None:
    """Is one bit of the codes turned in some readings, though few or none stand out of the noise? And what it added to
    each reading (N, 3), by its probability.

    All (N, 3); cut: the components that stand out. A turned bit moves a reading up where the bit is set now, down where it
    is not: the likelihood of that is set against noise alone, and against moves either way, as heavy tails make them.
    """
    sigma_nT = np.maximum(_scatter(residual_nT), lsb_nT / np.sqrt(12.0))
    largest = float(np.nanmax(np.abs(residual_nT)))
    bits = [bit for bit in range(_BITS) if sigma_nT.min() < 2.0**bit * lsb_nT < largest]
    code = np.rint(np.where(np.isfinite(reading_nT), reading_nT, 0.0) / lsb_nT).astype(np.int64)
    alone = _mixture([], residual_nT, sigma_nT).log_likelihood
    best: tuple[float, int, _Mixture, FloatArray] | None = None
    for bit in bits:
        moved_nT = np.where(code & (1 << bit) != 0, 1.0, -1.0) * 2.0**bit * lsb_nT
        own, either = (_mixture(ways, residual_nT, sigma_nT) for ways in ([moved_nT], [moved_nT, -moved_nT]))
        drop = 2.0 * (own.log_likelihood - max(either.log_likelihood, alone))
        if own.share.sum() > 1.5 and (best is None or drop > best[0]):  # one is a spike
            best = (drop, bit, own, moved_nT * own.share)
    if best is None:
        return None
    drop, bit, flips, moved_nT = best
    value = worth(max(drop, 0.0), 1, float(np.isfinite(residual_nT).sum()), float(np.log(len(bits))))
    what = f"bit {bit} is turned in {100 * flips.rate:.2g} % of the readings"
    hidden_nT = 2.0**bit * lsb_nT * float(np.sqrt(np.mean(flips.share[~cut])))
    size = (np.array([flips.rate]), np.array([flips.sigma]))
    return Finding(BitErrors(bit, "flip", lsb_nT), *size, value, what, hidden_nT=hidden_nT), moved_nT


def _scatter(residual_nT: FloatArray) -> FloatArray:
    """(3,) robust standard deviation of (N, 3)."""
    return np.asarray(MAD_TO_SIGMA * np.nanmedian(np.abs(residual_nT - np.nanmedian(residual_nT, axis=0)), axis=0))


def noise_level(
    left: ProjectedResidual,
    fitted_nT: FloatArray | float,
    declared_nT: float,
    shape_nT: float | None,
    measured: BoolArray | None = None,
    predicted_nT: FloatArray | None = None,
) -> Finding | None:
    """Is the white noise above its budget, and is it noise?

    fitted_nT: the level that the whitening used, one number or (3,); declared_nT: noise and rounding of the budget
    together (with the true step where that is coarser). shape_nT: what named causes may leave because nature's form is not
    theirs; None where something unknown is left. Confirmed beyond both where nothing unknown is left and the values are
    Gaussian and independent of the prediction. measured (N, 3): components that there are, where rows have no attitude; if
    these are few, the others tell, else no single axis is named. predicted_nT (N, 3): None if that is not tested.
    """
    there = np.ones((left.residual.size // 3, 3), dtype=np.bool_) if measured is None else measured
    whole = np.asarray(there.all(axis=1), dtype=np.bool_)
    rows = whole if 2 * whole.sum() > whole.size else there.any(axis=1)
    series, share = left.residual.reshape(-1, 3)[rows], there[rows].mean(axis=0) / there[rows].mean()
    degrees_of_rows = left.degrees * there[rows].sum() / there.sum()
    axis_energy = np.sum(series**2, axis=0) / degrees_of_rows * 3.0 / np.where(share > 0, share, 1.0)
    level = np.maximum(np.asarray(fitted_nT) * np.sqrt(axis_energy), 1e-12)
    expected_nT = float(np.hypot(declared_nT, shape_nT or 0.0))
    noisy = np.log(level / expected_nT) > 2 * NOISE_LOG_SD
    alone = bool(whole[rows].all()) and int(noisy.sum()) == 1
    level_nT = float(level[noisy][0]) if alone else float(np.sqrt(np.sum(share * level**2) / 3.0))
    degrees = degrees_of_rows / 3 if alone else degrees_of_rows
    beyond = float(np.log(level_nT / expected_nT) / np.hypot(NOISE_LOG_SD, np.sqrt(0.5 / degrees)))
    value = worth(max(beyond, 0.0) ** 2, 1, left.degrees / 3.0, float(np.log(3.0)) if alone else 0.0)
    if value <= THRESHOLD:
        return None
    rms = float(np.sqrt(level_nT**2 - declared_nT**2))
    sigma = float(np.hypot(NOISE_LOG_SD * declared_nT**2, level_nT**2 * np.sqrt(0.5 / degrees)) / rms)
    unit = series / np.sqrt(np.where(share > 0, axis_energy, 1.0))
    given = np.any(series != 0, axis=1)
    faults = ["structure remains"] if shape_nT is None else []
    if not gaussian(unit[there[rows] & given[:, None]]):
        faults.append("it is not Gaussian")
    if predicted_nT is not None and repeats_with(predicted_nT[rows][given], unit[given], (shape_nT or 0.0) / level_nT):
        faults.append("it repeats with the reading")
    effect = ExcessNoise(("x", "y", "z")[int(np.argmax(noisy))]) if alone else ExcessNoise()
    where = f" on axis {effect.axis}" if alone else ""
    what = f"white noise is {level_nT:.4g} nT{where}, where {declared_nT:.4g} nT were expected"
    chance = float((3 if alone else 1) * stats.norm.sf(beyond))
    return Finding(effect, np.array([rms]), np.array([sigma]), value, what, tuple(faults), chance=chance)


def repeats_with(predicted_nT: FloatArray, unit: FloatArray, shape: float) -> bool:
    """Whether unit noise (N, 3) is periodic in the predicted reading (N, 3) of an axis, as errors of a converter's code are.

    In the order of time such an error looks white. Noise is white in the order of the predictions too, of which it is
    independent (the readings have it in them); so the strongest of the periods that N values have is weighed as a line in
    time is. shape: rms of the shape error that named causes may leave, in units of the noise.
    """
    worths = [0.0]
    for axis in range(3):
        known = np.isfinite(predicted_nT[:, axis])
        values, series = predicted_nT[known, axis], unit[known]
        if len(values) < FEWEST or not np.ptp(values) > 0:
            continue
        count = len(values) // 2
        place = (values - values.min()) / np.ptp(values)
        cells = 8 * len(values)  # the phase error at the shortest period is 0.2 rad at most
        grid = np.zeros((cells, 3))
        np.add.at(grid, np.rint(place * cells).astype(int) % cells, series)
        power = np.sum(np.abs(np.fft.rfft(grid, axis=0)[1 : count + 1]) ** 2, axis=1)
        phase = 2.0 * np.pi * (1 + int(np.argmax(power))) * place
        q = np.linalg.qr(np.stack([np.ones(len(phase)), np.cos(phase), np.sin(phase)], axis=1))[0]
        wider = 1.0 + shape**2 * series.size / SHAPE_DIRECTIONS
        drop = float(np.sum((q[:, 1:].T @ series) ** 2)) / wider
        worths.append(worth(drop, 6, float(len(values)), float(np.log(3 * count))))
    return max(worths) > THRESHOLD


def with_frozen_noise(
    frozen: Sequence[Active], noise_nT: float | None, lsb_nT: float | None
) -> tuple[float | None, float | None]:
    """White noise and step of the readings with what a scenario's effects add to those declared."""
    for effect, theta in frozen:
        if isinstance(effect, ExcessNoise) and effect.axis == "all" and noise_nT is not None:
            noise_nT = float(np.hypot(noise_nT, theta[0]))
        if isinstance(effect, CoarseQuantization):
            lsb_nT = max(lsb_nT or 0.0, float(theta[0]))
    return noise_nT, lsb_nT


def stochastic_nT(findings: Sequence[Finding], noise: NoiseModel, declared_lsb_nT: float | None) -> float:
    """What the named stochastic effects add to the white noise that the whitening works with, rms per component [nT]."""
    extra = 0.0
    for one in findings:
        if one.name == "coarse_quantization":
            extra += max(float(one.theta[0]) ** 2 - (declared_lsb_nT or 0.0) ** 2, 0.0) / 12.0
        elif one.name == "excess_noise":
            extra += max(noise.white_rms_nT**2 - noise.sigma_prior_nT**2, 0.0)
        extra += one.hidden_nT**2
    stuck = sum(size_nT**2 for size_nT in _stuck_nT(findings))
    return float(np.sqrt(min(extra + stuck, stuck or noise.white_rms_nT**2)))


def _stuck_nT(findings: Sequence[Finding]) -> list[float]:
    """rms per component of each bit that never changes: wrong by its whole size half of the time, b taking the mean."""
    found = []
    for bits in (one.effect for one in findings):
        if isinstance(bits, BitErrors) and bits.kind != "flip":
            assert bits.bit is not None
            size_nT = 0.5 * 2.0**bits.bit * (bits.lsb_nT or 0.0)
            found.append(size_nT if bits.axis == "all" else size_nT / float(np.sqrt(3.0)))
    return found


def floor_noise(findings: Sequence[Finding], noise: NoiseModel, budget: Budget) -> tuple[float, float]:
    """White noise [nT] and attitude error [rad] of what is expected with the named effects.

    As declared, unless a named cause makes the readings noisier; what was not declared is what the whitening works with.
    """
    white, theta = noise.white_rms_nT, noise.theta_rad
    stuck = _stuck_nT(findings)
    louder = any(one.name in ("excess_noise", "coarse_quantization") for one in findings)
    if stuck:
        white = float(np.hypot(noise.sigma_prior_nT, max(stuck)))
    elif budget.noise_nT is not None and not louder:
        white = float(np.hypot(noise.sigma_prior_nT, max((one.hidden_nT for one in findings), default=0.0)))
    if budget.attitude_sigma_rad is not None:
        theta = budget.attitude_sigma_rad
    return white, theta


def in_the_readings(
    problem: Problem,
    whitener: Whitener,
    robust: RobustRows,
    residual_nT: FloatArray,
    fitted_nT: FloatArray,
    shape_nT: float | None,
    found: Sequence[Finding],
) -> tuple[Finding, ...]:
    """Those found before, then what the codes and the level of the noise say, confirmed or not.

    residual_nT (N, 3), fitted_nT (N, 3, q): given the named effects. shape_nT: what these may leave besides noise; None
    where something unknown is left. found: a coarser step and structured causes.
    """
    reading, lsb = np.asarray(problem.telemetry.mag_B_nT), complete_budget(problem).lsb_nT
    noise = whitener.noise
    step = next((float(one.theta[0]) for one in found if one.name == "coarse_quantization"), lsb)
    stuck: Finding | None = None
    findings: list[Finding | None] = [*found]
    whole = problem.measured.all(axis=1)  # elsewhere the axis of a spike is not known
    if lsb is not None and lsb > 0 and step is not None and whole.any():
        stuck = stuck_bit(reading[whole], (reading - residual_nT)[whole], lsb, step)
        findings.append(stuck)
        if stuck is None:
            difference = residual_nT if robust.difference_nT is None else robust.difference_nT
            codes = (reading[whole], difference[whole], robust.cut[whole], lsb)
            flipped = flipped_bits(*codes)
            any_bit = flipped is not None and flipped.confirmed and cast(BitErrors, flipped.effect).bit is None
            hidden = None if any_bit else hidden_flips(*codes)
            if hidden is not None and hidden[0].confirmed:
                flipped, moved_nT = hidden
                residual_nT = residual_nT.copy()
                residual_nT[whole] -= moved_nT
            findings.append(flipped)
    walks = any(one.name == "bias_random_walk" for one in found)
    if noise.sigma_prior_nT > 0 and not walks and not (stuck is not None and stuck.confirmed):
        rest = projected(whitener, residual_nT, fitted_nT)
        measured = None if problem.axes is None else problem.measured
        findings.append(
            noise_level(rest, noise.white_nT, noise.sigma_prior_nT, shape_nT, measured, reading - residual_nT)
        )
    return tuple(finding for finding in findings if finding is not None)
