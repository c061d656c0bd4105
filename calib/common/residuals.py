"""Residual statistics: rms per axis, correlation in time, and the test on days that were not used."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from fluxtwin.calib.common.covariance import autocorrelation, correlation_time_s, segments, stretches
from fluxtwin.calib.common.design import joined, reference_field_B_nT
from fluxtwin.calib.common.records import Calibration
from fluxtwin.sim.base.errors import NoAnswer
from fluxtwin.sim.base.types import FloatArray, TimeArray
from fluxtwin.sim.earth.constants import NT_PER_MG
from fluxtwin.sim.earth.field import FieldModel, field_N_nT
from fluxtwin.sim.telemetry.record import Telemetry

_LAGS_SHOWN = 10


@dataclass(frozen=True)
class ResidualStatistics:
    """Of true-field residuals A B0 - [(I+S) B + b + T D], body axes."""

    samples: int
    mean_nT: FloatArray
    """(3,)."""
    rms_nT: FloatArray
    """(3,) about zero, per axis."""
    lag_correlation: FloatArray
    """Correlation of residuals 0, 1, 2, ... samples apart, mean over the axes."""
    correlation_time_s: float
    """Where that falls below 1/e."""

    @property
    def component_rms_nT(self) -> float:
        """rms of one component over the three axes: the papers' "rms residual"."""
        return float(np.sqrt((self.rms_nT**2).mean()))

    def to_dict(self) -> dict[str, Any]:
        """Plain numbers; no NaN."""
        return {
            "samples": self.samples,
            "mean_nT": self.mean_nT.tolist(),
            "rms_nT": self.rms_nT.tolist(),
            "component_rms_nT": self.component_rms_nT,
            "component_rms_mG": self.component_rms_nT / NT_PER_MG,
            "lag_correlation": self.lag_correlation.tolist(),
            "correlation_time_s": self.correlation_time_s,
        }


def residual_statistics(time: TimeArray, residual_nT: FloatArray) -> ResidualStatistics:
    """Statistics of residuals (N, 3) at `time` (N,); rows that are not finite are left out."""
    finite = np.isfinite(residual_nT).all(axis=1)
    r, stamps = (residual_nT, time) if finite.all() else (residual_nT[finite], time[finite])
    if not len(r):
        raise NoAnswer("there is no residual: no row has reading, attitude and position", evidence={"samples": 0})
    some = stretches(len(r))
    segment = segments(stamps[some])
    lags = min(_LAGS_SHOWN, max(1, len(some) // 4))
    return ResidualStatistics(
        samples=len(r),
        mean_nT=r.mean(axis=0),
        rms_nT=np.sqrt((r**2).mean(axis=0)),
        lag_correlation=autocorrelation(r[some], segment, range(lags + 1)),
        correlation_time_s=correlation_time_s(stamps[some], r[some], segment),
    )


def residuals_of(records: Telemetry | Sequence[Telemetry], calibration: Calibration, model: FieldModel) -> FloatArray:
    """(N, 3) A B0 - [(I+S) B + b + T D] of telemetry under a calibration made elsewhere; NaN where unknown."""
    telemetry = joined(records)
    found = calibration.apply(telemetry.mag_B_nT, telemetry.dipole_B_Am2, calibration.columns_of(telemetry))
    return reference_field_B_nT(telemetry, model) - found


def size_residuals_of(telemetry: Telemetry, calibration: Calibration, model: FieldModel) -> FloatArray:
    """(N, 1) |(I+S) B + b + T D| - |B0|, which needs no attitude; NaN where unknown."""
    found = calibration.apply(telemetry.mag_B_nT, telemetry.dipole_B_Am2, calibration.columns_of(telemetry))
    size = np.full(len(telemetry), np.nan)
    placed = np.flatnonzero(telemetry.has_position)
    if placed.size and telemetry.r_N_km is not None:
        size[placed] = np.linalg.norm(field_N_nT(model, telemetry.time[placed], telemetry.r_N_km[placed]), axis=1)
    return np.asarray((np.linalg.norm(found, axis=1) - size)[:, None])


def predict(
    records: Telemetry | Sequence[Telemetry], calibration: Calibration, model: FieldModel, *, size_only: bool = False
) -> ResidualStatistics:
    """How well a calibration predicts telemetry that was not used to make it, or |B| of it alone."""
    telemetry = joined(records)
    residuals = size_residuals_of if size_only else residuals_of
    return residual_statistics(telemetry.time, residuals(telemetry, calibration, model))
