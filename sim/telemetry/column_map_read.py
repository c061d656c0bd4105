"""Reading one source of a column map: its stamps and quantities in the record's units and axes."""

from __future__ import annotations

from collections.abc import MutableMapping
from dataclasses import dataclass, field
from fnmatch import fnmatchcase
from pathlib import Path

import numpy as np

from fluxtwin.sim.base.errors import BadInput, amount
from fluxtwin.sim.base.types import BoolArray, FloatArray, TimeArray
from fluxtwin.sim.earth import epoch
from fluxtwin.sim.earth.constants import EARTH_RATE_RAD_S
from fluxtwin.sim.earth.frames import rotation_from_N
from fluxtwin.sim.telemetry import column_map_values, time_stamps
from fluxtwin.sim.telemetry.column_map import ColumnSpec, FileEntry, TimeRecipe, matches
from fluxtwin.sim.telemetry.columns import clip
from fluxtwin.sim.telemetry.csv_files import CsvFile, open_csv
from fluxtwin.sim.telemetry.formats.catalogue import table_of
from fluxtwin.sim.telemetry.formats.table import Table
from fluxtwin.sim.telemetry.netcdf_files import NetcdfFile
from fluxtwin.sim.telemetry.quantities import BY_MAP_NAME, family_of
from fluxtwin.sim.telemetry.selection import STAMPS, Condition, condition

_NAMED = 3  # files in one notice; the others are counted


@dataclass
class Source:
    """One `[[file]]`, read: quantities in the record's units on the source's own stamps."""

    entry: FileEntry
    where: str
    time: TimeArray
    values: MutableMapping[str, FloatArray]
    """Quantity: (N, components)."""
    notices: list[str] = field(default_factory=list)
    digests: list[str] = field(default_factory=list)


def read_source(path: Path | Table, entry: FileEntry, max_samples: int) -> Source:
    """Read the file or files of one entry, or a table; rows without a stamp are left out and counted."""
    found = [path] if isinstance(path, Table) else matches(path, entry)
    parts = [_read_one(one, entry, max_samples) for one in found]
    source = parts[0]
    if not isinstance(path, Table) and Path(source.where) != path:  # one file of several, or several: which?
        source.notices[:] = _of_files(parts)
    if len(parts) > 1:
        source = Source(
            entry,
            f"{parts[0].where} and {len(parts) - 1} more",
            np.concatenate([part.time for part in parts]),
            {name: np.concatenate([part.values[name] for part in parts]) for name in parts[0].values},
            source.notices,
            [digest for part in parts for digest in part.digests],
        )
    keep = ~np.isnat(source.time)
    if not keep.all():
        lost = amount(int((~keep).sum()), "row without a time was|rows without a time were")
        source.notices.append(f"{Path(source.where).name}: {lost} left out")
        _cut(source, np.flatnonzero(keep))
    if entry.sort:
        _sort(source)
    if source.time.size == 0:
        what = "no row has a time" if entry.where is None else f"no row with a time is left where {entry.where}"
        raise BadInput(what, where=source.where, wanted="at least one")
    return source


def _of_files(parts: list[Source]) -> list[str]:
    """The notices of the files, each once with the names of those that it is about."""
    about: dict[str, list[str]] = {}
    for part in parts:
        for text in part.notices:
            about.setdefault(text, []).append(Path(part.where).name)
    more = {text: f" and {len(names) - _NAMED} more" if len(names) > _NAMED else "" for text, names in about.items()}
    return [f"{', '.join(names[:_NAMED])}{more[text]}: {text}" for text, names in about.items()]


def _read_one(path: Path | Table, entry: FileEntry, max_samples: int) -> Source:
    table = path if isinstance(path, Table) else table_of(path, max_samples, entry.sheet)
    if table is not None:
        return _source(_Reader(table.where, table.names(), table), entry, list(table.notices), table.sha256)
    assert not isinstance(path, Table)
    if path.name.lower().endswith((".nc", ".nc4", ".h5")):
        with NetcdfFile(path, max_samples=max_samples) as opened:
            known = opened.names()
            reader = _Reader(str(path), known, opened)
            return _source(reader, entry, [], opened.sha256)
    csv = open_csv(path, max_samples=max_samples)
    return _source(_Reader(str(path), list(csv.names), csv), entry, list(csv.notices), csv.sha256)


