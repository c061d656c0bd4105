"""`fluxtwin trend`: does last month's calibration still hold?"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from fluxtwin.calib import methods
from fluxtwin.commands import options as of
from fluxtwin.console import Output

BRIEF = "Test whether a calibration still holds: compare calibrations, or telemetry of several days."


def command(
    output: Output,
    files: Annotated[list[Path], of.argument("FILE...", "Calibration files, or telemetry to be calibrated.")],
    every: Annotated[
        float | None,
        of.option("HOURS", "Cut telemetry into stretches of this length; default: a single file is cut into days."),
    ] = None,
    out: Annotated[
        Path | None,
        of.option(
            "FILE.toml", "Write the last calibration with the date at which its drift, if it has one, makes it expire."
        ),
    ] = None,
    html: of.HtmlOption = None,
    field: of.FieldOption = "igrf14",
    degree: of.DegreeOption = None,
    reading: of.Reading = of.READING,
    **options: Any,
) -> None:
    """Test whether calibrations agree within their sigmas; say which parameter changed when, or drifts, and its effect.

    Exit status 0 if they agree, 1 if not.
    """
    with output.progress(f"reading {files[0]}") as progress:
        from fluxtwin import outputs, trending
        from fluxtwin.report import write_page

        methods.require(options["method"], options)
        targets = {"--out": (out, outputs.CALIBRATION), "--html": (html, outputs.PAGE)}
        output.claim(targets, [*files, field, *reading.files])
        given = [
            path if path.suffix.lower() == ".toml" else of.read(path, output, reading, one_of_many=True)
            for path in files
        ]
        found = trending.trend(given, every_h=every, field=field, degree=degree, progress=progress, **options)
        written = [] if out is None else [found.last.to_toml(out)]
        if html is not None:
            progress("drawing", 0.9)
            written.append(write_page(trending.trend_page(found), html))
    output.prose(*found.lines)
    output.say()
    output.tables([trending.trend_table(found)])
    output.files(written)
    output.result({**found.to_dict(), "written": [str(path) for path in written]})
    if not found.holds:
        raise typer.Exit(1)
