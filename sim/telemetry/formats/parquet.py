"""Parquet, through pandas and pyarrow (optional: fluxtwin[parquet])."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

from fluxtwin.sim.base.files import write_bytes
from fluxtwin.sim.base.limits import MAX_SAMPLES, require_expansion, require_rows
from fluxtwin.sim.telemetry.columns import file_texts
from fluxtwin.sim.telemetry.formats.frame import of_file, to_pandas
from fluxtwin.sim.telemetry.formats.table import Table, extra
from fluxtwin.sim.telemetry.record import Telemetry


def read(path: Path, max_samples: int = MAX_SAMPLES) -> Table:
    """The columns of a Parquet file."""
    pyarrow = extra("pyarrow.parquet", "parquet", path)
    pd = extra("pandas", "parquet", path)

    def unpack(content: bytes) -> Any:
        about = pyarrow.read_metadata(io.BytesIO(content))
        require_rows(about.num_rows, max_samples, str(path))
        require_expansion(8 * about.num_rows * about.num_columns, len(content), str(path))
        return pd.read_parquet(io.BytesIO(content), engine="pyarrow", page_checksum_verification=True)

    return of_file(path, "Parquet", ".parquet", unpack)


def write(telemetry: Telemetry, path: Path | str) -> Path:
    """The record; numbers and stamps read back bit-equal."""
    extra("pyarrow", "parquet", path)
    frame = to_pandas(telemetry)
    frame = frame.reset_index().assign(**file_texts(telemetry))
    return write_bytes(path, frame.to_parquet(None, engine="pyarrow", index=False, write_page_checksum=True))
