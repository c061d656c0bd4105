"""The independent figures, and ours beside them."""

from __future__ import annotations

import csv
import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TypeAlias

PACKAGED = Path(__file__).parent / "data" / "figures.csv"

Key: TypeAlias = tuple[str, str, str, str, str]
"""(track, model, selection, quantity, component) of a figure."""


@dataclass(frozen=True)
class Figure:
    """One figure of the independent look, and ours."""

    id: str
    key: Key
    value: float
    unit: str
    last_digit: float
    printed: str
    here: float | None = None
    status: str = "not testable"
    """`reproduced`, `differs` or `not testable`."""
    why: str = ""
    """Why it differs or cannot be tested; empty where it is reproduced."""

    @property
    def shown(self) -> float | None:
        """Ours with one digit more than the printed figure."""
        return None if self.here is None else round(self.here, 1 - math.floor(math.log10(self.last_digit)))


def read_figures() -> list[Figure]:
    """The packaged figures, in the form of data/README.md."""
    with PACKAGED.open(encoding="utf-8", newline="") as lines:
        return [
            Figure(name, (track, model, rows, quantity, part), float(value), unit, float(digit), printed)
            for name, track, model, rows, quantity, part, value, unit, digit, printed in list(csv.reader(lines))[1:]
        ]


def compare(figures: list[Figure], here: Mapping[Key, float], why: Mapping[str, str]) -> list[Figure]:
    """Ours beside each figure: reproduced within one unit of its last printed digit.

    here: what was computed, by key; a key that is missing makes the figure not testable. why: the explanation
    for a figure that differs or is not testable, by id.
    """
    compared = []
    for figure in figures:
        ours, status = here.get(figure.key), "not testable"
        if ours is not None:
            # a thousandth of a digit for the decimals that binary numbers cannot hold
            agrees = abs(ours - figure.value) <= 1.001 * figure.last_digit
            status = "reproduced" if agrees else "differs"
        reason = "" if status == "reproduced" else why.get(figure.id, "no explanation found")
        compared.append(replace(figure, here=ours, status=status, why=reason))
    return compared
