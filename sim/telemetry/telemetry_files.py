"""The door for telemetry files: read one, whatever its kind; write one, whole or not at all."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import replace
from datetime import date
from pathlib import Path
from typing import Any, Protocol, TypeAlias, TypedDict

import numpy as np

from fluxtwin.sim.base.errors import BadInput, kind_of
from fluxtwin.sim.base.files import is_stream
from fluxtwin.sim.base.limits import MAX_SAMPLES
from fluxtwin.sim.telemetry.columns import FileTable
from fluxtwin.sim.telemetry.formats.catalogue import READ, format_of, table_of
from fluxtwin.sim.telemetry.formats.table import Table, contract
from fluxtwin.sim.telemetry.record import Telemetry


class DataFrame(Protocol):
    """What is needed of pandas' table; pandas need not be installed."""

    columns: Any
    attrs: Any


class Dataset(Protocol):
    """What is needed of an xarray Dataset, which need not be installed."""

    variables: Any
    attrs: Any


Readable: TypeAlias = "Telemetry | Path | str | DataFrame | Dataset"
"""What a verb takes for telemetry."""
_READABLE = "the path of a file, a fluxtwin.Telemetry, a pandas DataFrame or an xarray Dataset (docs/telemetry.md)"


class Reading(TypedDict, total=False):
    """How telemetry is read: the keywords of `read_telemetry`, which every verb takes."""

    column_map: Path | str | None
    tle: Path | str | None
    attitude: Path | str | None
    max_samples: int | None
    start: np.datetime64 | date | str | None
    end: np.datetime64 | date | str | None
    where: str | None
    magnetometer: int


_TEXT = (".csv", ".csv.gz", ".txt", ".dat", ".tsv")
_SUFFIXES = ", ".join((".nc", *_TEXT, *READ))


def read_telemetry(
    path: Path | str | DataFrame | Dataset,
    *,
    column_map: Path | str | None = None,
    tle: Path | str | None = None,
    attitude: Path | str | None = None,
    max_samples: int | None = None,
    start: np.datetime64 | date | str | None = None,
    end: np.datetime64 | date | str | None = None,
    where: str | None = None,
    magnetometer: int = 1,
) -> Telemetry:
    """The record in `path`: a file with the columns of the contract, or a foreign file or folder with `column_map`.

    path: a DataFrame or a Dataset is taken as it is, with units in the names or attributes of its columns.
    column_map: TOML that says which columns hold what, in which units and frames; or "preset:NAME".
    tle: two-line elements or a CCSDS OEM: positions where the file has none.
    attitude: a CCSDS AEM: attitudes where the file has none.
    max_samples: the largest number of rows to read; None for 5,000,000.
    start, end, where: rows from `start` to before `end` in which the condition holds, as `sunlit == 1`.
    magnetometer: 2 puts the readings of the second one in the place of the first one's.

    What was left out or converted is listed in `provenance["notices"]`. Raises BadInput naming the file and the row or
    column at fault.
    """
    from fluxtwin.sim.telemetry.build import record
    from fluxtwin.sim.telemetry.selection import selection

    given = as_path(path) if is_path(path) else _table(path)
    if max_samples is not None and max_samples < 1:
        raise BadInput(f"{max_samples}", where="max_samples", wanted="1 or more")
    chosen = selection(start, end, where)
    files = [one for one in (given, tle, attitude) if isinstance(one, str | os.PathLike)]
    if column_map is not None:
        from fluxtwin.sim.telemetry.column_map import mapped_table

        table, tle = mapped_table(given, column_map, tle=tle, max_samples=max_samples or MAX_SAMPLES), None
    else:
        table = read_table(given, max_samples=max_samples or MAX_SAMPLES, others=chosen.columns)
    paths = tuple(dict.fromkeys(os.path.realpath(one) for one in (*files, *table.origin.paths)))
    table = replace(table, origin=replace(table.origin, paths=paths))
    return record(chosen.cut(table), tle=tle, attitude=attitude).with_magnetometer(magnetometer)


