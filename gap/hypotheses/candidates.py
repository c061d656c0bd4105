"""The causes to be tested: every effect of the catalogue that is not re-estimated, with its image in the readings.

The image is the Jacobian of the noise-free chain at the best present fit. Columns that move nothing (a panel never
lit, a torquer axis never fired) are dropped one by one; an effect with no column left is untestable, not absent.

Some images the error of the reference attitude makes by itself. Regressors like the sun's direction in body axes and the
body rate are made of the recorded attitude. Where the body hardly turns they hold little but the attitude's error, and the
residual holds the same error as theta x B: the two correlate, and mere noise looks like a cause (errors in variables: Fuller
1987, Measurement Error Models, section 1.1). The design is made a second time with one more attitude error of the same size;
what does not come out alike is no evidence of anything.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property

import numpy as np

from fluxtwin.gap.linear.projection import span_of
from fluxtwin.gap.problem.problem import Problem
from fluxtwin.sim.attitude.gauss_markov import gauss_markov
from fluxtwin.sim.attitude.recorded_motion import RecordedMotion
from fluxtwin.sim.base.types import BoolArray, FloatArray
from fluxtwin.sim.effects.base import Effect, SignalEffect
from fluxtwin.sim.effects.catalogue import CATALOGUE
from fluxtwin.sim.effects.chain import Active, Chain, jacobian
from fluxtwin.sim.effects.digits import BitErrors
from fluxtwin.sim.effects.signal import Setting

OF_ERRORS = (
    "what the calibration cannot imitate of its signature comes mostly from errors of the reference attitude: the body "
    "would have to turn further"
)
_DEAD_NT = 1e-6  # a parameter of its typical size that moves the readings by less is not there
MOST_CHANGED = 0.3
"""Share of an image's energy that may change with the attitude's error."""
SLOW_S = 300.0
"""Errors of the attitude last minutes."""
_SEED = 12


@dataclass(frozen=True, eq=False)
class Candidate:
    """One alternative: an effect with its discrete settings."""

    effect: SignalEffect
    jacobian: FloatArray
    """(M, 3, p) derivative of the reading by its parameters, nT per unit."""
    live: BoolArray
    """(p,) columns that move anything."""
    change: float = 0.0
    """Share of its image, beside what is modelled, that another attitude error would change."""

    @property
    def name(self) -> str:
        return self.effect.name

    @cached_property
    def label(self) -> str:
        """The name with its settings."""
        settings = settings_of(self.effect)
        inside = ", ".join(f"{key}={value}" for key, value in settings.items())
        return f"{self.name}({inside})" if inside else self.name

    @cached_property
    def scale(self) -> FloatArray:
        """(p,) typical sizes of its parameters."""
        return np.array([parameter.scale for parameter in self.effect.parameters])


def candidates(problem: Problem, perturbed: PerturbedDesign | None = None) -> tuple[list[Candidate], dict[str, str]]:
    """All alternatives of all signal effects that are not modelled, and why others cannot be tested: {name: reason}.

    perturbed: the design with one more attitude error, if at hand.
    """
    taken = {effect.name for effect in problem.modelled}
    on = [*problem.frozen, *problem.modelled_active]
    perturbed = perturbed or PerturbedDesign(problem)
    found: list[Candidate] = []
    untestable: dict[str, str] = {}
    for effect in (one for kind in CATALOGUE for one in kind.instances(problem.setting)):
        if effect.name in taken:
            continue
        reason, possible = _not_reported(effect, problem), []
        if reason is None and isinstance(effect, SignalEffect):
            possible = [one for one in effect.alternatives(problem.setting) if isinstance(one, SignalEffect)]
        if possible:
            reasons = [one.untestable(problem.setting) for one in possible]
            reason = None if None in reasons else reasons[0]
        if possible and reason is None:
            seen: dict[Effect, FloatArray] = {}
            every = (_candidate(problem.design, alternative, on, perturbed, seen) for alternative in possible)
            testable = [candidate for candidate in every if candidate.live.any()]
            firm = [candidate for candidate in testable if candidate.change <= MOST_CHANGED]
            nothing = "nothing in these data excites it: at its typical size it would not change any reading"
            reason = None if firm else OF_ERRORS if testable else nothing
            found += firm
        if reason is not None:
            untestable[effect.name] = reason
    return found, untestable


def candidate_of(problem: Problem, effect: SignalEffect, *, modelled: Sequence[Active]) -> Candidate:
    """One alternative that `candidates` does not try, linearised beside what is modelled."""
    return made(effect, jacobian(problem.design, effect, [*problem.frozen, *modelled]), _DEAD_NT)


def made(effect: SignalEffect, image: FloatArray, least: float) -> Candidate:
    """An alternative with its image (M, 3, p). least: rms by which a parameter of its typical size moves something."""
    scale = np.array([parameter.scale for parameter in effect.parameters])
    return Candidate(effect, image, np.sqrt(np.mean(image**2, axis=(0, 1))) * scale > least)


def _not_reported(effect: Effect, problem: Problem) -> str | None:
    """Why an effect is not to be tested: another measurement rules it out, or no attitude was reported."""
    if effect.name in problem.ruled_out:
        return f"another measurement rules it out: {problem.ruled_out[effect.name]}"
    if problem.axes is None or problem.axes.known.any():
        return None
    if isinstance(effect, BitErrors):
        return "no row has a reference attitude, so the axis and the bit of a spike are not known"
    return "no row has a reference attitude" if effect.stage == "attitude" else None


def settings_of(effect: Effect) -> dict[str, object]:
    """Settings of an effect that can be written in a word: numbers, words, flags, region edges, a panel's normal."""
    given = {item.name: getattr(effect, item.name) for item in fields(effect) if item.compare}
    return {
        key: list(value) if isinstance(value, tuple) else value
        for key, value in given.items()
        if isinstance(value, int | float | str) or (key in ("region_deg", "panel") and value is not None)
    }


