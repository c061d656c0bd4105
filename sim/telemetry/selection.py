"""Which rows of telemetry are taken: from, to, and a condition on columns, as `sunlit == 1 and temperature_degC < 10`.

A condition is comparisons of a column with a number, or of `time` with a quoted instant, joined by `and`, `or` and
brackets. Python's parser reads it; nothing of it is ever evaluated as Python, and whatever else the parser knows is
refused.
"""

from __future__ import annotations

import ast
import operator
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from datetime import UTC, date, datetime
from typing import Any

import numpy as np

from fluxtwin.sim.base.errors import BadInput
from fluxtwin.sim.base.types import BoolArray, FloatArray, TimeArray
from fluxtwin.sim.earth import epoch
from fluxtwin.sim.telemetry.columns import FileTable, clip, file_columns
from fluxtwin.sim.telemetry.record import Telemetry

_LONGEST, _DEEPEST = 500, 20
_SIGNS: dict[type[ast.cmpop], Callable[[Any, Any], BoolArray]] = {
    ast.Eq: operator.eq,
    ast.NotEq: operator.ne,
    ast.LtE: operator.le,
    ast.GtE: operator.ge,
    ast.Lt: operator.lt,
    ast.Gt: operator.gt,
}
_MIRRORED: dict[type[ast.cmpop], type[ast.cmpop]] = {ast.Lt: ast.Gt, ast.Gt: ast.Lt, ast.LtE: ast.GtE, ast.GtE: ast.LtE}
_NUMBER = re.compile(r"[+-]?\s*(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?")
_EXAMPLE = "comparisons of a column with a number, joined by `and` or `or`, as 'sunlit == 1 and temperature_degC < 10'"


class NoneTaken(BadInput):
    """No row is taken."""


STAMPS = "\0time"
"""Key of the rows' stamps among the values of a condition; no column is called so."""
Rows = Callable[[Mapping[str, np.ndarray]], BoolArray]


@dataclass(frozen=True)
class Condition:
    """A condition on columns: which ones, and the rows in which it holds. A missing value fulfils no comparison."""

    text: str
    columns: tuple[str, ...]
    rows: Rows
    timed: bool = False
    """Whether it compares the stamps, which `rows` then takes under `STAMPS`."""


@dataclass(frozen=True)
class Selection:
    """Rows from `start` (inclusive) to `end` (exclusive) in which the condition holds; None: no limit."""

    start: np.datetime64 | None = None
    end: np.datetime64 | None = None
    condition: Condition | None = None

    @property
    def columns(self) -> tuple[str, ...]:
        return () if self.condition is None else self.condition.columns

    @property
    def words(self) -> str:
        """The selection in words; empty where everything is taken."""
        parts = [f"from {epoch.iso(self.start)}"] if self.start is not None else []
        parts += [f"to {epoch.iso(self.end)}"] if self.end is not None else []
        parts += [f"where {self.condition.text}"] if self.condition is not None else []
        return " ".join(parts)

    def rows(self, time: TimeArray, columns: Mapping[str, FloatArray], where: str) -> BoolArray:
        """(N,) True in the rows that are taken. Raises BadInput for a column that is not there, or when none is taken."""
        taken: BoolArray = np.ones(time.size, dtype=np.bool_)
        if self.start is not None:
            taken &= time >= self.start
        if self.end is not None:
            taken &= time < self.end
        if self.condition is not None:
            missing = [name for name in self.columns if name not in columns]
            if missing:
                listed = ", ".join(clip(name) for name in list(columns)[:40])
                raise BadInput(f"{where} has no column {clip(missing[0])}", where="--where", wanted=f"one of {listed}")
            taken &= self.condition.rows({**columns, STAMPS: time})
        if not taken.any():
            span = f"; the file reaches from {epoch.iso(time.min())} to {epoch.iso(time.max())}" if time.size else ""
            raise NoneTaken(f"no row is left {self.words}{span}", where=where, wanted="a wider selection")
        return taken

    def cut(self, table: FileTable) -> FileTable:
        """The table with the rows that are taken, and a notice of how many these are."""
        if not self.words:
            return table
        taken = self.rows(table.time, {**table.columns, **table.others}, table.where)
        return replace(
            table,
            time=table.time[taken],
            columns={name: value[taken] for name, value in table.columns.items()},
            others={},
            notices=[*table.notices, f"{int(taken.sum())} of {taken.size} rows were taken, {self.words}"],
        )


def selection(
    start: np.datetime64 | date | str | None = None,
    end: np.datetime64 | date | str | None = None,
    where: str | None = None,
    names: tuple[str, str, str] = ("--from", "--to", "--where"),
) -> Selection:
    """The selection of rows from `start` (inclusive) to `end` (exclusive), ISO 8601 UTC, in which `where` holds.

    names: of the three, for messages. Raises BadInput for text that is no time or no condition, and where nothing can lie
    between start and end.
    """
    begin = None if start is None else instant(start, names[0])
    until = None if end is None else instant(end, names[1])
    if begin is not None and until is not None and until <= begin:
        raise BadInput(f"is not after {names[0]}", where=f"{names[1]} {epoch.iso(until)}", wanted="a later time")
    return Selection(begin, until, None if where is None else condition(where, names[2]))


