"""`fluxtwin map`: a first column map from the header of a foreign file."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from fluxtwin.console import Output

NAME = "map"
BRIEF = "Write a first column map from the header of foreign files."


def command(
    output: Output,
    files: Annotated[list[Path], typer.Argument(metavar="FILE...", help="Foreign .csv, .csv.gz or .nc files.")],
    out: Annotated[
        Path | None, typer.Option("--out", metavar="FILE.toml", help="Where to write the map; else it is printed.")
    ] = None,
) -> None:
    """Guess what the columns are from their names and sizes; whatever was guessed is marked "to be confirmed".

    Confirm or mend each mark, then `fluxtwin check FILE --map MAP`: it tells whether the guesses were right.
    """
    from fluxtwin import outputs
    from fluxtwin.sim.base import files as storage
    from fluxtwin.sim.telemetry import column_map_draft

    output.claim({"--out": (out, outputs.COLUMN_MAP)}, files)
    text = column_map_draft.draft(files)
    guesses = text.count(column_map_draft.CONFIRM)
    if out is None:
        output.say(text.rstrip("\n"))
    else:
        storage.write_toml(out, text)
        output.say(f"{out}: {guesses} guess{'es' if guesses != 1 else ''} to be confirmed, marked in the file")
    output.result({"map": text, "guesses": guesses, "written": [] if out is None else [str(out)]})