def is_path(given: object) -> bool:
    """Whether `given` names a file."""
    return isinstance(given, str | os.PathLike)


def _table(given: Any) -> Table:
    """A table of pandas or xarray as ours; raises BadInput for anything else."""
    from fluxtwin.sim.telemetry.formats import frame

    kind = kind_of(given)
    if kind == "pandas DataFrame":
        return frame.of_pandas(given)
    if kind == "xarray Dataset":
        return frame.of_xarray(given)
    as_path(given)
    raise AssertionError


def as_path(given: Any, where: str = "telemetry", wanted: str = _READABLE) -> Path:
    """`given` as the path of a file; raises BadInput that says what it is instead, and what is wanted in its place."""
    if isinstance(given, str | os.PathLike):
        return Path(given)
    raise BadInput(f"an object of type {kind_of(given)} was given", where=where, wanted=wanted)


def read_table(path: Path | str | Table, *, max_samples: int = MAX_SAMPLES, others: Sequence[str] = ()) -> FileTable:
    """The columns of a contract file before they are a record, and `others`; rows may still be in any order."""
    table = table_of(path, max_samples) if not isinstance(path, Table) else path
    if table is not None:
        return contract(table, others)
    assert not isinstance(path, Table)
    if _kind(path) == "nc":
        from fluxtwin.sim.telemetry import netcdf_files

        return netcdf_files.read_table(path, max_samples=max_samples, others=others)
    from fluxtwin.sim.telemetry import csv_files

    return csv_files.read_table(path, max_samples=max_samples, others=others)


def write_telemetry(telemetry: Telemetry, path: Path | str) -> Path:
    """Write the record to `path`, in the format of its ending, atomically; CSV to a device or pipe. Returns the path.

    path: ends in .nc, .nc4, .h5, .csv, .csv.gz, .xlsx, .parquet, .aem or .oem; a file that is there is replaced.

    Each magnetometer's readings go into its own columns. Raises BadInput for anything but a record, and for a file that
    the record was read from.
    """
    given: object = telemetry
    if not isinstance(given, Telemetry):
        wanted = "a fluxtwin.Telemetry (`simulate` returns two: the telemetry and the truth)"
        raise BadInput(f"an object of type {kind_of(given)} was given", where="telemetry", wanted=wanted)
    there = [one for one in telemetry.origin.paths if os.path.exists(one) and os.path.exists(path)]
    if any(os.path.samefile(one, path) for one in there):
        raise BadInput("this record was read from it", where=str(path), wanted="another name; inputs are kept")
    telemetry = telemetry.with_magnetometer(1)
    found = None if is_stream(path) else format_of(path)
    if found is not None:
        return found.write(telemetry, path)
    if not is_stream(path) and _kind(path) == "nc":
        from fluxtwin.sim.telemetry import netcdf_files

        return netcdf_files.write(telemetry, path)
    from fluxtwin.sim.telemetry import csv_files

    return csv_files.write(telemetry, path)


def _kind(path: Path | str) -> str:
    name = str(path).lower()
    if name.endswith((".nc", ".nc4", ".h5")):
        return "nc"
    if name.endswith(_TEXT):
        return "csv"
    if Path(path).is_dir():
        raise BadInput("is a folder", where=str(path), wanted=f"a {_SUFFIXES} file, or a column map for a folder")
    refuse_other(path)
    raise BadInput("the kind of this file is not known from its name", where=str(path), wanted=_SUFFIXES)


def refuse_other(path: Path | str) -> None:
    """Raises BadInput for what by its name is a scenario, a calibration or a column map, or MATLAB's own."""
    name = Path(path).name.lower()
    if name.endswith(".mat"):
        wanted = f"{_SUFFIXES} (in MATLAB, writetable makes a .csv of a table)"
        raise BadInput("is a .mat file, which is not read", where=str(path), wanted=wanted)
    if name.endswith(".toml"):
        wanted = "telemetry, as a .nc or .csv file; `fluxtwin simulate` makes it from a scenario"
        raise BadInput("is not telemetry but a scenario, a calibration or a column map", where=str(path), wanted=wanted)