@dataclass
class _Reader:
    """The columns of a CSV or NetCDF file under one roof."""

    where: str
    known: list[str]
    file: CsvFile | NetcdfFile | Table
    taken: BoolArray | None = None
    """(N,) the rows that count; what stands in the others is missing, whatever it is."""

    def numbers(self, names: list[str]) -> FloatArray:
        """(N, k) of the named columns; one NetCDF variable may bring several components."""
        names = [self._named(name) for name in names]
        if isinstance(self.file, CsvFile):
            found = self.file.numbers(list(dict.fromkeys(names)))
            return self._blanked(np.stack([found[name] for name in names], axis=1), np.nan)
        parts = [self.file.numbers(name) for name in names]
        if any(part.ndim not in (1, 2) for part in parts) or len({part.shape[0] for part in parts}) > 1:
            raise BadInput(
                f"{clip(names[0])} does not have one row per sample", where=self.where, wanted="(time,) or (time, 3)"
            )
        return self._blanked(np.concatenate([part.reshape(len(part), -1) for part in parts], axis=1), np.nan)

    def lists(self, name: str) -> FloatArray:
        """(N, k) of one column: a variable of several components, or cells that hold a list."""
        name = self._named(name)
        if isinstance(self.file, CsvFile) or (
            isinstance(self.file, Table) and self.file.columns[name].dtype.kind == "S"
        ):
            text = self._blanked(self.file.text(name, width=column_map_values.LIST_BYTES), b"")
            return column_map_values.from_lists(text, name, self.where)
        return self.numbers([name])

    def choose(self, chosen: Condition, time: TimeArray | None) -> None:
        """Let only those rows count in which the condition holds."""
        values: dict[str, np.ndarray] = {}
        for name in chosen.columns:
            found = self.numbers([name])
            if found.shape[1] != 1:
                raise BadInput(
                    f"{clip(name)} has {found.shape[1]} components", where=f"{self.where}: where", wanted="one"
                )
            values[name] = found[:, 0]
        self.taken = chosen.rows(values if time is None else values | {STAMPS: time})

    def _blanked(self, value: np.ndarray, missing: object) -> np.ndarray:
        """A column with `missing` in the rows that do not count."""
        if self.taken is None:
            return value
        if len(value) != len(self.taken):
            raise BadInput(f"its columns have {len(value)} and {len(self.taken)} rows", where=self.where)
        value = value.copy()
        value[~self.taken] = missing
        return value

    def _named(self, name: str) -> str:
        """The column of that name, or the only one that the pattern `name` fits, whatever its case."""
        if name in self.known:
            return name
        fitting = [one for one in self.known if "*" in name and fnmatchcase(one.lower(), name.lower())]
        if len(fitting) == 1:
            return fitting[0]
        listed = ", ".join(clip(n) for n in (fitting or self.known)[:12])
        what = f"{clip(name)} fits {len(fitting)} columns: {listed}" if fitting else f"column {clip(name)} is missing"
        raise BadInput(what if fitting else f"{what}; the columns are: {listed}", where=self.where)

    def _written(self, recipe: TimeRecipe, notices: list[str]) -> TimeArray:
        """Stamps that the file has as such, in the recipe's time scale."""
        names = [self._named(name) for name in recipe.names]
        if recipe.recipe == "cf" and not isinstance(self.file, CsvFile):
            stamps = self._blanked(self.file.times(names[0]), np.datetime64("NaT", "ns"))
        elif recipe.recipe == "cf" or isinstance(self.file, NetcdfFile):
            raise BadInput(f"time recipe {recipe.recipe} does not fit this kind of file", where=self.where)
        else:
            text = self._blanked(time_stamps.joined(self.file.text, names), b"")
            if recipe.recipe == "iso":  # what states a zone of its own keeps it
                said = notices if recipe.scale is None else None
                return time_stamps.parse_iso(text, self.where, said, " and ".join(names), recipe.zone)
            stamps = time_stamps.parse_text(text, str(recipe.format), self.where)
        return time_stamps.utc_of_local(stamps, recipe.zone, self.where)

    def times(self, recipe: TimeRecipe, notices: list[str]) -> TimeArray:
        """UTC stamps by `recipe`; what was assumed of them goes to `notices`."""
        if recipe.recipe in time_stamps.TEXT:
            return epoch.utc_of(self._written(recipe, notices), recipe.scale or "UTC")
        raw = self.numbers(recipe.names)
        raw[np.isin(raw[:, 0], recipe.invalid), 0] = np.nan
        stamps, counted = time_stamps.stamps_of_counts(raw, recipe), np.isfinite(raw).all(axis=1)
        if counted.any():
            words = time_stamps.beyond if np.isnat(stamps[counted]).all() else time_stamps.in_1970
            if (said := words(raw[counted][0], recipe)) is not None:
                wanted = "the recipe that the stamps were made with (docs/telemetry.md)"
                raise BadInput(said, where=self.where, wanted=wanted)
        return time_stamps.utc_of_local(stamps, recipe.zone, self.where)


