"""The independent figures, and ours beside them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TypeAlias

from fluxtwin.sim.base.errors import BadInput
from fluxtwin.sim.telemetry.csv_files import open_csv

PACKAGED = Path(__file__).parent / "data" / "figures.csv"

Key: TypeAlias = tuple[str, str, str, str, str]
"""(track, model, selection, quantity, component) of a figure."""


@dataclass(frozen=True)
class Figure:
    """One figure of the independent look."""

    id: str
    key: Key
    value: float
    unit: str
    last_digit: float
    printed: str


@dataclass(frozen=True)
class Finding:
    """Ours beside one independent figure."""

    figure: Figure
    here: float | None
    status: str
    """`reproduced`, `differs` or `not testable`."""
    why: str = ""
    """Why it differs or cannot be tested; empty where it is reproduced."""


def read_figures(path: Path = PACKAGED) -> list[Figure]:
    """The figures of a table in the form of data/README.md; raises BadInput."""
    table = open_csv(path)
    names = ("id", "track", "model", "selection", "quantity", "component", "unit", "printed")
    text = {name: [cell.decode() for cell in table.text(name).tolist()] for name in names}
    number = table.numbers(["value", "last_digit"])
    found = []
    for row in range(table.rows):
        key = (
            text["track"][row],
            text["model"][row],
            text["selection"][row],
            text["quantity"][row],
            text["component"][row],
        )
        value, digit = float(number["value"][row]), float(number["last_digit"][row])
        found.append(Figure(text["id"][row], key, value, text["unit"][row], digit, text["printed"][row]))
    if len({figure.id for figure in found}) < len(found):
        raise BadInput("an id is there twice", where=str(path))
    return found


def compare(figures: list[Figure], here: Mapping[Key, float], why: Mapping[str, str]) -> list[Finding]:
    """Ours beside each figure: reproduced within one unit of its last printed digit.

    here: what was computed, by key; a key that is missing makes the figure not testable. why: the explanation
    for a figure that differs or is not testable, by id.
    """
    findings = []
    for figure in figures:
        ours = here.get(figure.key)
        if ours is None:
            status = "not testable"
        else:
            # a thousandth of a digit for the decimals that binary numbers cannot hold
            agrees = abs(ours - figure.value) <= 1.001 * figure.last_digit
            status = "reproduced" if agrees else "differs"
        reason = "" if status == "reproduced" else why.get(figure.id, "no explanation found")
        findings.append(Finding(figure, ours, status, reason))
    return findings
