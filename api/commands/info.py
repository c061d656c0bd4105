"""`fluxtwin info`: what is in these files?"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from fluxtwin.commands import options as of
from fluxtwin.console import Output
from fluxtwin.sim.base.errors import amount

if TYPE_CHECKING:
    from fluxtwin.describing import Inventory

BRIEF = "List what is in the files: columns, units, span, gaps, and what each command lacks."
_MOST_PASSES = 20


def command(
    output: Output,
    files: Annotated[list[Path], of.argument("FILE...", "Telemetry, or foreign files.")],
    reading: of.Reading = of.READING,
) -> None:
    """List columns with units, rates and values, span, gaps, passes, provenance, and what is missing for which verb.

    For a foreign file without --map, only the header is listed.
    """
    from fluxtwin.describing import info

    output.claim({}, [*files, *reading.files])
    found = []
    for path in files:  # what was read is shown, though a later one cannot be read
        with output.progress(f"reading {path}"):
            found.append(info(path, **reading._asdict()))
        _print(output, found[-1])
    output.result({"files": [one.to_dict() for one in found]})


def _print(output: Output, one: Inventory) -> None:
    if one.unread:
        why = one.unread.removeprefix(f"{one.source}: ")
        output.prose(f"{one.source}: {amount(one.rows, 'row|rows')}; not telemetry as it stands: {why}")
        output.table("", ("column", "unit"), [(column.name, column.unit) for column in one.columns])
        if " beside the readings" not in one.unread:
            output.say(f"Next: fluxtwin map {one.source} --out map.toml")
        output.say()
        return
    span = ""
    if one.span_s is not None and one.step_s is not None:
        span = f" ({one.span_s / 3600.0:.4g} h), every {one.step_s:.4g} s"
    output.say(f"{one.source}: {amount(one.rows, 'row|rows')}, {one.start} to {one.end}{span}")
    rows = [
        (
            column.name,
            column.unit,
            f"{100.0 * (column.known or 0) / one.rows:.4g} %",
            column.step_s,
            column.low,
            column.median,
            column.high,
        )
        for column in one.columns
    ]
    output.table("", ("column", "unit", "known", "every [s]", "lowest", "median", "highest"), rows)
    _passes(output, one)
    ready = [verb for verb, missing in one.lacks.items() if not missing]
    if ready:
        output.prose(f"has the columns for: {', '.join(ready)}", indent="  ")
    for verb, missing in one.lacks.items():
        if missing:
            output.say(f"{verb} lacks {', '.join(missing)}")
    for key, text in one.provenance.items():
        for line in text.split("; ") if key == "notices" else [text]:
            output.prose(f"{key}: {line}", indent="  ")
    output.say()


def _passes(output: Output, one: Inventory) -> None:
    output.say(f"{one.gaps or 'no'} gap{'' if one.gaps == 1 else 's'} of more than three median steps")
    if len(one.passes) < 2:
        return
    rows = [(piece.start, piece.end, piece.rows, piece.gap_before_s) for piece in one.passes[:_MOST_PASSES]]
    note = f"The first {_MOST_PASSES} are listed." if len(one.passes) > _MOST_PASSES else ""
    output.table(
        amount(len(one.passes), "pass|passes"), ("from [UTC]", "to [UTC]", "rows", "gap before [s]"), rows, note
    )
