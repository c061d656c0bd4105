"""`fluxtwin fleet`: which effect is of the design, and which belongs to one vehicle."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from fluxtwin.commands import options as of
from fluxtwin.commands.reading import read
from fluxtwin.console import Output

BRIEF = "Compare vehicles of one design: what is common to them, and which one differs."


def command(
    output: Output,
    telemetry: Annotated[
        list[Path],
        typer.Argument(metavar="TELEMETRY...", help="One file per vehicle; three or more vehicles of one design."),
    ],
    scenario: Annotated[
        Path | None, typer.Option(metavar="FILE.toml", help="What is known of the design, as for diagnose.")
    ] = None,
    assumed: of.Assumed = of.ASSUMED,
    workers: of.Workers = of.WORKERS,
    reading: of.Reading = of.READING,
) -> None:
    """Diagnose each record, then all together: an effect that is too small in each may be plain in all."""
    with output.progress(f"reading {telemetry[0]}") as progress:
        from fluxtwin import fleets

        output.claim({}, [*telemetry, scenario, assumed.field, *reading.files])
        records = {str(path): read(path, output, reading, one_of_many=True) for path in telemetry}
        how = {**assumed._asdict(), **workers._asdict()}
        found = fleets.fleet(records, scenario=scenario, progress=progress, **how)
    for line in found.lines:
        output.prose(line)
    output.say()
    output.tables(fleets.tables(found))
    output.result(found.to_dict())
