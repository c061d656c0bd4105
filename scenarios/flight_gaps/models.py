"""Field models with a known error, and the one-dipole field of the aircraft."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.earth.field_models import FieldModel, linear_model, load_field

_DIPOLE_NT = 30_000.0


def field_model(name: str) -> FieldModel:
    """The model of a case: `igrf14`, `igrf14, degree 8`, `igrf1975, held back`, `igrf1975, carried on` or `dipole`."""
    base, _, change = name.partition(", ")
    if base == "dipole":
        # a centred dipole along the Earth's axis that does not change: the field of an aircraft at an unknown place
        knots = np.array(["2000-01-01", "2100-01-01"], dtype="datetime64[ns]")
        return linear_model("dipole", "a centred dipole, fixed", knots, np.array([[-_DIPOLE_NT, 0.0, 0.0]] * 2))
    if change.startswith("degree"):
        return load_field(base, int(change.removeprefix("degree ")))
    model = load_field(base)
    return held_back(model) if change == "held back" else carried_on(model) if change == "carried on" else model


def held_back(model: FieldModel) -> FieldModel:
    """The model as it was one whole validity earlier, with its secular variation: IGRF 1975 of 1975.0 in 1980.0."""
    return replace(model, title=f"{model.title}, used as if it were five years ago", knots=_later(model))


def carried_on(model: FieldModel) -> FieldModel:
    """The model with its straight secular variation carried on for one whole validity more."""
    polynomial = model.polynomial_nT.copy()
    polynomial[-1, 1:] *= 2.0
    knots = np.append(model.knots[:-1], _later(model)[-1])
    title = f"{model.title}, its secular variation carried on"
    return replace(model, title=title, knots=knots, polynomial_nT=polynomial)


def dipole_radius_km(size_nT: FloatArray, latitude_rad: float, radius_km: float) -> FloatArray:
    """(N,) distance from the centre at which the dipole has that size [nT], at a latitude."""
    at_reference = _DIPOLE_NT * float(np.sqrt(1.0 + 3.0 * np.sin(latitude_rad) ** 2))
    distance: FloatArray = radius_km * np.cbrt(at_reference / size_nT)
    return distance


def _later(model: FieldModel) -> np.ndarray:
    return np.asarray(model.knots + (model.knots[-1] - model.knots[0]))
