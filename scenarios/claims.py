"""What a paper claims beside what a study finds, in five statuses.

`reproduced`: an outcome that could have come out otherwise, and came out as printed. `put in`: an input of the scenario
read back. `definition`: a formula or a frame, true of any data. `differs`: with its computed reason.
`not testable`: with what would test it. The kind of a claim, where it is no outcome, is in the study's `claims.toml`;
whether it holds is said with its words.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
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
    """One claim with its status."""

    id: int
    where: str
    paper: str
    here: str
    value: float
    unit: str
    status: str
    why: str = ""

    def to_dict(self) -> dict[str, object]:
        """As it is in `summary.json`."""
        plain = {name: value for name, value in vars(self).items() if name != "why"}
        return plain | ({"why": self.why} if self.why else {})


def claim_of(entry: Mapping[str, Any], found: Mapping[str, Any]) -> Claim:
    """A claim of a paper (id, where, paper, and kind where it is no outcome) with its status.

    found: `here` (text with the number and its unit), `value`, `unit`, `holds` (None: it cannot be tested), `otherwise` (why
    not; what would test it), `remark` (to be said in any case). Raises ValueError without a number or without a reason.
    """
    kind = entry.get("kind", REPRODUCED)
    if kind not in (REPRODUCED, PUT_IN, DEFINITION):
        raise ValueError(f"claim {entry['id']}: there is no kind {kind!r}")
    if not np.isfinite(found["value"]):
        raise ValueError(f"claim {entry['id']}: no finite number was computed")
    status = NOT_TESTABLE if found["holds"] is None else kind if found["holds"] else DIFFERS
    if not found["holds"] and not found["otherwise"]:
        raise ValueError(f"claim {entry['id']}: {status} without a reason")
    return Claim(
        **{key: entry[key] for key in ("id", "where", "paper")},
        **{key: found[key] for key in ("here", "unit")},
        value=float(found["value"]),
        status=status,
        why="; ".join(filter(None, (found["remark"], "" if found["holds"] else found["otherwise"]))),
    )


def counted(claims: Sequence[Claim]) -> str:
    """As "9 of 24 claims reproduced, 2 put in, 0 definitions, 11 differ, 2 not testable"."""
    counts = Counter(claim.status for claim in claims)
    definitions = f"{counts[DEFINITION]} definition{'' if counts[DEFINITION] == 1 else 's'}"
    return (
        f"{counts[REPRODUCED]} of {len(claims)} claims reproduced, {counts[PUT_IN]} put in, {definitions}, "
        f"{counts[DIFFERS]} differ{'s' if counts[DIFFERS] == 1 else ''}, {counts[NOT_TESTABLE]} not testable"
    )


def claims_tables(claims: Sequence[Claim]) -> dict[str, Table]:
    """`claims`: one line each, with its reason; `statuses`: the same without; `whys`: the reasons alone."""
    heading, columns = "The papers' claims", ["claim", "where", "printed", "here", "status"]
    bare: list[list[Cell]] = [[c.id, c.where, c.paper, c.here, c.status] for c in claims]
    full = [[*row[:4], f"{c.status}: {c.why}" if c.why else c.status] for row, c in zip(bare, claims, strict=True)]
    return {
        "claims": Table(heading, columns, full),
        "statuses": Table(heading, columns, bare),
        "whys": Table("Why not", ["claim", "status", "why"], [[c.id, c.status, c.why] for c in claims if c.why]),
    }
