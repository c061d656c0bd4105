"""The options that several commands share, spelled once."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, TypeAlias

import typer

JsonOption: TypeAlias = Annotated[
    str | None,
    typer.Option("--json", metavar="FILE", help="Write the result as JSON; '-' is standard output."),
]
MapOption: TypeAlias = Annotated[
    Path | None,
    typer.Option("--map", metavar="FILE.toml", help="Column map: how a foreign file's columns are to be read."),
]
TleOption: TypeAlias = Annotated[
    Path | None,
    typer.Option("--tle", metavar="FILE", help="Two-line elements that give the position where the file has none."),
]
MaxSamplesOption: TypeAlias = Annotated[
    int | None,
    typer.Option(
        "--max-samples", metavar="N", min=1, help="Most rows that are read of a file; 5,000,000 where not given."
    ),
]
FieldOption: TypeAlias = Annotated[
    str, typer.Option("--field", metavar="MODEL", help="Field model: igrf14, igrf1975 or chaos:FILE.")
]
DegreeOption: TypeAlias = Annotated[
    int | None,
    typer.Option("--degree", metavar="N", help="Highest degree used; the model's own where not given."),
]
ScenarioFieldOption: TypeAlias = Annotated[
    str | None,
    typer.Option(
        "--field",
        metavar="MODEL",
        help="The field that acts, in place of the scenario's: igrf14, igrf1975 or chaos:FILE.",
    ),
]
OutOption: TypeAlias = Annotated[Path, typer.Option("--out", metavar="FILE", help="File to write.")]
