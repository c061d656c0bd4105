"""`fluxtwin apply`: a calibration file corrects telemetry."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from fluxtwin.commands import options as of
from fluxtwin.commands.reading import TelemetryArgument, known_calibration, read
from fluxtwin.console import Output

BRIEF = "Correct telemetry with a calibration file."


def command(
    output: Output,
    telemetry: TelemetryArgument,
    calibration: Annotated[Path, typer.Option(metavar="FILE.toml", help="Calibration file.")],
    out: of.OutOption,
    reading: of.Reading = of.READING,
) -> None:
    """Write telemetry with the readings corrected by (I+S) B + b + T D [nT]; other columns as they are.

    Refused, unless --force, are readings that are corrected already and a calibration of another spacecraft or time.
    """
    with output.progress(f"correcting {telemetry}"):
        import numpy as np

        from fluxtwin import outputs, verbs
        from fluxtwin.calib.common.apply import outside_span
        from fluxtwin.sim.telemetry.telemetry_files import write_telemetry

        output.claim({"--out": (out, outputs.TELEMETRY)}, [telemetry, calibration, *reading.files])
        record = read(telemetry, output, reading)
        known = known_calibration(calibration, record, output)
        corrected = verbs.apply(record, known, force=output.force)
        change = corrected.mag_B_nT - record.mag_B_nT
        moved = change[np.isfinite(change).all(axis=1)]
        write_telemetry(corrected, out)
    rms = [float(x) for x in np.sqrt(np.mean(moved**2, axis=0))] if len(moved) else None
    output.say(f"{len(moved)} of {len(record)} samples corrected")
    if rms is not None:
        output.say("rms change x, y, z: " + ", ".join(f"{x:.1f}" for x in rms) + " nT")
    beyond = outside_span(record, known)
    output.say(f"the new file is marked as corrected by {corrected.corrected_by}")
    output.say(f"  {out}")
    output.result(
        {
            "samples": len(record),
            "corrected": len(moved),
            "rms_change_nT": rms,
            "corrected_by": corrected.corrected_by,
            "outside_span": beyond,
            "written": [str(out)],
        }
    )
