"""How often names were right, by what the posterior gave them: the table that `fluxtwin.gap.posterior.stated` reads."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import tomli_w
from scipy.optimize import isotonic_regression

from fluxtwin.sim.base import files
from withheld_cases.judged import Judged

TABLE = Path(__file__).parents[2] / "gap" / "posterior" / "stated.toml"
FIRST, FURTHER = "first", "further"
"""As in the module that reads the table."""
WHAT = """\
# How often names were right, by what the posterior gave them. Made by benchmarks/withheld.py --fit; not written by hand.
"""


def pairs_of(cases: Sequence[Judged], place: str) -> tuple[list[float], list[bool]]:
    """The posterior of every name at that place in its answer, and whether it, or its group, holds a truth."""
    found = []
    for case in cases:
        named = [
            (float(p), case.hits(entry))
            for (_, p), entry in zip(case.said["provenance"]["posterior"], case.effects, strict=True)
        ]
        found += named[:1] if place == FIRST else named[1:]
    return [p for p, _ in found], [hit for _, hit in found]


def steps(posterior: Sequence[float], right: Sequence[bool]) -> dict[str, list[float]]:
    """Least posterior, number right and number of each step of the non-decreasing shares that suit the counts best."""
    order = np.argsort(posterior, kind="stable")
    p, hit = np.asarray(posterior, dtype=np.float64)[order], np.asarray(right, dtype=np.float64)[order]
    blocks = isotonic_regression(hit).blocks
    # Names of one posterior belong to one step.
    starts = [int(start) for start in blocks[:-1] if start == 0 or p[start] > p[start - 1]]
    ends = [*starts[1:], p.size]
    return {
        "least": [0.0, *(float(p[start]) for start in starts[1:])],
        "right": [int(hit[a:b].sum()) for a, b in zip(starts, ends, strict=True)],
        "of": [b - a for a, b in zip(starts, ends, strict=True)],
    }


def write(cases: Sequence[Judged], seed: int, commit: str) -> None:
    """The table, with where it is from."""
    counts: dict[str, int] = {}
    for case in cases:
        counts[case.population] = counts.get(case.population, 0) + 1
    found = {place: steps(*pairs_of(cases, place)) for place in (FIRST, FURTHER)}
    made = {"seed": seed, "commit": commit, "date": datetime.now(UTC).date().isoformat(), "records": counts}
    files.write_text(TABLE, WHAT + tomli_w.dumps({"made": made, **found}))
