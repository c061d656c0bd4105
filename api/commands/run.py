"""`fluxtwin run`: a whole study, from the orbit to the page."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from fluxtwin.commands import options as of
from fluxtwin.console import Output

BRIEF = "Run a complete study: tables, figures, report.html, summary.json."


def command(
    output: Output,
    name: Annotated[str, of.argument("NAME", "The study: seasat, hcmm, st5, elfin, flight-field or flight-gaps.")],
    data: Annotated[Path | None, of.option("DIR", "Folder with recorded data, for flight studies.")] = None,
    out: Annotated[Path | None, of.option("DIR", "Folder for the results; default ./NAME-results.")] = None,
    attitude: Annotated[
        str | None, of.option("HOW", "seasat, hcmm: moved by torques (dynamics, default) or as prescribed.")
    ] = None,
) -> None:
    """Run a whole study: tables here; figures, report.html, summary.json and the scenario in a folder."""
    with output.progress(f"starting {name}") as progress:
        from fluxtwin import outputs
        from fluxtwin.studies import run_study

        output.claim({"--out": (out or f"{name}-results", outputs.STUDY)}, [data])
        result, written = run_study(name, out, data, progress, attitude=attitude)
    output.tables(result.tables)
    if written:
        output.say("written:")
        output.files(dict.fromkeys(written))
    output.say(result.status_line)
    output.result(result.summary)
