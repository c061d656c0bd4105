"""What is left once calibration and the named effects are out: is there structure, and what does it look like?

Four searches, each with its own exact or analytic law: blocks of columns (F tests), one line of any frequency
(three-axis periodogram), one step (cumulated sums against the Brownian bridge), drift (energy of block means at
growing lengths against short scales).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import stats

from fluxtwin.gap.blocks import Block, blocks, step_block
from fluxtwin.gap.evidence import Fit, Leftover, Whitens, fit, fit_all, leftover, log10_sf_f
from fluxtwin.gap.problem import Problem
from fluxtwin.gap.tones import Tone, strongest_tone
from fluxtwin.sim.base.types import FloatArray

ALPHA = 0.002
"""False-alarm rate of the four searches together when the noise is what the whitening takes it for."""
NOISE_TOLERANCE = 1.15**2
"""How much larger the noise energy at long scales may be than at short ones before it is called drift: the slow
part of the attitude error, which the whitening cannot know better than to 15 % rms."""
_SEARCHES = 4


@dataclass(frozen=True)
class Left:
    """What was found in a residual."""

    structured: bool
    p_value: float
    """Corrected for all four searches."""
    condition: str | None
    frame: str | None
    kind: str
    """`block`, `tone`, `step`, `drift` or `none`: what the structure resembles most."""
    words: str
    p_values: dict[str, float]
    """By search, each corrected for the number of its alternatives."""
    label: str = ""
    """Which variant of the condition."""
    frequency_Hz: float | None = None
    """Of the strongest line."""
    step_s: float | None = None
    """Likeliest moment of a step, from the first stamp."""


@dataclass(frozen=True)
class _Clue:
    kind: str
    log10_p: float
    explained: float
    price: float
    """Parameters that were free, settings that were searched included."""


def what_is_left(
    problem: Problem,
    whitener: Whitens,
    residual_nT: FloatArray,
    fitted: FloatArray,
    *,
    found: Sequence[Block] | None = None,
    alpha: float = ALPHA,
) -> Left:
    """Search a residual for structure.

    residual_nT (N, 3): reading less the best prediction; fitted (N, 3, q): Jacobian of everything that was fitted,
    calibration included. Both in nT; they are whitened here. found: blocks made before for this design.
    """
    left = leftover(whitener, residual_nT, fitted)
    tests = fit_all(blocks(problem) if found is None else found, left)
    return judge(problem, left, tests, alpha=alpha)


def judge(problem: Problem, left: Leftover, fits: Sequence[Fit], *, alpha: float = ALPHA) -> Left:
    """As `what_is_left`, from fits that are at hand."""
    seconds = problem.setting.seconds
    scored = [(*one.f_test(left), one.block) for one in fits]
    best = min(scored, key=lambda item: item[0])
    tone = strongest_tone(seconds, left)
    step_p, step_s = step(seconds, left)
    drift_p = drift(left)
    logs = {
        "block": float(best[0] + np.log10(len(scored))),
        "tone": tone.log10_p,
        "step": float(np.log10(max(step_p, 1e-300))),
        "drift": drift_p,
    }
    smallest = min(logs.values())
    p_value = float(min(1.0, _SEARCHES * 10**smallest))
    p_values = {name: float(min(1.0, 10**value)) for name, value in logs.items()}
    if p_value >= alpha:
        words = "nothing structured is left"
        return Left(False, p_value, None, None, "none", words, p_values, "", tone.frequency_Hz, step_s)
    kind = _kind(problem, left, logs, best, tone, step_s)
    block = best[3]
    named = kind == "block"
    condition = block.condition if named else {"step": "after_time", "drift": "time"}.get(kind)
    frame = block.frame if named else None
    return Left(
        True,
        p_value,
        condition,
        frame,
        kind,
        _words(kind, block, tone, step_s),
        p_values,
        block.label if named else kind,
        tone.frequency_Hz,
        step_s,
    )


def step(seconds: FloatArray, left: Leftover) -> tuple[float, float]:
    """p-value of a step and its likeliest moment.

    Cumulated sums of the whitened residual, one an axis, against the largest excursion of a Brownian bridge
    (Kolmogorov's law), times three axes. The projection of the fitted columns only lowers them.
    """
    series = left.residual.reshape(-1, 3)
    rows = series.shape[0]
    scale = np.sqrt(max(left.energy / left.degrees, 1e-300) * rows)
    bridge = np.cumsum(series - series.mean(axis=0), axis=0) / scale
    p = 3 * float(stats.kstwobign.sf(np.abs(bridge).max(axis=0).max()))
    share = (np.arange(rows) + 1.0) / rows
    inside = (share > 0.02) & (share < 0.98)
    score = np.sum(bridge**2, axis=1) / np.where(inside, share * (1 - share), np.inf)
    row = min(int(np.argmax(score)) + 1, rows - 1)
    return min(p, 1.0), float(seconds[row])


def drift(left: Leftover) -> float:
    """log10 p-value of too much energy at long scales.

    Means over blocks of 4, 16, 64, ... samples (an Allan-like scale) hold a known share of the energy of white
    noise; the fitted columns' share is taken out exactly. F against the rest, less a tolerance.
    """
    series = left.residual.reshape(-1, 3)
    rows = series.shape[0]
    lengths = [length for length in (4**n for n in range(1, 10)) if rows // length >= 6]
    found = [0.0]
    for length in lengths:
        means = _block_means(series, length)
        basis = _block_means(left.basis.reshape(rows, 3, -1), length)
        degrees = _block_degrees(left, means.size, length) - float(np.sum(basis**2))
        energy = float(np.sum(means**2))
        spare = left.degrees - degrees
        if degrees < 3 or spare < 10:
            continue
        ratio = (energy / degrees) / max((left.energy - energy) / spare, 1e-300) / NOISE_TOLERANCE
        found.append(log10_sf_f(ratio, degrees, spare) if ratio > 1 else 0.0)
    return float(min(found) + np.log10(max(len(lengths), 1)))


def _block_degrees(left: Leftover, most: int, length: int) -> float:
    """Degrees of freedom of the block means of white noise; less than `most` where components are not measured."""
    weights = getattr(left.whitener, "weights", None)
    if weights is None:
        return float(most)
    return float(np.sum(_block_means((weights > 0).astype(float), length))) / float(np.sqrt(length))


def _block_means(series: FloatArray, length: int) -> FloatArray:
    """Sums over blocks of rows over the root of their length: orthonormal combinations."""
    count = series.shape[0] // length
    grouped = series[: count * length].reshape(count, length, *series.shape[1:])
    return np.asarray(grouped.sum(axis=1) / np.sqrt(length))


def _kind(
    problem: Problem,
    left: Leftover,
    logs: dict[str, float],
    best: tuple[float, float, int, Block],
    tone: Tone,
    step_s: float,
) -> str:
    """What the structure resembles most: the search whose fit is worth most after its price (as in BIC)."""
    price = np.log(left.degrees)
    jump = step_block(problem, step_s)
    _, gain, rank = fit(jump, left).f_test(left)
    log_gate = np.log10(ALPHA / _SEARCHES)
    clues = [
        _Clue("block", logs["block"], best[1], best[2] + 1),
        _Clue("tone", logs["tone"], tone.explained, 6 + 2),
        _Clue("step", logs["step"], gain, rank + 2),
    ]
    clues = [c for c in clues if c.log10_p < log_gate] or [_Clue("drift", logs["drift"], 0.0, 0.0)]

    def worth(clue: _Clue) -> float:
        rest = max(left.energy - clue.explained, 1e-300)
        return -left.degrees * float(np.log(rest / left.energy)) - clue.price * float(price)

    winner = max(clues, key=worth)
    return winner.kind if winner.kind == "drift" or worth(winner) > 0 else "drift"


def _words(kind: str, block: Block, tone: Tone, step_s: float) -> str:
    if kind == "tone":
        return f"a line at a period of {1 / tone.frequency_Hz:.0f} s" if tone.frequency_Hz else "a line"
    if kind == "step":
        return f"a step {step_s:.0f} s after the first sample"
    if kind == "drift":
        return "slow wandering that follows no condition"
    frame = f", coherent in the {block.frame} frame" if block.frame else ""
    return f"structure that follows {block.label}{frame}"
