"""What every result can do in a notebook: show itself, say itself, draw itself.

How that looks is the business of the front door, which stands above all results; here is only its name.
"""

from __future__ import annotations

from importlib import import_module
from typing import Any

_PRESENTING = "fluxtwin.presenting"


class Shown:
    """A result: `.report()`, `.plot()`, and its own place in a notebook."""

    def __init_subclass__(cls, **more: Any) -> None:
        super().__init_subclass__(**more)
        cls.__repr__ = Shown.__repr__  # type: ignore[method-assign]  # a dataclass would print every array

    def __repr__(self) -> str:
        return f"<{type(self).__name__}: {self.report().splitlines()[0]}>"

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
