"""What a telemetry file holds: columns, units, span, rates, gaps, passes, where it comes from, and what each verb lacks."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Unpack

import numpy as np

from fluxtwin.calib.methods import ESTIMATORS
from fluxtwin.sim.base.errors import BadInput
from fluxtwin.sim.base.shown import Shown
from fluxtwin.sim.base.types import FloatArray, TimeArray
from fluxtwin.sim.earth import epoch
from fluxtwin.sim.telemetry.column_map import mapped_table, recognised
from fluxtwin.sim.telemetry.column_map_draft_header import headers_of
from fluxtwin.sim.telemetry.columns import describe, file_columns
from fluxtwin.sim.telemetry.formats.catalogue import format_of
from fluxtwin.sim.telemetry.record import Telemetry
from fluxtwin.sim.telemetry.telemetry_files import Readable, Reading, as_path, is_path
from fluxtwin.verbs import as_record, with_reading

_GAP_STEPS = 3.0
"""A step of more median steps than this is a gap."""
_PASS_STEPS, _PASS_S = 10.0, 120.0
"""A gap of more median steps, and seconds, than these parts two passes."""


@dataclass(frozen=True)
class Column:
    """One column: where it is known, how often, and its values. None where the file could not be read as telemetry."""

    name: str
    unit: str
    meaning: str = ""
    known: int | None = None
    """Rows with a value."""
    step_s: float | None = None
    """Median time between rows with a value."""
    low: float | None = None
    median: float | None = None
    high: float | None = None


@dataclass(frozen=True)
class Pass:
    """Rows without a long gap between them."""

    start: str
    end: str
    rows: int
    gap_before_s: float | None
    """Time since the pass before; None for the first."""


@dataclass(frozen=True)
class Inventory(Shown):
    """What one file holds."""

    source: str
    rows: int
    start: str | None
    end: str | None
    span_s: float | None
    step_s: float | None
    """Median time between rows."""
    columns: list[Column]
    gaps: int | None = None
    """Steps of more than three median ones."""
    passes: list[Pass] = field(default_factory=list)
    lacks: dict[str, list[str]] = field(default_factory=dict)
    """By verb: what is missing for it; empty where nothing is."""
    provenance: dict[str, str] = field(default_factory=dict)
    unread: str = ""
    """Why the file is no telemetry as it stands; empty where it is."""

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON; its keys are the fields."""
        return asdict(self)


@with_reading
def info(telemetry: Readable, **reading: Unpack[Reading]) -> Inventory:
    """What the file or record holds: columns, span, rates, gaps, passes, provenance, and what each verb lacks.

    A foreign file that is named without a map is listed by its header alone, with the reason in `unread`; one with a
    packaged layout is read by that. Raises BadInput for a file that cannot be read at all.
    """
    if isinstance(telemetry, Telemetry) or not is_path(telemetry):
        return of_record(as_record(telemetry, **reading))
    path = as_path(telemetry)
    try:
        return of_record(as_record(path, **reading), str(path))
    except BadInput as error:
        if path.is_dir() or any(value not in (None, 1) for value in reading.values()):
            raise
        return _of_header(path, str(error))


def of_record(record: Telemetry, source: str = "") -> Inventory:
    """What a record holds."""
    time, columns = record.time, file_columns(record)
    drivers = {f"driver_{name}": unit for name, unit in record.driver_units.items()}
    known = [_column(name, value, time, drivers.get(name)) for name, value in columns.items()]
    step = _step(time)
    gaps = _steps_s(time)
    breaks = np.flatnonzero(gaps > max(_PASS_STEPS * (step or np.inf), _PASS_S)) + 1
    out: list[Pass] = []
    for piece in np.split(np.arange(time.size), breaks):
        before = float(gaps[piece[0] - 1]) if out else None
        out.append(Pass(epoch.iso(time[piece[0]], "ms"), epoch.iso(time[piece[-1]], "ms"), int(piece.size), before))
    return Inventory(
        source=source or record.provenance.get("source", "telemetry"),
        rows=len(record),
        start=epoch.iso(time[0], "ms"),
        end=epoch.iso(time[-1], "ms"),
        span_s=float((time[-1] - time[0]).astype("int64") * 1e-9),
        step_s=step,
        columns=known,
        gaps=int((_steps_s(time) > _GAP_STEPS * (step or np.inf)).sum()),
        passes=out,
        lacks=lacks(record),
        provenance=dict(record.provenance),
    )


def lacks(record: Telemetry) -> dict[str, list[str]]:
    """By verb, and for `calibrate` by method: what the record lacks for it."""
    reading = [] if record.has_reading.any() else ["readings"]
    place = [] if record.r_N_km is not None and record.has_position.any() else ["positions (columns, or --tle)"]
    attitude = [] if record.has_attitude.any() else ["attitude"]
    nadir, sun = record.nadir_B is not None, record.sun_B is not None
    missing = {
        "positions": place,
        "attitude": attitude,
        "attitude, or nadir and sun": [] if not attitude or (nadir and sun) else ["attitude, or nadir and sun"],
        "sun pulses": [] if sun else ["sun pulses"],
        "body rates": [] if record.rate_B_rad_s is not None else ["body rates"],
    }
    out = {"check": reading, "apply": reading}
    for name, estimator in ESTIMATORS.items():
        out[f"calibrate --method {name}"] = [*reading, *(word for need in estimator.needs for word in missing[need])]
    out["yaw"] = out["attitude"] = [*reading, *place, *([] if not attitude or nadir else ["attitude, or nadir"])]
    out["diagnose"] = [*reading, *place]
    return out


def _column(name: str, value: FloatArray, time: TimeArray, stated: str | None) -> Column:
    rows = np.flatnonzero(np.isfinite(value))
    meaning, unit = describe(name)
    unit = stated or unit
    if rows.size == 0:
        return Column(name, unit, meaning, 0)
    low, median, high = (float(x) for x in np.percentile(value[rows], [0.0, 50.0, 100.0]))
    return Column(name, unit, meaning, int(rows.size), _step(time[rows]), low, median, high)


def _step(time: TimeArray) -> float | None:
    return float(np.median(_steps_s(time))) if time.size > 1 else None


def _steps_s(time: TimeArray) -> FloatArray:
    return np.diff(time).astype("int64") * 1e-9


def _of_header(path: Path, why: str) -> Inventory:
    """A foreign file: by the packaged layout that it has, else by its header alone."""
    found = recognised(path)
    if found is not None and any("mag" in entry.columns for entry in found[1].file):
        from fluxtwin.sim.telemetry.build import record

        read = record(mapped_table(path, found[1]))
        return of_record(read.replace(provenance={**read.provenance, "column_map": found[0]}), str(path))
    listed = headers_of(path)
    kind = format_of(path)
    if kind is not None and kind.option:
        why = f"a {kind.name}: give it as {kind.option} {path} beside the readings"
    columns = [
        Column(f"{one.sheet}: {name}" if one.sheet else name, one.units.get(name, ""))
        for one in listed
        for name in one.names
    ]
    return Inventory(str(path), max(one.rows for one in listed), None, None, None, None, columns, unread=why)
