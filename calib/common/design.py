"""The rows of the regression, assembled from telemetry and a field model.

Each row pairs the reading B with the reference field in body axes, A B0, and the torquer dipole D. Rows
without attitude, reading, position or (when T is wanted) dipole are left out and counted by reason.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from fluxtwin.sim.base.errors import BadInput, NoAnswer, amount
from fluxtwin.sim.base.types import BoolArray, FloatArray, TimeArray
from fluxtwin.sim.earth import frames
from fluxtwin.sim.earth.constants import GM_EARTH_KM3_S2
from fluxtwin.sim.earth.field import FieldModel, field_N_nT
from fluxtwin.sim.telemetry.record import Telemetry, concatenate


@dataclass(frozen=True)
class Design:
    """Usable rows, time-ordered; body axes, nT."""

    time: TimeArray
    """(N,) UTC."""
    B_nT: FloatArray
    """(N, 3) reading."""
    H_nT: FloatArray
    """(N, 3) reference field A B0; without attitude its size (N,)."""
    columns: Mapping[str, FloatArray]
    """(N,) by name, columns of telemetry that a field follows; without attitude those of the torquer dipole too."""
    rows: np.ndarray
    """(N,) indices into the joined telemetry."""
    left_out: Mapping[str, int]
    """Rows not used, by reason."""
    radian_s: float = 1000.0
    """Time in which the spacecraft moves one radian along its orbit; where unknown, that of a low orbit."""
    D_Am2: FloatArray | None = None
    """(N, 3) torquer dipole of a calibration by attitude; None when it is not asked for."""

    def __len__(self) -> int:
        return int(self.time.size)


def of_turns(field_nT: FloatArray) -> FloatArray:
    """(N, 3, 3) change [nT/rad] of a field (N, 3) by small turns: column j is e_j x field."""
    x, y, z = field_nT.T
    none = np.zeros(len(field_nT))
    return np.array([[none, z, -y], [-z, none, x], [y, -x, none]]).transpose(2, 0, 1)


def joined(records: Telemetry | Sequence[Telemetry]) -> Telemetry:
    """One record of one or several, ordered in time. Raises BadInput for none, or for overlap in time."""
    return records if isinstance(records, Telemetry) else concatenate(list(records))


def assemble(
    records: Telemetry | Sequence[Telemetry],
    model: FieldModel,
    *,
    with_dipole: bool,
    columns: Mapping[str, FloatArray] | None = None,
) -> Design:
    """The rows of journal eq. 2.

    columns: (N,) of the joined telemetry, by name, that a row needs as well.
    Raises BadInput when a whole column that is needed is absent, NoAnswer when no row is complete.
    """
    telemetry = joined(records)
    needs = {
        "no reading": telemetry.has_reading,
        "no reference attitude": telemetry.has_attitude,
        "no position": telemetry.has_position,
    }
    if with_dipole:
        needs["no torquer dipole"] = np.asarray(np.isfinite(dipole_for_T(telemetry)).all(axis=1))
    columns = columns or {}
    needs |= {f"no {name}": np.isfinite(values) for name, values in columns.items()}
    rows, left_out = complete_rows(needs, "by attitude needs reading, attitude and position")
    used = telemetry.select(rows)
    return Design(
        time=used.time,
        B_nT=used.mag_B_nT,
        H_nT=reference_field_B_nT(used, model),
        columns={name: values[rows] for name, values in columns.items()},
        rows=rows,
        left_out=left_out,
        radian_s=radian_s(used),
        D_Am2=used.dipole_B_Am2 if with_dipole else None,
    )


def radian_s(telemetry: Telemetry) -> float:
    """Time in which the spacecraft moves one radian along its orbit, sqrt(r^3 / GM) at the median radius."""
    assert telemetry.r_N_km is not None
    radius_km = float(np.median(np.linalg.norm(telemetry.r_N_km, axis=1)))
    return float(np.sqrt(radius_km**3 / GM_EARTH_KM3_S2))


def dipole_for_T(telemetry: Telemetry) -> FloatArray:
    """(N, 3) torquer dipole [A m2]. Raises BadInput where the telemetry has none."""
    if telemetry.dipole_B_Am2 is None:
        raise BadInput(
            "T is asked for, and the telemetry has no torquer dipole",
            where="dipole_x_Am2 dipole_y_Am2 dipole_z_Am2",
            wanted="the dipole columns, or --parameters b,S",
        )
    return telemetry.dipole_B_Am2


def reference_field_B_nT(telemetry: Telemetry, model: FieldModel) -> FloatArray:
    """(N, 3) model field in body axes, A B0, where position and attitude are known; NaN elsewhere."""
    known = np.flatnonzero(telemetry.has_position & telemetry.has_attitude)
    reference = np.full((len(telemetry), 3), np.nan)
    if known.size and telemetry.r_N_km is not None and telemetry.q_NB is not None:
        field_N = field_N_nT(model, telemetry.time[known], telemetry.r_N_km[known])
        reference[known] = frames.rotation_from_q(telemetry.q_NB[known]).apply(field_N)
    return reference


def rows_with(needs: Mapping[str, BoolArray]) -> tuple[np.ndarray, dict[str, int]]:
    """Indices of the rows that have everything, and how many lack what (a row counts for its first missing thing).

    needs: (N,) by reason, where the row has it.
    """
    usable = np.ones(len(next(iter(needs.values()))), dtype=bool)
    left_out = {}
    for reason, present in needs.items():
        left_out[reason] = int((usable & ~present).sum())
        usable &= present
    return np.flatnonzero(usable), {reason: count for reason, count in left_out.items() if count}


def complete_rows(needs: Mapping[str, BoolArray], wanted: str) -> tuple[np.ndarray, dict[str, int]]:
    """As `rows_with`. Raises NoAnswer, with the words of `wanted`, when no row is left."""
    rows, left_out = rows_with(needs)
    if not rows.size:
        reasons = ", ".join(f"{amount(count, 'row has|rows have')} {reason}" for reason, count in left_out.items())
        positions = "; --tle FILE gives positions" if "no position" in left_out else ""
        raise NoAnswer(
            f"no row is complete: {reasons}. A calibration {wanted}{positions}", evidence={"left_out": left_out}
        )
    return rows, left_out
