"""Column maps: a TOML file that says what the columns of foreign telemetry are, in which units and frames.

One `[[file]]` entry a source; several sources at several rates become one record on the magnetometer's stamps.
The magnetometer is never interpolated; attitude is (slerp), and positions are, within `max_gap_s` of the entry.

    tle = "satellite.tle"                      # optional: positions from two-line elements

    [[file]]
    path = "*MAGNETOMETER*.csv"                # a pattern inside the folder; may be left out for a single file
    time = { recipe = "seconds_ns", columns = ["timeSeconds", "timeNs"] }
    [file.columns]
    mag = { from = ["mx", "my", "mz"], unit = "uT", valid = { magIsValid = 1 } }

    [[file]]
    path = "*ESTIMATOR*.csv"
    max_gap_s = 60
    time = { recipe = "unix_ms", columns = "timestamp_ms" }
    [file.columns]
    attitude = { from = ["q0", "q1", "q2", "q3"], order = "xyzw", relative_to = "orbital" }

Nothing is guessed: a quantity with a dimension must state its unit.
"""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, Self

from pydantic import BeforeValidator, Field, model_validator

from fluxtwin.sim.base.errors import BadInput
from fluxtwin.sim.base.limits import MAX_SAMPLES
from fluxtwin.sim.base.toml_input import Strict, read_model
from fluxtwin.sim.telemetry import column_map_values, time_stamps
from fluxtwin.sim.telemetry import column_map_words as words
from fluxtwin.sim.telemetry.columns import FileTable
from fluxtwin.sim.telemetry.formats.catalogue import format_of
from fluxtwin.sim.telemetry.formats.table import Table
from fluxtwin.sim.telemetry.netcdf_files import NetcdfFile
from fluxtwin.sim.telemetry.quantities import BY_MAP_NAME, DRIVERS, FAMILIES, family_of
from fluxtwin.sim.telemetry.selection import condition

PRESETS = Path(__file__).parent / "data" / "presets"
LAYOUTS = Path(__file__).parent / "data" / "layouts"
PRESET = "preset:"
KNOWN = [
    *sorted(BY_MAP_NAME, key=lambda name: not BY_MAP_NAME[name].map_units),
    *(family.prefix + "NAME" for family in FAMILIES),
]
"""What a map may name; those that take a unit first."""


class TimeRecipe(Strict):
    """How the stamps of a source are made."""

    recipe: Annotated[str, BeforeValidator(words.recipe)]
    example: ClassVar[str] = '{ recipe = "unix_ms", columns = "NAME" }'
    columns: str | list[str] = "time"
    epoch: str | None = None
    """Origin of `seconds_since` (SI seconds), in the time scale."""
    scale: Literal["UTC", "TAI", "GPS", "TT"] | None = None
    """Time scale of the stamps; None: that of the recipe, which is UTC where `time_stamps` does not say another."""
    format: str | None = None
    """Of the recipe `text`, as strptime has it: `%d/%m/%Y %H:%M:%S.%f`."""
    unit_s: list[float] | None = None
    """Seconds that one unit of each column has, where it is not that of the recipe, as [604800, 0.001] of weeks and ms."""
    zone: str | None = None
    """Of local times: `Europe/Berlin` or `+02:00`; text that states its own zone keeps it."""
    offset_s: float = 0.0
    """Added to every stamp."""
    invalid: list[float] = []
    """Values of the first column that mean "no time": such rows are left out."""

    @property
    def names(self) -> list[str]:
        return [self.columns] if isinstance(self.columns, str) else self.columns

    @model_validator(mode="after")
    def _complete(self) -> Self:
        counted = time_stamps.COUNTED.get(self.recipe)
        wanted = len(self.unit_s or counted.units_s) if counted is not None else 1
        if self.unit_s is not None and (
            counted is None or not self.unit_s or not all(1e-12 <= one <= 1e9 for one in self.unit_s)
        ):
            raise ValueError(
                "unit_s has a positive number of seconds, 1e-12 to 1e9, for each column of a recipe that counts"
            )
        if self.recipe == time_stamps.YEAR:
            if not 1 <= len(self.names) <= 2:
                raise ValueError(
                    "recipe year takes a column of decimal years, or two of the year and the day of the year"
                )
        elif len(self.names) != wanted and not (self.recipe in ("iso", "text") and self.names):
            raise ValueError(f"recipe {self.recipe} takes {wanted} column{'s' if wanted > 1 else ''}")
        if counted is not None and counted.scale == "GPS" and self.scale not in (None, "GPS"):
            raise ValueError(f"recipe {self.recipe} counts GPS time")
        if self.invalid and self.recipe in time_stamps.TEXT:
            raise ValueError(f"recipe {self.recipe} takes no invalid: only numbers do")
        for key, owner, given in (("epoch", "seconds_since", self.epoch), ("format", "text", self.format)):
            if (self.recipe == owner) != (given is not None):
                raise ValueError(f"{key} belongs to the recipe {owner}, and is needed there")
        if self.zone is not None:
            time_stamps.zone_named(self.zone)
            scale = self.scale or (counted.scale if counted is not None else "UTC")
            if scale != "UTC" or "%z" in (self.format or ""):
                raise ValueError("zone is for local times; these stamps are " + ("%z" if scale == "UTC" else scale))
        return self


