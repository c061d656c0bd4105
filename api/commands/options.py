"""What commands share: their options, spelled once, and how they read telemetry and a calibration and write a table."""

from __future__ import annotations

import inspect
import shlex
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple, TypeAlias, get_type_hints

import typer

from fluxtwin.calib.common.options import OPTIONS
from fluxtwin.console import Output, manners
from fluxtwin.sim.base.processes import stop_if_asked

if TYPE_CHECKING:
    from fluxtwin.calib.common.records import Calibration
    from fluxtwin.calib.methods import Offered
    from fluxtwin.sim.telemetry.record import Telemetry

_KEYWORD = inspect.Parameter.KEYWORD_ONLY


def option(metavar: str, text: str, *flags: str, **limits: Any) -> Any:
    """An option with a value, by default under the name of its parameter; text: its help."""
    return typer.Option(*flags, metavar=metavar, help=text, **limits)


def argument(metavar: str, text: str) -> Any:
    """An argument, and its help."""
    return typer.Argument(metavar=metavar, help=text)


def declared_option(name: str) -> Any:
    """The option of a calibration method, on the command line."""
    flag, option = f"--{name.replace('_', '-')}", OPTIONS[name]
    return typer.Option(
        f"{flag}/--no-{flag[2:]}" if option.kind is bool else flag, metavar=option.metavar or None, help=option.help
    )


TelemetryArgument: TypeAlias = Annotated[
    Path, argument("TELEMETRY", "A .nc, .csv or .csv.gz file, or a foreign file or folder with --map.")
]
AttitudeSigmaOption: TypeAlias = Annotated[float | None, declared_option("attitude_sigma_deg")]
AttitudeTauOption: TypeAlias = Annotated[float | None, declared_option("attitude_tau_s")]
CalibrationOption: TypeAlias = Annotated[
    Path | None, option("FILE.toml", "Calibration file; not for telemetry that apply has corrected.")
]
FieldOption: TypeAlias = Annotated[str, option("MODEL", "Field model: igrf14, igrf1975 or chaos:FILE.")]
DegreeOption: TypeAlias = Annotated[int | None, option("N", "Highest degree to use; default: all of the model.")]
ScenarioFieldOption: TypeAlias = Annotated[
    str | None, option("MODEL", "Field to use, instead of the scenario's: igrf14, igrf1975 or chaos:FILE.")
]
HtmlOption: TypeAlias = Annotated[Path | None, option("FILE", "Write the report as one HTML page.")]
SchedulerOption: TypeAlias = Annotated[
    str | None,
    option(
        "ADDRESS", "Run on the workers of this Dask scheduler, such as tcp://host:8786; only on a network you trust."
    ),
]
OutOption: TypeAlias = Annotated[Path, option("FILE", "File to write.")]
SeedOption: TypeAlias = Annotated[int | None, option("S", "Random seed; default: the scenario's.")]
ResumeOption: TypeAlias = Annotated[bool, typer.Option("--resume", help="Continue an interrupted run in this folder.")]
QuietOption: TypeAlias = Annotated[
    bool, typer.Option("--quiet", "-q", help="Print only the result and errors: no progress, no notes.")
]
VerboseOption: TypeAlias = Annotated[
    bool, typer.Option("--verbose", "-v", help="Include long lists in error messages, such as all known keys.")
]


ModelledOption: TypeAlias = Annotated[
    str | None,
    option(
        "NAMES",
        "Effects to re-estimate in every test, separated by commas; or none. Default: bias,scale_misalignment, and, of "
        "corrected readings, what else their calibration has estimated.",
        "--modelled",
    ),
]