def _candidate(
    chain: Chain, effect: SignalEffect, on: Sequence[Active], perturbed: PerturbedDesign, seen: dict[Effect, FloatArray]
) -> Candidate:
    """seen: images of effects that others modulate, made so far; more are added."""
    whole, share = effect.modulates(chain.setting) or (effect, np.ones((1, 1)))
    if whole not in seen:
        assert isinstance(whole, SignalEffect)
        seen[whole] = jacobian(chain, whole, on)
    one = made(effect, seen[whole] * share[:, None, :], _DEAD_NT)
    return replace(one, change=perturbed.change(effect, one.jacobian, on)) if one.live.any() else one


def alike(columns: FloatArray, again: FloatArray | None) -> bool:
    """Whether columns (N, k) are alike in a design with one more attitude error, but for a small share of their energy."""
    if again is None or again.shape != columns.shape:
        return False
    level, other = columns - columns.mean(axis=0), again - again.mean(axis=0)
    return bool(np.sum((level - other) ** 2) <= MOST_CHANGED * np.sum(level**2))


class PerturbedDesign:
    """The design of a problem with one more attitude error in it."""

    def __init__(self, problem: Problem, errors: Sequence[tuple[float, float]] | None = None) -> None:
        """errors: sigma [rad] and time constant [s] of the parts of the error; None: those of `attitude_error_rad`."""
        self.problem = problem
        motion = problem.setting.motion
        parts = parts_of(attitude_error_rad(problem)) if errors is None else errors
        self.chain: Chain | None = None
        self._latest: tuple[Effect, Sequence[Active], FloatArray] | None = None
        if not any(size > 0 for size, _ in parts) or not isinstance(motion, RecordedMotion):
            return
        rng = np.random.default_rng(_SEED)
        perturbed = motion.with_errors(
            lambda time: np.sum([gauss_markov(time, size, tau_s, rng, columns=3) for size, tau_s in parts], axis=0)
        )
        self.chain = Chain(replace(problem.setting, motion=perturbed.along_track()))

    @property
    def setting(self) -> Setting | None:
        """The design that is perturbed; None where the attitude has no error."""
        return None if self.chain is None else self.chain.setting

    def change(self, effect: Effect, image: FloatArray, on: Sequence[Active]) -> float:
        """Share of the energy of an effect's image that changes, beside what is modelled.

        image (N, 3, p) of the effect at nothing, with `on` on, in body axes; all its parameters move together, each by
        its typical size, with signs that are drawn once.
        """
        if self.chain is None:
            return 0.0
        step = _step(effect)
        carrier, share = effect.modulates(self.chain.setting) or (effect, np.ones((1, 1)))
        inner = _step(carrier)
        share = share if share.shape[1] == 1 else (share @ step / inner)[:, None]
        moved = self._moved(carrier, inner, on) * share
        first, again = self._beside(image @ step), self._beside(moved)
        whole = float(np.sum(first**2))
        return float(np.sum((again - first) ** 2)) / whole if whole > 0 else 0.0

    def _moved(self, effect: Effect, step: FloatArray, on: Sequence[Active]) -> FloatArray:
        """(N, 3) by how much an effect from nothing, or from minus the step, to the step moves the readings, for a step."""
        if self._latest is None or self._latest[0] != effect or self._latest[1] is not on:
            low, high = (np.array([getattr(p, end) for p in effect.parameters]) for end in ("low", "high"))
            up, down = np.clip(step, low, high), np.clip(-step, low, high)
            assert self.chain is not None
            readings = [self.chain.reading_nT([*on, (effect, end)]) for end in (up, down)]
            share = float(np.max(np.abs(up - down) / np.abs(step)))
            self._latest = effect, on, (readings[0] - readings[1]) / share
        return self._latest[2]

    def _beside(self, image: FloatArray) -> FloatArray:
        flat = self.problem.in_row_axes(image).reshape(-1)
        return np.asarray(flat - self._basis @ (self._basis.T @ flat))

    @cached_property
    def _basis(self) -> FloatArray:
        nuisance = self.problem.in_row_axes(self.problem.nuisance)
        flat = nuisance.reshape(3 * self.problem.rows, nuisance.shape[2])  # none where nothing is modelled
        return span_of(flat).basis(flat)


def parts_of(sigma_rad: float) -> list[tuple[float, float]]:
    """Sigma [rad] and time constant [s] of an attitude error of this size: white and slow, each as large."""
    return [(sigma_rad, 0.0), (sigma_rad, SLOW_S)]


def _step(effect: Effect) -> FloatArray:
    """(p,) all parameters by their typical size, with signs that are drawn once."""
    signs = np.random.default_rng(_SEED).choice([-1.0, 1.0], len(effect.parameters))
    return np.asarray(signs * [parameter.scale for parameter in effect.parameters])


def attitude_error_rad(problem: Problem) -> float:
    """Error of the reference attitude, 1 sigma per axis: as declared, or at least what stands off the smooth track."""
    declared = problem.budget.attitude_sigma_rad or 0.0
    motion = problem.setting.motion
    if not isinstance(motion, RecordedMotion):
        return declared
    off = (motion.track(0.0) * motion.R_BN.inv()).as_rotvec()
    if motion.attitude_known is not None:
        off = off[motion.attitude_known]
    return max(declared, float(np.sqrt(np.mean(off**2))) if off.size else 0.0)
