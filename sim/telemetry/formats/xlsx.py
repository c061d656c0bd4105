"""Excel workbooks: one sheet, the first unless it is named, its header in the first row; by pandas and openpyxl (optional:
fluxtwin[xlsx])."""

from __future__ import annotations

import io
import re
import zipfile
from functools import reduce
from pathlib import Path
from typing import Any

from fluxtwin.sim.base.errors import BadInput
from fluxtwin.sim.base.files import write_bytes
from fluxtwin.sim.base.limits import MAX_COLUMNS, MAX_SAMPLES, require_expansion, require_rows
from fluxtwin.sim.telemetry.columns import file_texts
from fluxtwin.sim.telemetry.formats.frame import of_file, to_pandas
from fluxtwin.sim.telemetry.formats.table import Table, content_of, extra
from fluxtwin.sim.telemetry.record import Telemetry

_PLACE = re.compile(
    rb"""<(?:\w+:)?(?:c|row)\s(?:[^<>]*\s)?r=["']([A-Z]{0,4})([0-9]{1,9})["']"""
)  # of a cell, or of a row
_DATE = re.compile(rb"(<dcterms:(?:created|modified) [^>]*>)[^<]*")
_CELL_BYTES = 8  # of an empty one
_MOST_ROWS = 1_048_575  # of a sheet, beside the header


def read(path: Path, max_samples: int = MAX_SAMPLES, sheet: str | None = None) -> Table:
    """One sheet, the first where none is named. Stamps may be cells of dates (to a millisecond) or text."""
    extra("openpyxl", "xlsx", path)
    pd = extra("pandas", "xlsx", path)
    there: list[str] = []

    def unpack(content: bytes) -> Any:
        _require_sane(content, max_samples, str(path))
        with pd.ExcelFile(io.BytesIO(content), engine="openpyxl") as book:
            there.extend(map(str, book.sheet_names))
            if sheet not in (None, *there):
                raise BadInput(f"has no sheet {sheet!r}", where=str(path), wanted=", ".join(there))
            return pd.read_excel(book, sheet_name=0 if sheet is None else sheet)

    table = of_file(path, "a workbook", ".xlsx", unpack)
    if sheet is None and len(there) > 1:
        table.notices.append(
            f"the first of {len(there)} sheets was read: {', '.join(there)}; a column map reads others"
        )
    return table


def sheets(path: Path) -> list[str]:
    """Their names; none of a file that is damaged: whatever is wrong with it, `read` says so."""
    extra("openpyxl", "xlsx", path)
    pd = extra("pandas", "xlsx", path)
    try:
        content = content_of(path)[0]
        _require_sane(content, MAX_SAMPLES, str(path))
        with pd.ExcelFile(io.BytesIO(content), engine="openpyxl") as book:
            return [str(name) for name in book.sheet_names]
    except Exception:
        return []


def _require_sane(content: bytes, max_samples: int, where: str) -> None:
    """Raises BadInput for more cells than are read: pandas makes all between the first and the farthest that has a value."""
    rows = columns = 0
    with zipfile.ZipFile(io.BytesIO(content)) as book:
        require_expansion(sum(one.file_size for one in book.infolist()), len(content), where)
        for name in (one for one in book.namelist() if "sharedStrings" not in one):
            for column, row in _PLACE.findall(book.read(name)):
                rows, columns = max(rows, int(row)), max(columns, reduce(lambda n, c: 26 * n + c - 64, column, 0))
    require_rows(rows - 1, max_samples, where)
    if columns > MAX_COLUMNS:
        raise BadInput(f"has {columns} columns", where=where, wanted=f"at most {MAX_COLUMNS}")
    require_expansion(_CELL_BYTES * rows * columns, len(content), where)


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
    # The workbook without the hour it was made at: the same record gives the same bytes.
    out = io.BytesIO()
    with zipfile.ZipFile(made) as book, zipfile.ZipFile(out, "w") as plain:
        for one in book.namelist():
            plain.writestr(
                zipfile.ZipInfo(one), _DATE.sub(rb"\g<1>1980-01-01T00:00:00Z", book.read(one)), zipfile.ZIP_DEFLATED
            )
    return write_bytes(path, out.getvalue())
