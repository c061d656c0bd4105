"""Parquet, through pandas and pyarrow (optional: fluxtwin[parquet])."""

from __future__ import annotations

import io
from pathlib import Path

from fluxtwin.sim.base.errors import BadInput
from fluxtwin.sim.base.files import write_bytes
from fluxtwin.sim.telemetry.columns import file_texts
from fluxtwin.sim.telemetry.formats.frame import of_pandas, to_pandas
from fluxtwin.sim.telemetry.formats.table import Table, content_of, extra, require_size
from fluxtwin.sim.telemetry.record import Telemetry


def read(path: Path) -> Table:
    """The columns of a Parquet file."""
    pyarrow = extra("pyarrow.parquet", "parquet", path)
    import pandas as pd

    content, digest = content_of(path)
    try:
        about = pyarrow.read_metadata(io.BytesIO(content))
        require_size(8 * about.num_rows * about.num_columns, str(path))
        frame = pd.read_parquet(io.BytesIO(content), engine="pyarrow")
    except BadInput:
        raise
    except Exception as error:  # pyarrow has many of its own
        raise BadInput(
            f"cannot be read as Parquet ({type(error).__name__})", where=str(path), wanted=".parquet"
        ) from None
    table = of_pandas(frame, str(path))
    table.sha256 = digest
    return table


def write(telemetry: Telemetry, path: Path | str) -> Path:
    """The record; numbers and stamps read back bit-equal."""
    extra("pyarrow", "parquet", path)
    frame = to_pandas(telemetry)
    frame = frame.reset_index().assign(**file_texts(telemetry))
    return write_bytes(path, frame.to_parquet(None, engine="pyarrow", index=False))
