"""`fluxtwin diagnose`: where the gap between telemetry and simulation lies, which effect causes it, how far it shrinks."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

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
    reading: of.Reading = of.READING,
) -> None:
    """Say where the gap between telemetry and simulation lies, which effect causes it and how far it shrinks.

    Errors that are not declared are the scenario's, where it has them, else found in the data.
    """
    with output.progress(f"reading {telemetry}") as progress:
        from fluxtwin import diagnosing, diagnosis_page, outputs
        from fluxtwin.report import render_report
        from fluxtwin.sim.base.errors import BadInput
        from fluxtwin.sim.base.files import write_text
        from fluxtwin.sim.scenario.scenario import save_scenario

        targets = {"--html": (html, outputs.PAGE), "--close": (close, outputs.SCENARIO)}
        output.claim(targets, [telemetry, scenario, field, *reading.files])
        if close is not None and scenario is None and not reading.whole:
            wanted = "a file of these rows alone (fluxtwin convert), or --scenario"
            raise BadInput("the scenario would replay the whole file", where="--close", wanted=wanted)
        record = read(telemetry, output, reading)
        names = [] if modelled.strip() == "none" else [name.strip() for name in modelled.split(",") if name.strip()]
        diagnosis = diagnosing.diagnose(
            record,
            scenario=scenario,
            modelled=names,
            noise_nT=noise_nt,
            lsb_nT=lsb_nt,
            attitude_sigma_deg=attitude_sigma_deg,
            attitude_tau_s=attitude_tau_s,
            field=field,
            degree=degree,
            progress=progress,
        )
        scene = None
        if close is not None:
            declared = diagnosing.Declared(noise_nt, lsb_nt, attitude_sigma_deg, attitude_tau_s, field, degree)
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
    output.result(diagnosis.to_dict())
