"""The answer of a calibration without attitude: from D, b, s of the scalar form to S, b, T of journal eq. 1."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from fluxtwin.calib.common.conventions import PAIRS
from fluxtwin.calib.common.fit import Fit
from fluxtwin.calib.common.records import TelemetryBias
from fluxtwin.calib.scalar.model import ScalarData, unpack
from fluxtwin.sim.base.types import FloatArray

NO_ROTATION = (
    "how the magnetometer is turned in the body: |B| does not show it. S is given symmetric, S12 = S21, S13 = S31, "
    "S23 = S32; its rotation is not in the sigmas"
)
_DIPOLES = ("dipole_x_Am2", "dipole_y_Am2", "dipole_z_Am2")


@dataclass(frozen=True, kw_only=True)
class ScalarFit(Fit):
    """What the methods without attitude add to the record of every method."""

    quality: Mapping[str, float] = field(default_factory=dict)
    """`chi2_per_sample`: mean of r^2/q; `field_size_variation`: rms of |H| over its mean; `rounds` of the search."""

    def to_dict(self) -> dict[str, Any]:
        """Plain numbers and text for JSON; no NaN."""
        biases = self.calibration.to_dict().get("telemetry_bias", {})
        return {**super().to_dict(), "telemetry_bias": biases, "quality": dict(self.quality)}


def file_parameters(
    p: FloatArray,
    covariance: FloatArray,
    data: ScalarData,
    columns: tuple[str, ...],
    scale_nT: float,
    units: FloatArray,
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, dict[str, TelemetryBias]]:
    """S (3, 3), b_nT (3,), T (3, 3), their covariance (21, 21) in the order of the calibration file, and other fields.

    O = I: I + S = I + D, b = -b_A, T = -(I+D) s. units: (J,) rms of the columns that they were scaled by.
    """
    D, b, s = unpack(p, data)
    sigma_s = np.sqrt(np.diag(covariance))[(6 if data.with_D else 0) + 3 :].reshape(-1, 3)
    biases = {}
    P = np.eye(3) + D
    T = np.zeros((3, 3))
    jacobian = np.zeros((21, len(p)))
    at = 0
    if data.with_D:
        for k, (i, j) in enumerate(PAIRS):
            jacobian[3 * i + j, k] = jacobian[3 * j + i, k] = 1.0
        at = 6
    jacobian[9:12, at : at + 3] = -scale_nT * np.eye(3)
    for j, name in enumerate(columns):
        per = scale_nT / units[j]
        if name not in _DIPOLES:
            biases[name] = TelemetryBias(s[j] * per, sigma_s[j] * per)
            continue
        axis = _DIPOLES.index(name)
        T[:, axis] = -per * P @ s[j]
        rows = 12 + 3 * np.arange(3) + axis
        jacobian[rows, at + 3 + 3 * j : at + 6 + 3 * j] = -per * P
        if data.with_D:
            for k, (m, n) in enumerate(PAIRS):
                unit = np.zeros((3, 3))
                unit[m, n] = unit[n, m] = 1.0
                jacobian[rows, k] = -per * unit @ s[j]
    return D, -b * scale_nT, T, jacobian @ covariance @ jacobian.T, biases


def driver_covariance(
    covariance: FloatArray, data: ScalarData, columns: tuple[str, ...], scale_nT: float, units: FloatArray
) -> FloatArray:
    """(3J, 3J) of the fields that follow columns other than the dipole; arguments as `file_parameters`."""
    own = [j for j, name in enumerate(columns) if name not in _DIPOLES]
    start = (6 if data.with_D else 0) + 3
    place = np.array([start + 3 * j + axis for j in own for axis in range(3)], dtype=int)
    per = np.repeat(scale_nT / units[own], 3)
    return np.asarray(np.outer(per, per) * covariance[np.ix_(place, place)])
