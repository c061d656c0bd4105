"""What the studies of Lerner and Shuster's papers read off a linear fit: S row by row, and b in mG."""

from __future__ import annotations

import numpy as np

from fluxtwin.calib.common.records import Calibration, parameter_names
from fluxtwin.calib.linear.fit import LinearFit
from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.earth.constants import NT_PER_MG
from fluxtwin.sim.scenario.scenario import Scenario

NAMES = parameter_names(with_T=False)


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
