"""Excel workbooks: the first sheet, its header in the first row; by pandas and openpyxl (optional: fluxtwin[xlsx])."""

from __future__ import annotations

import io
import zipfile
from pathlib import Path
from typing import Any

from fluxtwin.sim.base.errors import BadInput
from fluxtwin.sim.base.files import write_bytes
from fluxtwin.sim.telemetry.columns import file_texts
from fluxtwin.sim.telemetry.formats.frame import of_file, to_pandas
from fluxtwin.sim.telemetry.formats.table import Table, extra, require_size
from fluxtwin.sim.telemetry.record import Telemetry

_MOST_ROWS = 1_048_575  # of a sheet, beside the header


def read(path: Path) -> Table:
    """The first sheet. Stamps may be cells of dates (to a millisecond) or text."""
    extra("openpyxl", "xlsx", path)
    import pandas as pd

    def unpack(content: bytes) -> Any:
        require_size(sum(one.file_size for one in zipfile.ZipFile(io.BytesIO(content)).infolist()), str(path))
        return pd.read_excel(io.BytesIO(content), sheet_name=0, engine="openpyxl")

    return of_file(path, "a workbook", ".xlsx", unpack)


def write(telemetry: Telemetry, path: Path | str) -> Path:
    """The record on one sheet, stamps as ISO 8601 text. Raises BadInput for more rows than a sheet has."""
    from fluxtwin.sim.telemetry.time_stamps import format_iso

    extra("openpyxl", "xlsx", path)
    if len(telemetry) > _MOST_ROWS:
        raise BadInput(f"has {len(telemetry)} rows", where=str(path), wanted=f"at most {_MOST_ROWS} in a sheet")
    frame = to_pandas(telemetry)
    frame.index = format_iso(telemetry.time)
    frame.index.name = "time"
    made = io.BytesIO()
    frame.reset_index().assign(**file_texts(telemetry)).to_excel(made, index=False, engine="openpyxl")
    return write_bytes(path, made.getbuffer())