class Reading(NamedTuple):
    """How telemetry is read; a command with a parameter of this type takes an option for each field."""

    column_map: Annotated[
        Path | None, option("FILE.toml", "Column map: how to read the columns of a foreign file.", "--map")
    ] = None
    tle: Annotated[
        Path | None,
        option("FILE", "Two-line elements or a CCSDS OEM file that gives the position if the telemetry has none."),
    ] = None
    attitude: Annotated[
        Path | None, option("FILE.aem", "CCSDS AEM file that gives the attitude if the telemetry has none.")
    ] = None
    max_samples: Annotated[
        int | None, option("N", "Largest number of rows to read from a file; default: 5,000,000.", min=1)
    ] = None
    start: Annotated[str | None, option("TIME", "Use only rows from this instant on (ISO 8601 UTC).", "--from")] = None
    end: Annotated[str | None, option("TIME", "Use only rows before this instant.", "--to")] = None
    where: Annotated[
        str | None, option("CONDITION", "Use only rows that satisfy this, such as 'sunlit == 1 and speed < 5'.")
    ] = None
    magnetometer: Annotated[int, option("N", "1, or 2 to use the readings mag2.", min=1, max=2)] = 1

    @property
    def files(self) -> tuple[Path | None, ...]:
        """What is read besides the telemetry."""
        return self.column_map, self.tle, self.attitude

    @property
    def whole(self) -> bool:
        """No rows are chosen."""
        return self.start is None and self.end is None and self.where is None

    @property
    def of_all_rows(self) -> Reading:
        """The same, of every row: what was found in some is applied to all."""
        return self._replace(start=None, end=None, where=None)

    @property
    def words(self) -> str:
        """The options that are given, as a shell takes them."""
        names = ("map", "tle", "attitude", "max_samples", "from", "to", "where", "magnetometer")
        return as_options(dict(zip(names, self, strict=True)), {"magnetometer": 1})


READING = Reading()


class Assumed(NamedTuple):
    """The errors and the field model given to a diagnosis; an option for each."""

    noise_nT: Annotated[float | None, declared_option("noise_nT")] = None
    lsb_nT: Annotated[float | None, declared_option("lsb_nT")] = None
    attitude_sigma_deg: AttitudeSigmaOption = None
    attitude_tau_s: AttitudeTauOption = None
    field: ScenarioFieldOption = None
    degree: DegreeOption = None


ASSUMED = Assumed()


class Workers(NamedTuple):
    """Who does the work; likewise."""

    jobs: Annotated[int | None, option("J", "Number of processes; default: all cores.")] = None
    scheduler: SchedulerOption = None


WORKERS = Workers()


def read(path: Path, output: Output, reading: Reading, *, one_of_many: bool = False) -> Telemetry:
    """The record in `path`; the reader's notices go to standard error, one a line, with the file's name among many."""
    from fluxtwin.sim.telemetry.telemetry_files import read_telemetry

    stop_if_asked()  # importing took its time
    record = read_telemetry(path, **reading._asdict())
    stop_if_asked()
    for notice in filter(None, record.provenance.get("notices", "").split("; ")):
        output.note(f"note: {path.name}: {notice}" if one_of_many else f"note: {notice}")
    return record


def stem(telemetry: Path) -> str:
    """What names of files that are made of it begin with."""
    whole = telemetry.resolve()  # `.` and `..` have no name of their own
    return whole.name if whole.is_dir() else whole.name.removesuffix(".gz").rsplit(".", 1)[0]


def proposed_name(telemetry: Path, reading: Reading, made: str, ending: str) -> str:
    """The file made of it that a next step proposes, in the current folder: each magnetometer has its own."""
    return f"{stem(telemetry)}-{made}{'-2' if reading.magnetometer == 2 else ''}{ending}"


def known_calibration(path: Path, record: Telemetry, output: Output) -> Calibration:
    """The calibration in a file, with a note of what --force waives for this record."""
    from fluxtwin.calib.common.apply import waived
    from fluxtwin.calib.common.records import Calibration

    known = Calibration.from_toml(path)
    if output.force and (refusal := waived(record, known)) is not None:
        output.note(f"note: applied anyway, by --force: {refusal}")
    return known


