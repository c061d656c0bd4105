"""The formats, a line each: their endings, what reads them and, where we write them, what writes them."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fluxtwin.sim.base.errors import BadInput

if TYPE_CHECKING:
    from fluxtwin.sim.telemetry.formats.table import Table
    from fluxtwin.sim.telemetry.record import Telemetry

_HERE = "fluxtwin.sim.telemetry.formats"


@dataclass(frozen=True)
class Format:
    """One format. `module` has `read(path, max_samples) -> Table`, and `write(telemetry, path) -> Path` where `writes`."""

    name: str
    endings: tuple[str, ...]
    module: str
    """Its module in this folder, imported when it is used."""
    suffix: str = ""
    """Of the names of its functions there, where the module has several formats."""
    writes: bool = False
    sheets: bool = False
    option: str = ""
    """Of a file that has attitude or orbit alone: the option that takes it beside the readings."""

    def read(self, path: Path, max_samples: int, *sheet: str) -> Table:
        """The file, or one sheet of it, as a table. Raises BadInput, for more rows than wanted before they are read."""
        found: Table = self._function("read")(path, max_samples, *sheet)
        return found

    def sheets_of(self, path: Path) -> list[str]:
        """Names of the sheets where the format has such; raises nothing for a damaged file."""
        return self._function("sheets")(path) if self.sheets else []

    def write(self, telemetry: Telemetry, path: Path | str) -> Path:
        """The record as a file, atomically. Raises BadInput where the format cannot hold it."""
        written: Path = self._function("write")(telemetry, path)
        return written

    def _function(self, name: str) -> Callable[..., Any]:
        found: Callable[..., Any] = getattr(import_module(f"{_HERE}.{self.module}"), name + self.suffix)
        return found


FORMATS = (
    Format("CCSDS attitude ephemeris (AEM, KVN)", (".aem",), "ccsds", "_aem", writes=True, option="--attitude"),
    Format("CCSDS orbit ephemeris (OEM, KVN)", (".oem",), "ccsds", "_oem", writes=True, option="--tle"),
    Format("CDF", (".cdf",), "cdf"),
    Format("Excel workbook", (".xlsx",), "xlsx", writes=True, sheets=True),
    Format("Parquet", (".parquet",), "frame", "_parquet", writes=True),
)
READ = tuple(ending for one in FORMATS for ending in one.endings)
WRITTEN = tuple(ending for one in FORMATS if one.writes for ending in one.endings)


def format_of(path: Path | str) -> Format | None:
    """The format of that name, None for CSV, NetCDF and what is not known. A folder of 42's files is one too."""
    name = str(path).lower()
    found = next((one for one in FORMATS if name.endswith(one.endings)), None)
    if found is None and os.path.isdir(path) and any(Path(path).glob("*.42")):
        return Format("a run of 42", (), "forty_two")
    return found


def table_of(path: Path | str, max_samples: int, sheet: str | None = None) -> Table | None:
    """The table of a file, or of one sheet of it, in one of these formats; None for another. Raises BadInput, also for more
    rows than wanted."""
    found = format_of(path)
    if sheet is not None and (found is None or not found.sheets):
        raise BadInput(f"has no sheets, and the map names {sheet!r}", where=str(path), wanted="a workbook")
    if found is None:
        return None
    return found.read(Path(path), max_samples, *([] if sheet is None else [sheet]))
