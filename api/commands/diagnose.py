"""`fluxtwin diagnose`: where the gap between telemetry and simulation lies, which effect causes it, how far it shrinks."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from fluxtwin.commands import options as of
from fluxtwin.commands.reading import TelemetryArgument, read
from fluxtwin.console import Output

NAME = "diagnose"
BRIEF = "Where the gap to the simulation lies, which effect causes it, how far it shrinks."


def command(
    output: Output,
    telemetry: TelemetryArgument,
    scenario: Annotated[
        Path | None,
        typer.Option(
            "--scenario", metavar="FILE.toml", help="Field, starting calibration, noise budget, frozen effects."
        ),
    ] = None,
    modelled: Annotated[
        str,
        typer.Option("--modelled", metavar="NAMES", help="Effects re-estimated in every test, by commas; or none."),
    ] = "bias,scale_misalignment",
    noise_nt: of.NoiseOption = None,
    lsb_nt: of.LsbOption = None,
    attitude_sigma_deg: of.AttitudeSigmaOption = None,
    attitude_tau_s: of.AttitudeTauOption = None,
    field: of.ScenarioFieldOption = None,
    degree: of.DegreeOption = None,
    html: of.HtmlOption = None,
    close: Annotated[
        Path | None, typer.Option("--close", metavar="OUT.toml", help="Write a scenario with the named effects in it.")
    ] = None,
    follow: Annotated[
        bool,
        typer.Option(
            "--follow", help="Rows as they come, of a CSV that grows or of '-': an alarm where something changes."
        ),
    ] = False,
    calibration: Annotated[
        Path | None,
        typer.Option("--calibration", metavar="FILE.toml", help="With --follow: does this calibration still hold?"),
    ] = None,
    reading: of.Reading = of.READING,
) -> None:
    """Say where the gap between telemetry and simulation lies, which effect causes it and how far it shrinks.

    Errors that are not declared are the scenario's, where it has them, else found in the data. Exit status 1 where
    --follow has ended with an alarm.
    """
    followed = None
    with output.progress(f"reading {telemetry}") as progress:
        from fluxtwin import diagnosing, diagnosis_page, outputs
        from fluxtwin.report import render_report
        from fluxtwin.sim.base.errors import BadInput
        from fluxtwin.sim.base.files import write_text
        from fluxtwin.sim.scenario.scenario import save_scenario

        targets = {"--html": (html, outputs.PAGE), "--close": (close, outputs.SCENARIO)}
        output.claim(
            targets, [telemetry if str(telemetry) != "-" else None, scenario, calibration, field, *reading.files]
        )
        if follow and (scenario is not None or close is not None):
            wanted = "no --scenario or --close beside it: --calibration, and the errors by their flags"
            raise BadInput("knows S and b, and no other effects", where="--follow", wanted=wanted)
        if calibration is not None and not follow:
            raise BadInput("is for --follow", where="--calibration", wanted="fluxtwin apply first, or --follow")
        if close is not None and scenario is None and not reading.whole:
            wanted = "a file of these rows alone (fluxtwin convert), or --scenario"
            raise BadInput("the scenario would replay the whole file", where="--close", wanted=wanted)
        names = [] if modelled.strip() == "none" else [name.strip() for name in modelled.split(",") if name.strip()]
        errors = {
            "noise_nT": noise_nt,
            "lsb_nT": lsb_nt,
            "attitude_sigma_deg": attitude_sigma_deg,
            "attitude_tau_s": attitude_tau_s,
        }
        asked: dict[str, Any] = {**errors, "modelled": names, "field": field, "degree": degree, "progress": progress}
        if follow:
            from fluxtwin.following import follow as watch

            known = {"calibration": calibration, "said": output.line, **reading._asdict()}
            followed = watch(str(telemetry), **asked, **known)
            diagnosis = followed.diagnosis
        else:
            record = read(telemetry, output, reading)
            diagnosis = diagnosing.diagnose(record, scenario=scenario, **asked)
        scene = None
        if close is not None:
            declared = diagnosing.Declared(**errors, field=field, degree=degree)
            diagnosis, scene = diagnosing.close(
                diagnosis, scenario=scenario, telemetry=telemetry, column_map=reading.column_map, declared=declared
            )
        title = f"The gap: {telemetry.name}"
        page = None if html is None else render_report(diagnosis_page.diagnosis_page(diagnosis, title))
        if html is not None and page is not None:
            write_text(html, page)
        if close is not None and scene is not None:
            save_scenario(scene, close)
    for note in diagnosis.notes:
        output.note(f"note: {note}")
    if close is not None and scene is None:
        why = "what is named is not in the readings" if diagnosis.effects else "no effect is named"
        output.note(f"note: {why}, so there is nothing to close: {close} is not written")
    output.prose(diagnosis.sentence)
    for line in diagnosis_page.where_lines(diagnosis):
        output.prose(line)
    output.say()
    for table in diagnosis_page.tables(diagnosis):
        output.table(table.title, table.columns, table.rows, table.note)
    if page is not None:
        output.say(f"written: {html}")
    if scene is not None:
        output.say(f"written: {close}")
    output.result(diagnosis.to_dict() if followed is None else followed.to_dict())
    if followed is not None and followed.changed is not None:
        raise typer.Exit(1)
