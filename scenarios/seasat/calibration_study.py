"""Table 1: the calibration of each data set, of all together, and why only the second column of S scatters."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from fluxtwin.calib.common.records import Calibration
from fluxtwin.calib.linear.calibrate import LinearFit
from fluxtwin.scenarios.calibration_records import NAMES, bias_alone, papers_regression, truth_vector, vector
from fluxtwin.scenarios.seasat import mission
from fluxtwin.scenarios.seasat.mission import DATA_SETS, Flight
from fluxtwin.sim.base.errors import NoAnswer
from fluxtwin.sim.base.progress import Progress
from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.earth import frames
from fluxtwin.sim.earth.constants import NT_PER_MG
from fluxtwin.sim.earth.field import FieldModel

RUNS = 200
WHITE_RUNS = 50
WHITE_SETS = ("205", "all")


@dataclass(frozen=True)
class CalibrationStudy:
    """Fits by data set, and the scatter over many runs; K = 12 parameters (S, then b in mG)."""

    fits: Mapping[str, LinearFit]
    """The papers' regression, with the covariance widened for correlated errors."""
    corrected: Mapping[str, LinearFit]
    """The same with the errors-in-variables correction."""
    estimates: FloatArray
    """(RUNS, data sets, K) of the papers' regression; every run has its own seed and start hours."""
    corrected_estimates: FloatArray
    """(RUNS, data sets, K) with the correction."""
    field_rms_mG: FloatArray
    """(RUNS, data sets, 3) smallest, middle and largest rms of the field's variation in body directions."""
    bias_only_mG: FloatArray
    """(RUNS, 3) mean bias of day 205 with T = S = 0, as in figure 1."""
    white_estimates: FloatArray
    """(WHITE_RUNS, 2, K) as `estimates` for day 205 and all, had the unknown been white noise."""
    reference_3sigma_deg: FloatArray
    """(3,) three times the rms error of the reference attitude about x, y, z: roll, pitch, yaw; over all runs."""
    truth: FloatArray
    """(K,)."""

    def scatter(self, data_set: str, *, corrected: bool = False) -> FloatArray:
        """(K,) standard deviation of the estimates over the runs."""
        values = self.corrected_estimates if corrected else self.estimates
        return np.asarray(np.nanstd(values[:, self.index(data_set)], axis=0, ddof=1))

    def mean_error(self, data_set: str, *, corrected: bool = False) -> FloatArray:
        """(K,) mean of estimate minus truth over the runs."""
        values = self.corrected_estimates if corrected else self.estimates
        return np.asarray(np.nanmean(values[:, self.index(data_set)], axis=0) - self.truth)

    def refused(self, data_set: str) -> int:
        """Runs in which the data set did not determine S and the regression said so."""
        return int(np.isnan(self.estimates[:, self.index(data_set), 0]).sum())

    @staticmethod
    def index(data_set: str) -> int:
        """Place of a data set in the arrays."""
        return list(DATA_SETS).index(data_set)


def run_calibrations(flight: Flight, ground: FieldModel, progress: Progress, runs: int = RUNS) -> CalibrationStudy:
    """Fit every data set of one flight, then repeat it with other seeds and hours."""
    fits = {name: _fit(flight, name, ground, corrected=False, blocks=True) for name in DATA_SETS}
    corrected = {name: _fit(flight, name, ground, corrected=True, blocks=True) for name in DATA_SETS}
    estimates = np.empty((runs, len(DATA_SETS), len(NAMES)))
    corrected_estimates = np.empty_like(estimates)
    spread = np.empty((runs, len(DATA_SETS), 3))
    bias_only, reference_square = np.empty((runs, 3)), np.empty((runs, 3))
    white_estimates = np.full((min(runs, WHITE_RUNS), len(WHITE_SETS), len(NAMES)), np.nan)
    for run in range(runs):
        progress(f"calibration {run + 1} of {runs}", run / runs)
        other = mission.fly(mission.with_random_hours(flight.scenario, flight.scenario.seed + 1 + run))
        reference_square[run] = np.nanmean(reference_error_rad(other) ** 2, axis=0)
        day_205 = other.telemetry.select(other.rows("205"))
        bias_only[run] = bias_alone(day_205, ground).b_nT / NT_PER_MG
        for place, name in enumerate(DATA_SETS):
            found = _try_both(other, name, ground)
            estimates[run, place], corrected_estimates[run, place], spread[run, place] = found
        if run < len(white_estimates):
            white_estimates[run] = _white_estimates(other, ground)
    return CalibrationStudy(
        fits=fits,
        corrected=corrected,
        estimates=estimates,
        corrected_estimates=corrected_estimates,
        field_rms_mG=spread,
        bias_only_mG=bias_only,
        white_estimates=white_estimates,
        reference_3sigma_deg=3 * np.degrees(np.sqrt(reference_square.mean(axis=0))),
        truth=truth_vector(flight.scenario),
    )


def _white_estimates(flight: Flight, ground: FieldModel) -> FloatArray:
    """(2, K) of the same flight, were the unknown white: how much of the scatter hangs on its correlation time."""
    white = flight.scenario.updated({"magnetometer.unknown.kind": "white"})
    again = mission.fly(white, flight.world)
    return np.stack([_try_both(again, name, ground)[0] for name in WHITE_SETS])


def reference_error_rad(flight: Flight) -> FloatArray:
    """(N, 3) rotation vector in body axes from the true to the reported attitude; NaN where none is reported."""
    assert flight.telemetry.q_NB is not None
    known = flight.telemetry.has_attitude
    error = np.full((known.size, 3), np.nan)
    reported = frames.rotation_from_q(np.array(flight.telemetry.q_NB)[known])
    error[known] = (reported * frames.rotation_from_q(flight.truth.q_NB[known]).inv()).as_rotvec()
    return error


def calibrations(flight: Flight, ground: FieldModel) -> tuple[Calibration, Calibration]:
    """The full calibration of all days, and the mean bias of day 205."""
    whole = papers_regression(flight.telemetry, ground).calibration
    return whole, bias_alone(flight.telemetry.select(flight.rows("205")), ground)


def _try_both(flight: Flight, data_set: str, ground: FieldModel) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Estimates without and with the correction, and the field's variation; NaN where the fit is refused."""
    try:
        plain = _fit(flight, data_set, ground, corrected=False)
        corrected = _fit(flight, data_set, ground, corrected=True)
    except NoAnswer:
        return np.full(12, np.nan), np.full(12, np.nan), np.full(3, np.nan)
    return vector(plain), vector(corrected), np.sort(plain.variation.rms_nT) / NT_PER_MG


def _fit(flight: Flight, data_set: str, ground: FieldModel, *, corrected: bool, blocks: bool = False) -> LinearFit:
    covariance = "blocks" if blocks else "white"
    telemetry = flight.telemetry.select(flight.rows(data_set))
    return papers_regression(telemetry, ground, errors_in_variables=corrected, covariance=covariance)
