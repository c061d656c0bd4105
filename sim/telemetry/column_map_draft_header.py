"""What a draft of a column map looks at: the names of the columns of a foreign file, and some of its numbers."""

from __future__ import annotations

import re
from collections.abc import MutableMapping
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from fluxtwin.sim.base.errors import BadInput
from fluxtwin.sim.base.limits import MAX_SAMPLES
from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.telemetry.column_map_values import LIST_BYTES, from_lists
from fluxtwin.sim.telemetry.columns import TRUTHS, clip
from fluxtwin.sim.telemetry.csv_files import open_csv
from fluxtwin.sim.telemetry.formats.catalogue import format_of, table_of
from fluxtwin.sim.telemetry.netcdf_files import NetcdfFile
from fluxtwin.sim.telemetry.telemetry_files import refuse_other

FILLS = (-9999.0, -99999.0, -999.0, 9999.0, 99999.0, 65535.0, 32767.0, -32768.0, 1e31, -1e31)
"""What programs write where there is nothing."""
_SAMPLE = 2000


@dataclass
class Header:
    """Names of the columns of one file, and numbers of a few rows."""

    path: Path
    names: list[str]
    values: MutableMapping[str, FloatArray] = field(default_factory=dict)
    """Columns (n,) or variables (n, k) that are numbers."""
    iso: list[str] = field(default_factory=list)
    """Columns of ISO 8601 stamps."""
    cf: list[str] = field(default_factory=list)
    """NetCDF variables with units "... since"."""
    units: dict[str, str] = field(default_factory=dict)
    rows: int = 0
    texts: dict[str, list[str]] = field(default_factory=dict)
    """Some cells of the columns of text as they stand."""
    odd: dict[str, str] = field(default_factory=dict)
    """Words with the first cell that is no number, of columns that begin with some."""
    sheet: str | None = None
    pattern: str = ""
    """Of the names of several files with this header."""
    frame: str | None = None
    """Of its attitude or orbit, where the format states it."""


def headers_of(path: Path) -> list[Header]:
    """The headers of the sheets of a workbook that has several, or of the file. Raises BadInput as `header_of`."""
    known = format_of(path)
    sheets = known.sheets_of(path) if known is not None else []
    return [header_of(path, sheet) for sheet in sheets] if len(sheets) > 1 else [header_of(path)]


def header_of(path: Path, sheet: str | None = None) -> Header:
    """The header of a file, or of a sheet of it, and numbers of its first rows. Raises BadInput for a file that cannot be
    read."""
    if path.name.lower().endswith((".nc", ".nc4", ".h5")):
        with NetcdfFile(path) as opened:
            return _netcdf_header(path, opened)
    if (table := table_of(path, MAX_SAMPLES, sheet)) is not None:
        found = Header(path, table.names(), units=dict(table.units), sheet=sheet, frame=table.attributes.get("frame"))
        for name, value in table.columns.items():
            found.rows = max(found.rows, len(value))
            if value.dtype.kind == "M":
                found.cf.append(name)
            elif value.dtype.kind == "S":
                _look(found, name, value)
            elif value.ndim <= 2:
                found.values[name] = np.asarray(value[:_SAMPLE], dtype=np.float64)
        return found
    refuse_other(path)
    csv = open_csv(path)
    found = Header(path, list(csv.names), rows=csv.rows)
    for name in csv.names:
        _look(found, name, csv.text(name, width=LIST_BYTES))
    return found


def _look(header: Header, name: str, text: np.ndarray) -> None:
    """Whether a column of text, bytes (N,), holds numbers, stamps or lists."""
    cells = [cell.decode("utf-8", "replace").strip() for cell in text[:_SAMPLE].tolist()]
    header.texts[name] = [cell for cell in cells[:20] if cell]
    if any(re.match(r"\d{4}-\d\d-\d\d[T ]\d\d:", cell) for cell in cells[:20]):
        header.iso.append(name)
        return
    numbers = list[float]()
    with suppress(ValueError):
        for cell in cells:
            numbers.append(TRUTHS[cell.lower()] if cell.lower() in TRUTHS else float(cell or "nan"))
    if len(numbers) == len(cells):
        header.values[name] = np.array(numbers)
        return
    if any(np.isfinite(numbers)):
        header.odd[name] = f": {clip(cells[len(numbers)])!r}"
    with suppress(BadInput):
        listed = from_lists(text[:_SAMPLE], name, str(header.path))
        if listed.shape[1] in (3, 4):
            header.values[name] = listed


def _netcdf_header(path: Path, opened: NetcdfFile) -> Header:
    header = Header(path, list(opened.names()))
    for name in header.names:
        units = str(opened.attributes(name).get("units", ""))
        header.units[name] = units
        if " since " in units:
            header.cf.append(name)
            continue
        with suppress(BadInput):
            value = np.asarray(opened.numbers(name))
            if value.ndim in (1, 2) and len(value):
                header.values[name] = value[:_SAMPLE]
                header.rows = max(header.rows, len(value))
    return header


def fill_values(stacked: FloatArray, *, alike: bool) -> list[float]:
    """The values that seem to mean "missing" in columns (n, k); alike: also one that is in all of them more than twice."""
    found = [value for value in FILLS if _stands_out(stacked, value)]
    values, count = np.unique(stacked[np.ptp(stacked, axis=1) == 0.0, 0], return_counts=True)
    if alike and count.max(initial=0) > 2 and values[np.argmax(count)] not in found:
        found.append(float(values[np.argmax(count)]))
    return found


def _stands_out(stacked: FloatArray, value: float) -> bool:
    """Whether all components (n, k) of a row have that value, or one has it beyond all else in its column."""
    at = stacked == value
    beyond = abs(value) > np.nanmax(np.abs(np.where(at, 0.0, stacked)), axis=0, initial=0.0)
    return bool(at.all(axis=1).any() or (at.any(axis=0) & beyond).any())
