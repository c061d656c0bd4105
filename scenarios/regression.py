"""The papers' regression as the mission studies do it: one fit, and what many flights give; in mG."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from fluxtwin.calib.common.design import assemble
from fluxtwin.calib.common.records import Calibration, parameter_names
from fluxtwin.calib.linear.calibrate import LinearFit, calibrate_linear
from fluxtwin.scenarios.flights import Flight, rms, rms_along
from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.earth.constants import NT_PER_MG
from fluxtwin.sim.earth.field import FieldModel
from fluxtwin.sim.scenario.scenario import Scenario
from fluxtwin.sim.telemetry.record import Telemetry

NAMES = parameter_names(with_T=False)


def papers_regression(telemetry: Telemetry, ground: FieldModel, **options: Any) -> LinearFit:
    """Lerner and Shuster's equations 8 and 9 as they have them: every sample an error of its own, none in the regressor."""
    plain = {"errors_in_variables": False, "robust": "none", "covariance": "white"}
    return calibrate_linear(telemetry, ground, **{**plain, **options})


def bias_alone(telemetry: Telemetry, ground: FieldModel) -> Calibration:
    """The mean bias, with S = T = 0, as the flight software of 1978 had it."""
    return calibrate_linear(telemetry, ground, parameters="b", robust="none", covariance="white").calibration


def error_square_mG2(flight: Flight, telemetry: Telemetry, ground: FieldModel) -> float:
    """Mean square of equation 1's error at the true S, b, T = 0, as the ground sees it in rows of the flight."""
    design = assemble(telemetry, ground, with_dipole=False)
    corrected = design.B_nT @ (np.eye(3) + flight.truth.S).T + flight.truth.b_nT
    return float(np.mean((design.H_nT - corrected) ** 2) / NT_PER_MG**2)


def vector(fit: LinearFit) -> FloatArray:
    """(12,) S row by row and b in mG."""
    return np.concatenate([fit.calibration.S.ravel(), fit.calibration.b_nT / NT_PER_MG])


def vector_sigma(fit: LinearFit) -> FloatArray:
    """(12,) 1 sigma in the same order and units."""
    return np.asarray(fit.calibration.sigmas[:12] / np.repeat([1.0, NT_PER_MG], [9, 3]))


def truth_vector(config: Scenario) -> FloatArray:
    """(12,) S row by row and b in mG as the scenario has them. For comparison only; no estimator sees it."""
    return np.concatenate([np.array(config.magnetometer.S).ravel(), np.array(config.magnetometer.bias_nT) / NT_PER_MG])


@dataclass(frozen=True)
class Estimates:
    """What many flights gave: R flights, each with D data sets of K parameters."""

    sets: tuple[str, ...]
    values: FloatArray
    """(R, D, K) NaN where a data set was refused."""
    truth: FloatArray
    """(K,)."""

    def of(self, name: str) -> FloatArray:
        """(R, K) of one data set."""
        return np.asarray(self.values[:, self.sets.index(name)])

    def scatter(self, name: str) -> FloatArray:
        """(K,) standard deviation over the flights."""
        return np.asarray(np.nanstd(self.of(name), axis=0, ddof=1))

    def mean_error(self, name: str) -> FloatArray:
        """(K,) mean of estimate less truth."""
        return np.asarray(np.nanmean(self.of(name), axis=0) - self.truth)

    def rms_error(self, name: str) -> FloatArray:
        """(K,) root mean square of estimate less truth: an error that all flights share is in it."""
        return rms_along(self.of(name) - self.truth, axis=0)

    def refused(self, name: str) -> int:
        """Flights in which the data set did not determine S and the regression said so."""
        return int(np.isnan(self.of(name)[:, 0]).sum())


def budget(squares: Mapping[str, list[float]]) -> dict[str, dict[str, float]]:
    """By source of error, of mean squares [mG^2] of many flights: their root mean, and the standard deviation of roots."""
    return {
        "simulated": {source: float(np.sqrt(np.mean(values))) for source, values in squares.items()},
        "simulated_spread": {source: float(np.std(np.sqrt(values))) for source, values in squares.items()},
    }


def rms_mG(fit: LinearFit) -> float:
    """Residual, rms per component over all three axes [mG]."""
    return rms(fit.residuals_nT) / NT_PER_MG


def calibration_summary(found: Calibration) -> dict[str, object]:
    """S, b_mG and sigmas as they are in `summary.json`."""
    sigma = found.sigmas
    return {
        "S": found.S.tolist(),
        "b_mG": (found.b_nT / NT_PER_MG).tolist(),
        "sigma_S": sigma[:9].reshape(3, 3).tolist(),
        "sigma_b_mG": (sigma[9:12] / NT_PER_MG).tolist(),
        **{name: getattr(found, name) for name in ("samples", "method", "covariance_kind", "field_model")},
    }
