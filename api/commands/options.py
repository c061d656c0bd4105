"""The options that several commands share, spelled once."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeAlias, TypeVar, get_type_hints

import typer

from fluxtwin.calib.common import options as declared
from fluxtwin.console import manners

if TYPE_CHECKING:
    from fluxtwin.calib.methods import Offered

_KEYWORD = inspect.Parameter.KEYWORD_ONLY
C = TypeVar("C", bound=Callable[..., None])


def declared_option(name: str, option: declared.Option) -> Any:
    """The option of a calibration method, on the command line."""
    flag = f"--{name.replace('_', '-')}"
    return typer.Option(
        f"{flag}/--no-{flag[2:]}" if option.kind is bool else flag, metavar=option.metavar or None, help=option.help
    )


NoiseOption: TypeAlias = Annotated[float | None, declared_option("noise_nT", declared.NOISE_NT)]
LsbOption: TypeAlias = Annotated[float | None, declared_option("lsb_nT", declared.LSB_NT)]
AttitudeSigmaOption: TypeAlias = Annotated[
    float | None, declared_option("attitude_sigma_deg", declared.ATTITUDE_SIGMA_DEG)
]
AttitudeTauOption: TypeAlias = Annotated[float | None, declared_option("attitude_tau_s", declared.ATTITUDE_TAU_S)]
CalibrationOption: TypeAlias = Annotated[
    Path | None,
    typer.Option(
        "--calibration", metavar="FILE.toml", help="Calibration file; not for telemetry that apply has corrected."
    ),
]
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


def with_options(offered: Iterable[Offered]) -> Callable[[C], C]:
    """The command, whose `**options` are those of the calibration methods, after its argument."""

    def decorate(command: C) -> C:
        hints = get_type_hints(command, include_extras=True)
        own = [one.replace(annotation=hints[one.name]) for one in inspect.signature(command).parameters.values()]
        added = []
        for one in offered:
            if one.option.kind is not None:
                kind: Any = one.option.kind if one.default is not None else one.option.kind | None
                note: Any = Annotated[kind, declared_option(one.name, one.option)]
                added.append(inspect.Parameter(one.name, _KEYWORD, default=one.default, annotation=note))
        whole = [own[0], *added, *(one.replace(kind=_KEYWORD) for one in own[1:-1])]
        command.__annotations__ = {one.name: one.annotation for one in whole}
        command.__signature__ = inspect.Signature(whole)  # type: ignore[attr-defined]
        return command

    return decorate


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
            *(one.replace(annotation=hints[one.name], kind=_KEYWORD) for one in given),
            inspect.Parameter("quiet", _KEYWORD, default=False, annotation=QuietOption),
            inspect.Parameter("verbose", _KEYWORD, default=False, annotation=VerboseOption),
        ]
    )
    return polite
