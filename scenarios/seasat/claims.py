"""The numbered claims of the papers beside what this run gives: reproduced, differs, or not testable.

`here` is always computed from the run's own results; what is printed is read from the packaged tables and
`claims.toml`. A claim counts as reproduced when the printed number lies within the stated margin of ours.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from fluxtwin.scenarios.seasat import geometry, mission
from fluxtwin.scenarios.seasat.accuracy_study import AccuracyStudy
from fluxtwin.scenarios.seasat.calibration_study import CalibrationStudy
from fluxtwin.scenarios.seasat.error_study import ErrorStudy
from fluxtwin.scenarios.seasat.identities import Identities
from fluxtwin.scenarios.seasat.yaw_study import YawStudy
from fluxtwin.sim.scenario import Scenario

REPRODUCED, DIFFERS, NOT_TESTABLE = "reproduced", "differs", "not testable"


@dataclass(frozen=True)
class Results:
    """All that a run has found."""

    scenario: Scenario
    calibration: CalibrationStudy
    errors: ErrorStudy
    yaw: YawStudy
    accuracy: AccuracyStudy
    identities: Identities
    nodes: geometry.NodeScan
    heads: geometry.HeadScan


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


Judge = Callable[[Results], Verdict]


def judge_claims(results: Results) -> list[Claim]:
    """Every claim of the packaged list, in order. Raises KeyError for a claim without a judge."""
    from fluxtwin.scenarios.seasat.judges_calibration import JUDGES as OF_CALIBRATION
    from fluxtwin.scenarios.seasat.judges_yaw import JUDGES as OF_YAW

    judges: Mapping[int, Judge] = {**OF_CALIBRATION, **OF_YAW}
    claims = []
    for entry in mission.read_claims():
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


def agree(ours: float, printed: float, margin: float) -> str:
    """`reproduced` when the two are no further apart than the margin, else `differs`."""
    return REPRODUCED if abs(ours - printed) <= margin else DIFFERS
