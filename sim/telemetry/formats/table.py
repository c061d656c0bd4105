"""A table of named columns in memory: what every format but CSV and NetCDF is read into."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from fluxtwin.sim.base import limits
from fluxtwin.sim.base.errors import BadInput
from fluxtwin.sim.base.types import FloatArray, TimeArray
from fluxtwin.sim.telemetry.columns import TEXTS, FileTable, clip, resolve, texts_in, truths_in
from fluxtwin.sim.telemetry.quantities import DRIVERS, QUANTITIES
from fluxtwin.sim.telemetry.time_stamps import parse_iso

_XYZ = ("x", "y", "z", "w")


@dataclass
class Table:
    """Columns by name: float64 (N,) or (N, k), datetime64[ns] (N,) in UTC, or text as bytes (N,)."""

    where: str
    """The file, for messages."""
    columns: dict[str, np.ndarray]
    units: dict[str, str] = field(default_factory=dict)
    """By column, where the format states them."""
    attributes: dict[str, str] = field(default_factory=dict)
    """What the file says of itself."""
    notices: list[str] = field(default_factory=list)
    sha256: str = ""

    def names(self) -> list[str]:
        return list(self.columns)

    def numbers(self, name: str) -> FloatArray:
        """A column as float64, (N,) or (N, k). Raises BadInput where it holds none."""
        value = self.columns[name]
        if value.dtype.kind == "S":
            found, cell = list[float](), b""
            try:
                for cell in value.tolist():
                    found.append(float(cell) if cell.strip() else np.nan)
            except ValueError:
                if (truths := truths_in(value)) is not None:
                    return truths
                text = clip(cell.decode("utf-8", "replace"), 30)
                raise BadInput(
                    f"{clip(name)} in row {len(found) + 1} is {text!r}, which is no number",
                    where=self.where,
                    wanted="numbers; blank or NaN where a value is missing",
                ) from None
            return np.array(found)
        if value.dtype.kind == "M":
            raise BadInput(f"{clip(name)} holds stamps, no numbers", where=self.where, wanted="a numeric column")
        out = np.asarray(value, dtype=np.float64)
        if np.isinf(out).any():
            raise BadInput(f"{clip(name)} has infinite values", where=self.where, wanted="finite numbers or NaN")
        return out

    def text(self, name: str, width: int = 0) -> np.ndarray:
        """A column of text as bytes (N,); `width` is for files that have to cut it."""
        value = self.columns[name]
        if value.dtype.kind != "S":
            raise BadInput(f"{clip(name)} holds no text", where=self.where, wanted="a column of text")
        return value

    def times(self, name: str = "time") -> TimeArray:
        """A column of stamps, UTC."""
        value = self.columns[name]
        if value.dtype.kind == "M":
            return value.astype("datetime64[ns]")
        if value.dtype.kind == "S":
            return parse_iso(value, self.where, self.notices, name)
        raise BadInput(
            f"{clip(name)} holds numbers, no stamps", where=self.where, wanted="stamps, or a column map (--map)"
        )

    def described(self, name: str) -> str:
        """Name, shape and unit for a message."""
        shape = self.columns[name].shape
        unit = self.units.get(name, "")
        return name + (f" {shape}" if len(shape) != 1 else "") + (f" [{unit}]" if unit else "")


def contract(table: Table, others: Sequence[str] = ()) -> FileTable:
    """The columns of a record in a table: as `mag_x_nT`, or `mag_x` or a variable `mag` (N, 3) that states its unit nT.

    Raises BadInput as for a CSV, with what is missing.
    """
    spread = _spread(table)
    if "time" not in table.columns:
        listed = ", ".join(clip(table.described(name)) for name in table.names()[:12])
        raise BadInput(
            f"column time is missing; the columns are: {listed or 'none'}",
            where=table.where,
            wanted="time, or a column map (--map; `fluxtwin map` drafts one)",
        )
    described = {new: table.described(old) for new, (old, _) in spread.items()}
    texts = [column for column in TEXTS if column in spread and table.columns[column].dtype.kind == "S"]
    found = resolve([name for name in spread if name not in texts], table.where, described)
    beside = [name for name in others if name in spread and name not in found.used]
    columns = {name: _one(table, *spread[name]) for name in (*found.used, *beside)}
    time = table.times()
    for name, value in columns.items():
        if value.shape != time.shape:
            raise BadInput(f"{name} has the shape {value.shape}, time has {time.shape}", where=table.where)
    stated = table.attributes | texts_in({column: table.columns[column].tolist() for column in texts}, table.where)
    stated |= {"source": Path(table.where).name, "sha256": table.sha256}
    return FileTable(
        where=table.where,
        time=time,
        columns={name: columns[name] for name in found.used},
        notices=[*table.notices, *found.notices],
        provenance={key: text for key, text in stated.items() if text},
        units={
            name: table.units[name] for name in found.named[DRIVERS.field].values() if table.units.get(name, "1") != "1"
        },
        others={name: columns[name] for name in beside},
    )


def _spread(table: Table) -> dict[str, tuple[str, int | None]]:
    """Contract names of all columns: a stated unit goes to the end of the name, components become columns."""
    stems = {stem for quantity in QUANTITIES for stem in quantity.stems}
    fields = {quantity.name: quantity for quantity in QUANTITIES}
    out: dict[str, tuple[str, int | None]] = {}
    for name, value in table.columns.items():
        unit = table.units.get(name, "").replace("/", "_").replace(" ", "")
        if name in fields and value.ndim == 2 and value.shape[1] == len(fields[name].stems):
            out |= {column: (name, k) for k, column in enumerate(fields[name].plain)}
        elif name in fields and value.ndim == 1 and len(fields[name].stems) == 1:
            out[fields[name].plain[0]] = (name, None)
        elif value.ndim == 2 and f"{name}_x" in stems and value.shape[1] <= len(_XYZ):
            out |= {_with(f"{name}_{axis}", unit): (name, k) for k, axis in enumerate(_XYZ[: value.shape[1]])}
        elif value.ndim == 1:
            out[_with(name, unit) if name in stems else name] = (name, None)
    return {name: place for name, place in out.items() if name != "time"}


def _with(stem: str, unit: str) -> str:
    return f"{stem}_{unit}" if unit and unit != "1" else stem


def _one(table: Table, name: str, component: int | None) -> FloatArray:
    value = table.numbers(name)
    return value if component is None else np.asarray(value[:, component])


def in_ns(stamps: np.ndarray, name: str, where: str) -> TimeArray:
    """Stamps (N,) of any unit as datetime64[ns]. Raises BadInput for one beyond its years, which numpy may wrap."""
    years = stamps.astype("datetime64[Y]").astype(np.int64) + 1970
    wrong = np.flatnonzero(~np.isnat(stamps) & ((years < 1678) | (years > 2261)))
    if wrong.size:
        stamp = np.datetime_as_string(stamps[wrong[0]], unit="D")
        raise BadInput(f"{clip(name)} in row {wrong[0] + 1} is {stamp}", where=where, wanted="years 1678 to 2261")
    return stamps.astype("datetime64[ns]")


def content_of(path: Path, look: Callable[[bytes], None] | None = None) -> tuple[bytes, str]:
    """The bytes of a file and their SHA-256. look: as of `limits.content_of`. Raises BadInput where it cannot be read."""
    content = limits.content_of(path, most=limits.TABLE_BYTES, wanted="a file of telemetry", look=look)
    if not content:
        raise BadInput("the file is empty", where=str(path), wanted="telemetry")
    return content, hashlib.sha256(content).hexdigest()


def extra(package: str, name: str, path: Path | str) -> Any:
    """The optional package, imported. Raises BadInput that says how to install it, as `fluxtwin[NAME]`."""
    import importlib

    try:
        return importlib.import_module(package)
    except ImportError:
        wanted = f"pip install 'fluxtwin[{name}]'"
        raise BadInput(f"to read or write it the package {package} is needed", where=str(path), wanted=wanted) from None
