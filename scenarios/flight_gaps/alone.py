"""What each effect takes alone by plain least squares: nothing is whitened, priced or searched.

It is the look that a person takes first, and the table beside which the diagnosis must be read: many names take much of
one and the same residual.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fluxtwin.gap.problem import Problem, pose
from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.earth.field_models import FieldModel
from fluxtwin.sim.effects.base import SignalEffect
from fluxtwin.sim.effects.chain import jacobian
from fluxtwin.sim.telemetry.record import Telemetry

_RCOND = 1e-12


@dataclass(frozen=True)
class Share:
    """What is left of a residual once an effect is fitted beside what is modelled."""

    effects: tuple[str, ...]
    """Fitted together."""
    parameters: int
    left_nT: float
    """rms per component."""
    sizes: tuple[float, ...]
    """The fitted value of each effect with one parameter, else its largest, in units of that parameter."""


@dataclass(frozen=True)
class Alone:
    """The table of one record."""

    raw_nT: float
    """rms per component with nothing fitted."""
    modelled: tuple[str, ...]
    base_nT: float
    """rms per component with what is modelled fitted."""
    shares: tuple[Share, ...]

    def left_nT(self, *effects: str) -> float:
        """What is left beside those effects."""
        return next(share.left_nT for share in self.shares if share.effects == effects)

    def size(self, *effects: str) -> float:
        """The first fitted value of those effects."""
        return next(share.sizes[0] for share in self.shares if share.effects == effects)


def alone(
    telemetry: Telemetry,
    model: FieldModel,
    modelled: Sequence[str],
    wanted: Sequence[tuple[SignalEffect, ...]],
) -> Alone:
    """Least squares of each set of effects beside what is modelled, all components alike. Raises as `pose` does."""
    problem = pose(telemetry, model, modelled=modelled)
    residual = np.asarray(problem.residual_nT).reshape(-1)
    nuisance = problem.nuisance.reshape(residual.size, -1)
    shares = [_share(problem, residual, nuisance, effects) for effects in wanted]
    base = _rms(residual - least_squares(nuisance, residual)[0])
    return Alone(_rms(residual), tuple(modelled), base, tuple(shares))


def visible_nT(
    telemetry: Telemetry, model: FieldModel, modelled: Sequence[str], effect: SignalEffect, size: float
) -> tuple[float, float]:
    """rms per component of an effect with one parameter of that size: whole, and beside what is modelled."""
    problem = pose(telemetry, model, modelled=modelled)
    image = size * jacobian(problem.chain, effect, at=problem.modelled_active).reshape(-1)
    nuisance = problem.nuisance.reshape(image.size, -1)
    return _rms(image), _rms(image - least_squares(nuisance, image)[0])


def _share(problem: Problem, residual: FloatArray, nuisance: FloatArray, effects: tuple[SignalEffect, ...]) -> Share:
    images = [jacobian(problem.chain, one, at=problem.modelled_active) for one in effects]
    own = np.concatenate([image.reshape(residual.size, -1) for image in images], axis=1)
    fitted, values = least_squares(np.concatenate([nuisance, own], axis=1), residual)
    sizes, first = [], nuisance.shape[1]
    for image in images:
        part = values[first : first + image.shape[2]]
        sizes.append(float(part[np.argmax(np.abs(part))]))
        first += image.shape[2]
    return Share(tuple(one.name for one in effects), own.shape[1], _rms(residual - fitted), tuple(sizes))


def least_squares(design: FloatArray, residual: FloatArray) -> tuple[FloatArray, FloatArray]:
    """What columns (M, P) of any units give of the residual (M,), and their coefficients."""
    if not design.shape[1]:
        return np.zeros_like(residual), np.zeros(0)
    length = np.linalg.norm(design, axis=0)
    length = np.where(length > 0, length, 1.0)
    found = np.linalg.lstsq(design / length, residual, rcond=_RCOND)[0]
    return np.asarray(design / length @ found), np.asarray(found / length)


def _rms(value: FloatArray) -> float:
    return float(np.sqrt(np.mean(np.square(value))))
