"""How well a calibration made elsewhere gives |H|, where no attitude is known."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from fluxtwin.calib.common.design import joined
from fluxtwin.calib.common.records import Calibration
from fluxtwin.calib.common.residuals import ResidualStatistics, residual_statistics
from fluxtwin.calib.scalar.rows import assemble_scalar
from fluxtwin.sim.earth.field import FieldModel
from fluxtwin.sim.telemetry.record import Telemetry, recorded_columns


def predict_scalar(
    records: Telemetry | Sequence[Telemetry], calibration: Calibration, model: FieldModel
) -> ResidualStatistics:
    """Statistics of |(I+S) B + b + T D| - |H| of telemetry that was not used to make the calibration."""
    telemetry = joined(records)
    rows = assemble_scalar(telemetry, model)
    dipole = telemetry.dipole_B_Am2
    columns = {name: values[rows.rows] for name, values in recorded_columns(telemetry).items()}
    true = calibration.apply(rows.B_nT, None if dipole is None else dipole[rows.rows], columns)
    return residual_statistics(rows.time, (np.linalg.norm(true, axis=1) - rows.H_nT)[:, None])
