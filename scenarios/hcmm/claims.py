"""The numbered claims of the papers on HCMM beside what this run gives.

`here` is always computed from the run's own results, or from the printed record itself where a claim is arithmetic on
it; what is printed is read from the packaged tables and `claims.toml`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from fluxtwin.scenarios.claims import Claim, Verdict, judged
from fluxtwin.scenarios.hcmm import mission
from fluxtwin.scenarios.hcmm.accuracy_study import AccuracyStudy
from fluxtwin.scenarios.hcmm.calibration_study import CalibrationStudy
from fluxtwin.scenarios.hcmm.dawn_study import DawnStudy
from fluxtwin.scenarios.hcmm.error_study import ErrorStudy
from fluxtwin.scenarios.hcmm.field_evidence import FieldEvidence
from fluxtwin.scenarios.hcmm.gallery_study import Answer
from fluxtwin.scenarios.hcmm.horizon_study import HorizonStudy
from fluxtwin.scenarios.hcmm.missing_study import MissingStudy
from fluxtwin.scenarios.hcmm.pass_study import PassStudy
from fluxtwin.scenarios.hcmm.real_passes import RealPasses
from fluxtwin.scenarios.hcmm.scanner_study import ScannerStudy
from fluxtwin.scenarios.hcmm.yaw_study import YawStudy
from fluxtwin.scenarios.hcmm_orbit.fit import OrbitFit
from fluxtwin.scenarios.hcmm_orbit.flight_test import FlightTest
from fluxtwin.scenarios.hcmm_orbit.nadir_field import NadirField
from fluxtwin.scenarios.hcmm_orbit.windows import Windows
from fluxtwin.scenarios.motion import Motion
from fluxtwin.sim.scenario.scenario import Scenario


@dataclass(frozen=True)
class Results:
    """All that a run has found."""

    scenario: Scenario
    motion: Motion
    """Of the three days of Table 5."""
    orbit: OrbitFit
    windows: Windows
    """Of all 43 passes, from the sun-nadir ranges with their documented digits."""
    flight_test: FlightTest
    nadir_field: NadirField
    evidence: FieldEvidence
    calibration: CalibrationStudy
    errors: ErrorStudy
    passes: PassStudy
    dawn: DawnStudy
    yaw: YawStudy
    accuracy: AccuracyStudy
    scanner: ScannerStudy
    horizon: HorizonStudy
    missing: MissingStudy
    real_passes: RealPasses
    gallery: tuple[Answer, ...]
    gallery_law: Answer | None
    """Case (c) with the coils driven by the control law; None where the motion of the study is prescribed too."""


Judge = Callable[[Results], Verdict]


def judge_claims(results: Results) -> list[Claim]:
    """Every claim of the packaged list, in order. Raises KeyError for a claim without a judge."""
    from fluxtwin.scenarios.hcmm.judges_calibration import JUDGES as OF_CALIBRATION
    from fluxtwin.scenarios.hcmm.judges_passes import JUDGES as OF_PASSES

    judges: Mapping[int, Judge] = {**OF_CALIBRATION, **OF_PASSES}
    return judged(mission.read_claims(), judges, results)
