"""What every command that reads telemetry does first: read, and pass on what the reader noticed."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, TypeAlias

import typer

from fluxtwin.console import Output

if TYPE_CHECKING:
    from fluxtwin.sim.telemetry import Telemetry

TelemetryArgument: TypeAlias = Annotated[
    Path,
    typer.Argument(metavar="TELEMETRY", help="A .nc, .csv or .csv.gz file, or a foreign file or folder with --map."),
]


def read(
    path: Path, output: Output, *, column_map: Path | None, tle: Path | None, max_samples: int | None = None
) -> Telemetry:
    """The record in `path`; the reader's notices go to standard error, one a line."""
    from fluxtwin.sim.telemetry_csv import MAX_SAMPLES
    from fluxtwin.sim.telemetry_io import read_telemetry

    record = read_telemetry(path, column_map=column_map, tle=tle, max_samples=max_samples or MAX_SAMPLES)
    for notice in filter(None, record.provenance.get("notices", "").split("; ")):
        output.note(f"note: {path}: {notice}")
    return record
