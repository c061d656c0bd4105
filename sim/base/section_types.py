"""The types of a section's keys: numbers in bounds, vectors, matrices; each quantity has its unit in its name."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import AfterValidator, BeforeValidator, Field

from fluxtwin.sim.base.toml_input import Strict


def as_tuple(value: Any) -> Any:
    """Lists, as TOML has them, become tuples, all the way down."""
    return tuple(as_tuple(item) for item in value) if isinstance(value, list | tuple) else value


def _not_zero(value: Any) -> Any:
    if not any(value):
        raise ValueError("all are zero: no such direction or attitude")
    return value


Vector3 = Annotated[tuple[float, float, float], BeforeValidator(as_tuple)]
Direction = Annotated[tuple[float, float, float], BeforeValidator(as_tuple), AfterValidator(_not_zero)]
"""Of any length but zero."""
Matrix3 = Annotated[tuple[Vector3, Vector3, Vector3], BeforeValidator(as_tuple)]
Quaternion = Annotated[tuple[float, float, float, float], BeforeValidator(as_tuple), AfterValidator(_not_zero)]
NonNegative = Annotated[float, Field(ge=0)]
Positive = Annotated[float, Field(gt=0)]
ZERO3: tuple[float, float, float] = (0.0, 0.0, 0.0)
ZERO33 = (ZERO3, ZERO3, ZERO3)


class Section(Strict):
    """Base of all sections."""


def one_of(section: Section, *names: str) -> None:
    """Raise ValueError unless exactly one of the keys `names` is given."""
    given = [name for name in names if getattr(section, name) is not None]
    if len(given) != 1:
        raise ValueError(f"give exactly one of {', '.join(names)}; found {', '.join(given) or 'none'}")
