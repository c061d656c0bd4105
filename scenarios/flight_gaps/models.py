"""Field models that are wrong in a way known to us, and the one-dipole field of the aircraft."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.earth.field_models import FieldModel, linear_model, load_field

_DIPOLE_NT = 30_000.0


def held_back(model: FieldModel) -> FieldModel:
    """The model as it was one whole validity earlier, with its secular variation: IGRF 1975 of 1975.0 in 1980.0."""
    return replace(model, title=f"{model.title}, used as if it were five years ago", knots=_later(model))


def carried_on(model: FieldModel) -> FieldModel:
    """The model with its straight secular variation carried on for one whole validity more."""
    knots, later = model.knots, _later(model)
    polynomial = model.polynomial_nT.copy()
    polynomial[-1, 1:] *= 2.0
    title = f"{model.title}, its secular variation carried on"
    return replace(model, title=title, knots=np.append(knots[:-1], later[-1]), polynomial_nT=polynomial)


def degree_8() -> FieldModel:
    """IGRF-14 cut at degree 8."""
    return load_field("igrf14", 8)


def dipole() -> FieldModel:
    """A centred dipole along the Earth's axis that does not change: the field of an aircraft at an unknown place."""
    g10 = np.array([-_DIPOLE_NT, 0.0, 0.0])
    knots = np.array(["2000-01-01", "2100-01-01"], dtype="datetime64[ns]")
    return linear_model("dipole", "a centred dipole, fixed", knots, np.stack([g10, g10]))


def dipole_radius_km(size_nT: FloatArray, latitude_rad: float, radius_km: float) -> FloatArray:
    """(N,) distance from the centre at which the dipole has that size [nT], at a latitude."""
    at_reference = _DIPOLE_NT * float(np.sqrt(1.0 + 3.0 * np.sin(latitude_rad) ** 2))
    distance: FloatArray = radius_km * np.cbrt(at_reference / size_nT)
    return distance


def _later(model: FieldModel) -> np.ndarray:
    return np.asarray(model.knots + (model.knots[-1] - model.knots[0]))
