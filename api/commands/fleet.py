"""`fluxtwin fleet`: which effect is of the design, and which belongs to one vehicle."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from fluxtwin.commands import options as of
from fluxtwin.commands.reading import read
from fluxtwin.console import Output

NAME = "fleet"
BRIEF = "Many vehicles of one design: what is common to them, and which is the odd one."


def command(
    output: Output,
    telemetry: Annotated[
        list[Path], typer.Argument(metavar="TELEMETRY...", help="One file a vehicle, three or more, of one design.")
    ],
    scenario: Annotated[
        Path | None,
        typer.Option("--scenario", metavar="FILE.toml", help="What is known of the design, as for diagnose."),
    ] = None,
    noise_nt: of.NoiseOption = None,
    lsb_nt: of.LsbOption = None,
    attitude_sigma_deg: of.AttitudeSigmaOption = None,
    attitude_tau_s: of.AttitudeTauOption = None,
    field: of.ScenarioFieldOption = None,
    degree: of.DegreeOption = None,
    jobs: of.JobsOption = None,
    scheduler: of.SchedulerOption = None,
    reading: of.Reading = of.READING,
) -> None:
    """Diagnose each record, then all together: an effect that is too small in each may be plain in all."""
    with output.progress(f"reading {telemetry[0]}") as progress:
        from fluxtwin import fleets

        output.claim({}, [*telemetry, scenario, field, *reading.files])
        records = {str(path): read(path, output, reading, one_of_many=True) for path in telemetry}
        found = fleets.fleet(
            records,
            scenario=scenario,
            noise_nT=noise_nt,
            lsb_nT=lsb_nt,
            attitude_sigma_deg=attitude_sigma_deg,
            attitude_tau_s=attitude_tau_s,
            field=field,
            degree=degree,
            jobs=jobs,
            scheduler=scheduler,
            progress=progress,
        )
    for line in found.lines:
        output.prose(line)
    output.say()
    for table in fleets.tables(found):
        output.table(table.title, table.columns, table.rows, table.note)
    output.result(found.to_dict())
