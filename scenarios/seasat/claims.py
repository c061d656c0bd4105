"""The numbered claims of the papers beside what this run gives.

`here` is always computed from the run's own results; what is printed is read from the packaged tables and
`claims.toml`. A claim counts as reproduced when the printed number lies within the stated margin of ours.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from fluxtwin.scenarios.claims import Claim, Verdict, judged
from fluxtwin.scenarios.motion import Motion
from fluxtwin.scenarios.seasat import geometry, mission
from fluxtwin.scenarios.seasat.accuracy_study import AccuracyStudy
from fluxtwin.scenarios.seasat.calibration_study import CalibrationStudy
from fluxtwin.scenarios.seasat.error_study import ErrorStudy
from fluxtwin.scenarios.seasat.identities import Identities
from fluxtwin.scenarios.seasat.yaw_study import YawStudy
from fluxtwin.sim.scenario.scenario import Scenario


@dataclass(frozen=True)
class Results:
    """All that a run has found."""

    scenario: Scenario
    motion: Motion
    """Of the flight that is calibrated."""
    calibration: CalibrationStudy
    errors: ErrorStudy
    yaw: YawStudy
    accuracy: AccuracyStudy
    identities: Identities
    nodes: geometry.NodeScan
    heads: geometry.HeadScan


Judge = Callable[[Results], Verdict]


def judge_claims(results: Results) -> list[Claim]:
    """Every claim of the packaged list, in order. Raises KeyError for a claim without a judge."""
    from fluxtwin.scenarios.seasat.judges_calibration import JUDGES as OF_CALIBRATION
    from fluxtwin.scenarios.seasat.judges_yaw import JUDGES as OF_YAW

    judges: Mapping[int, Judge] = {**OF_CALIBRATION, **OF_YAW}
    return judged(mission.read_claims(), judges, results)
