"""`fluxtwin plan`: what to fly next, so that the next diagnosis can tell what this one leaves open."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from fluxtwin.commands import options as of
from fluxtwin.console import Output, command_line

NAME = "plan"
BRIEF = "What to fly next to settle what a diagnosis leaves open, and with what power."


def command(
    output: Output,
    telemetry: Annotated[
        Path, typer.Argument(metavar="TELEMETRY|DIAGNOSIS.json", help="Telemetry, or what diagnose --json wrote.")
    ],
    limits: Annotated[
        Path | None,
        typer.Option("--limits", metavar="FILE.toml", help="[limits]: what may be flown, how fast and how long."),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option("--out", metavar="PLAN.toml", help="Write the first manoeuvre as a scenario that simulate flies."),
    ] = None,
    about: Annotated[
        str,
        typer.Option(
            "--for",
            metavar="NAMES",
            help="One effect to be shown; several, by commas, to be distinguished; or calibration.",
        ),
    ] = "",
    scenario: Annotated[
        Path | None,
        typer.Option(
            "--scenario", metavar="FILE.toml", help="The spacecraft as it is flown; else it is made of the record."
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
    reading: of.Reading = of.READING,
) -> None:
    """Say which manoeuvre within the limits settles what a diagnosis leaves open: hours, power, what each answer means.

    Exit status 1 where nothing is open, or no manoeuvre helps.
    """
    with output.progress(f"reading {telemetry}") as progress:
        from fluxtwin import outputs, plan_page, planning
        from fluxtwin.commands.reading import read
        from fluxtwin.gap.records.plan import Plan
        from fluxtwin.report import render_report
        from fluxtwin.sim.base.files import write_text
        from fluxtwin.sim.scenario.scenario import save_scenario

        output.claim(
            {"--out": (out, outputs.SCENARIO), "--html": (html, outputs.PAGE)},
            [telemetry, limits, scenario, field, *reading.files],
        )
        is_json = telemetry.suffix.lower() == ".json"
        found = planning.plan(
            telemetry if is_json else read(telemetry, output, reading),
            limits=limits,
            scenario=scenario,
            names=_names(about),
            modelled=[] if modelled.strip() == "none" else _names(modelled),
            noise_nT=noise_nt,
            lsb_nT=lsb_nt,
            attitude_sigma_deg=attitude_sigma_deg,
            attitude_tau_s=attitude_tau_s,
            field=field,
            degree=degree,
            progress=progress,
        )
        written = []
        if out is not None and found.scenario is not None:
            written.append(save_scenario(found.scenario, out))
        if html is not None:
            page = plan_page.plan_page(found, f"What to fly: {telemetry.name}", command=command_line())
            written.append(write_text(html, render_report(page)))
    for note in found.notes:
        output.note(f"note: {note}")
    output.prose(found.sentence)
    output.say()
    tables = [plan_page.plan_table(found)]
    if isinstance(found, Plan) and found.questions[0].courses:
        tables.insert(0, plan_page.answers_table(found.questions[0]))
    for table in tables:
        output.table(table.title, table.columns, table.rows, table.note)
    for words, why in found.refused.items():
        output.note(f"not flown: {words}: {why}")
    for path in written:
        output.say(f"written: {path}")
    output.result({**found.to_dict(), "written": [str(path) for path in written]})
    if found.scenario is None:
        raise typer.Exit(1)


def _names(given: str) -> list[str]:
    return [name.strip() for name in given.split(",") if name.strip()]