class ColumnSpec(Strict):
    """One quantity: its columns in the source and what they mean."""

    example: ClassVar[str] = '{ from = ["X", "Y", "Z"], unit = "nT" }'
    source: str | list[str] = Field(alias="from")
    """Column names, one a component; or one variable of several components (NetCDF)."""
    unit: str | None = None
    scale: float | list[float] = 1.0
    """Unit per stored number, as 0.01 nT a count; a list has one for each component, negative where an axis points back."""
    offset: float | list[float] = 0.0
    """In the unit, added after the scale."""
    matrix: list[list[float]] | None = None
    """Turns a vector as it is stored, in the axes of its sensor, into the nominal axes of the body."""
    fill: list[float] = []
    """Stored values that mean "missing", in any component."""
    invalid: list[float] = []
    """Stored values that mean "missing" where all components of a vector are such values, as zeros."""
    valid: dict[str, float] = {}
    """Columns that must have these values for the row to count."""
    frame: Annotated[str | None, BeforeValidator(words.frame)] = None
    """Axes of position and velocity; `axes` resolves other words for them."""
    relative_to: Annotated[str | None, BeforeValidator(words.reference)] = None
    """Reference of the attitude; orbital is z nadir, y negative orbit normal, NEC is geocentric. See `reference`."""
    order: Annotated[Literal["xyzw", "wxyz", "xyz"] | None, BeforeValidator(words.order)] = None
    """Order of the quaternion's components; xyz leaves the scalar out (it is taken as positive)."""
    sense: Literal["textbook", "conjugate"] = "textbook"
    """textbook: the attitude matrix of the quaternion maps reference components to body components."""
    euler: str | None = None
    """Axes of the three angles, as scipy has them: "ZYX" turns about the body's axes, "zyx" about those of the reference;
    the rotation takes the reference's axes to the body's."""
    vectors: str | None = None
    """Six columns: "x z" are the directions of these body axes in the reference; "sun nadir" those of sun and nadir as
    measured in the body. The first is followed exactly."""
    between: Literal["linear", "hold"] | None = None
    """Of a driver of another source, between its samples: a straight line (default), or the last value holds."""

    @property
    def names(self) -> list[str]:
        return [self.source] if isinstance(self.source, str) else self.source

    @property
    def axes(self) -> str | None:
        """`frame` by its own name, as GCRS for ECI; places by latitude and longitude are in ITRS."""
        if self.frame in column_map_values.PLACES:
            return "ITRS"
        return None if self.frame is None else words.canonical(self.frame)

    @property
    def reference(self) -> str | None:
        """`relative_to` by its own name; of measured vectors what they are."""
        if self.vectors in column_map_values.MEASURED:
            return self.vectors.replace(" ", "_")
        return None if self.relative_to is None else words.canonical(self.relative_to)

    def assumptions(self, quantity: str) -> list[str]:
        """What was taken for granted in reading `frame` and `relative_to`."""
        said = [words.assumption(word, quantity) for word in (self.frame, self.relative_to) if word is not None]
        return [text for text in said if text is not None]


def _recipe(value: Any) -> Any:
    """A bare column name in place of a recipe is answered with an example."""
    if isinstance(value, str):
        raise ValueError(
            f'wants a recipe and its column, as {{ recipe = "unix_ms", columns = "{value[:40]}" }} (found {value[:40]!r})'
        )
    return value


def _specs(value: Any) -> Any:
    """Bare column names in place of a table are answered with an example."""
    for name, spec in value.items() if isinstance(value, dict) else ():
        if isinstance(spec, str | list):
            raise ValueError(f'{name} wants a table, as {{ from = ["a", "b", "c"], unit = "nT" }} (found {spec!r:.60})')
    return value


