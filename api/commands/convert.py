"""`fluxtwin convert`: telemetry in another format."""

from __future__ import annotations

from fluxtwin.commands import options as of
from fluxtwin.console import Output
from fluxtwin.sim.base.errors import amount

BRIEF = "Write telemetry in another format, completely or in part."


def command(
    output: Output, telemetry: of.TelemetryArgument, out: of.OutOption, reading: of.Reading = of.READING
) -> None:
    """Read telemetry, foreign files with --map, and write it in the format that the name of --out ends in."""
    with output.progress(f"reading {telemetry}"):
        from fluxtwin import outputs
        from fluxtwin.sim.telemetry.telemetry_files import write_telemetry

        output.claim({"--out": (out, outputs.TELEMETRY)}, [telemetry, *reading.files])
        record = of.read(telemetry, output, reading)
        write_telemetry(record, out)
    output.say(f"{out}: {amount(len(record), 'row|rows')}")
    output.result({"rows": len(record), "written": [str(out)]})
