"""From a table of file columns to the record: units, frames, and the refusals that keep a wrong file out.

Every reader ends here, so a file, a column map and a simulation pass the same door.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from fluxtwin.sim.base.errors import BadInput, amount
from fluxtwin.sim.base.types import BoolArray, FloatArray, TimeArray
from fluxtwin.sim.earth import frames
from fluxtwin.sim.telemetry.columns import FileTable, Resolution, resolve
from fluxtwin.sim.telemetry.quantities import ANGLES, BY_NAME, DRIVERS, FAMILIES
from fluxtwin.sim.telemetry.record import Telemetry, is_frozen

METRES_ABOVE = 1.0e5
"""A median |r| beyond this is no orbit in km that a magnetometer serves (GEO is 42,164 km) but metres."""
METRES_PER_SECOND_ABOVE = 1.0e3
"""A median |v| beyond this is no orbit in km/s."""
NORM_TOLERANCE = 1.0e-3
"""Largest |q| - 1: files print quaternions to four digits or more, which keeps the norm within 2e-4."""


def record(table: FileTable, *, tle: Path | str | None = None, attitude: Path | str | None = None) -> Telemetry:
    """The record of a table. `tle`: two-line elements or a CCSDS OEM that give the position where the table has none.

    attitude: a CCSDS AEM that gives the attitude where the table has none.

    Raises BadInput naming the file and the row or column at fault.
    """
    from fluxtwin.sim.telemetry import companions

    found = resolve(table.columns, table.where)
    notices, provenance, origin = list(table.notices), dict(table.provenance), table.origin
    fields = _fields(table, found)
    time = table.time
    if time.size == 0:
        raise BadInput("there are no rows", where=table.where, wanted="a header and at least one row of data")
    missing = np.flatnonzero(np.isnat(time))
    if missing.size:
        raise BadInput(
            f"time is missing in row {missing[0] + 1}", where=table.where, wanted="a UTC stamp in every row (ISO 8601)"
        )
    _check_positions(fields, table.where)
    if "r_E_km" in fields:
        r_E_km = fields.pop("r_E_km")
        fields["r_N_km"] = (
            frames.rotation_EN(time).apply(np.where(np.isnan(r_E_km), 0.0, r_E_km), inverse=True) + 0.0 * r_E_km
        )
        notices.append("positions were turned from Earth-fixed to GCRS")
        origin = replace(origin, position="ITRS")
    if tle is not None and "r_N_km" in fields:
        notices.append(companions.not_used(tle, "the file has positions, so the elements in {} were not used"))
    elif tle is not None:
        fields["r_N_km"], fields["v_N_km_s"], said, stated, elements = companions.positions(tle, time)
        notices.extend(said)
        origin = replace(origin, elements=elements)
        provenance |= stated | ({companions.ATTITUDE_OF_ORBIT: "orbital"} if ANGLES.name in fields and stated else {})
    if ANGLES.name in fields:
        fields["q_NB"] = _from_angles(fields, time, notices, table.where)
        origin = replace(origin, attitude="orbital")
    if attitude is not None and "q_NB" in fields:
        notices.append(companions.not_used(attitude, "the file has an attitude, so that in {} was not used"))
    elif attitude is not None:
        fields["q_NB"], said = companions.attitude(attitude, time, fields.get("r_N_km"), fields.get("v_N_km_s"))
        notices.extend(said)
    _check_quaternions(fields.get("q_NB"), table.where)
    for name, value in fields.items():
        if name in BY_NAME and BY_NAME[name].binary:
            _binary(name, value, table.where)
    named = {column: table.columns[column] for columns in found.named.values() for column in columns.values()}
    notices.extend(_missing_rows({**fields, **named}))
    if notices:
        provenance["notices"] = "; ".join(notice.replace("; ", ", ") for notice in notices)
    try:
        return Telemetry(time=time, provenance=provenance, origin=origin, **_named(table, found), **fields)  # type: ignore[arg-type]
    except BadInput as error:
        raise BadInput(str(error), where=table.where) from None


def velocity_from_positions(time: TimeArray, r_N_km: FloatArray) -> FloatArray:
    """Velocity (N, 3) in km/s by the derivative of a cubic spline through the positions.

    The spline is broken at gaps longer than ten median steps, or 300 s where that is more; pieces of fewer than
    four positions, and rows without a position, get NaN.
    """
    v = np.full_like(r_N_km, np.nan)
    rows = np.flatnonzero(np.isfinite(r_N_km).all(axis=1))
    if rows.size < 4:
        return v
    seconds = (time - time[0]).astype("int64") * 1e-9
    from scipy.interpolate import CubicSpline  # here: it takes a fifth of a second to load

    step = np.diff(seconds[rows])
    breaks = np.flatnonzero(step > max(10.0 * float(np.median(step)), 300.0)) + 1
    for piece in np.split(rows, breaks):
        if piece.size >= 4:
            spline = CubicSpline(seconds[piece], r_N_km[piece])
            v[piece] = spline(seconds[piece], 1)
    return v


def _fields(table: FileTable, found: Resolution) -> dict[str, FloatArray]:
    fields: dict[str, FloatArray] = {}
    for name, (columns, unit) in found.found.items():
        factor = BY_NAME[name].units[unit]
        parts = [table.columns[column] for column in columns]
        value = parts[0] if len(parts) == 1 else _joined(parts)
        fields[name] = value if factor == 1.0 else value * factor
    if found.wheels:
        fields["wheel_speed_rpm"] = _joined([table.columns[c] for c in found.wheels])
    return fields


def _joined(columns: Sequence[FloatArray]) -> FloatArray:
    """(N, n); nobody can change it, so that the record takes it as it is. Columns of one such array are that array."""
    whole: object = columns[0]
    while isinstance(whole, np.ndarray):
        if whole.ndim == 2 and is_frozen(whole) and all(map(_is_column, columns, whole.T)):
            return whole
        whole = whole.base
    whole = np.stack(columns, axis=1)
    whole.setflags(write=False)
    return whole


def _is_column(one: FloatArray, other: FloatArray) -> bool:
    same_shape = one.shape == other.shape and one.strides == other.strides  # the first rows of a column start with it
    return same_shape and one.ctypes.data == other.ctypes.data


def _named(table: FileTable, found: Resolution) -> dict[str, dict[str, FloatArray] | dict[str, str]]:
    """The fields of the record for columns that the user has named, and the units of drivers."""
    fields: dict[str, dict[str, FloatArray] | dict[str, str]] = {}
    for family in FAMILIES:
        columns = found.named[family.field]
        for column in columns.values() if family.binary else ():
            _binary(column, table.columns[column], table.where)
        fields[family.field] = {name: table.columns[column] for name, column in columns.items()}
    drivers = found.named[DRIVERS.field].items()
    fields["driver_units"] = {name: table.units[column] for name, column in drivers if column in table.units}
    return fields


def _check_positions(fields: dict[str, FloatArray], where: str) -> None:
    for name, limit, unit in (
        ("r_N_km", METRES_ABOVE, "km"),
        ("r_E_km", METRES_ABOVE, "km"),
        ("v_N_km_s", METRES_PER_SECOND_ABOVE, "km/s"),
    ):
        size = np.linalg.norm(fields[name], axis=1) if name in fields else np.empty(0)
        size = size[np.isfinite(size)]
        typical = float(np.median(size)) if size.size and size.max() > limit else 0.0
        if typical > limit:
            what = "positions look like metres" if unit == "km" else "velocities look like metres per second"
            stem = BY_NAME[name].written[0]
            raise BadInput(
                f"{what}: the median of |{stem[:-5] if unit == 'km' else 'v'}| is {typical:.6g} in a column that "
                f"says {unit}",
                where=where,
                wanted=f"{', '.join(BY_NAME[name].written)} in {unit}, or a column map with the unit",
            )


def _from_angles(fields: dict[str, FloatArray], time: TimeArray, notices: list[str], where: str) -> FloatArray:
    angles = fields.pop(ANGLES.name)
    r = fields.get("r_N_km")
    if r is None:
        raise BadInput(
            "yaw, roll and pitch need the position, and the file has none",
            where=where,
            wanted="r_x_km r_y_km r_z_km (or ecef_x_km ...), or two-line elements (--tle)",
        )
    v = fields.get("v_N_km_s")
    if v is None:
        v = velocity_from_positions(time, r)
        notices.append("the orbital frame of yaw, roll and pitch was found by differentiating the positions")
    return q_from_angles(angles, r, v)


def q_from_angles(angles_rad: FloatArray, r_N_km: FloatArray, v_N_km_s: FloatArray) -> FloatArray:
    """Quaternions q_NB (N, 4) from yaw, roll, pitch (N, 3) relative to the orbital frame; NaN where unknown."""
    q = np.full((len(angles_rad), 4), np.nan)
    rows: BoolArray = np.isfinite(np.concatenate([angles_rad, r_N_km, v_N_km_s], axis=1)).all(axis=1)
    if rows.any():
        R_BO = frames.rotation_BO(*angles_rad[rows].T)
        q[rows] = frames.q_from_rotation(frames.product(R_BO, frames.rotation_ON(r_N_km[rows], v_N_km_s[rows])))
    return q


def _check_quaternions(q: FloatArray | None, where: str) -> None:
    if q is None:
        return
    size = np.linalg.norm(q, axis=1)
    off = np.flatnonzero(np.abs(size - 1.0) > NORM_TOLERANCE)
    if off.size:
        raise BadInput(
            f"the quaternion in row {off[0] + 1} has norm {size[off[0]]:.6g} ({amount(off.size, 'such row|such rows')})",
            where=where,
            wanted=f"unit quaternions, norm 1 within {NORM_TOLERANCE:g} (0.02 in a column map); blank where not known",
        )


def _binary(name: str, value: FloatArray, where: str) -> None:
    wrong = np.flatnonzero(~((value == 0) | (value == 1) | np.isnan(value)))
    if wrong.size:
        raise BadInput(f"{name} is {value[wrong[0]]:g} in row {wrong[0] + 1}", where=where, wanted="0, 1 or blank")


def _missing_rows(fields: dict[str, FloatArray]) -> list[str]:
    """How many rows of a field are blank; a sun sensor's blanks in shadow are none."""
    total = max((len(value) for value in fields.values()), default=0)
    if {"sun_B", "sunlit"} <= fields.keys():
        fields = {**fields, "sun_B": np.where(fields["sunlit"][:, None] == 0.0, 0.0, fields["sun_B"])}
    some = {name: value for name, value in fields.items() if np.isnan(np.min(value, initial=0.0))}
    missing = {_column(name): int(np.isnan(value).reshape(total, -1).any(axis=1).sum()) for name, value in some.items()}
    if len(missing) == 1:
        return [f"{name} is missing in {count} of {total} rows" for name, count in missing.items()]
    listed = ", ".join(f"{name} in {count}" for name, count in missing.items())
    return [f"missing of {total} rows: {listed}"] if missing else []


def _column(name: str) -> str:
    """What a file calls a field of the record: of a vector its first column."""
    written = BY_NAME[name].written if name in BY_NAME else (name,)
    return written[0] + " ..." * (len(written) > 1)
