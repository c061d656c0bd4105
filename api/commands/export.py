"""`fluxtwin export`: a calibration as flight software holds it."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from fluxtwin.commands import options as of
from fluxtwin.console import Output

BRIEF = "Write a calibration for flight software, and the error that its number format adds."


def command(
    output: Output,
    calibration: Annotated[Path, of.argument("CALIBRATION", "Calibration file.")],
    to: Annotated[str, of.option("TARGET", "ardupilot, px4, gomspace, c-header, json, matlab or cubeadcs:FORM,UNIT.")],
    out: of.OutOption,
    instance: Annotated[int, of.option("N", "Number of the magnetometer in that software, from 1.", min=1)] = 1,
) -> None:
    """Print the formula of the target with units, its numbers and the error that they add; write its file.

    A calibration that the target cannot hold, or would refuse itself, is refused without --force.
    """
    from fluxtwin import flight_software

    output.claim({}, [calibration, out])  # the JSON is neither of them
    made = flight_software.export(calibration, to, out, instance=instance, force=output.force)
    output.say(made.formula)
    output.say(f"source: {made.source}")
    output.say()
    output.table("", ["number", "value", "unit"], [[one.name, one.text, one.unit] for one in made.numbers])
    for line in made.lines:
        output.say(line)
    for note in made.notes:
        output.prose(f"- {note}", indent="  ")
    output.say(f"  {out}")
    output.result({**made.to_dict(), "written": [str(out)]})
