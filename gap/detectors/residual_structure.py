"""What is left once calibration and the named effects are out: is there structure, and what does it look like?

Five ways to look, all weighed by one criterion: blocks of columns, one line of any frequency (three-axis periodogram), one
step (cumulated sums), drift (energy of block means at growing lengths), and parameters of their own for each part of the
record (Chow 1960, Econometrica 28, 591).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from fluxtwin.gap.detectors.finding import in_parts
from fluxtwin.gap.detectors.lines import independent_frequencies, strongest_line
from fluxtwin.gap.hypotheses.blocks import BlockFit, Dictionary, blocks, fit, step_block
from fluxtwin.gap.linear.projection import (
    SHARE_LEFT,
    ProjectedResidual,
    Whitens,
    explained,
    log10_sf_f,
    projected,
    projected_out,
)
from fluxtwin.gap.problem.problem import Problem
from fluxtwin.gap.selection.criterion import SHAPE_DIRECTIONS, THRESHOLD, of_shape, worth
from fluxtwin.sim.base.types import FloatArray

PARTS = (2, 5)


@dataclass(frozen=True)
class Structure:
    """The finding of most worth in a residual."""

    worth: float
    drop: float
    """Of chi-square, by the finding."""
    kind: str
    """`block`, `tone`, `step`, `drift`, `parts` or `none`."""
    words: str
    condition: str | None = None
    frame: str | None = None
    rank: int = 0
    log_tried: float = 0.0
    of_named: bool = False
    """Whether it is one more waveform of a cause that is named: no other one need be there."""

    @property
    def structured(self) -> bool:
        return self.worth > THRESHOLD

    def beyond(self, explained: float, samples: float) -> float:
        """Worth beside the shape error of causes that explain so much of chi-square.

        By its direction, the best of those tried; or by its size, beyond what shape errors have in all of theirs: of these,
        other than of the noise, none was looked for.
        """
        wider = 1.0 + of_shape(explained, max(self.rank, 1))
        if not self.rank:
            return self.worth / wider
        drop = self.drop / wider
        return max(
            worth(drop, self.rank, samples, self.log_tried),
            worth(drop, max(self.rank, SHAPE_DIRECTIONS), samples, self.log_tried / wider),
        )


def residual_structure(
    problem: Problem, whitener: Whitens, residual_nT: FloatArray, fitted: FloatArray, found: Dictionary | None = None
) -> Structure:
    """Search a residual for structure.

    residual_nT (N, 3): reading less the best prediction; fitted (N, 3, q): Jacobian of everything that was fitted,
    calibration included. Both in nT; they are whitened here. found: blocks made before for this design.
    """
    left = projected(whitener, residual_nT, fitted)
    fits = [fit(block, left) for block in blocks(problem)] if found is None else found.fits(left)
    return judge(problem, left, fits)


def judge(
    problem: Problem,
    left: ProjectedResidual,
    fits: Sequence[BlockFit],
    own: FloatArray | None = None,
    variance: float | None = None,
) -> Structure:
    """As `residual_structure`, from fits of blocks that are at hand.

    own (N, 3, p): whitened columns of the named effects, which keep their parameters or not. variance: of whitened rows,
    default that of the residual.
    """
    unit = left.energy / left.degrees if variance is None else variance
    seconds, samples = problem.setting.seconds, left.degrees / 3.0
    tried = float(np.log(max(len(fits), 1)))

    def clue(kind: str, found: tuple[float, int], log_tried: float, words: str, **place: Any) -> Structure:
        """place: `condition` and `frame`."""
        drop, rank = found[0] / unit, found[1]
        value = worth(drop, rank, samples, log_tried)
        return Structure(value, drop, kind, words, rank=rank, log_tried=log_tried, **place)

    clues: list[Structure] = []
    for one in fits:
        block, axes = one.block, f", coherent in the {one.block.frame} frame" if one.block.frame else ""
        words = f"structure that follows {block.label}{axes}"
        clues.append(clue("block", one.explained(), tried, words, condition=block.condition, frame=block.frame))
    line = strongest_line(seconds, left)
    if line.frequency_Hz > 0:
        words, frequencies = f"a line at a period of {1 / line.frequency_Hz:.0f} s", independent_frequencies(seconds)
        clues.append(clue("tone", (line.explained, 6), float(np.log(frequencies)), words))
    step_s = likeliest_step(seconds, left)
    words, gain = f"a step {step_s:.0f} s after the first sample", fit(step_block(problem, step_s), left).explained()
    clues.append(clue("step", gain, float(np.log(seconds.size)), words, condition="after_time"))
    log10_p, excess = drift(left)
    words = "a slow drift that follows no known condition"
    clues.append(Structure(-2.0 * log10_p * float(np.log(10.0)), excess / unit, "drift", words, "time"))
    if own is not None and own.shape[2]:
        for count, gain in zip(PARTS, parts(left, own), strict=True):
            words = f"the parameters differ between the {count} parts of the record"
            clues.append(clue("parts", gain, float(np.log(len(PARTS))), words, condition="time"))
    best = max(clues, key=lambda clue: clue.worth)
    if best.worth <= THRESHOLD:
        return Structure(best.worth, 0.0, "none", "no structure remains")
    return best


def parts(left: ProjectedResidual, own: FloatArray) -> list[tuple[float, int]]:
    """What parameters of their own for each of two, or five, parts explain, and their number."""
    found = []
    for count in PARTS:
        cut = np.concatenate(in_parts(own, count)[:-1], axis=2).reshape(3 * len(own), -1)
        size = np.linalg.norm(cut, axis=0)
        cut = projected_out(left.basis, cut[:, size > 0] / size[size > 0])
        found.append(explained(cut.T @ cut, cut.T @ left.residual, SHARE_LEFT))
    return found


def likeliest_step(seconds: FloatArray, left: ProjectedResidual) -> float:
    """Likeliest moment of a step, from the first stamp: by cumulated sums of the whitened residual, one an axis."""
    series = left.residual.reshape(-1, 3)
    rows, bridge = len(series), np.cumsum(series - series.mean(axis=0), axis=0)
    share = (np.arange(rows) + 1.0) / rows
    inside = (share > 0.02) & (share < 0.98)
    score = np.sum(bridge**2, axis=1) / np.where(inside, share * (1 - share), np.inf)
    return float(seconds[min(int(np.argmax(score)) + 1, rows - 1)])


def drift(left: ProjectedResidual) -> tuple[float, float]:
    """log10 p-value of too much energy at long scales, and the excess, as energy.

    Means over blocks of 4, 16, 64, ... samples (an Allan-like scale) hold a known share of the energy of white
    noise; the fitted columns' share is taken out exactly. F against the rest, less a tolerance: the slow part of the
    attitude error, which the whitening cannot know better than to 15 % rms.
    """
    tolerance = 1.15**2
    series = left.residual.reshape(-1, 3)
    rows = series.shape[0]
    lengths = [length for length in (4**n for n in range(1, 10)) if rows // length >= 6]
    found = [(0.0, 0.0)]
    for length in lengths:
        means = _block_means(series, length)
        basis = _block_means(left.basis.reshape(rows, 3, -1), length)
        degrees = _block_degrees(left, means.size, length) - float(np.sum(basis**2))
        energy = float(np.sum(means**2))
        spare = left.degrees - degrees
        if degrees < 3 or spare < 10:
            continue
        rest = max((left.energy - energy) / spare, 1e-300)
        ratio = (energy / degrees) / rest / tolerance
        if ratio > 1:
            found.append((log10_sf_f(ratio, degrees, spare), energy - degrees * rest * tolerance))
    log10_p, excess = min(found)
    return min(float(log10_p + np.log10(max(len(lengths), 1))), 0.0), excess


def _block_degrees(left: ProjectedResidual, most: int, length: int) -> float:
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
