"""`fluxtwin diagnose`: where the gap between telemetry and simulation lies, which effect causes it, how far it shrinks."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from fluxtwin.commands import options as of
from fluxtwin.console import Output

if TYPE_CHECKING:
    from fluxtwin.gap.records.diagnosis import Diagnosis
    from fluxtwin.sim.telemetry.record import Telemetry

BRIEF = "Find where telemetry and simulation differ, which effect causes it and how much it explains."


def command(
    output: Output,
    telemetry: Annotated[
        list[Path],
        of.argument(
            "TELEMETRY...",
            "A .nc, .csv or .csv.gz file, or a foreign one with --map; several: one by one, or with --fleet together.",
        ),
    ],
    scenario: Annotated[
        Path | None, of.option("FILE.toml", "The spacecraft: field model, first calibration, noise, known effects.")
    ] = None,
    modelled: of.ModelledOption = None,
    assumed: of.Assumed = of.ASSUMED,
    html: of.HtmlOption = None,
    close: Annotated[Path | None, of.option("OUT.toml", "Write a scenario that contains the named effects.")] = None,
    fleet: Annotated[
        bool,
        typer.Option(
            "--fleet",
            help="The files are vehicles of one design, three or more: which effect is common, and which vehicle differs.",
        ),
    ] = False,
    follow: Annotated[
        bool,
        typer.Option(
            "--follow",
            help="Watch a growing CSV file, or '-' for standard input, and raise an alarm when something changes.",
        ),
    ] = False,
    calibration: Annotated[
        Path | None, of.option("FILE.toml", "With --follow: does this calibration still hold?")
    ] = None,
    workers: of.Workers = of.WORKERS,
    reading: of.Reading = of.READING,
) -> None:
    """Find where telemetry and simulation differ, which effect causes it and how much of the gap it explains.

    Noise and attitude errors that you do not declare come from the scenario, or else are estimated from the data. The exit
    status is 1 if --follow ended with an alarm.
    """
    from fluxtwin import outputs
    from fluxtwin.sim.base.errors import BadInput

    asked: dict[str, Any] = {"modelled": modelled, **assumed._asdict()}
    given = [path for path in telemetry if not follow or str(path) != "-"]
    targets = {"--html": (html, outputs.PAGE), "--close": (close, outputs.SCENARIO)}
    output.claim(targets, [*given, scenario, calibration, assumed.field, *reading.files])
    _require_together(telemetry, fleet, follow, scenario, html, close, calibration, workers)
    if len(telemetry) == 1 and (workers.jobs or 1) > 1:
        output.note("note: one file is diagnosed by one process; --jobs shares several files")
    if follow:
        _follow(output, telemetry[0], html, {**asked, "calibration": calibration}, reading)
        return
    if fleet or len(telemetry) > 1:
        several = _fleet if fleet else _several
        several(output, telemetry, {**asked, "scenario": scenario}, workers, reading)
        return
    with output.progress(f"reading {telemetry[0]}") as progress:
        from fluxtwin import diagnosing
        from fluxtwin.sim.scenario.scenario import save_scenario

        if close is not None and scenario is None and not reading.whole:
            wanted = "a file of these rows alone (fluxtwin convert), or --scenario"
            raise BadInput("the scenario would replay the whole file", where="--close", wanted=wanted)
        record = of.read(telemetry[0], output, reading)
        diagnosis = diagnosing.diagnose(
            record, scenario=scenario, said=lambda line: output.note(f"note: {line}"), progress=progress, **asked
        )
        scene = None
        if close is not None:
            declared = diagnosing.Declared(*assumed)
            diagnosis, scene = diagnosing.close(
                diagnosis, scenario=scenario, telemetry=telemetry[0], column_map=reading.column_map, declared=declared
            )
        named = (shlex.quote(str(telemetry[0])), reading.words, of.as_options({"scenario": scenario, **asked}))
        commands = {"source": " ".join(filter(None, named)), "correct": _correct(telemetry[0], close, reading)}
        if scene is not None:
            commands["closed"] = shlex.quote(str(close))
        _page(diagnosis, telemetry[0], html, record, **commands)
        if close is not None and scene is not None:
            save_scenario(scene, close)
    _say(output, diagnosis, html, close, **commands)
    output.result(diagnosis.to_dict())


def _correct(telemetry: Path, close: Path | None, reading: of.Reading) -> str:
    """The command that corrects the readings with a closed scenario."""
    closed = shlex.quote(str(close or "CLOSED.toml"))
    out = shlex.quote(of.proposed_name(telemetry, reading, "corrected", ".nc"))
    named = " ".join(filter(None, (shlex.quote(str(telemetry)), reading.of_all_rows.words)))
    return f"fluxtwin apply {named} --scenario {closed} --out {out}"


def _require_together(
    telemetry: list[Path],
    fleet: bool,
    follow: bool,
    scenario: Path | None,
    html: Path | None,
    close: Path | None,
    calibration: Path | None,
    workers: of.Workers,
) -> None:
    """Raises BadInput for options that do not go together."""
    from fluxtwin.sim.base.errors import BadInput
    from fluxtwin.sim.base.workers import require_workers

    if follow and (scenario is not None or close is not None):
        wanted = "--follow without --scenario and --close: give --calibration, and the errors by their own options"
        raise BadInput("knows S and b, and no other effects", where="--follow", wanted=wanted)
    if calibration is not None and not follow:
        raise BadInput("is for --follow", where="--calibration", wanted="fluxtwin apply first, or --follow")
    if (fleet or len(telemetry) > 1) and (follow or html is not None or close is not None):
        wanted = "one file for --follow, --html and --close"
        raise BadInput("--fleet" if fleet else f"{len(telemetry)} files", where="TELEMETRY", wanted=wanted)
    require_workers(*workers)
    if len(telemetry) == 1 and workers.scheduler is not None:
        raise BadInput("one file is no work to share", where="--scheduler", wanted="several files")


def _follow(output: Output, telemetry: Path, html: Path | None, asked: dict[str, Any], reading: of.Reading) -> None:
    """Rows as they come; without a bar, which would redraw itself over the lines."""
    from fluxtwin.following import follow

    found = follow(str(telemetry), said=output.line, **asked, **reading._asdict())
    _page(found.diagnosis, telemetry, html)
    _say(output, found.diagnosis, html, None)
    output.result(found.to_dict())
    if found.changed is not None:
        raise typer.Exit(1)


def _several(
    output: Output, telemetry: list[Path], asked: dict[str, Any], workers: of.Workers, reading: of.Reading
) -> None:
    """Each file by itself, in processes here or on a cluster; a sentence each, all of them as JSON."""
    with output.progress(f"reading {telemetry[0]}") as progress:
        from fluxtwin import diagnosis_page, fleets

        records = {str(path): of.read(path, output, reading, one_of_many=True) for path in telemetry}
        found = fleets.diagnoses(records, asked, progress=progress, **workers._asdict())
    for name, diagnosis in found.items():
        for note in diagnosis.notes:
            output.note(f"note: {name}: {note}")
        lines = [f"  {line}" for line in diagnosis_page.lines(diagnosis)]
        output.prose(f"{name}: {diagnosis.sentence}", *lines, indent="  ")
    output.result({"records": {name: diagnosis.to_dict() for name, diagnosis in found.items()}})


def _fleet(
    output: Output, telemetry: list[Path], asked: dict[str, Any], workers: of.Workers, reading: of.Reading
) -> None:
    """All together: an effect that is too small in each may be plain in all."""
    with output.progress(f"reading {telemetry[0]}") as progress:
        from fluxtwin import fleets

        records = {str(path): of.read(path, output, reading, one_of_many=True) for path in telemetry}
        found = fleets.fleet(records, progress=progress, **asked, **workers._asdict())
    output.prose(*found.lines)
    output.say()
    output.tables(fleets.tables(found))
    output.result(found.to_dict())


def _page(
    diagnosis: Diagnosis, telemetry: Path, html: Path | None, record: Telemetry | None = None, **commands: str
) -> None:
    from fluxtwin.diagnosis_page import diagnosis_page
    from fluxtwin.report import write_page

    if html is not None:
        page = diagnosis_page(diagnosis, f"The gap: {telemetry.name}", record=record, **commands)
        write_page(page, html)


def _say(output: Output, diagnosis: Diagnosis, html: Path | None, close: Path | None, **commands: str) -> None:
    from fluxtwin import diagnosis_page

    for note in diagnosis.notes:
        output.note(f"note: {note}")
    closed = "closed" in commands
    if close is not None and not closed:
        why = "what is named is not in the readings" if diagnosis.effects else "no effect is named"
        output.note(f"note: {why}, so there is nothing to close: {close} is not written")
    output.prose(diagnosis.sentence, *diagnosis_page.lines(diagnosis))
    output.say()
    output.tables(diagnosis_page.tables(diagnosis))
    output.files([html, close if closed else None], "written: ")
    output.prose(f"Next: {diagnosis_page.next_step(diagnosis, **commands)}")
