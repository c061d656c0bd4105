"""`fluxtwin plan`: what to fly next, so that the next diagnosis can tell what this one leaves open."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from fluxtwin.commands import options as of
from fluxtwin.console import Output
from fluxtwin.sim.base.errors import names_in

BRIEF = "Plan what to fly next to settle what a diagnosis leaves open."


def command(
    output: Output,
    telemetry: Annotated[Path, of.argument("TELEMETRY|DIAGNOSIS.json", "Telemetry, or the output of diagnose --json.")],
    limits: Annotated[
        Path | None, of.option("FILE.toml", "[limits]: what may be flown, how fast and how long.")
    ] = None,
    out: Annotated[
        Path | None, of.option("PLAN.toml", "Write the first manoeuvre as a scenario that simulate flies.")
    ] = None,
    about: Annotated[
        str,
        of.option(
            "NAMES", "One effect to detect; several, separated by commas, to distinguish; or calibration.", "--for"
        ),
    ] = "",
    scenario: Annotated[
        Path | None, of.option("FILE.toml", "The spacecraft as flown; otherwise it is inferred from the record.")
    ] = None,
    modelled: of.ModelledOption = None,
    assumed: of.Assumed = of.ASSUMED,
    html: of.HtmlOption = None,
    reading: of.Reading = of.READING,
) -> None:
    """Say which manoeuvre within the limits settles what a diagnosis leaves open: hours, power, what each answer means.

    Exit status 1 if nothing is open, or if no manoeuvre helps.
    """
    with output.progress(f"reading {telemetry}") as progress:
        from fluxtwin import outputs, plan_page, planning
        from fluxtwin.gap.records.plan import Plan
        from fluxtwin.report import write_page
        from fluxtwin.sim.scenario.scenario import save_scenario

        output.claim(
            {"--out": (out, outputs.SCENARIO), "--html": (html, outputs.PAGE)},
            [telemetry, limits, scenario, assumed.field, *reading.files],
        )
        is_json = telemetry.suffix.lower() == ".json"
        found = planning.plan(
            telemetry if is_json else of.read(telemetry, output, reading),
            limits=limits,
            scenario=scenario,
            names=names_in(about),
            modelled=modelled,
            progress=progress,
            **assumed._asdict(),
        )
        written = []
        if out is not None and found.scenario is not None:
            written.append(save_scenario(found.scenario, out))
        if html is not None:
            written.append(write_page(plan_page.plan_page(found, f"What to fly: {telemetry.name}"), html))
    for note in found.notes:
        output.note(f"note: {note}")
    output.prose(found.sentence)
    output.say()
    tables = [plan_page.plan_table(found)]
    if isinstance(found, Plan) and found.questions[0].courses:
        tables.insert(0, plan_page.answers_table(found.questions[0]))
    output.tables(tables)
    for words, why in found.refused.items():
        output.note(f"not flown: {words}: {why}")
    output.files(written, "written: ")
    output.result({**found.to_dict(), "written": [str(path) for path in written]})
    if found.scenario is None:
        raise typer.Exit(1)