def selected(
    record: Telemetry,
    start: np.datetime64 | date | str | None = None,
    end: np.datetime64 | date | str | None = None,
    where: str | None = None,
) -> Telemetry:
    """The record cut as a file is on reading; the condition takes the columns that the record's file would have."""
    chosen = selection(start, end, where, ("start", "end", "where"))
    if not chosen.words:
        return record
    columns = file_columns(record) if chosen.condition is not None else {}
    return record.select(chosen.rows(record.time, columns, "the record"))


def condition(text: str, place: str = "--where") -> Condition:
    """The condition that `text` states. Raises BadInput, with the place where it was given and the part that is none."""
    if not isinstance(text, str):
        raise BadInput(f"{clip(repr(text))} is not text", where=place, wanted=_EXAMPLE)
    if len(text) > _LONGEST:
        raise BadInput(f"has {len(text)} characters", where=place, wanted=f"at most {_LONGEST}")
    if text.count("(") > _DEEPEST:
        raise BadInput("has too many brackets", where=place, wanted=_EXAMPLE)
    text = " ".join(text.split())
    try:
        tree = ast.parse(text, mode="eval").body
    except (SyntaxError, ValueError) as error:
        said = getattr(error, "msg", str(error))
        raise BadInput(f"cannot be read ({said})", where=f"{place} {clip(text)!r}", wanted=_EXAMPLE) from None
    columns: list[str] = []
    rows = _rows(tree, text, columns, place)
    named = tuple(name for name in dict.fromkeys(columns) if name != STAMPS)
    return Condition(text, named, rows, STAMPS in columns)


def _rows(part: ast.expr, text: str, columns: list[str], place: str) -> Rows:
    """The rows in which a part of the condition holds; its columns go to `columns`. Raises BadInput for another part."""
    if isinstance(part, ast.BoolOp):
        join = np.logical_and if isinstance(part.op, ast.And) else np.logical_or
        parts = [_rows(one, text, columns, place) for one in part.values]
        return lambda values: join.reduce([one(values) for one in parts])
    if isinstance(part, ast.Compare) and len(part.ops) == 1:
        sign, left, right = type(part.ops[0]), part.left, part.comparators[0]
        if _number(text, left) is not None or (_name(text, right) == "time" and _quoted(left) is not None):
            sign, left, right = _MIRRORED.get(sign, sign), right, left
        name, number = _name(text, left), _number(text, right)
        if name is not None and number is not None and sign in _SIGNS:
            columns.append(name)
            return lambda values: _SIGNS[sign](values[name], number) & ~np.isnan(values[name])
        if name == "time" and _quoted(right) is not None and sign in _SIGNS:
            instant = epoch.parse_time(str(_quoted(right)), where=f"{place} {clip(text)!r}")
            columns.append(STAMPS)
            return lambda values: _SIGNS[sign](values[STAMPS], instant) & ~np.isnat(values[STAMPS])
    said = clip(str(ast.get_source_segment(text, part)), 40)
    raise BadInput(f"{said!r} compares no column with a number", where=f"{place} {clip(text)!r}", wanted=_EXAMPLE)


def _name(text: str, side: ast.expr) -> str | None:
    """The column that a side names: plainly, with dots, or in quotes."""
    if isinstance(side, ast.Constant):
        return side.value if isinstance(side.value, str) else None
    said = ast.get_source_segment(text, side) or ""
    return said if isinstance(side, ast.Name | ast.Attribute) and re.fullmatch(r"[\w.]+", said) else None


def _quoted(side: ast.expr) -> str | None:
    return side.value if isinstance(side, ast.Constant) and isinstance(side.value, str) else None


def _number(text: str, side: ast.expr) -> float | None:
    said = ast.get_source_segment(text, side) or ""
    return float(said.replace(" ", "")) if _NUMBER.fullmatch(said) else None


def instant(given: np.datetime64 | date | str, where: str) -> np.datetime64:
    """One instant in UTC; what has a zone is taken to UTC. Raises BadInput for what is no time."""
    if isinstance(given, datetime):  # a Timestamp of pandas is one
        given = (given if given.tzinfo is None else given.astimezone(UTC).replace(tzinfo=None)).isoformat()
    if isinstance(given, date):
        given = given.isoformat()  # its midnight
    if isinstance(given, str):
        return epoch.parse_time(given, where=where)
    if isinstance(given, np.datetime64):
        moment: np.datetime64 = given.astype("datetime64[ns]")
        return moment
    raise BadInput(
        f"{clip(repr(given))} is no time", where=where, wanted="ISO 8601 text, a date, a datetime or a datetime64"
    )
