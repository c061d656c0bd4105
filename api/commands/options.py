"""The options that several commands share, spelled once."""

from __future__ import annotations

import inspect
import shlex
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple, TypeAlias, get_type_hints

import typer

from fluxtwin.calib.common import options as declared
from fluxtwin.console import Output, manners

if TYPE_CHECKING:
    from fluxtwin.calib.methods import Offered

_KEYWORD = inspect.Parameter.KEYWORD_ONLY


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
    typer.Option(
        "--tle",
        metavar="FILE",
        help="Two-line elements, or a CCSDS OEM, that give the position where the file has none.",
    ),
]
AttitudeOption: TypeAlias = Annotated[
    Path | None,
    typer.Option("--attitude", metavar="FILE.aem", help="CCSDS AEM that gives the attitude where the file has none."),
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
JobsOption: TypeAlias = Annotated[
    int | None, typer.Option("--jobs", metavar="J", help="Processes; all cores where not given.")
]
SchedulerOption: TypeAlias = Annotated[
    str | None,
    typer.Option(
        "--scheduler",
        metavar="ADDRESS",
        help="A Dask scheduler whose workers do it, as tcp://host:8786; only on a network you trust.",
    ),
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


class Reading(NamedTuple):
    """How telemetry is read; a command with a parameter of this type takes an option for each field."""

    column_map: MapOption = None
    tle: TleOption = None
    attitude: AttitudeOption = None
    max_samples: Annotated[
        int | None,
        typer.Option(
            "--max-samples", metavar="N", min=1, help="Most rows that are read of a file; 5,000,000 where not given."
        ),
    ] = None
    start: Annotated[
        str | None, typer.Option("--from", metavar="TIME", help="Only rows from this instant on (ISO 8601 UTC).")
    ] = None
    end: Annotated[str | None, typer.Option("--to", metavar="TIME", help="Only rows before this instant.")] = None
    where: Annotated[
        str | None,
        typer.Option(
            "--where", metavar="CONDITION", help="Only rows in which it holds, as 'sunlit == 1 and speed < 5'."
        ),
    ] = None
    magnetometer: Annotated[
        int, typer.Option("--magnetometer", metavar="N", min=1, max=2, help="1, or 2 for the readings mag2.")
    ] = 1

    @property
    def files(self) -> tuple[Path | None, ...]:
        """What is read besides the telemetry."""
        return self.column_map, self.tle, self.attitude

    @property
    def whole(self) -> bool:
        """No rows are chosen."""
        return self.start is None and self.end is None and self.where is None

    @property
    def words(self) -> str:
        """The options that are given, as a shell takes them."""
        flags = ("--map", "--tle", "--attitude", "--max-samples", "--from", "--to", "--where", "--magnetometer")
        usual = zip(flags, self, READING, strict=True)
        given = ((flag, value) for flag, value, default in usual if value != default)
        return shlex.join(str(word) for pair in given for word in pair)


READING = Reading()


class _Common(NamedTuple):
    """What every command takes; --quiet and --verbose before its name or after it."""

    force: ForceOption = False
    json: JsonOption = None
    quiet: QuietOption = False
    verbose: VerboseOption = False


def as_command(command: Callable[..., None], offered: Iterable[Offered] = ()) -> Callable[..., None]:
    """The command as typer takes it: its `output` made of the options of every command, its `reading` taken apart, and
    `offered`, the options of the calibration methods, after its argument in place of its `**options`."""
    hints = get_type_hints(command, include_extras=True)
    given: list[inspect.Parameter] = []
    for one in list(inspect.signature(command).parameters.values())[1:]:
        if one.kind is one.VAR_KEYWORD:
            given[1:1] = [_offered(option) for option in offered if option.option.kind is not None]
        elif hints[one.name] is Reading:
            given += _fields(Reading)
        else:
            given.append(one.replace(annotation=hints[one.name], kind=_KEYWORD))
    whole = [*given, *_fields(_Common)]

    def polite(**options: Any) -> None:
        common = _Common(**{name: options.pop(name) for name in _Common._fields})
        manners.quiet |= common.quiet
        manners.verbose |= common.verbose
        if "reading" in hints:
            options["reading"] = Reading(**{name: options.pop(name) for name in Reading._fields})
        command(Output(common.json, force=common.force), **options)

    polite.__doc__ = command.__doc__
    polite.__annotations__ = {one.name: one.annotation for one in whole}
    polite.__signature__ = inspect.Signature(whole)  # type: ignore[attr-defined]
    return polite


def _fields(group: type[Reading | _Common]) -> list[inspect.Parameter]:
    hints = get_type_hints(group, include_extras=True)
    return [
        inspect.Parameter(name, _KEYWORD, default=group._field_defaults[name], annotation=hints[name])
        for name in group._fields
    ]


def _offered(one: Offered) -> inspect.Parameter:
    kind: Any = one.option.kind if one.default is not None else one.option.kind | None
    note: Any = Annotated[kind, declared_option(one.name, one.option)]
    return inspect.Parameter(one.name, _KEYWORD, default=one.default, annotation=note)
