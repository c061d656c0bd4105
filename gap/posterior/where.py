"""Where the gap lies: stage, axis, frame and condition, each with a probability.

Every block (a discrepancy placed at a stage, under a condition, in a frame) and every catalogue effect is a
hypothesis with an evidence; so is each single axis of it. Stages share the prior evenly, blocks the prior of
their stage. One posterior over all of them is summed up four ways, so the four sets of probabilities agree.

Nature is none of the blocks exactly, so differences of evidence between blocks are worth less than between a
block and nothing: they are divided by a temperature that grows with the evidence itself (a hypothesis that
explains a few per cent less may still be the right one with another shape).
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any, Protocol

import numpy as np
from scipy.special import expit

from fluxtwin.gap.detectors.residual_structure import step
from fluxtwin.gap.hypotheses.blocks import STAGES, Block, blocks, step_block
from fluxtwin.gap.hypotheses.evidence import Fit, fit, fit_all
from fluxtwin.gap.linear.leftover import Leftover, Whitens, leftover, share_mimicked
from fluxtwin.gap.problem.problem import Problem
from fluxtwin.gap.records.diagnosis import STAGES as ALL_STAGES
from fluxtwin.gap.records.diagnosis import Place
from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.effects.base import Effect

LEAST_LOG_EVIDENCE = 6.0
"""Below this the best hypothesis is no better than "nothing": no claim."""
TEMPERATURE = 1.5
SHAPE_TOLERANCE = 0.05
"""Share of its evidence that the right hypothesis may lose by having another shape than nature."""
AXIS_TOLERANCE = 0.02
"""Share of the evidence that a single axis may lose against all three."""
EQUIVALENT_SHARE = 0.98
_STEP_P = 1e-3
_CATALOGUE_PRIOR = 4.0
_NOTHING = "none"
_QUESTIONS = ("stage", "axis", "frame", "condition")


class HasJacobian(Protocol):
    """An effect with its Jacobian on this design."""

    @property
    def effect(self) -> Effect: ...

    @property
    def jacobian(self) -> FloatArray:
        """(N, 3, p)"""


@dataclass(frozen=True)
class Where:
    """The answer; a value is None where nothing can be said."""

    stage: str | None
    axis: str | None
    frame: str | None
    condition: str | None
    equivalent: tuple[str, ...]
    """Stages whose images on this design are those of `stage`, not counting itself."""
    probabilities: dict[str, dict[str, float]] = field(default_factory=dict)
    log_evidence: float = 0.0
    """Of the best hypothesis against nothing."""
    label: str = ""
    """The best hypothesis in words."""

    @property
    def place(self) -> Place:
        """As the diagnosis records it."""
        return Place(self.stage, self.axis, self.frame, self.condition, self.equivalent, self.probabilities)

    def to_dict(self) -> dict[str, Any]:
        """As the contract has it."""
        return self.place.to_dict()


@dataclass(frozen=True)
class _Hypothesis:
    fit: Fit
    stage: str
    log_evidence: float
    log_prior: float
    axes: dict[str, float]
    """Probability of each axis if the hypothesis is true."""


def where(
    problem: Problem,
    whitener: Whitens,
    residual_nT: FloatArray,
    fitted: FloatArray,
    *,
    found: Sequence[Block] | None = None,
    candidates: Iterable[HasJacobian] = (),
) -> Where:
    """Find the place of the largest part of a residual.

    residual_nT (N, 3), fitted (N, 3, q): as for `what_is_left`, with only the calibration fitted if the place of
    the whole gap is asked for. found: blocks made before. candidates: catalogue effects, which join as hypotheses.
    """
    left = leftover(whitener, residual_nT, fitted)
    fits = fit_all(blocks(problem) if found is None else found, left)
    return locate(left, [*fits, *fit_all(catalogue_blocks(problem, candidates), left), *step_fits(problem, left)])


def step_fits(problem: Problem, left: Leftover) -> list[Fit]:
    """The block of a step at its likeliest moment, if the cumulated sums show one."""
    p_value, moment_s = step(problem.setting.seconds, left)
    return [fit(step_block(problem, moment_s), left)] if p_value < _STEP_P else []


def locate(left: Leftover, fits: Sequence[Fit]) -> Where:
    """As `where`, from fits that are at hand."""
    hypotheses = _hypotheses(left, fits)
    if not hypotheses:
        return Where(None, None, None, None, (), {name: {_NOTHING: 1.0} for name in _QUESTIONS}, 0.0, "no claim")
    logs = np.array([h.log_evidence for h in hypotheses])
    priors = np.array([h.log_prior for h in hypotheses])
    best = int(np.argmax(logs))
    something = float(expit(np.logaddexp.reduce(logs + priors)))
    temperature = max(TEMPERATURE, SHAPE_TOLERANCE * float(logs[best]))
    heat = logs / temperature + priors
    weight = something * np.exp(heat - np.logaddexp.reduce(heat))
    stage = _share([h.stage for h in hypotheses], weight)
    probabilities = {
        "stage": {**dict.fromkeys(ALL_STAGES, 0.0), **stage},
        "axis": _axes(hypotheses, weight),
        "frame": _share([h.fit.block.frame for h in hypotheses], weight),
        "condition": _share([h.fit.block.condition for h in hypotheses], weight),
    }
    if logs[best] < LEAST_LOG_EVIDENCE or something < 0.5:
        return Where(None, None, None, None, (), probabilities, float(logs[best]), "no claim")
    likeliest = {
        name: max((key for key in values if key != _NOTHING), key=lambda key: values[key], default=None)
        for name, values in probabilities.items()
    }
    for name in ("axis", "frame", "condition"):
        value = likeliest[name]
        if value is not None and probabilities[name].get(_NOTHING, 0.0) > probabilities[name][value]:
            likeliest[name] = None
    at = likeliest["stage"]
    assert at is not None
    same = _equivalent(left, at, _strongest(hypotheses, weight, at).fit, fits)
    return Where(
        at,
        likeliest["axis"],
        likeliest["frame"],
        likeliest["condition"],
        same,
        probabilities,
        float(logs[best]),
        _strongest(hypotheses, weight, at).fit.block.label,
    )


def catalogue_blocks(problem: Problem, candidates: Iterable[HasJacobian]) -> list[Block]:
    """Catalogue effects as blocks: stage from the effect, frame and condition too."""
    found = []
    for candidate in candidates:
        effect = candidate.effect
        condition = effect.condition_on(problem.setting)
        stages = {candidate.effect.stage: 1.0}
        if candidate.effect.stage not in STAGES:
            continue
        axes = "".join(_axis_of(p.name) for p in candidate.effect.parameters)
        width = candidate.jacobian.shape[2]
        axes = axes if len(axes) == width else " " * width
        jacobian = candidate.jacobian
        label = candidate.effect.name.replace("_", " ")
        found.append(
            Block(stages, condition, effect.frame, label, axes, partial(np.asarray, jacobian), _CATALOGUE_PRIOR)
        )
    return found


def _axis_of(name: str) -> str:
    return name[-1] if len(name) > 1 and name[-2] == "_" and name[-1] in "xyz" else " "


def _hypotheses(left: Leftover, fits: Sequence[Fit]) -> list[_Hypothesis]:
    """Each fit at each of its stages; priors sum to 1."""
    raw = []
    for one in fits:
        evidence, axes = _by_axis(left, one)
        if np.isfinite(evidence):
            raw += [(one, stage, evidence, one.block.prior * part, axes) for stage, part in one.block.stages.items()]
    total: dict[str, float] = {}
    for _, stage, _, prior, _ in raw:
        total[stage] = total.get(stage, 0.0) + prior
    return [
        _Hypothesis(one, stage, evidence, float(np.log(prior / total[stage] / len(total))), axes)
        for one, stage, evidence, prior, axes in raw
    ]


def _by_axis(left: Leftover, one: Fit) -> tuple[float, dict[str, float]]:
    """Evidence of a block with its axes free, and the probability of each axis given the block.

    A single axis may lose a little evidence against all three (nature's axes are not quite the body's).
    """
    whole = one.log_evidence(left)
    letters = np.array(list(one.block.axes))
    if not np.isfinite(whole) or not np.isin(letters, list("xyz")).all():
        return whole, {"all": 1.0}
    present = [letter for letter in "xyz" if (letters == letter).any()]
    if len(present) == 1:
        return whole, {present[0]: 1.0}
    logs = {"all": whole + np.log(0.5)}
    for letter in present:
        logs[letter] = one.log_evidence(left, letters == letter) + np.log(0.5 / len(present))
    evidence = float(np.logaddexp.reduce(list(logs.values())))
    allowed = AXIS_TOLERANCE * max(whole, 0.0)
    heat = {
        letter: (value + (min(max(whole - value, 0.0), allowed) if letter != "all" else 0.0)) / TEMPERATURE
        for letter, value in logs.items()
    }
    norm = np.logaddexp.reduce(list(heat.values()))
    return evidence, {letter: float(np.exp(value - norm)) for letter, value in heat.items()}


def _axes(hypotheses: Sequence[_Hypothesis], weight: FloatArray) -> dict[str, float]:
    keys = [axis for h in hypotheses for axis in h.axes]
    values = [w * p for h, w in zip(hypotheses, weight, strict=True) for p in h.axes.values()]
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


def _strongest(hypotheses: Sequence[_Hypothesis], weight: FloatArray, stage: str) -> _Hypothesis:
    return max(zip(hypotheses, weight, strict=True), key=lambda pair: pair[1] if pair[0].stage == stage else -1.0)[0]


def _equivalent(left: Leftover, stage: str, best: Fit, fits: Sequence[Fit]) -> tuple[str, ...]:
    """Other stages that can make the image of the stage's best block on this design."""
    same = {other for other in best.block.stages if other != stage}
    image, _ = left.project(best.block.make())
    _, explained = best.modes()
    for other in fits:
        stages = set(other.block.stages) - {stage} - same
        _, gain = other.modes()
        # A stage that cannot explain these data cannot make the image either.
        if not stages or gain.sum() < 0.9 * explained.sum() or gain.size > 2 * explained.size + 3:
            continue
        columns, _ = left.project(other.block.make())
        if share_mimicked(image, columns) >= EQUIVALENT_SHARE:
            same |= stages
    return tuple(name for name in ALL_STAGES if name in same)
