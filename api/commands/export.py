"""`fluxtwin export`: a calibration as flight software holds it."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from fluxtwin.commands import options as of
from fluxtwin.console import Output

BRIEF = "Write a calibration for flight software, and the error that its number format adds."

_SEEN_NT = 1e-6  # less is the arithmetic of this computer


def command(
    output: Output,
    calibration: Annotated[Path, typer.Argument(metavar="CALIBRATION", help="Calibration file.")],
    to: Annotated[
        str,
        typer.Option(metavar="TARGET", help="ardupilot, px4, gomspace, c-header, json, matlab or cubeadcs:FORM,UNIT."),
    ],
    out: of.OutOption,
    instance: Annotated[
        int, typer.Option(metavar="N", min=1, help="Number of the magnetometer in that software, from 1.")
    ] = 1,
) -> None:
    """Print the formula of the target with units, its numbers and the error that they add; write its file.

    A calibration that the target cannot hold, or would refuse itself, is refused without --force.
    """
    from fluxtwin import flight_software
    from fluxtwin.calib.common.digits import plain
    from fluxtwin.calib.onboard.export import FIELDS_NT

    output.claim({}, [calibration, out])  # the JSON is neither of them
    made = flight_software.export(calibration, to, out, instance=instance, force=output.force)
    output.say(made.formula)
    output.say(f"source: {made.source}")
    output.say()
    output.table("", ["number", "value", "unit"], [[one.name, one.text, one.unit] for one in made.numbers])
    low, high = (f"{size / 1e3:.0f}" for size in FIELDS_NT)
    output.say(f"added error, the largest over fields of {low} to {high} uT in any direction:")
    for why, error in (
        ("the rounding of its numbers", made.rounding),
        ("a symmetric M, whose rotation is lost", made.form),
        ("numbers that it ignores", made.passed_over),
    ):
        if error is made.rounding or error.largest_nT > _SEEN_NT:
            output.say(f"  {plain(error.largest_nT, 2)} nT, {plain(error.largest_deg, 2)} deg by {why}")
    for note in made.notes:
        output.prose(f"- {note}", indent="  ")
    output.say(f"  {out}")
    output.result({**made.to_dict(), "written": [str(out)]})
