"""`--method all`: every method that the record allows, compared by its error on rows that were not fitted.

The record is cut into twelve stretches. Each method is fitted to every other stretch and predicts those between, and the
other way round. Where there is attitude the error is that of the field vector, and then of |B|, else that of |B|. A method
is taken for worse than the best where the mean square over the stretches is, by two standard errors of the paired
difference; among those that are not, the first of `_PREFERRED` is taken.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from fluxtwin.calib.common.design import reference_field_B_nT
from fluxtwin.calib.common.digits import plain
from fluxtwin.calib.common.direction import CONFIDENCE
from fluxtwin.calib.common.observability import listed
from fluxtwin.calib.common.options import Estimator
from fluxtwin.calib.common.residuals import residuals_of, size_residuals_of
from fluxtwin.calib.common.robust import find_outliers
from fluxtwin.sim.base.errors import BadInput, FluxtwinError, NoAnswer
from fluxtwin.sim.base.progress import Progress, silent
from fluxtwin.sim.base.types import BoolArray, FloatArray
from fluxtwin.sim.earth.field import FieldModel
from fluxtwin.sim.earth.frames import angle_between
from fluxtwin.sim.telemetry.record import Telemetry

if TYPE_CHECKING:
    from fluxtwin.calib.common.fit import Fit

_STRETCHES = 12
_WORSE = 2.0  # standard errors
_PREFERRED = ("linear", "scalar", "forward", "twostep", "recursive", "batch", "iterative", "gyro", "center")
"""What is known best first: sigmas that were tested, no motion to be estimated, no tuning."""
_WHY_NOT = 160  # characters of a refusal


@dataclass(frozen=True)
class MethodResult:
    """One method on one record."""

    method: str
    held_out_nT: tuple[float, ...] | None = None
    """rms on rows that were not fitted: x, y, z against the reference attitude; or of |B| alone. None: no answer."""
    along_nT: float | None = None
    """rms of |B| there."""
    angle_deg: float | None = None
    """95 % of the angles between calibrated reading and field there; None without attitude."""
    why_not: str = ""
    """Why there is no answer."""


@dataclass(frozen=True)
class Comparison:
    """All methods that a record allows, and the choice among them."""

    results: tuple[MethodResult, ...]
    chosen: str
    why: str
    """In a sentence."""

    @property
    def columns(self) -> list[str]:
        """The heads of the table."""
        three = any(one.held_out_nT is not None and len(one.held_out_nT) == 3 for one in self.results)
        return [
            "method",
            *(["x [nT]", "y [nT]", "z [nT]"] if three else []),
            "|B| [nT]",
            *(["angle [deg]"] if three else []),
            "remark",
        ]

    @property
    def rows(self) -> list[list[str]]:
        """The cells of the table, numbers to three digits."""
        rows = []
        for one in self.results:
            remark = one.why_not or ("take this one" if one.method == self.chosen else "")
            numbers: list[float | None] = [None] * (len(self.columns) - 2)
            if one.held_out_nT is not None:
                three = [*one.held_out_nT] if len(one.held_out_nT) == 3 else []
                numbers = [*three, one.along_nT, *([one.angle_deg] if three else [])]
            rows.append([one.method, *("" if x is None else plain(x) for x in numbers), remark])
        return rows

    def to_dict(self) -> dict[str, Any]:
        """Plain numbers and text for JSON."""
        return {"results": [asdict(one) for one in self.results], "chosen": self.chosen, "why": self.why}


def compare(
    telemetry: Telemetry,
    model: FieldModel,
    estimators: Mapping[str, Estimator],
    given: Mapping[str, Any],
    progress: Progress = silent,
) -> Comparison:
    """Every method on a record. given: options, each handed to the methods that take it.

    Raises BadInput without positions, NoAnswer where no method gives an answer.
    """
    if not telemetry.has_position.any():
        raise BadInput(
            "without positions there is no field to predict",
            where="--method all",
            wanted="positions (columns, or --tle), or --method gyro",
        )
    found: dict[str, MethodResult] = {}
    errors: dict[str, FloatArray] = {}
    stretch = np.arange(len(telemetry)) * _STRETCHES // len(telemetry)
    for number, (name, estimator) in enumerate(estimators.items()):
        progress(f"method {name}", number / len(estimators))
        taken = {key: value for key, value in given.items() if key in estimator.takes}
        try:
            errors[name] = _held_out(
                telemetry, model, stretch, partial(estimator.fit, model=model, given=taken, sigmas=False)
            )
        except FluxtwinError as error:
            found[name] = MethodResult(name, why_not=_why_not(error, given))
    if not errors:
        reasons = "; ".join(f"{one.method}: {one.why_not}" for one in found.values())
        raise NoAnswer(f"no method gives an answer. {reasons}")
    # (N,) rows that every method predicts, without those that are outliers for all of them.
    finite = np.all([np.isfinite(one).all(axis=1) for one in errors.values()], axis=0)
    kept: BoolArray = np.array(finite)
    far = [find_outliers(one[finite]) for one in errors.values()]
    kept[finite] = ~np.all(far, axis=0)
    for name, error_nT in errors.items():
        found[name] = _result(name, telemetry, model, error_nT, kept)
    order = sorted(errors, key=lambda name: _mean_square(errors[name][kept]))
    alike = _alike(order, errors, stretch, kept)
    if errors[order[0]].shape[1] == 3:  # an error of the attitude hides much, but not in |B|
        reference_nT = reference_field_B_nT(telemetry, model)
        size_nT = np.linalg.norm(reference_nT, axis=1)
        along = {name: (np.linalg.norm(reference_nT + errors[name], axis=1) - size_nT)[:, None] for name in alike}
        alike = _alike(sorted(alike, key=lambda name: _mean_square(along[name][kept])), along, stretch, kept)
    chosen = min(alike, key=lambda name: [*_PREFERRED, name].index(name))
    listed = [*order, *(name for name in found if name not in errors)]
    return Comparison(tuple(found[name] for name in listed), chosen, _why(chosen, order, alike))


def _why_not(error: FluxtwinError, given: Mapping[str, Any]) -> str:
    """Why a method gives no answer, in a line of the table."""
    if isinstance(error, BadInput) and (error.where or "").removeprefix("--") == "parameters":
        return f"does not estimate {given['parameters']}"
    text = str(error).removeprefix(f"{getattr(error, 'where', None)}: ").split(". Wanted:")[0]
    return text if len(text) <= _WHY_NOT else f"{text[:_WHY_NOT].rpartition(' ')[0] or text[:_WHY_NOT]} ..."


def _held_out(
    telemetry: Telemetry, model: FieldModel, stretch: np.ndarray, fit: Callable[[Telemetry], Fit]
) -> FloatArray:
    """(N, 3) error of the field, or (N, 1) of |B| where no row has attitude, by fits that have not seen the row."""
    halves = [(stretch % 2 == side) for side in (0, 1)]
    parts = []
    for seen, unseen in (halves, halves[::-1]):
        known = fit(telemetry.select(np.flatnonzero(seen))).calibration
        part = telemetry.select(np.flatnonzero(unseen))
        vector = part.has_attitude.any()
        error_nT = -residuals_of(part, known, model) if vector else size_residuals_of(part, known, model)
        parts.append((np.flatnonzero(unseen), error_nT))
    error_nT = np.full((len(telemetry), parts[0][1].shape[1]), np.nan)
    for rows, values in parts:
        error_nT[rows] = values
    return error_nT


def _result(name: str, telemetry: Telemetry, model: FieldModel, error_nT: FloatArray, kept: BoolArray) -> MethodResult:
    error = error_nT[kept]
    each = tuple(float(x) for x in np.sqrt((error**2).mean(axis=0)))
    if error.shape[1] == 1:
        return MethodResult(name, each, each[0])
    true_nT = reference_field_B_nT(telemetry.select(np.flatnonzero(kept)), model)
    found_nT = true_nT + error
    along = np.linalg.norm(found_nT, axis=1) - np.linalg.norm(true_nT, axis=1)
    angle = float(np.degrees(np.quantile(angle_between(found_nT, true_nT), CONFIDENCE)))
    return MethodResult(name, each, float(np.sqrt((along**2).mean())), angle)


def _mean_square(error_nT: FloatArray) -> float:
    return float((error_nT**2).sum(axis=1).mean())


def _alike(order: list[str], errors: Mapping[str, FloatArray], stretch: np.ndarray, kept: BoolArray) -> list[str]:
    """The first of `order`, and those that are not worse by more than chance gives."""
    return [name for name in order if not _is_worse(errors[name], errors[order[0]], stretch, kept)]


def _is_worse(one: FloatArray, best: FloatArray, stretch: np.ndarray, kept: BoolArray) -> bool:
    """Whether the mean square over stretches is larger by more than chance gives, and its root in the digits shown."""
    if plain(_mean_square(one[kept]) ** 0.5) == plain(_mean_square(best[kept]) ** 0.5):
        return False
    difference = np.array(
        [
            _mean_square(one[rows]) - _mean_square(best[rows])
            for rows in (np.flatnonzero(kept & (stretch == k)) for k in range(_STRETCHES))
            if rows.size
        ]
    )
    error = float(difference.std(ddof=1) / np.sqrt(difference.size)) if difference.size > 1 else 0.0
    return float(difference.mean()) > _WORSE * error


def _why(chosen: str, order: list[str], alike: list[str]) -> str:
    others = [name for name in alike if name != chosen]
    worse = [name for name in order if name not in alike]
    said = f"Take {chosen}: no other method has a significantly smaller error"
    if others:
        said += f"; {listed(others)} may be as good, but {chosen} is better tested"
    return said + (f". Significantly worse, in the vector or in |B|: {', '.join(worse)}" if worse else "")