def write_table(columns: Mapping[str, Sequence[object]], names: Sequence[str], path: Path) -> None:
    """The named columns as CSV; a number that is none is blank."""
    from fluxtwin.sim.base.files import write_text

    cells = zip(*(columns[name] for name in names), strict=True)
    lines = [",".join("" if cell is None or cell != cell else str(cell) for cell in row) for row in cells]
    write_text(path, "\n".join([",".join(names), *lines, ""]))


def say_how_to_go_on(
    output: Output, kept: int, what: str, command: Iterable[object], seed: int | None, workers: Workers
) -> None:
    """After an interruption: what is kept, if anything is, and the command that takes up the work."""
    words = [*command, *([] if seed is None else ["--seed", seed])]
    words += [] if workers.scheduler is None else ["--scheduler", workers.scheduler]
    if kept:
        output.note(f"{kept} {what}; go on with: {shlex.join(map(str, ['fluxtwin', *words, '--resume']))}")


class _Common(NamedTuple):
    """What every command takes; --quiet and --verbose before its name or after it."""

    force: Annotated[
        bool,
        typer.Option(
            "--force",
            help="Do what a message refuses without --force, such as replacing a file that fluxtwin did not write. "
            "Inputs are never overwritten.",
        ),
    ] = False
    json: Annotated[str | None, option("FILE", "Write the result as JSON; '-' is standard output.")] = None
    quiet: QuietOption = False
    verbose: VerboseOption = False


def as_options(given: Mapping[str, Any], usual: Mapping[str, Any] | None = None) -> str:
    """Options by name as a shell takes them, without those that are None or have their usual value."""
    words = []
    for name, value in given.items():
        flag = name.replace("_", "-")
        if value is None or (usual is not None and value == usual.get(name)):
            continue
        if isinstance(value, bool):
            words.append(f"--{flag}" if value else f"--no-{flag}")
        else:
            for one in value if isinstance(value, list | tuple) else [value]:
                words += [f"--{flag}", str(one)]
    return shlex.join(words)


def as_command(command: Callable[..., None], offered: Iterable[Offered] = ()) -> Callable[..., None]:
    """The command as typer takes it: its `output` made of the options of every command, records of options taken apart, and
    `offered`, the options of the calibration methods, after its argument in place of its `**options`."""
    hints = get_type_hints(command, include_extras=True)
    groups = {name: hint for name, hint in hints.items() if hint in (Reading, Assumed, Workers)}
    given: list[inspect.Parameter] = []
    for one in list(inspect.signature(command).parameters.values())[1:]:
        if one.kind is one.VAR_KEYWORD:
            given[1:1] = [_offered(option) for option in offered if option.option.kind is not None]
        elif one.name in groups:
            given += _fields(groups[one.name])
        else:
            given.append(one.replace(annotation=hints[one.name], kind=_KEYWORD))
    whole = [*given, *_fields(_Common)]

    def polite(**options: Any) -> None:
        common = _Common(**{name: options.pop(name) for name in _Common._fields})
        manners.quiet |= common.quiet
        manners.verbose |= common.verbose
        for name, group in groups.items():
            options[name] = group(**{field: options.pop(field) for field in group._fields})
        command(Output(common.json, force=common.force), **options)

    polite.__doc__ = command.__doc__
    polite.__annotations__ = {one.name: one.annotation for one in whole}
    polite.__signature__ = inspect.Signature(whole)  # type: ignore[attr-defined]
    return polite


def _fields(group: Any) -> list[inspect.Parameter]:
    hints = get_type_hints(group, include_extras=True)
    return [
        inspect.Parameter(name, _KEYWORD, default=group._field_defaults[name], annotation=hints[name])
        for name in group._fields
    ]


def _offered(one: Offered) -> inspect.Parameter:
    kind: Any = one.option.kind if one.default is not None else one.option.kind | None
    note: Any = Annotated[kind, declared_option(one.name)]
    return inspect.Parameter(one.name, _KEYWORD, default=one.default, annotation=note)
