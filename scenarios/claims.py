"""What a paper claims beside what a study finds: reproduced, differs, or not testable."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np

from fluxtwin.scenarios.page import Cell, Table

REPRODUCED, DIFFERS, NOT_TESTABLE = "reproduced", "differs", "not testable"

ResultsT = TypeVar("ResultsT")


@dataclass(frozen=True)
class Claim:
    """One claim judged."""

    id: int
    where: str
    paper: str
    here: str
    value: float
    unit: str
    status: str
    why: str = ""

    def to_dict(self) -> dict[str, object]:
        """As it stands in `summary.json`."""
        plain: dict[str, object] = {
            "id": self.id, "where": self.where, "paper": self.paper, "here": self.here, "value": self.value,
            "unit": self.unit, "status": self.status,
        }  # fmt: skip
        return plain | ({"why": self.why} if self.why else {})


@dataclass(frozen=True)
class Verdict:
    """What a judge says: text with the number and unit, the number, the unit, status, and why unless reproduced."""

    here: str
    value: float
    unit: str
    status: str
    why: str = ""


def agree(ours: float, printed: float, margin: float) -> str:
    """`reproduced` when the two are no further apart than the margin, else `differs`."""
    return REPRODUCED if abs(ours - printed) <= margin else DIFFERS


def judged(
    entries: Iterable[Mapping[str, Any]], judges: Mapping[int, Callable[[ResultsT], Verdict]], results: ResultsT
) -> list[Claim]:
    """Every entry (id, where, paper) judged, in order.

    Raises KeyError for a claim without a judge, ValueError for a verdict without a number or without its reason.
    """
    claims = []
    for entry in entries:
        verdict = judges[entry["id"]](results)
        if not np.isfinite(verdict.value):
            raise ValueError(f"claim {entry['id']}: no finite number was computed")
        if verdict.status != REPRODUCED and not verdict.why:
            raise ValueError(f"claim {entry['id']}: {verdict.status} without a reason")
        claims.append(
            Claim(
                entry["id"], entry["where"], entry["paper"], verdict.here, float(verdict.value), verdict.unit,
                verdict.status, "" if verdict.status == REPRODUCED else verdict.why,
            )
        )  # fmt: skip
    return claims


def claims_table(claims: Sequence[Claim], *, with_why: bool = False) -> Table:
    """All claims, one line each."""
    rows: list[list[Cell]] = []
    for claim in claims:
        status = f"{claim.status}: {claim.why}" if with_why and claim.why else claim.status
        rows.append([claim.id, claim.where, claim.paper, claim.here, status])
    return Table("The papers' claims", ["claim", "where", "printed", "here", "status"], rows)


def whys_table(claims: Sequence[Claim]) -> Table:
    """Why some claims are not reproduced."""
    rows: list[list[Cell]] = [[claim.id, claim.status, claim.why] for claim in claims if claim.why]
    return Table("Why not", ["claim", "status", "why"], rows)
