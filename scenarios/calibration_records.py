"""The regression of Lerner and Shuster's papers, and what their studies read off it: S row by row, and b in mG."""

from __future__ import annotations

from typing import Any

import numpy as np

from fluxtwin.calib.common.design import assemble
from fluxtwin.calib.common.records import Calibration, parameter_names
from fluxtwin.calib.linear.calibrate import LinearFit, calibrate_linear
from fluxtwin.scenarios.flights import Flight
from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.earth.constants import NT_PER_MG
from fluxtwin.sim.earth.field import FieldModel
from fluxtwin.sim.scenario.scenario import Scenario
from fluxtwin.sim.telemetry.record import Telemetry

NAMES = parameter_names(with_T=False)


def papers_regression(telemetry: Telemetry, ground: FieldModel, **options: Any) -> LinearFit:
    """Equations 8 and 9 as the papers have them: every sample an error of its own, none of them in the regressor."""
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
    sigma = fit.calibration.sigmas[:12]
    return np.concatenate([sigma[:9], sigma[9:] / NT_PER_MG])


def truth_vector(config: Scenario) -> FloatArray:
    """(12,) S row by row and b in mG as the scenario has them. For comparison only; no estimator sees it."""
    return np.concatenate([np.array(config.magnetometer.S).ravel(), np.array(config.magnetometer.bias_nT) / NT_PER_MG])


def rms_mG(fit: LinearFit) -> float:
    """Residual, rms per component over all three axes [mG]."""
    return float(np.sqrt(np.mean(fit.residuals_nT**2)) / NT_PER_MG)


def calibration_summary(found: Calibration) -> dict[str, object]:
    """S, b_mG and sigmas as they stand in `summary.json`."""
    sigma = found.sigmas
    return {
        "S": found.S.tolist(),
        "b_mG": (found.b_nT / NT_PER_MG).tolist(),
        "sigma_S": sigma[:9].reshape(3, 3).tolist(),
        "sigma_b_mG": (sigma[9:12] / NT_PER_MG).tolist(),
        "samples": found.samples,
        "method": found.method,
        "covariance_kind": found.covariance_kind,
        "field_model": found.field_model,
    }
