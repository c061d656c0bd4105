"""One row of the table, and which cases it counts."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from withheld_cases.cases import DISTRIBUTIONAL
from withheld_cases.judged import Judged
from withheld_cases.statistics import wilson

Test = Callable[[Judged], bool]


def share_row(
    title: str, reach: str, cases: Sequence[Judged], test: Test, least: float, most: float = 1.0
) -> dict[str, Any]:
    """A share: met where the point estimate lies from least to most; a row that is `compared` has nothing to meet."""
    return counted_row(title, reach, sum(test(case) for case in cases), len(cases), least, most)


def counted_row(title: str, reach: str, right: int, of: int, least: float, most: float = 1.0) -> dict[str, Any]:
    """The same of what is no case."""
    low, high = wilson(right, of)
    value = right / of if of else None
    met = None if value is None or reach == "compared" else bool(least <= value <= most)
    return {
        "figure": title,
        "reach": reach,
        "value": value,
        "right": right,
        "of": of,
        "interval": [low, high],
        "met": met,
    }


def number_row(title: str, reach: str, value: float | None, of: int, met: bool | None) -> dict[str, Any]:
    """A figure that is no share."""
    clean = None if value is None or value != value else value
    return {"figure": title, "reach": reach, "value": clean, "of": of, "met": met if clean is not None else None}


def of(cases: Sequence[Judged], *populations: str, least: float = 0.0, names: Test | None = None) -> list[Judged]:
    """Cases of populations, at least so visible."""
    return [c for c in cases if c.population in populations and c.visible >= least and (names is None or names(c))]


def distributional(case: Judged) -> bool:
    """Known by its distribution, without a Jacobian."""
    return any(name in DISTRIBUTIONAL for name in case.truths)


def carried(case: Judged) -> float:
    """Share of a truth's visible energy that the plain entry of its name can carry with the columns that there are."""
    return float(case.sealed.get("plain_share", 1.0))


def expressible(case: Judged) -> bool:
    """Whether the entries of the truths can carry 90 % of them with the columns that the record has."""
    return carried(case) >= 0.9
