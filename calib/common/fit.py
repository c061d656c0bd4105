"""The answer of any calibration method, ready to print: one record, whatever the method."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, TypeVar

import numpy as np

from fluxtwin.calib.common.comparison import Comparison
from fluxtwin.calib.common.coverage import Coverage
from fluxtwin.calib.common.error_model import ErrorModel
from fluxtwin.calib.common.noise import ReadingNoise
from fluxtwin.calib.common.observability import FieldVariation
from fluxtwin.calib.common.records import Calibration, parameter_unit
from fluxtwin.calib.common.residuals import ResidualStatistics, residual_statistics
from fluxtwin.calib.common.robust import find_outliers
from fluxtwin.calib.common.verdict import Verdict
from fluxtwin.sim.base.errors import amount
from fluxtwin.sim.base.shown import Shown
from fluxtwin.sim.base.types import BoolArray, FloatArray, TimeArray
from fluxtwin.sim.telemetry.record import Telemetry

F = TypeVar("F", bound="Fit")


@dataclass(frozen=True, kw_only=True)
class Fit(Shown):
    """A calibration and the evidence for it. N rows used."""

    calibration: Calibration
    method: str
    """The method's name, as `--method` takes it."""
    time: TimeArray
    """(N,) UTC."""
    residuals_nT: FloatArray
    """(N, 3) A B0 - [(I+S) B + b + T D], body axes; (N, 1) |(I+S) B + b + T D| - |B0| for the methods without attitude."""
    weights: FloatArray
    """(N,) a_k of journal eq. 4, sum 1."""
    rows: np.ndarray
    """(N,) indices of the used rows in the joined telemetry."""
    left_out: Mapping[str, int]
    """Rows not used, by reason."""
    rejected: int
    """Rows set aside as outliers (they stay in `residuals_nT`, without weight)."""
    variation: FieldVariation
    """Eigen-directions of <B|B>."""
    noise: ReadingNoise
    """What was taken for the noise of the reading."""
    messages: tuple[str, ...]
    """What a person should know, in sentences."""
    warnings: tuple[str, ...] = ()
    """What the method itself found to contradict its answer, in sentences: with one, a fit is not good."""
    error_model: ErrorModel | None = None
    """What the residuals were taken to be made of; None where only white errors were."""
    driver_covariance: FloatArray = field(default_factory=lambda: np.zeros((0, 0)))
    """(3J, 3J) of the fields that follow columns, x, y, z of each in the order of `calibration.telemetry_bias`."""
    coverage: Coverage | None = None
    """Directions of the field in the body; given as the verdict is."""
    comparison: Comparison | None = None
    """Of all methods, where that was asked for."""
    verdict: Verdict | None = None
    """What the fit is worth; given by `methods.calibrate_by` and `fluxtwin.calibrate`."""

    @property
    def kept(self) -> BoolArray:
        """(N,) rows that count; the others were set aside as outliers."""
        return np.asarray(self.weights > 0.0, dtype=np.bool_)

    @cached_property
    def statistics(self) -> ResidualStatistics:
        """Of the residuals with weight."""
        return residual_statistics(self.time[self.kept], self.residuals_nT[self.kept])

    @property
    def condition_number(self) -> float:
        """Largest over smallest eigenvalue of <B|B>."""
        return self.variation.condition_number

    @property
    def sigma(self) -> dict[str, float | None]:
        """1 sigma by parameter name (`S11` ... `b1` ... `T33`); None where not estimated."""
        return self.calibration.sigma

    @property
    def correlation(self) -> FloatArray:
        """(P, P) correlation of the parameters; zero rows where not estimated."""
        sigma = self.calibration.sigmas
        scale = np.where(sigma > 0, sigma, 1.0)
        return np.asarray(self.calibration.covariance / np.outer(scale, scale))

    @property
    def observability(self) -> tuple[str, ...]:
        """What the data do not determine, in words."""
        return self.calibration.unobservable

    def parameters(self) -> list[dict[str, Any]]:
        """One entry a parameter: name, value, sigma (None where not estimated), unit."""
        values = zip(self.calibration.names, self.calibration.values, strict=True)
        sigma = self.sigma
        return [{"name": n, "value": float(v), "sigma": sigma[n], "unit": parameter_unit(n)} for n, v in values]

    def to_dict(self) -> dict[str, Any]:
        """Plain numbers and text for JSON; no NaN."""
        return {
            "calibration": self.calibration.to_dict(),
            "parameters": self.parameters(),
            "method_name": self.method,
            "residuals": self.statistics.to_dict(),
            "samples": {"used": len(self.time), "rejected": self.rejected, "left_out": dict(self.left_out)},
            "observability": {
                "condition_number": min(self.condition_number, 1e300),
                "field_rms_nT": self.variation.rms_nT.tolist(),
                "field_directions_B": self.variation.directions_B.tolist(),
                "words": list(self.observability),
            },
            "noise": {"variance_nT2": self.noise.variance_nT2.tolist(), "source": self.noise.source},
            "error_model": None if self.error_model is None else self.error_model.to_dict(),
            "messages": list(self.messages),
            "coverage": None if self.coverage is None else self.coverage.to_dict(),
            "comparison": None if self.comparison is None else self.comparison.to_dict(),
            "verdict": None if self.verdict is None else self.verdict.to_dict(),
        }


def with_warnings(fit: F, telemetry: Telemetry, *, robust: bool) -> F:
    """The fit of a record with its warnings among the messages; none for a fit that looks sound."""
    found = []
    dipole = telemetry.dipole_B_Am2
    if fit.calibration.T_nT_per_Am2 is None and dipole is not None and bool((np.nanstd(dipole, axis=0) > 0).any()):
        found.append("the torquers fired in these data but T was not estimated: compare with --parameters b,S,T")
    outliers = 0 if robust else int(find_outliers(fit.residuals_nT).sum())
    if outliers:
        found.append(
            f"{amount(outliers, 'row is an outlier|rows are outliers')} (bit errors?): compare with --robust tukey"
        )
    return replace(fit, messages=(*fit.messages, *found))
