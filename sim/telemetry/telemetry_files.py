"""The door for telemetry files: read one, whatever its kind; write one, whole or not at all."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any, TypedDict

import numpy as np

from fluxtwin.sim.base.errors import BadInput
from fluxtwin.sim.base.files import is_stream
from fluxtwin.sim.telemetry.columns import FileTable
from fluxtwin.sim.telemetry.csv_files import MAX_SAMPLES
from fluxtwin.sim.telemetry.record import Telemetry


class Reading(TypedDict, total=False):
    """How telemetry is read: the keywords of `read_telemetry`, which every verb takes."""

    column_map: Path | str | None
    tle: Path | str | None
    max_samples: int | None
    start: np.datetime64 | str | None
    end: np.datetime64 | str | None
    where: str | None
    magnetometer: int


_SUFFIXES = ".nc, .csv or .csv.gz"


def read_telemetry(
    path: Path | str,
    *,
    column_map: Path | str | None = None,
    tle: Path | str | None = None,
    max_samples: int | None = None,
    start: np.datetime64 | str | None = None,
    end: np.datetime64 | str | None = None,
    where: str | None = None,
    magnetometer: int = 1,
) -> Telemetry:
    """The record in `path`: a .nc, .csv or .csv.gz of the contract, or a foreign file or folder with `column_map`.

    column_map: TOML that says which columns hold what, in which units and frames. tle: two-line elements that
    give the position where the file has none. max_samples: most rows that are read; None for 5,000,000.
    start, end, where: rows from `start` to before `end` in which the condition holds, as `sunlit == 1`.
    magnetometer: 2 puts the readings of the second one in the first one's place.
    What was left out or converted stands in
    `provenance["notices"]`. Raises BadInput naming the file and the row or column at fault.
    """
    from fluxtwin.sim.telemetry.build import record
    from fluxtwin.sim.telemetry.selection import selection

    path = as_path(path)
    chosen = selection(start, end, where)
    if column_map is not None:
        from fluxtwin.sim.telemetry.column_map import mapped_table

        table = mapped_table(path, column_map, tle=tle, max_samples=max_samples or MAX_SAMPLES)
        return record(chosen.cut(table)).with_magnetometer(magnetometer)
    table = read_table(path, max_samples=max_samples or MAX_SAMPLES, others=chosen.columns)
    return record(chosen.cut(table), tle=tle).with_magnetometer(magnetometer)


def as_path(given: Any) -> Path:
    """`given` as the path of a file; raises BadInput that says what it is instead, and the way from there to a record."""
    if isinstance(given, str | os.PathLike):
        return Path(given)
    kind = f"{type(given).__module__.partition('.')[0]} {type(given).__name__}"
    ways = {
        "pandas DataFrame": "write it with `.to_csv('t.csv', index=False)` and give 't.csv'; the columns have their units",
        "xarray Dataset": "write it with `.to_netcdf('t.nc')` and give 't.nc'; the variables have their units",
    }
    way = f"; {ways[kind]} in their names (docs/telemetry.md)" if kind in ways else ""
    raise BadInput(
        f"a {kind.removeprefix('builtins ')} was given",
        where="telemetry",
        wanted=f"the path of a file or a fluxtwin.Telemetry{way}",
    )


def read_table(path: Path | str, *, max_samples: int = MAX_SAMPLES, others: Sequence[str] = ()) -> FileTable:
    """The columns of a contract file before they are a record, and `others`; rows may still be in any order."""
    if _kind(path) == "nc":
        from fluxtwin.sim.telemetry import netcdf_files

        return netcdf_files.read_table(path, max_samples=max_samples, others=others)
    from fluxtwin.sim.telemetry import csv_files

    return csv_files.read_table(path, max_samples=max_samples, others=others)


def write_telemetry(telemetry: Telemetry, path: Path | str) -> Path:
    """Write the record to `path` (.nc, .csv or .csv.gz), atomically; CSV to a device or pipe. Returns the path.

    Each magnetometer's readings go into its own columns.
    """
    telemetry = telemetry.with_magnetometer(1)
    if not is_stream(path) and _kind(path) == "nc":
        from fluxtwin.sim.telemetry import netcdf_files

        return netcdf_files.write(telemetry, path)
    from fluxtwin.sim.telemetry import csv_files

    return csv_files.write(telemetry, path)


def _kind(path: Path | str) -> str:
    name = Path(path).name.lower()
    if name.endswith((".nc", ".nc4", ".h5")):
        return "nc"
    if name.endswith((".csv", ".csv.gz")):
        return "csv"
    if Path(path).is_dir():
        raise BadInput("is a folder", where=str(path), wanted=f"a {_SUFFIXES} file, or a column map for a folder")
    if name.endswith(".toml"):
        wanted = f"a {_SUFFIXES} file; `fluxtwin simulate` makes one from a scenario"
        raise BadInput("is no telemetry: a scenario, a calibration or a column map", where=str(path), wanted=wanted)
    raise BadInput("the kind of this file is not known from its name", where=str(path), wanted=_SUFFIXES)
