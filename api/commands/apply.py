"""`fluxtwin apply`: a calibration file corrects telemetry."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from fluxtwin.commands import options as of
from fluxtwin.console import Output

BRIEF = "Correct telemetry with a calibration file."


def command(
    output: Output,
    telemetry: of.TelemetryArgument,
    out: of.OutOption,
    calibration: Annotated[Path | None, of.option("FILE.toml", "Calibration file.")] = None,
    scenario: Annotated[
        Path | None,
        of.option("CLOSED.toml", "Instead of --calibration: a closed scenario, whose effects are taken out too."),
    ] = None,
    reading: of.Reading = of.READING,
) -> None:
    """Write telemetry with the readings corrected by (I+S) B + b + T D [nT]; other columns as they are.

    With --scenario, the effects of a closed scenario are taken out first: those of spacecraft and sensor from the
    readings, an error along the track from the positions.

    Readings that are corrected already, and a calibration of another spacecraft, are refused without --force. Rows
    outside the time or temperatures of the calibration are counted.
    """
    with output.progress(f"correcting {telemetry}"):
        import numpy as np

        from fluxtwin import outputs, verbs
        from fluxtwin.calib.common.apply import outside_span
        from fluxtwin.sim.base.errors import BadInput
        from fluxtwin.sim.telemetry.telemetry_files import write_telemetry

        if (calibration is None) == (scenario is None):
            raise BadInput(
                "one of them is needed",
                where="--calibration, --scenario",
                wanted="a calibration file, or a closed scenario",
            )
        output.claim({"--out": (out, outputs.TELEMETRY)}, [telemetry, calibration, scenario, *reading.files])
        record = of.read(telemetry, output, reading)
        known, effects = None, None
        if scenario is not None:
            from fluxtwin import diagnosing

            effects = diagnosing.apply_closed(record, scenario, force=output.force)
            corrected = effects.telemetry
        elif calibration is not None:
            known = of.known_calibration(calibration, record, output)
            corrected = verbs.apply(record, known, force=output.force)
        change = corrected.mag_B_nT - record.mag_B_nT
        moved = change[np.isfinite(change).all(axis=1)]
        write_telemetry(corrected, out)
    rms = [float(x) for x in np.sqrt(np.mean(moved**2, axis=0))] if len(moved) else None
    output.say(f"{len(moved)} of {len(record)} samples corrected")
    if rms is not None:
        output.say("rms change x, y, z: " + ", ".join(f"{x:.1f}" for x in rms) + " nT")
    if effects is not None:
        output.say(f"effects taken out: {', '.join(effects.taken) or 'none'}")
        if effects.left:
            because = "only errors of positions, and of readings that are known row by row, can be"
            output.say(f"not taken out, because {because}: {', '.join(effects.left)}")
    beyond = None if known is None else outside_span(record, known)
    output.say(f"the new file is marked as corrected by {corrected.corrected_by}")
    output.say(f"  {out}")
    output.result(
        {
            "samples": len(record),
            "corrected": len(moved),
            "rms_change_nT": rms,
            "corrected_by": corrected.corrected_by,
            "outside_span": beyond,
            **({} if effects is None else {"taken_out": list(effects.taken), "left": list(effects.left)}),
            "written": [str(out)],
        }
    )
