"""The rows of a calibration without attitude: each pairs the reading B with the size |H| of the model field there.

Columns of telemetry (torquer dipole, currents, temperature) may be added, for fields that follow them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from fluxtwin.calib.common.design import complete_rows, dipole_for_T, joined, radian_s
from fluxtwin.calib.common.records import Calibration
from fluxtwin.calib.common.residuals import ResidualStatistics, residual_statistics
from fluxtwin.sim.base.types import FloatArray, TimeArray
from fluxtwin.sim.earth.field import FieldModel, field_N_nT
from fluxtwin.sim.telemetry.record import Telemetry


@dataclass(frozen=True)
class ScalarRows:
    """Usable rows, time-ordered."""

    time: TimeArray
    """(N,) UTC."""
    B_nT: FloatArray
    """(N, 3) reading."""
    H_nT: FloatArray
    """(N,) size of the model field."""
    columns: Mapping[str, FloatArray]
    """(N,) by name: what the magnetometer's surroundings did; `dipole_x_Am2` and the like, or telemetry's names."""
    rows: np.ndarray
    """(N,) indices into the joined telemetry."""
    left_out: Mapping[str, int]
    """Rows not used, by reason."""
    radian_s: float = 1000.0
    """Time in which the spacecraft moves one radian along its orbit; where unknown, that of a low orbit."""

    def __len__(self) -> int:
        return int(self.time.size)


def assemble_scalar(
    records: Telemetry | Sequence[Telemetry],
    model: FieldModel,
    *,
    with_dipole: bool = False,
    drivers: Mapping[str, FloatArray] | None = None,
) -> ScalarRows:
    """Rows with reading, position and these columns.

    drivers: (N,) columns of the joined telemetry that a field follows, by name. Raises BadInput where the dipole is asked
    for and absent, NoAnswer when no row is complete.
    """
    telemetry = joined(records)
    dipole = dipole_for_T(telemetry) if with_dipole else np.zeros((0, 0))
    columns = {f"dipole_{axis}_Am2": dipole[:, i] for i, axis in enumerate("xyz") if with_dipole} | dict(drivers or {})
    needs = {"no reading": telemetry.has_reading, "no position": telemetry.has_position}
    for name, values in columns.items():
        needs[f"no {name}"] = np.isfinite(values)
    rows, left_out = complete_rows(needs, "without attitude needs reading and position")
    used = telemetry.select(rows)
    assert used.r_N_km is not None
    return ScalarRows(
        time=used.time,
        B_nT=used.mag_B_nT,
        H_nT=np.linalg.norm(field_N_nT(model, used.time, used.r_N_km), axis=1),
        columns={name: values[rows] for name, values in columns.items()},
        rows=rows,
        left_out=left_out,
        radian_s=radian_s(used),
    )


def predict_scalar(
    records: Telemetry | Sequence[Telemetry], calibration: Calibration, model: FieldModel
) -> ResidualStatistics:
    """Statistics of |(I+S) B + b + T D| - |H| of telemetry that was not used to make the calibration."""
    telemetry = joined(records)
    rows = assemble_scalar(telemetry, model)
    dipole = telemetry.dipole_B_Am2
    columns = {name: values[rows.rows] for name, values in calibration.columns_of(telemetry).items()}
    true = calibration.apply(rows.B_nT, None if dipole is None else dipole[rows.rows], columns)
    return residual_statistics(rows.time, (np.linalg.norm(true, axis=1) - rows.H_nT)[:, None])
