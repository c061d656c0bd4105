"""Where the gap lies: stage, axis, frame and condition, each with a probability.

Every block (a discrepancy placed at a stage, under a condition, in a frame) and every catalogue effect is a hypothesis,
weighed by the one criterion; within a hypothesis so is each single axis of it. Stages share the prior evenly, blocks the
prior of their stage. One posterior over all of them is summed up four ways, so the four sets of probabilities agree.

Nature is none of the hypotheses exactly. What separates two of them lies along one direction, the difference of their
images, and there the shape error of the right one has a variance of `SHAPE_ERROR`**2 of its energy, added to the noise.

A block is the likeness of a cause that follows a known condition. A cause that follows none (a load that nobody logs, a
clock that runs by the day, rows out of order) still has its stage's image: a late stamp lies along dB/dt, a turn across the
field, and a field of the body is steady in the body while it turns. So for what no effect of the catalogue explains each
stage's quantity may go its own course in time, and half of the stage's prior is its courses'. A course is a Gaussian
process: values at evenly spaced knots, independent and of one variance, with straight lines between them; or a value of its
own in each row. Its evidence at the likeliest variance is that of a random effect (Harville 1977, J. Am. Stat. Assoc. 72,
320).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from scipy.special import expit, softmax

from fluxtwin.gap.detectors.residual_structure import likeliest_step
from fluxtwin.gap.hypotheses.blocks import (
    DEFAULT_BODY,
    OWN_STAGES,
    STAGES,
    Block,
    BlockFit,
    Carrier,
    Dictionary,
    always,
    fit,
    step_block,
)
from fluxtwin.gap.hypotheses.candidates import Candidate
from fluxtwin.gap.linear.projection import SHARE_LEFT, ProjectedResidual, Whitens, orthonormal, projected
from fluxtwin.gap.problem.problem import Problem
from fluxtwin.gap.records.diagnosis import Place
from fluxtwin.gap.selection.criterion import LOG_FURTHER, SHAPE_ERROR, THRESHOLD, penalty
from fluxtwin.gap.selection.score import ALIKE
from fluxtwin.sim.base.types import BoolArray, FloatArray
from fluxtwin.sim.effects.base import STAGES as ALL_STAGES

_NOTHING = "none"


@dataclass(frozen=True, eq=False)
class CourseFit:
    """A course of one stage against a residual."""

    stages: Mapping[str, float]
    """The stages it may belong to, with their prior shares."""
    frame: str | None
    energy: FloatArray
    """(k,) of each independent direction of its columns, whitened and with the fitted columns out of them."""
    square: FloatArray
    """(k,) of the product of each direction with the residual."""

    def worth(self, variance: float, samples: float) -> tuple[float, float, float]:
        """Twice the log of its Bayes factor against noise of that variance, the drop of chi-square, and the parameters
        that bring it, counted by how free they are."""
        sizes = np.exp(np.arange(-12.0, 12.0, 0.5))[:, None]  # over the noise: far beyond what is seen
        free = sizes * self.energy / (1.0 + sizes * self.energy)
        drops = (self.square / self.energy * free).sum(axis=1) / variance
        values = drops - np.log1p(sizes * self.energy).sum(axis=1)
        best = int(np.argmax(values))
        gain = float(values[best])
        return gain - float(penalty(1, max(gain, 0.0), samples)), float(drops[best]), float(free[best].sum())


def courses(problem: Problem, left: ProjectedResidual) -> list[CourseFit]:
    """A course at each stage, in each frame, on each scale. Of 60 gaps of unknown cause on a tuning
    seed (docs/design/ablation.md) the likeliest stage is the true one in 27 without courses, in 39 with them."""
    carrier, steady, seconds = Carrier(problem), always(problem.setting), problem.setting.seconds
    late = carrier.late(steady)
    carried: list[tuple[Mapping[str, float], str | None, FloatArray]] = [
        (DEFAULT_BODY, "body", carrier.additive(steady, "body")),
        ({"sensor": 1.0}, "body", carrier.gain(steady)),
        ({"orbit": 1.0}, "orbital", carrier.moved(steady)),
        ({"time": 1.0}, None, late),
        ({"field": 1.0}, "earth", carrier.additive(steady, "local")),
        *(({"field": 1.0}, frame, carrier.additive(steady, frame)) for frame in ("orbital", "inertial", "earth")),
        *(({"attitude": 1.0}, frame, carrier.turned(steady, frame)) for frame in ("body", "orbital", "inertial")),
    ]
    # Into so many parts the knots cut a record.
    spacings = [float(seconds[-1] - seconds[0]) / parts for parts in (8, 32, 128)]
    scales = [_hats(seconds, one) for one in spacings if one > 2.0 * float(np.median(np.diff(seconds)))]
    smooth = [_smooth(left, *one, scale) for scale in scales for one in carried]
    # A clock does not jump to and fro from row to row; rows that are repeated or out of order do.
    rows_apart = [_of_each_row(left, {"telemetry": 0.5, "time": 0.5}, None, late)]
    rows_apart += [_of_each_row(left, *one) for one in carried if "attitude" in one[0] and one[1] == "body"]
    return [*smooth, *rows_apart]


def _smooth(
    left: ProjectedResidual, stages: Mapping[str, float], frame: str | None, image: FloatArray, scale: FloatArray
) -> CourseFit:
    """image (N, 3, m) of the quantity; scale (N, k) of its course at each knot."""
    columns = (image[:, :, None, :] * scale[:, None, :, None]).reshape(len(image), 3, -1)
    free, size = left.project(columns)
    free /= np.sqrt(np.mean(size))
    energy, direction = np.linalg.eigh(free.T @ free)
    seen = energy > SHARE_LEFT * energy[-1]
    return CourseFit(stages, frame, energy[seen], (direction[:, seen].T @ (free.T @ left.residual)) ** 2)


def _of_each_row(
    left: ProjectedResidual, stages: Mapping[str, float], frame: str | None, image: FloatArray
) -> CourseFit:
    """A value of its own in each row. What the fitted columns take of it is left in: they are few beside the rows."""
    white = left.whitener.apply(np.ascontiguousarray(image))
    direction, size, _ = np.linalg.svd(white / np.sqrt(np.mean(white**2)), full_matrices=False)
    square = (size * np.einsum("nik,ni->nk", direction, left.residual.reshape(-1, 3))) ** 2
    seen = size**2 > SHARE_LEFT  # not where a row is cut
    return CourseFit(stages, frame, size[seen] ** 2, square[seen])


def _hats(seconds: FloatArray, spacing: float) -> FloatArray:
    """(N, k) of a straight line between knots, by its values at those that have rows beside them."""
    place = (seconds - seconds[0]) / spacing
    knots = np.unique(np.floor([place, place + 1.0]))
    return np.asarray(np.maximum(1.0 - np.abs(place[:, None] - knots), 0.0))


@dataclass(frozen=True)
class _Hypothesis:
    stage: str
    frame: str | None
    condition: str | None
    prior: float
    drop: float
    """Of chi-square."""
    worth: float
    fit: BlockFit | None
    """None for a course."""
    seen: tuple[BlockFit, ...] = ()
    """The block in each channel, for residuals of unit variance."""

    def explained(self, columns: BoolArray | None = None) -> tuple[float, int]:
        """By its block, or by some columns of it, in all channels together."""
        every = [one.explained(columns) for one in self.seen]
        return sum(drop for drop, _ in every), sum(rank for _, rank in every)


_Apart = tuple[ProjectedResidual, Sequence[BlockFit], Sequence[CourseFit]]
"""The difference of two magnetometers, and the same blocks and courses fitted to it."""


def where(
    problem: Problem,
    whitener: Whitens,
    residual_nT: FloatArray,
    fitted: FloatArray,
    found: Dictionary,
    candidates: Sequence[Candidate] = (),
    apart: tuple[ProjectedResidual, Sequence[BlockFit]] | None = None,
    *,
    unexplained: bool = False,
) -> Place:
    """Find the place of the largest part of a residual.

    residual_nT (N, 3), fitted (N, 3, q): as for `residual_structure`, with only the calibration fitted if the place of
    the whole gap is asked for. candidates: catalogue effects, which join as hypotheses. apart: the difference of two
    magnetometers, if there are two, and the fits of the blocks found to it. unexplained: what is to be placed is nothing
    that the catalogue has, so courses of any kind join too.
    """
    left = projected(whitener, residual_nT, fitted)
    own = catalogue_blocks(problem, candidates)
    steps = step_fits(problem, left)
    fits = [*found.fits(left), *(fit(block, left) for block in own), *steps]
    free = courses(problem, left) if unexplained else []
    if apart is None:
        return locate(left, fits, free)
    its_left, its_fits = apart
    steps = [replace(fit(one.block, its_left), searched=1) for one in steps]
    its_free = courses(problem, its_left) if unexplained else []
    its_fits = [*its_fits, *(fit(block, its_left) for block in own), *steps]
    return locate(left, fits, free, (its_left, its_fits, its_free))


def step_fits(problem: Problem, left: ProjectedResidual) -> list[BlockFit]:
    """The block of a step at its likeliest moment, a parameter too."""
    return [replace(fit(step_block(problem, likeliest_step(problem.setting.seconds, left)), left), searched=1)]


def locate(
    left: ProjectedResidual, fits: Sequence[BlockFit], free: Sequence[CourseFit] = (), apart: _Apart | None = None
) -> Place:
    """As `where`, from fits that are at hand; apart: the difference of two magnetometers, and the same fits to it."""
    hypotheses = _hypotheses(left, fits, free, apart)
    if not hypotheses:
        nothing = {name: {_NOTHING: 1.0} for name in ("stage", "axis", "frame", "condition")}
        return Place(None, None, None, None, (), nothing)
    priors, samples = np.log([h.prior for h in hypotheses]), left.degrees / 3.0
    worths = np.array([h.worth for h in hypotheses])
    best = int(np.argmax(worths + 2.0 * priors))
    claim = float(worths[best] + 2.0 * priors[best])
    wider = 1.0 + SHAPE_ERROR**2 * hypotheses[best].drop
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
    same = _equivalent(left, hypotheses, at, weight)
    if apart is not None:  # the difference, too, must allow them
        most = {name: max(h.worth for h in hypotheses if h.stage == name) for name in (at, *same)}
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
        "frame": _share([h.frame for h in hypotheses], weight),
        "condition": _share([h.condition for h in hypotheses], weight),
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
    left: ProjectedResidual, fits: Sequence[BlockFit], free: Sequence[CourseFit], apart: _Apart | None
) -> list[_Hypothesis]:
    """Each fit at each of its stages; priors sum to 1."""
    there = [0 < one.explained()[1] < left.degrees - 5 for one in fits]
    seen = [one for one, kept in zip(fits, there, strict=True) if kept]
    if not seen:
        return []
    samples, variance = left.degrees / 3.0, _variance(left, seen, free)
    values = [one.worth(variance, samples) for one in free]
    scaled = [_scaled(one, variance) for one in seen]
    others: Sequence[BlockFit | None] = [None] * len(seen)
    beside = [(0.0, 0.0)] * len(free)
    if apart is not None:
        its_left, its_fits, its_free = apart
        its_seen = [one for one, kept in zip(its_fits, there, strict=True) if kept]
        its_variance = _variance(its_left, its_seen, its_free)
        others = [_scaled(one, its_variance) for one in its_seen]
        beside = [one.worth(its_variance, samples)[:2] for one in its_free]
    found: list[_Hypothesis] = []
    for one, unit, other in zip(seen, scaled, others, strict=True):
        for stage, part in one.block.stages.items():
            channels = _seen(stage, unit, other)
            drop, rank = np.sum([each.explained() for each in channels], axis=0)
            value = float(drop - penalty(rank, drop, samples))
            about = (stage, one.block.frame, one.block.condition)
            found.append(_Hypothesis(*about, one.block.prior * part, float(drop), value, one, channels))
    for course, (value, drop, _), (more, further) in zip(free, values, beside, strict=True):
        for stage, part in course.stages.items():
            own = stage in OWN_STAGES
            total = (drop + further, value + more) if own else (drop, value)
            found.append(_Hypothesis(stage, course.frame, None, part, *total, None))
    return _shared(found)


def _shared(found: Sequence[_Hypothesis]) -> list[_Hypothesis]:
    """With priors that give all stages the same, and within a stage its blocks and its courses."""
    total: dict[tuple[str, bool], float] = {}
    for one in found:
        kind = (one.stage, one.fit is None)
        total[kind] = total.get(kind, 0.0) + one.prior
    kinds = [stage for stage, _ in total]
    stages = len(set(kinds))
    return [
        replace(one, prior=one.prior / total[one.stage, one.fit is None] / kinds.count(one.stage) / stages)
        for one in found
    ]


def _variance(left: ProjectedResidual, fits: Sequence[BlockFit], free: Sequence[CourseFit]) -> float:
    """Of the residual, beside what explains most of it; above zero."""

    def rest(taken: float, rank: float) -> float:
        return max(left.energy - taken, 1e-300) / max(left.degrees - rank, 1)

    variance = rest(*max((one.explained() for one in fits), key=lambda each: each[0]))
    for one in free:
        _, drop, directions = one.worth(variance, left.degrees / 3.0)
        variance = min(variance, rest(drop * variance, directions))
    return variance


def _scaled(one: BlockFit, variance: float) -> BlockFit:
    """A fit to a residual of that variance, as one to a residual of unit variance."""
    return replace(one, gram=one.gram / variance, moment=one.moment / variance, size=one.size / variance)


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
        axes = {"all": one.explained()}
        letters = np.array([] if one.fit is None else list(one.fit.block.axes))
        present = [letter for letter in "xyz" if (letters == letter).any()]
        if present and np.isin(letters, list("xyz")).all():
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


def _equivalent(
    left: ProjectedResidual, hypotheses: Sequence[_Hypothesis], stage: str, weight: FloatArray
) -> tuple[str, ...]:
    """Other stages that can make the image of the best block; of a course, those that these data do not distinguish."""
    own = [value if one.stage == stage else -1.0 for one, value in zip(hypotheses, weight, strict=True)]
    best = hypotheses[int(np.argmax(own))]
    if best.fit is None:
        near = max(one.worth for one in hypotheses if one.stage == stage) - LOG_FURTHER
        same = {one.stage for one in hypotheses if one.worth >= near} - {stage}
        return tuple(name for name in ALL_STAGES if name in same)
    same = set(best.fit.block.stages) - {stage}
    image, _ = left.project(best.fit.block.make())
    gain, rank = best.explained()
    for other in hypotheses:
        # A stage that cannot explain these data cannot make the image either.
        its_gain, its_rank = other.explained()
        if other.fit is None or other.stage in same | {stage} or its_gain < 0.9 * gain or its_rank > 2 * rank + 3:
            continue
        columns, _ = left.project(other.fit.block.make())
        if np.sum((orthonormal(columns).T @ image) ** 2) >= ALIKE * np.sum(image**2):
            same.add(other.stage)
    return tuple(name for name in ALL_STAGES if name in same)
