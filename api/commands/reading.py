"""What the commands that read telemetry share: the record with what the reader noticed, its calibration, a table."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, TypeAlias

from fluxtwin.commands import options as of
from fluxtwin.commands.options import Reading
from fluxtwin.console import Output
from fluxtwin.sim.base.processes import stop_if_asked

if TYPE_CHECKING:
    from fluxtwin.calib.common.records import Calibration
    from fluxtwin.sim.telemetry.record import Telemetry

TelemetryArgument: TypeAlias = Annotated[
    Path, of.argument("TELEMETRY", "A .nc, .csv or .csv.gz file, or a foreign file or folder with --map.")
]


def read(path: Path, output: Output, reading: Reading, *, one_of_many: bool = False) -> Telemetry:
    """The record in `path`; the reader's notices go to standard error, one a line, with the file's name among many."""
    from fluxtwin.sim.telemetry.telemetry_files import read_telemetry

    stop_if_asked()  # importing took its time
    record = read_telemetry(path, **reading._asdict())
    stop_if_asked()
    for notice in filter(None, record.provenance.get("notices", "").split("; ")):
        output.note(f"note: {path.name}: {notice}" if one_of_many else f"note: {notice}")
    return record


def known_calibration(path: Path, record: Telemetry, output: Output) -> Calibration:
    """The calibration in a file, with a note of what --force waives for this record."""
    from fluxtwin.calib.common.apply import waived
    from fluxtwin.calib.common.records import Calibration

    known = Calibration.from_toml(path)
    if output.force and (refusal := waived(record, known)) is not None:
        output.note(f"note: applied anyway, by --force: {refusal}")
    return known


def write_table(columns: Mapping[str, Sequence[object]], names: Sequence[str], path: Path) -> None:
    """The named columns as CSV; a number that is none is blank."""
    from fluxtwin.sim.base.files import write_text

    cells = zip(*(columns[name] for name in names), strict=True)
    lines = [",".join("" if cell is None or cell != cell else str(cell) for cell in row) for row in cells]
    write_text(path, "\n".join([",".join(names), *lines, ""]))