def _source(reader: _Reader, entry: FileEntry, notices: list[str], digest: str) -> Source:
    chosen = None if entry.where is None else condition(entry.where, "where")
    if chosen is not None and not chosen.timed:  # before the stamps: those of other rows may be none
        reader.choose(chosen, None)
    time = reader.times(entry.time, notices)
    if entry.time.offset_s:
        time = time + np.timedelta64(round(entry.time.offset_s * 1e9), "ns")
    if chosen is not None and chosen.timed:
        reader.choose(chosen, time)
    values = {}
    for name, spec in entry.columns.items():
        value = _quantity(reader, name, spec, entry.fill)
        if len(value) != len(time):
            raise BadInput(f"{name} has {amount(len(value), 'row|rows')}, time has {len(time)}", where=reader.where)
        values[name] = _to_N(name, spec, time, value)
    if "velocity" in values and entry.columns["velocity"].axes == "ITRS":
        if "position" not in values:
            raise BadInput("velocity in ITRS needs the position from the same file", where=reader.where)
        axis = rotation_from_N("ITRS", np.where(np.isnat(time), np.datetime64("2000-01-01"), time)).apply(
            [0.0, 0.0, EARTH_RATE_RAD_S], inverse=True
        )
        values["velocity"] = values["velocity"] + np.cross(axis, values["position"])
    notices += [text for name, spec in entry.columns.items() for text in spec.assumptions(name)]
    source = Source(entry, reader.where, time, values, notices, [digest])
    if chosen is not None and reader.taken is not None:
        rows = np.flatnonzero(reader.taken)
        notices.append(f"{rows.size} of {time.size} rows were taken, where {chosen.text}")
        _cut(source, rows)
    return source


def _quantity(reader: _Reader, name: str, spec: ColumnSpec, fill: list[float]) -> FloatArray:
    quantity = BY_MAP_NAME.get(name)
    wanted = 1 if family_of(name) is not None else quantity.components if quantity is not None else -1
    raw = reader.lists(spec.names[0]) if len(spec.names) == 1 and wanted not in (0, 1) else reader.numbers(spec.names)
    missing = column_map_values.missing(raw, spec, fill)
    for column, good in spec.valid.items():
        missing |= reader.numbers([column])[:, 0] != good
    if wanted in (1, 3) and raw.shape[1] != wanted:
        words = {1: "one", 3: "three"}[wanted]
        raise BadInput(f"{name} has {raw.shape[1]} components", where=reader.where, wanted=words)
    raw = np.array(raw)
    raw[missing] = np.nan
    value = column_map_values.in_units(raw, spec, quantity, reader.where)
    if spec.frame in column_map_values.PLACES:
        value = column_map_values.from_places(value, str(spec.frame), reader.where)
    if name in ("sun", "nadir"):
        size = np.linalg.norm(value, axis=1, keepdims=True)
        value = np.divide(value, size, out=np.full_like(value, np.nan), where=size > 0)
    if name == "attitude":
        value = column_map_values.quaternion(value, spec, reader.where)
    return np.array(value, dtype=np.float64)


def _to_N(name: str, spec: ColumnSpec, time: TimeArray, value: FloatArray) -> FloatArray:
    """Positions and velocities in GCRS axes."""
    if name not in ("position", "velocity") or spec.axes in (None, "GCRS"):
        return value
    good = np.flatnonzero(np.isfinite(value).all(axis=1) & ~np.isnat(time))
    turned = np.full_like(value, np.nan)
    if good.size:
        turned[good] = rotation_from_N(str(spec.axes), time[good]).apply(value[good], inverse=True)
    return turned


def _cut(source: Source, rows: np.ndarray) -> None:
    source.time = source.time[rows]
    source.values = {name: value[rows] for name, value in source.values.items()}


def _sort(source: Source) -> None:
    order = np.argsort(source.time, kind="stable")
    moved = int((order != np.arange(order.size)).sum())
    _cut(source, order)
    same = np.zeros(order.size, dtype=bool)
    same[1:] = np.diff(source.time.astype("int64")) == 0
    for value in source.values.values():
        same[1:] &= ((value[1:] == value[:-1]) | (np.isnan(value[1:]) & np.isnan(value[:-1]))).all(axis=1)
    _cut(source, np.flatnonzero(~same))
    if moved or same.any():
        source.notices.append(f"{Path(source.where).name}: sorted by time; {int(same.sum())} repeated rows dropped")


def require_increasing(source: Source) -> None:
    """Raises BadInput naming the first row whose stamp does not follow."""
    step = np.diff(source.time.astype("int64"))
    back = np.flatnonzero(step <= 0)
    if back.size:
        row = int(back[0])
        raise BadInput(
            f"time does not increase: row {row + 1} is {source.time[row]}, row {row + 2} is {source.time[row + 1]}",
            where=source.where,
            wanted="increasing stamps, or `sort = true` in this [[file]]",
        )