class FileEntry(Strict):
    """One source."""

    path: str | None = None
    """File name or pattern inside the folder; several matches are joined in the order of their names."""
    sheet: str | None = None
    """Of a workbook; the first where none is named."""
    optional: bool = False
    """Left out where no file matches."""
    time: Annotated[TimeRecipe, BeforeValidator(_recipe)]
    columns: Annotated[dict[str, ColumnSpec], BeforeValidator(_specs)]
    max_gap_s: Annotated[float, Field(gt=0)] = 60.0
    """Longest distance between two samples across which this source is interpolated or held."""
    fill: list[float] = []
    """Stored values that mean "missing" in every column, as -9999."""
    where: str | None = None
    """The rows that count, as `VALID == 1`: a condition (`selection`) on stored numbers of any column, and on `time`."""
    sort: bool = False
    """Sort by time and drop rows that repeat another one exactly."""

    @model_validator(mode="after")
    def _quantities(self) -> Self:
        for name, spec in self.columns.items():
            _check_quantity(name, spec)
        if self.where is not None:
            condition(self.where, "where")
        return self


class LayoutVariable(Strict):
    """What a layout states of one variable."""

    shape: list[Literal["time"] | int]
    """Its sizes; `time` is the number of stamps."""
    units: str | None = None
    """Its units, for `time` the word before "since"; absent: the variable must have none."""


class Layout(Strict):
    """Which NetCDF files a packaged map is for: title, names, shapes and units of all variables; one more variable, or
    another unit, and it is not. `check` reads such a file without `--map` and says so; whatever computes from telemetry asks
    for the map all the same."""

    name: str
    taken_as: str
    """In words: what the map takes the columns for."""
    title_begins: Annotated[str, Field(min_length=10)]
    """How the file's attribute `title` begins."""
    variables: dict[str, LayoutVariable]
    """Every variable of the file; one more or one less is another layout."""

    @model_validator(mode="after")
    def _has_time(self) -> Self:
        if "time" not in self.variables:
            raise ValueError("a layout has the variable time")
        return self


class ColumnMap(Strict):
    """A whole column map. Exactly one `[[file]]` carries the magnetometer; with a `layout` it may be none."""

    file_kind: ClassVar[str] = "a column map"
    file: Annotated[list[FileEntry], Field(min_length=1, max_length=100)]
    layout: Layout | None = None
    """Files that `check` reads with this map unasked; only packaged maps are looked through."""
    tle: str | None = None
    """File with two-line elements, beside the data or beside the map."""

    @model_validator(mode="after")
    def _one_magnetometer(self) -> Self:
        carriers = sum("mag" in entry.columns for entry in self.file)
        if carriers > 1 or (carriers == 0 and self.layout is None):
            raise ValueError(f"{carriers} [[file]] entries carry `mag`; exactly one must")
        names = [name for entry in self.file for name in entry.columns]
        doubled = sorted({name for name in names if names.count(name) > 1})
        if doubled:
            raise ValueError(f"{doubled[0]} comes from two [[file]] entries; give one of them")
        return self


def load_column_map(path: Path | str) -> ColumnMap:
    """Read and check a column map, or the packaged `preset:NAME`. Raises BadInput listing every fault."""
    if "\n" in str(path):
        raise BadInput("is the text of a map, not its file", where="--map", wanted="the path of a file with that text")
    return read_model(preset(path) or path, ColumnMap)


def preset(path: Path | str) -> Path | None:
    """The packaged map that `preset:NAME` means; None for a file. Raises BadInput for a name that is not there."""
    name = Path(path).name
    if not name.startswith(PRESET):
        return None
    name = name.removeprefix(PRESET)
    if name not in presets():
        raise BadInput(
            f"there is no preset {name[:40]!r}", where="--map", wanted=", ".join(PRESET + one for one in presets())
        )
    return PRESETS / f"{name}.toml"


def presets() -> list[str]:
    """The names of the packaged maps for the exports of common missions and units."""
    return sorted(path.stem for path in PRESETS.glob("*.toml"))


@cache
def packaged_layouts() -> dict[str, ColumnMap]:
    """The packaged maps by their names, without `.toml`."""
    return {path.stem: load_column_map(path) for path in sorted(LAYOUTS.glob("*.toml"))}


def recognised(path: Path | str) -> tuple[str, ColumnMap] | None:
    """Name and map of the one packaged layout that `path` has in every particular; None when there is none."""
    if not Path(path).name.lower().endswith((".nc", ".nc4", ".h5")):
        return None
    try:
        with NetcdfFile(path) as opened:
            fitting = [
                (name, column_map)
                for name, column_map in packaged_layouts().items()
                if column_map.layout is not None and _fits(opened, column_map.layout)
            ]
    except BadInput:  # damaged: the reader's own message is the better one
        return None
    return fitting[0] if len(fitting) == 1 else None


