"""What a paper claims beside what a study finds, in five statuses.

`reproduced`: an outcome that could have come out otherwise, and came out as printed. `put in`: an input of the scenario
read back. `definition`: a formula or a frame, true of any data. `differs`: with its computed reason.
`not testable`: with what would test it. The kind of a claim, where it is no outcome, stands in the study's `claims.toml`;
whether it holds is for its judge.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from fluxtwin.scenarios.page import Cell, Table

STATUSES = REPRODUCED, PUT_IN, DEFINITION, DIFFERS, NOT_TESTABLE = (
    "reproduced",
    "put in",
    "definition",
    "differs",
    "not testable",
)


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
        plain = {name: value for name, value in vars(self).items() if name != "why"}
        return plain | ({"why": self.why} if self.why else {})


def judged(entries: Iterable[Mapping[str, Any]], judge: Callable[[int], Mapping[str, Any]]) -> list[Claim]:
    """Every entry (id, where, paper, and kind where it is no outcome) judged, in order.

    judge: of a claim's number what was found: `here` (text with the number and its unit), `value`, `unit`, `holds` (None: it
    cannot be tested), `otherwise` (why not; what would test it), `remark` (to be said in any case). Raises KeyError for a
    claim without a judge, ValueError for a verdict without a number or without its reason.
    """
    claims = []
    for entry in entries:
        found, kind = judge(entry["id"]), entry.get("kind", REPRODUCED)
        if kind not in (REPRODUCED, PUT_IN, DEFINITION):
            raise ValueError(f"claim {entry['id']}: there is no kind {kind!r}")
        if not np.isfinite(found["value"]):
            raise ValueError(f"claim {entry['id']}: no finite number was computed")
        status = NOT_TESTABLE if found["holds"] is None else kind if found["holds"] else DIFFERS
        if not found["holds"] and not found["otherwise"]:
            raise ValueError(f"claim {entry['id']}: {status} without a reason")
        claims.append(
            Claim(
                id=entry["id"],
                where=entry["where"],
                paper=entry["paper"],
                here=found["here"],
                value=float(found["value"]),
                unit=found["unit"],
                status=status,
                why="; ".join(filter(None, (found["remark"], "" if found["holds"] else found["otherwise"]))),
            )
        )
    return claims


def counted(claims: Sequence[Claim]) -> str:
    """As "9 of 24 claims reproduced, 2 put in, 0 definitions, 11 differ, 2 not testable"."""
    counts = Counter(claim.status for claim in claims)
    definitions = f"{counts[DEFINITION]} definition{'' if counts[DEFINITION] == 1 else 's'}"
    return (
        f"{counts[REPRODUCED]} of {len(claims)} claims reproduced, {counts[PUT_IN]} put in, {definitions}, "
        f"{counts[DIFFERS]} differ{'s' if counts[DIFFERS] == 1 else ''}, {counts[NOT_TESTABLE]} not testable"
    )


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
