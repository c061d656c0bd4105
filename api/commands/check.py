"""`fluxtwin check`: is this file what it says?"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from fluxtwin.commands import options as of
from fluxtwin.console import Output, manners
from fluxtwin.sim.base.errors import amount

if TYPE_CHECKING:
    from fluxtwin.calib.checks.check import CheckReport
    from fluxtwin.sim.earth.field_models import FieldModel
    from fluxtwin.sim.telemetry.record import Telemetry

BRIEF = "Are units, frames, axes and clock what the file claims? Names the classic traps."


def command(
    output: Output,
    telemetry: of.TelemetryArgument,
    repair: Annotated[Path | None, of.option("OUT", "Write the rows sorted by time, without exact duplicates.")] = None,
    onboard: Annotated[
        Path | None, of.option("FILE", "An on-board calibration: was it applied to these readings?")
    ] = None,
    html: of.HtmlOption = None,
    field: of.FieldOption = "igrf14",
    degree: of.DegreeOption = None,
    reading: of.Reading = of.READING,
) -> None:
    """Name the traps: counts or mG labelled as nT, wrong frames, transposed quaternions, time out of order.

    A foreign file needs --map, unless its layout is exactly a packaged one; then that map is named.
    Exit status 0 if clean, 1 if a trap was named, 2 if the file cannot be read.
    """
    with output.progress(f"checking {telemetry}") as progress:
        from fluxtwin import flight_software, outputs, verbs
        from fluxtwin.calib.checks import check
        from fluxtwin.sim.base.errors import BadInput

        if repair is not None and reading.column_map is not None:
            raise BadInput(
                "a file read through a column map cannot be repaired",
                where="--repair",
                wanted="--repair without --map, on a file that has the columns of docs/telemetry.md",
            )
        if repair is not None and not reading.whole:
            raise BadInput("mends whole files", where="--repair", wanted="no --from, --to or --where with it")
        output.claim(
            {"--repair": (repair, outputs.TELEMETRY), "--html": (html, outputs.PAGE)},
            [telemetry, onboard, field, *reading.files],
        )
        model = verbs.as_model(field, degree)
        before = None if onboard is None else flight_software.as_onboard(onboard, reading.magnetometer)
        found = check.check_file(telemetry, model, **reading._asdict(), onboard=before)
        mended = after = None
        if repair is not None:
            progress("repairing", 0.5)
            mended = check.repair(telemetry, repair, max_samples=reading.max_samples)
            after = check.check_file(repair, model, **reading._asdict())
        if html is not None:
            progress("drawing", 0.9)
            _draw(found, telemetry, html, model, reading)
    _print(output, f"{telemetry}: {amount(found.samples, 'row|rows')}", found)
    record = found.to_dict()
    if mended is not None and after is not None:
        _print(output, f"{repair}: {amount(after.samples, 'row|rows')}, repaired", after)
        record |= {"repair": mended.to_dict(), "repaired": after.to_dict(), "written": [str(repair)]}
    output.files([html])
    output.result(record)
    raise typer.Exit(found.exit_status)


def _draw(found: CheckReport, telemetry: Path, html: Path, model: FieldModel, reading: of.Reading) -> None:
    from fluxtwin.check_page import check_page
    from fluxtwin.report import write_page
    from fluxtwin.sim.base.errors import FluxtwinError
    from fluxtwin.sim.telemetry.telemetry_files import read_telemetry

    try:
        record: Telemetry | str = read_telemetry(telemetry, **reading._asdict())
    except FluxtwinError as refusal:
        record = str(refusal)
    write_page(check_page(found, telemetry, record, model, reading=reading.words), html)


def _print(output: Output, title: str, report: CheckReport) -> None:
    output.say(title)
    for finding in sorted(report.findings, key=lambda one: one.code != "recognised_layout"):
        if finding.code == "recognised_layout":  # first, because all the rest follows from it
            output.say(f"  {finding.text}")
            continue
        rows = ", ".join(map(str, finding.rows[:5])) + (
            f", ...; {finding.row_count} in all" if finding.row_count > 5 else ""
        )
        place = f" (row{'s' if finding.row_count > 1 else ''} {rows})" if finding.row_count else ""
        if finding.severity != "note" or not manners.quiet:
            output.prose(f"  {finding.severity} {finding.code}: {finding.text}{place}", indent="    ")
    if not report.traps:
        output.prose(f"  {report.clean}", indent="  ")
