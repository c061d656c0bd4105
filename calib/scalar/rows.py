"""The rows of a calibration without attitude: each pairs the reading B with the size |H| of the model field there.

Columns of telemetry (torquer dipole, currents, temperature) may be added, for fields that follow them.
"""

from __future__ import annotations

import difflib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from fluxtwin.calib.common.design import complete_rows, dipole_for_T, joined, radian_s
from fluxtwin.calib.common.records import Calibration
from fluxtwin.calib.common.residuals import ResidualStatistics, residual_statistics
from fluxtwin.sim.base.errors import BadInput
from fluxtwin.sim.base.types import FloatArray, TimeArray
from fluxtwin.sim.earth.field import FieldModel, field_N_nT
from fluxtwin.sim.telemetry.record import Telemetry, recorded_columns

_NO_SCALARS = ("sun_B", "nadir_B", "rate_B_rad_s", "dipole_B_Am2", "wheel_speed_rpm")


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
    names: Sequence[str] = (),
) -> ScalarRows:
    """Rows with reading, position and the named columns.

    names: columns of the telemetry. Raises BadInput for a column that is absent, NoAnswer when no row is complete.
    """
    telemetry = joined(records)
    columns = _columns(telemetry, with_dipole, names)
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


def _columns(telemetry: Telemetry, with_dipole: bool, names: Sequence[str]) -> dict[str, FloatArray]:
    known = {name: v for name, v in recorded_columns(telemetry).items() if name not in _NO_SCALARS and v.ndim == 1}
    out: dict[str, FloatArray] = {}
    if with_dipole:
        out |= {f"dipole_{axis}_Am2": dipole_for_T(telemetry)[:, i] for i, axis in enumerate("xyz")}
    for name in names:
        if name not in known:
            near = difflib.get_close_matches(name, known, n=1, cutoff=0.4)
            hint = f"{near[0]!r} is near" if near else ", ".join(known) or "this telemetry has no such column"
            raise BadInput(f"the telemetry has no column {name!r}", where="telemetry_bias", wanted=hint)
        out[name] = known[name]
    return out


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
