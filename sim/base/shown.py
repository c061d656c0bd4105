"""What every result can do in a notebook: show itself, say itself, draw itself.

How that looks is the business of the front door, which stands above all results; here is only its name.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from importlib import import_module
from typing import Any

import numpy as np

_PRESENTING = "fluxtwin.presenting"


class Shown:
    """A result: `.report()`, `.plot()`, and its own place in a notebook."""

    def __init_subclass__(cls, **more: Any) -> None:
        super().__init_subclass__(**more)
        cls.__repr__ = Shown.__repr__  # type: ignore[method-assign]  # a dataclass would print every array
        cls.__eq__ = Shown.__eq__  # type: ignore[method-assign]  # and would ask arrays for one truth value

    def __repr__(self) -> str:
        return f"<{type(self).__name__}: {self.report().splitlines()[0]}>"

    def __eq__(self, other: object) -> bool:
        return _equal(self, other) if type(self) is type(other) else NotImplemented

    def __str__(self) -> str:
        return self.report()

    def report(self) -> str:
        """The result as text: the sentence first, then its tables."""
        return str(self._presented("report"))

    def plot(self, axes: Any = None) -> Any:
        """Draw the result into matplotlib's `axes`, or new ones, and return them. BadInput where nothing can be drawn."""
        return self._presented("plot", axes)

    def _repr_html_(self) -> str:
        return str(self._presented("html"))

    def _presented(self, how: str, *arguments: Any) -> Any:
        return getattr(import_module(_PRESENTING), how)(self, *arguments)


def _equal(one: Any, other: Any) -> bool:
    """Whether all entries are equal, and all fields that their class compares; missing numbers equal each other."""
    if type(one) is not type(other):
        return False
    if one is other:
        return True
    if isinstance(one, np.ndarray):
        return np.array_equal(one, other, equal_nan=all(part.dtype.kind in "fcmM" for part in (one, other)))
    if is_dataclass(one):
        return all(_equal(getattr(one, part.name), getattr(other, part.name)) for part in fields(one) if part.compare)
    if isinstance(one, Mapping):
        return one.keys() == other.keys() and all(_equal(one[key], other[key]) for key in one)
    if isinstance(one, list | tuple):
        return len(one) == len(other) and all(map(_equal, one, other))
    return bool(one == other or (one != one and other != other))  # a missing number is not itself
