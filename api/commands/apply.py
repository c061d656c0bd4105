"""`fluxtwin apply`: a calibration file corrects telemetry."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from fluxtwin.commands.options import ForceOption, JsonOption, MapOption, MaxSamplesOption, OutOption, TleOption
from fluxtwin.commands.reading import TelemetryArgument, read
from fluxtwin.console import Output

NAME = "apply"
BRIEF = "Correct telemetry with a calibration file."


def command(
    telemetry: TelemetryArgument,
    calibration: Annotated[Path, typer.Option("--calibration", metavar="FILE.toml", help="Calibration file.")],
    out: OutOption,
    column_map: MapOption = None,
    tle: TleOption = None,
    max_samples: MaxSamplesOption = None,
    force: ForceOption = False,
    json: JsonOption = None,
) -> None:
    """Write telemetry with the readings corrected by (I+S) B + b + T D [nT]; other columns as they are.

    Refused, unless --force, are readings that are corrected already and a calibration of another spacecraft or time.
    """
    output = Output(json)
    with output.progress(f"correcting {telemetry}"):
        import numpy as np

        from fluxtwin import outputs, verbs
        from fluxtwin.calib.common.apply import outside_span, waived
        from fluxtwin.calib.common.records import Calibration
        from fluxtwin.sim.telemetry.telemetry_files import write_telemetry

        targets = {"--out": (out, outputs.TELEMETRY), "--json": (json, outputs.JSON)}
        outputs.claim(targets, [telemetry, calibration, column_map, tle], force=force)
        record = read(telemetry, output, column_map=column_map, tle=tle, max_samples=max_samples)
        known = Calibration.from_toml(calibration)
        if force and (refusal := waived(record, known)) is not None:
            output.note(f"note: applied all the same, by --force: {refusal}")
        corrected = verbs.apply(record, known, force=force)
        change = corrected.mag_B_nT - record.mag_B_nT
        moved = change[np.isfinite(change).all(axis=1)]
        write_telemetry(corrected, out)
    rms = [float(x) for x in np.sqrt(np.mean(moved**2, axis=0))] if len(moved) else None
    output.say(f"{len(moved)} of {len(record)} samples corrected")
    if rms is not None:
        output.say("rms change x, y, z: " + ", ".join(f"{x:.1f}" for x in rms) + " nT")
    beyond = outside_span(record, known)
    if beyond:
        output.note(f"note: {beyond} of {len(record)} rows are outside the time from which the calibration was made")
    output.say(f"the file says that its readings are corrected, by {corrected.corrected_by}")
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
