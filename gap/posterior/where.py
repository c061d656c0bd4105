"""Where the gap lies: stage, axis, frame and condition, each with a probability.

Every block (a discrepancy placed at a stage, under a condition, in a frame) and every catalogue effect is a hypothesis,
weighed by the one criterion; within a hypothesis so is each single axis of it. Stages share the prior evenly, blocks the
prior of their stage. One posterior over all of them is summed up four ways, so the four sets of probabilities agree.

Nature is none of the hypotheses exactly. What separates two of them lies along one direction, the difference of their
images, and there the shape error of the right one has a variance of `_SHAPE_ERROR`**2 of its energy, added to the noise.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from scipy.special import expit, softmax

from fluxtwin.gap.channels.two_magnetometers import OWN_STAGES
from fluxtwin.gap.detectors.residual_structure import likeliest_step
from fluxtwin.gap.hypotheses.blocks import STAGES, Block, step_block
from fluxtwin.gap.hypotheses.candidates import Candidate
from fluxtwin.gap.hypotheses.evidence import BlockFit, Dictionary, fit, fit_all
from fluxtwin.gap.linear.projection import ProjectedResidual, Whitens, projected, share_mimicked
from fluxtwin.gap.problem.problem import Problem
from fluxtwin.gap.records.diagnosis import Place
from fluxtwin.gap.selection.criterion import THRESHOLD, penalty
from fluxtwin.gap.selection.score import ALIKE
from fluxtwin.sim.base.types import BoolArray, FloatArray
from fluxtwin.sim.effects.base import STAGES as ALL_STAGES

_SHAPE_ERROR = 0.25
"""Of the amplitude of what no effect of the catalogue explains: for a block is a cruder likeness of it than an effect is of
its own kind. Of 55 such gaps on tuning seeds (benchmarks/withheld.py, seed 62001) the log score of the true stage is -2.1 at
0.15, -1.7 at 0.2, -1.5 at 0.25, -1.6 at 0.3, -1.8 at 0.4, and at 0.25 a stated 0.8 comes true in 10 of 12."""
_NOTHING = "none"
_QUESTIONS = ("stage", "axis", "frame", "condition")


@dataclass(frozen=True)
class _Hypothesis:
    fit: BlockFit
    stage: str
    seen: tuple[BlockFit, ...]
    """In each channel, for residuals of unit variance."""
    prior: float

    def explained(self, columns: BoolArray | None = None) -> tuple[float, int]:
        """In all channels together."""
        every = [one.explained(columns) for one in self.seen]
        return sum(drop for drop, _ in every), sum(rank for _, rank in every)


def where(
    problem: Problem,
    whitener: Whitens,
    residual_nT: FloatArray,
    fitted: FloatArray,
    found: Dictionary,
    candidates: Sequence[Candidate] = (),
    apart: tuple[ProjectedResidual, Sequence[BlockFit]] | None = None,
) -> Place:
    """Find the place of the largest part of a residual.

    residual_nT (N, 3), fitted (N, 3, q): as for `residual_structure`, with only the calibration fitted if the place of
    the whole gap is asked for. candidates: catalogue effects, which join as hypotheses. apart: the difference of two
    magnetometers, if there are two, and the fits of the blocks found to it.
    """
    left = projected(whitener, residual_nT, fitted)
    own = catalogue_blocks(problem, candidates)
    steps = step_fits(problem, left)
    fits = [*found.fits(left), *fit_all(own, left), *steps]
    if apart is None:
        return locate(left, fits)
    its_left, its_fits = apart
    steps = [replace(fit(one.block, its_left), searched=1) for one in steps]
    return locate(left, fits, (its_left, [*its_fits, *fit_all(own, its_left), *steps]))


def step_fits(problem: Problem, left: ProjectedResidual) -> list[BlockFit]:
    """The block of a step at its likeliest moment, a parameter too."""
    return [replace(fit(step_block(problem, likeliest_step(problem.setting.seconds, left)), left), searched=1)]


def locate(
    left: ProjectedResidual,
    fits: Sequence[BlockFit],
    apart: tuple[ProjectedResidual, Sequence[BlockFit]] | None = None,
) -> Place:
    """As `where`, from fits that are at hand; apart: the difference of two magnetometers, and fits of the same blocks."""
    hypotheses = _hypotheses(left, fits, apart)
    if not hypotheses:
        return Place(None, None, None, None, (), {name: {_NOTHING: 1.0} for name in _QUESTIONS})
    drops, ranks = np.array([h.explained() for h in hypotheses], dtype=np.float64).T
    priors, samples = np.log([h.prior for h in hypotheses]), left.degrees / 3.0
    worths = drops - penalty(ranks, drops, samples)
    best = int(np.argmax(worths + 2.0 * priors))
    claim = float(worths[best] + 2.0 * priors[best])
    wider = 1.0 + _SHAPE_ERROR**2 * float(drops[best])
    weight = float(expit(0.5 * (claim - THRESHOLD))) * softmax(0.5 * worths / wider + priors)
    every = _answers(hypotheses, weight, wider, samples)
    probabilities = {**every, "stage": {**dict.fromkeys(ALL_STAGES, 0.0), **every["stage"]}}
    if claim < THRESHOLD:
        return Place(None, None, None, None, (), probabilities)
    at = max((key for key in probabilities["stage"] if key != _NOTHING), key=lambda key: probabilities["stage"][key])
    # The rest of the answer is of that stage: the likeliest of each on its own need not belong together.
    there = np.array([h.stage == at for h in hypotheses])
    within = _answers(hypotheses, np.where(there, weight, 0.0) / weight[there].sum(), wider, samples)
    axis, frame, condition = (_likeliest(within[name]) for name in ("axis", "frame", "condition"))
    own = hypotheses[int(np.argmax(np.where(there, weight, -1.0)))].fit
    same = _equivalent(left, at, own, fits)
    if apart is not None:  # the difference, too, must allow them
        most: dict[str, float] = {}
        for one, value in zip(hypotheses, worths.tolist(), strict=True):
            most[one.stage] = max(most.get(one.stage, -np.inf), value)
        alike = [name for name in same if (name in OWN_STAGES) == (at in OWN_STAGES)]
        same = tuple(name for name in alike if most[at] - most[name] <= THRESHOLD * wider)
    return Place(at, axis, frame, condition, same, probabilities)


def _answers(
    hypotheses: Sequence[_Hypothesis], weight: FloatArray, wider: float, samples: float
) -> dict[str, dict[str, float]]:
    """Probabilities of the answers to each question."""
    return {
        "stage": _share([h.stage for h in hypotheses], weight),
        "axis": _axes(hypotheses, weight, wider, samples),
        "frame": _share([h.fit.block.frame for h in hypotheses], weight),
        "condition": _share([h.fit.block.condition for h in hypotheses], weight),
    }


def _likeliest(values: dict[str, float]) -> str | None:
    best = max(values, key=lambda key: values[key])
    return None if best == _NOTHING else best


def catalogue_blocks(problem: Problem, candidates: Sequence[Candidate]) -> list[Block]:
    """Catalogue effects as blocks: stage from the effect, frame and condition too."""
    found = []
    for one in candidates:
        effect, condition = one.effect, one.effect.condition_on(problem.setting)
        axes = "".join(p.name[-1] if p.name[-2:] in ("_x", "_y", "_z") else " " for p in effect.parameters)
        label, image = one.name.replace("_", " "), partial(np.asarray, one.jacobian)
        if effect.stage in STAGES:
            found.append(Block({effect.stage: 1.0}, condition, effect.frame, label, axes, image))
    return found


def _hypotheses(
    left: ProjectedResidual,
    fits: Sequence[BlockFit],
    apart: tuple[ProjectedResidual, Sequence[BlockFit]] | None = None,
) -> list[_Hypothesis]:
    """Each fit at each of its stages; priors sum to 1."""
    there = [0 < one.explained()[1] < left.degrees - 5 for one in fits]
    seen = [one for one, kept in zip(fits, there, strict=True) if kept]
    if not seen:
        return []
    scaled = _of_unit_variance(left, seen)
    others: Sequence[BlockFit | None] = [None] * len(seen)
    if apart is not None:
        others = _of_unit_variance(apart[0], [one for one, kept in zip(apart[1], there, strict=True) if kept])
    total: dict[str, float] = {}
    for one in seen:
        for stage, part in one.block.stages.items():
            total[stage] = total.get(stage, 0.0) + one.block.prior * part
    return [
        _Hypothesis(one, stage, _seen(stage, unit, other), one.block.prior * part / total[stage] / len(total))
        for one, unit, other in zip(seen, scaled, others, strict=True)
        for stage, part in one.block.stages.items()
    ]


def _of_unit_variance(left: ProjectedResidual, fits: Sequence[BlockFit]) -> list[BlockFit]:
    """Fits to a residual whose variance is what the best of them leaves."""
    most, rank = max((one.explained() for one in fits), key=lambda each: each[0])
    variance = max((left.energy - most) / max(left.degrees - rank, 1), 1e-300)
    return [
        replace(one, gram=one.gram / variance, moment=one.moment / variance, size=one.size / variance) for one in fits
    ]


def _seen(stage: str, one: BlockFit, other: BlockFit | None) -> tuple[BlockFit, ...]:
    """A block at a stage, in readings and in the difference of two magnetometers: what both share is in the first alone,
    what the sensor does in both alike, what the spacecraft does in the second by another amount."""
    if other is None or stage not in OWN_STAGES:
        return (one,)
    if stage == "spacecraft":
        return (one, replace(other, searched=0))
    return (replace(one, gram=one.gram + other.gram, moment=one.moment + other.moment, size=one.size + other.size),)


def _axes(hypotheses: Sequence[_Hypothesis], weight: FloatArray, wider: float, samples: float) -> dict[str, float]:
    """Probability of each single axis and of "all": within each hypothesis by the criterion, with the shape error in it."""
    keys: list[str | None] = []
    values: list[float] = []
    for one, whole in zip(hypotheses, weight, strict=True):
        axes, letters = {"all": one.explained()}, np.array(list(one.fit.block.axes))
        present = [letter for letter in "xyz" if (letters == letter).any()]
        if np.isin(letters, list("xyz")).all():
            if len(present) == 1:
                axes = {present[0]: axes["all"]}
            else:
                axes |= {letter: one.explained(letters == letter) for letter in present}
        drops, ranks = np.array(list(axes.values())).T
        drops = drops / wider
        keys += axes
        values += (whole * softmax(0.5 * (drops - penalty(ranks, drops, samples)))).tolist()
    return _share(keys, np.array(values))


def _share(keys: Sequence[str | None], weight: FloatArray) -> dict[str, float]:
    """Weight by key, with the rest (and what has no key) as `none`; sums to 1."""
    shares: dict[str, float] = {}
    for key, value in zip(keys, weight, strict=True):
        if key is not None:
            shares[key] = shares.get(key, 0.0) + float(value)
    shares[_NOTHING] = max(0.0, 1.0 - sum(shares.values()))
    total = sum(shares.values())
    return {key: value / total for key, value in sorted(shares.items(), key=lambda item: -item[1])}


def _equivalent(left: ProjectedResidual, stage: str, best: BlockFit, fits: Sequence[BlockFit]) -> tuple[str, ...]:
    """Other stages that can make the image of the stage's best block on this design."""
    same = {other for other in best.block.stages if other != stage}
    image, _ = left.project(best.block.make())
    gain, rank = best.explained()
    for other in fits:
        stages = set(other.block.stages) - {stage} - same
        its_gain, its_rank = other.explained()
        # A stage that cannot explain these data cannot make the image either.
        if not stages or its_gain < 0.9 * gain or its_rank > 2 * rank + 3:
            continue
        columns, _ = left.project(other.block.make())
        if share_mimicked(image, columns) >= ALIKE:
            same |= stages
    return tuple(name for name in ALL_STAGES if name in same)
