"""The outer surface of a spacecraft as flat plates, for the torques that press on it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Any, Self

import numpy as np
from pydantic import BeforeValidator, Field, model_validator

from fluxtwin.sim.base.section_types import Positive, Section, Vector3

PLATE_SIZE = 7


class Plate(Section):
    """One side of a flat plate. A panel that is seen from both sides is two plates; none shades another."""

    area_m2: Positive
    normal_B: Vector3
    """Outward."""
    centre_m: Vector3
    """From the centre of mass, body axes."""

    @model_validator(mode="after")
    def _has_a_normal(self) -> Self:
        if not any(self.normal_B):
            raise ValueError("normal_B is zero: no such direction")
        return self

    def row(self) -> list[float]:
        """Area, unit normal, centre: PLATE_SIZE numbers."""
        normal = np.array(self.normal_B) / np.linalg.norm(self.normal_B)
        return [self.area_m2, *normal.tolist(), *self.centre_m]


def _as_tuple(value: Any) -> Any:
    return tuple(value) if isinstance(value, list) else value


Plates = Annotated[tuple[Plate, ...], BeforeValidator(_as_tuple), Field(min_length=1)]


def rows_of(plates: Sequence[Plate]) -> list[float]:
    """All plates, one after the other."""
    return [number for plate in plates for number in plate.row()]
