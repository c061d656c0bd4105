"""The door for telemetry files: read one, whatever its kind; write one, whole or not at all."""

from __future__ import annotations

from pathlib import Path

from fluxtwin.sim.errors import BadInput
from fluxtwin.sim.telemetry import Telemetry
from fluxtwin.sim.telemetry_columns import Table
from fluxtwin.sim.telemetry_csv import MAX_SAMPLES

_SUFFIXES = ".nc, .csv or .csv.gz"


def read_telemetry(
    path: Path | str,
    *,
    column_map: Path | str | None = None,
    tle: Path | str | None = None,
    max_samples: int = MAX_SAMPLES,
) -> Telemetry:
    """The record in `path`: a .nc, .csv or .csv.gz of the contract, or a foreign file or folder with `column_map`.

    column_map: TOML that says which columns hold what, in which units and frames. tle: two-line elements that
    give the position where the file has none. What was left out or converted stands in
    `provenance["notices"]`. Raises BadInput naming the file and the row or column at fault.
    """
    from fluxtwin.sim.telemetry_build import record

    if column_map is not None:
        from fluxtwin.sim.column_map import read_mapped

        return read_mapped(path, column_map, tle=tle, max_samples=max_samples)
    return record(read_table(path, max_samples=max_samples), tle=tle)


def read_table(path: Path | str, *, max_samples: int = MAX_SAMPLES) -> Table:
    """The columns of a contract file before they are a record; rows may still be in any order."""
    if _kind(path) == "nc":
        from fluxtwin.sim import telemetry_netcdf

        return telemetry_netcdf.read_table(path, max_samples=max_samples)
    from fluxtwin.sim import telemetry_csv

    return telemetry_csv.read_table(path, max_samples=max_samples)


def write_telemetry(telemetry: Telemetry, path: Path | str) -> Path:
    """Write the record to `path` (.nc, .csv or .csv.gz), atomically. Returns the path."""
    if _kind(path) == "nc":
        from fluxtwin.sim import telemetry_netcdf

        return telemetry_netcdf.write(telemetry, path)
    from fluxtwin.sim import telemetry_csv

    return telemetry_csv.write(telemetry, path)


def require_known_kind(path: Path | str) -> None:
    """Refuse, before long work, a file name that `write_telemetry` could not write. Raises BadInput."""
    _kind(path)


def _kind(path: Path | str) -> str:
    name = Path(path).name.lower()
    if name.endswith((".nc", ".nc4", ".h5")):
        return "nc"
    if name.endswith((".csv", ".csv.gz")):
        return "csv"
    if Path(path).is_dir():
        raise BadInput("is a folder", where=str(path), wanted=f"a {_SUFFIXES} file, or a column map for a folder")
    raise BadInput("the kind of this file is not known from its name", where=str(path), wanted=_SUFFIXES)