def _fits(opened: NetcdfFile, layout: Layout) -> bool:
    title = opened.attributes().get("title")
    if not (isinstance(title, str) and title.startswith(layout.title_begins)):
        return False
    if set(opened.names()) != set(layout.variables):
        return False
    rows = opened.shape("time")[0]
    for name, stated in layout.variables.items():
        units = opened.attributes(name).get("units")
        if name == "time" and isinstance(units, str):
            units = units.split(" since ")[0]
        shape = tuple(rows if size == "time" else size for size in stated.shape)
        if opened.shape(name) != shape or units != stated.units:
            return False
    return True


def mapped_table(
    path: Path | str | Table,
    column_map: Path | str | ColumnMap,
    *,
    tle: Path | str | None = None,
    max_samples: int = MAX_SAMPLES,
    any_order: bool = False,
) -> FileTable:
    """The columns of the foreign file or folder `path` under `column_map`, before they are a record.

    any_order: rows of a single source without attitude are let through as they come, for `check` to judge.
    """
    from fluxtwin.sim.telemetry.column_map_merge import merged_table

    if isinstance(column_map, ColumnMap):
        loaded, folder, name = column_map, Path("."), "column map"
    else:
        loaded, folder, name = load_column_map(column_map), Path(column_map).parent, Path(column_map).name
    if tle is None and loaded.tle is not None:
        beside = [*([] if isinstance(path, Table) else [_folder(Path(path))]), folder]
        tle = next((one / loaded.tle for one in beside if (one / loaded.tle).is_file()), beside[0] / loaded.tle)
    table = merged_table(
        path if isinstance(path, Table) else Path(path), loaded, tle=tle, max_samples=max_samples, any_order=any_order
    )
    table.provenance["column_map"] = name
    return table


def matches(path: Path, entry: FileEntry) -> list[Path]:
    """The files an entry names; a run of 42 is one. Raises BadInput when there is none."""
    if entry.path is None:
        if path.is_dir() and format_of(path) is None:
            raise BadInput("is a folder", where=str(path), wanted="`path` in every [[file]] of the column map")
        return [path]
    folder = _folder(path)
    if not folder.is_dir():
        raise BadInput("there is no such folder", where=str(folder))
    if Path(entry.path).is_absolute() or ".." in Path(entry.path).parts:
        raise BadInput(
            f"path {entry.path!r} leaves the folder", where="column map", wanted="a name or pattern inside it"
        )
    try:
        found = sorted(p for p in folder.glob(entry.path) if p.is_file())
    except ValueError as error:
        raise BadInput(f"path {entry.path!r}: {error}", where="column map", wanted="a name or pattern") from None
    if not found and not entry.optional:
        raise BadInput(f"no file matches {entry.path!r}", where=str(folder), wanted="the files the column map names")
    return found


def _folder(path: Path) -> Path:
    return path if path.is_dir() else path.parent


def _check_quantity(name: str, spec: ColumnSpec) -> None:
    quantity, family = BY_MAP_NAME.get(name), family_of(name)
    if quantity is None and family is None:
        raise ValueError(f"unknown quantity {name}; known: {', '.join(KNOWN)}")
    if family is not None and len(spec.names) != 1:
        raise ValueError(f"{name} takes one column")
    if family is not DRIVERS and spec.between is not None:
        raise ValueError(f"{name} takes no `between`: only a {DRIVERS.prefix}NAME does")
    accepted = quantity.map_units if quantity is not None else {}
    if accepted and spec.unit not in accepted:
        what = "has no unit" if spec.unit is None else f"has the unit {spec.unit!r}"
        raise ValueError(f"{name} {what}; accepted: {', '.join(accepted)}")
    if not accepted and family is not DRIVERS and name != "attitude" and spec.unit is not None:
        raise ValueError(f"{name} takes no unit")
    if name in ("position", "velocity") and spec.frame is None:
        raise ValueError(f"{name} wants frame: {', '.join(words.POSITIONS)}")
    vector = quantity is not None and quantity.components == 3
    if vector and isinstance(spec.source, list) and len(spec.source) not in (1, 3):
        raise ValueError(f"{name} takes three columns")
    column_map_values.check(name, spec, quantity)
    if name == "attitude":
        column_map_values.check_attitude(spec)
