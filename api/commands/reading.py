"""What every command that reads telemetry does first: read, and pass on what the reader noticed."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, TypeAlias

import typer

from fluxtwin.console import Output
from fluxtwin.sim.base.processes import stop_if_asked

if TYPE_CHECKING:
    from fluxtwin.sim.telemetry.record import Telemetry

TelemetryArgument: TypeAlias = Annotated[
    Path,
    typer.Argument(metavar="TELEMETRY", help="A .nc, .csv or .csv.gz file, or a foreign file or folder with --map."),
]


def read(
    path: Path,
    output: Output,
    *,
    column_map: Path | None,
    tle: Path | None,
    max_samples: int | None = None,
    one_of_many: bool = False,
) -> Telemetry:
    """The record in `path`; the reader's notices go to standard error, one a line, with the file's name among many."""
    from fluxtwin.sim.telemetry.csv_files import MAX_SAMPLES
    from fluxtwin.sim.telemetry.telemetry_files import read_telemetry

    stop_if_asked()  # importing took its time
    record = read_telemetry(path, column_map=column_map, tle=tle, max_samples=max_samples or MAX_SAMPLES)
    stop_if_asked()
    for notice in filter(None, record.provenance.get("notices", "").split("; ")):
        output.note(f"note: {path.name}: {notice}" if one_of_many else f"note: {notice}")
    return record
