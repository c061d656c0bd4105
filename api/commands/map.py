"""`fluxtwin map`: a first column map from the header of a foreign file."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from fluxtwin.commands import options as of
from fluxtwin.console import Output

BRIEF = "Draft a column map from the headers of foreign files."


def command(
    output: Output,
    files: Annotated[
        list[Path] | None, of.argument("FILE...", "Foreign files of any readable format, or a folder of them.")
    ] = None,
    preset: Annotated[
        str | None, of.option("NAME", "Write the packaged map of this name, to be edited; or `list`.")
    ] = None,
    out: Annotated[Path | None, of.option("FILE.toml", "Where to write the map; otherwise it is printed.")] = None,
) -> None:
    """Guess what the columns are from their names and values; whatever was guessed is marked "to be confirmed".

    Confirm or correct each guess, then run `fluxtwin check FILE --map MAP`, which says whether they were right.
    """
    from fluxtwin import outputs
    from fluxtwin.sim.base import files as storage
    from fluxtwin.sim.base.errors import BadInput
    from fluxtwin.sim.telemetry import column_map, column_map_draft

    output.claim({"--out": (out, outputs.COLUMN_MAP)}, files or [])
    if preset == "list":
        rows = [
            (f"--map preset:{name}", _preset(name).splitlines()[0].removeprefix("# ")) for name in column_map.presets()
        ]
        output.table("", ("map", "of"), rows)
        output.result({"presets": column_map.presets()})
        return
    if preset is None and not files:
        raise BadInput("no file was named", where="FILE", wanted="foreign files, or --preset NAME")
    text = column_map_draft.draft(files or []) if preset is None else _preset(preset)
    guesses = text.count(column_map_draft.CONFIRM)
    if out is None:
        output.say(text.rstrip("\n"))
    else:
        storage.write_toml(out, text, draft=True)
        output.say(f"{out}: {guesses} guess{'es' if guesses != 1 else ''} to be confirmed, marked in the file")
    output.result({"map": text, "guesses": guesses, "written": [] if out is None else [str(out)]})


def _preset(name: str) -> str:
    from fluxtwin.sim.telemetry import column_map

    found = column_map.preset(column_map.PRESET + name)
    assert found is not None
    return found.read_text(encoding="utf-8")
