"""The options that several commands share, spelled once."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any, TypeAlias, get_type_hints

import typer

from fluxtwin.console import manners

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
HtmlOption: TypeAlias = Annotated[
    Path | None, typer.Option("--html", metavar="FILE", help="Write the report as one page.")
]
OutOption: TypeAlias = Annotated[Path, typer.Option("--out", metavar="FILE", help="File to write.")]
ForceOption: TypeAlias = Annotated[
    bool,
    typer.Option(
        "--force",
        help="Write against a refusal that names --force, as of a file that fluxtwin did not write; never onto an input.",
    ),
]
QuietOption: TypeAlias = Annotated[
    bool, typer.Option("--quiet", "-q", help="Only the result and errors: no progress, no notes.")
]
VerboseOption: TypeAlias = Annotated[
    bool, typer.Option("--verbose", "-v", help="In an error also the long lists, as of all known keys.")
]


def with_manners(command: Callable[..., None]) -> Callable[..., None]:
    """The command with --quiet and --verbose, which every command takes, before its name or after it."""

    def polite(*, quiet: bool, verbose: bool, **options: Any) -> None:
        manners.quiet |= quiet
        manners.verbose |= verbose
        command(**options)

    hints = get_type_hints(command, include_extras=True)
    given = inspect.signature(command).parameters.values()
    polite.__doc__ = command.__doc__
    polite.__annotations__ = {**hints, "quiet": QuietOption, "verbose": VerboseOption}
    polite.__signature__ = inspect.Signature(  # type: ignore[attr-defined]
        [
            *(one.replace(annotation=hints[one.name], kind=one.KEYWORD_ONLY) for one in given),
            inspect.Parameter("quiet", inspect.Parameter.KEYWORD_ONLY, default=False, annotation=QuietOption),
            inspect.Parameter("verbose", inspect.Parameter.KEYWORD_ONLY, default=False, annotation=VerboseOption),
        ]
    )
    return polite
