"""Plain least squares: what each effect explains alone, and the coefficients behind a published compensation.

Nothing is whitened, penalised or searched. It is the look that a person takes first, and the table next to which the
diagnosis must be read: many names explain much of one and the same residual.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fluxtwin.gap.problem.problem import pose
from fluxtwin.scenarios.flight_gaps.records import Compensation
from fluxtwin.scenarios.flights import Numbers, rms
from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.earth.field_models import FieldModel
from fluxtwin.sim.effects.base import SignalEffect
from fluxtwin.sim.effects.catalogue import find_effect
from fluxtwin.sim.effects.chain import jacobian
from fluxtwin.sim.telemetry.record import Telemetry

_RCOND = 1e-12


@dataclass(frozen=True)
class Share:
    """What remains of a residual once effects are fitted in addition to what is modelled."""

    effects: tuple[str, ...]
    """Fitted together."""
    parameters: int
    left_nT: float
    """rms per component."""
    sizes: tuple[float, ...]
    """The fitted value of each effect with one parameter, else its largest, in units of that parameter."""

    def in_words(self, digits: int = 3) -> str:
        """The values with their units."""
        units = [find_effect(name).parameters[0].unit for name, _ in zip(self.effects, self.sizes, strict=False)]
        values = (f"{size:.{digits}g}" for size in self.sizes)
        return ", ".join(v if u == "1" else f"{v} {u}" for v, u in zip(values, units, strict=True))


@dataclass(frozen=True)
class Shares:
    """The table of one record."""

    raw_nT: float
    """rms per component with nothing fitted."""
    modelled: tuple[str, ...]
    base_nT: float
    """rms per component with what is modelled fitted."""
    shares: tuple[Share, ...]

    def share(self, *effects: str) -> Share:
        """Of those effects, fitted together."""
        return next(share for share in self.shares if share.effects == effects)

    def left_nT(self, *effects: str) -> float:
        """What remains with those effects fitted as well."""
        return self.share(*effects).left_nT

    def size(self, *effects: str) -> float:
        """The first fitted value of those effects."""
        return self.share(*effects).sizes[0]


class LeastSquares:
    """A record's residual to a field model, and the columns of what is modelled. Raises as `pose` does."""

    def __init__(self, telemetry: Telemetry, model: FieldModel, modelled: Sequence[str]) -> None:
        """Pose the problem."""
        self._problem = pose(telemetry, model, modelled=modelled)
        self.residual_nT: FloatArray = np.asarray(self._problem.residual_nT).reshape(-1)
        self.nuisance = self._problem.nuisance.reshape(self.residual_nT.size, -1)

    def image(self, effect: SignalEffect) -> FloatArray:
        """(M, P) change of the residual by the parameters of an effect."""
        image = jacobian(self._problem.chain, effect, at=self._problem.modelled_active)
        return np.asarray(image).reshape(self.residual_nT.size, -1)

    def remaining_nT(self, *effects: SignalEffect) -> tuple[FloatArray, list[FloatArray]]:
        """The residual (M,) once what is modelled and the effects are fitted, and the coefficients of each effect."""
        images = [self.image(effect) for effect in effects]
        fitted, values = _fit(np.concatenate([self.nuisance, *images], axis=1), self.residual_nT)
        ends = np.cumsum([self.nuisance.shape[1], *(image.shape[1] for image in images)])
        return self.residual_nT - fitted, [values[a:b] for a, b in itertools.pairwise(ends)]


def alone(
    telemetry: Telemetry, model: FieldModel, modelled: Sequence[str], wanted: Sequence[tuple[SignalEffect, ...]]
) -> Shares:
    """Least squares of each set of effects and what is modelled, all components alike. Raises as `pose` does."""
    problem, shares = LeastSquares(telemetry, model, modelled), []
    for effects in wanted:
        remaining_nT, values = problem.remaining_nT(*effects)
        sizes = tuple(float(part[np.argmax(np.abs(part))]) for part in values)
        names, count = tuple(one.name for one in effects), sum(part.size for part in values)
        shares.append(Share(names, count, rms(remaining_nT), sizes))
    return Shares(rms(problem.residual_nT), tuple(modelled), rms(problem.remaining_nT()[0]), tuple(shares))


def visible_nT(
    telemetry: Telemetry, model: FieldModel, modelled: Sequence[str], effect: SignalEffect, size: float
) -> tuple[float, float]:
    """rms per component of an effect with one parameter of that size: whole, and after projecting out what is modelled."""
    problem = LeastSquares(telemetry, model, modelled)
    image = size * problem.image(effect)[:, 0]
    return rms(image), rms(image - _fit(problem.nuisance, image)[0])


def _fit(design: FloatArray, residual: FloatArray) -> tuple[FloatArray, FloatArray]:
    """What columns (M, P) of any units explain of the residual (M,), and their coefficients."""
    length = np.linalg.norm(design, axis=0)
    length = np.where(length > 0, length, 1.0)
    found = np.linalg.lstsq(design / length, residual, rcond=_RCOND)[0]
    return np.asarray(design / length @ found), np.asarray(found / length)


def coefficients(given: Compensation, rate_Hz: float) -> Numbers:
    """The 18 coefficients of a published Tolles-Lawson compensation, recovered exactly.

    With the fluxgate's reading f and its direction u the compensation is u . (p + S f + K df/dt): permanent, induced (S
    symmetric) and eddy-current terms (Tolles & Lawson 1950; Leliak 1961, doi 10.1109/TANE3.1961.4201799). df/dt is the
    central difference that the source took, so the 18 coefficients repeat the published values to their last digit.
    """
    flux = given.fluxgate_B_nT
    u = flux / np.linalg.norm(flux, axis=1)[:, None]
    rows, columns = np.triu_indices(3)
    induced = u[:, rows] * flux[:, columns]
    eddy = np.einsum("ni,nj->nij", u, np.gradient(flux, 1.0 / rate_Hz, axis=0)).reshape(-1, 9)
    design = np.concatenate([u, induced, eddy], axis=1)
    length = np.linalg.norm(design, axis=0)
    found = np.linalg.lstsq(design / length, given.taken_nT, rcond=1e-13)[0] / length
    S = np.zeros((3, 3))
    S[rows, columns] = 0.5 * found[3:9]
    K = found[9:].reshape(3, 3)
    symmetric = 0.5 * (K + K.T)
    return Numbers(
        # (3,), (3, 3) symmetric, and (3, 3), of which the last also without its antisymmetric part and its trace.
        permanent_nT=found[:3],
        induced=S + S.T,
        eddy_s=K,
        symmetric_eddy_s=symmetric - np.eye(3) * np.trace(symmetric) / 3.0,
        # Largest difference between the published compensation and the one of these coefficients.
        worst_nT=np.abs(design @ found - given.taken_nT).max(),
        # rms along the field of the three parts, and of the eddy terms that are antisymmetric.
        parts_nT=(rms(u @ found[:3]), rms(induced @ found[3:9]), rms(eddy @ found[9:])),
        antisymmetric_nT=rms(eddy @ (K - symmetric).reshape(-1)),
    )
