"""Which rows of telemetry are taken: from, to, and a condition on columns, as `sunlit == 1 and temperature_degC < 10`.

A condition is read by a grammar of its own and never evaluated as Python:

    condition   = all-of { "or" all-of }
    all-of      = comparison { "and" comparison }
    comparison  = "(" condition ")" | side sign side          one side is a column, the other a number
    sign        = "==" | "!=" | "<" | "<=" | ">" | ">="
"""

from __future__ import annotations

import operator
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from fluxtwin.sim.base.errors import BadInput
from fluxtwin.sim.base.types import BoolArray, FloatArray, TimeArray
from fluxtwin.sim.earth import epoch
from fluxtwin.sim.telemetry.columns import FileTable, clip, file_columns
from fluxtwin.sim.telemetry.record import Telemetry

_LONGEST, _DEEPEST = 500, 20
_SIGNS: dict[str, Callable[[FloatArray, float], BoolArray]] = {
    "==": operator.eq,
    "!=": operator.ne,
    "<=": operator.le,
    ">=": operator.ge,
    "<": operator.lt,
    ">": operator.gt,
}
_MIRRORED = {"<": ">", ">": "<", "<=": ">=", ">=": "<="}
_TOKEN = re.compile(
    r"\s*(?:(?P<number>[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)(?![\w.])|(?P<sign>==|!=|<=|>=|<|>)"
    r"|(?P<mark>[()])|(?P<name>[A-Za-z_][\w.]*)|\"(?P<quoted>[^\"]+)\")"
)
_EXAMPLE = "comparisons of a column with a number, joined by `and` or `or`, as 'sunlit == 1 and temperature_degC < 10'"

Rows = Callable[[Mapping[str, FloatArray]], BoolArray]


@dataclass(frozen=True)
class Condition:
    """A condition on columns: which ones, and the rows in which it holds. A missing value fulfils no comparison."""

    text: str
    columns: tuple[str, ...]
    rows: Rows


@dataclass(frozen=True)
class Selection:
    """Rows from `start` (inclusive) to `end` (exclusive) in which the condition holds; None: no limit."""

    start: np.datetime64 | None = None
    end: np.datetime64 | None = None
    condition: Condition | None = None

    @property
    def columns(self) -> tuple[str, ...]:
        """The columns that the condition asks for."""
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
            taken &= self.condition.rows(columns)
        if not taken.any():
            span = f"; the file reaches from {epoch.iso(time.min())} to {epoch.iso(time.max())}" if time.size else ""
            raise BadInput(f"no row is left {self.words}{span}", where=where, wanted="a wider selection")
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
    start: np.datetime64 | str | None = None, end: np.datetime64 | str | None = None, where: str | None = None
) -> Selection:
    """The selection of rows from `start` (inclusive) to `end` (exclusive), ISO 8601 UTC, in which `where` holds.

    Raises BadInput for text that is no time or no condition, and where nothing can lie between start and end.
    """
    begin, until = _instant(start, "--from"), _instant(end, "--to")
    if begin is not None and until is not None and until <= begin:
        raise BadInput("is not after --from", where=f"--to {epoch.iso(until)}", wanted="a later time")
    return Selection(begin, until, None if where is None else condition(where))


def selected(
    record: Telemetry,
    start: np.datetime64 | str | None = None,
    end: np.datetime64 | str | None = None,
    where: str | None = None,
) -> Telemetry:
    """The record cut as a file is on reading; the condition takes the columns that the record's file would have."""
    chosen = selection(start, end, where)
    if not chosen.words:
        return record
    columns = file_columns(record) if chosen.condition is not None else {}
    return record.select(chosen.rows(record.time, columns, "the record"))


def condition(text: str) -> Condition:
    """The condition that `text` states. Raises BadInput that says where the text stops to be one."""
    if len(text) > _LONGEST:
        raise BadInput(f"has {len(text)} characters", where="--where", wanted=f"at most {_LONGEST}")
    reader = _Reader(text)
    rows = reader.any_of(0)
    if reader.place < len(reader.tokens):
        raise reader.stopped("`and` or `or`")
    return Condition(" ".join(text.split()), tuple(dict.fromkeys(reader.columns)), rows)


def _instant(given: np.datetime64 | str | None, where: str) -> np.datetime64 | None:
    if isinstance(given, str):
        return epoch.parse_time(given, where=where)
    return None if given is None else given.astype("datetime64[ns]")


class _Reader:
    """The words of one condition, read from left to right."""

    def __init__(self, text: str) -> None:
        self.text, self.place = text, 0
        self.columns: list[str] = []
        self.tokens: list[tuple[str, str]] = []
        at, end = 0, len(text.rstrip())
        while at < end:
            match = _TOKEN.match(text, at)
            if match is None:
                raise BadInput(f"cannot read {clip(text[at:].strip(), 20)!r}", where="--where", wanted=_EXAMPLE)
            kind = str(match.lastgroup)
            self.tokens.append((kind, match[kind]))
            at = match.end()

    def any_of(self, depth: int) -> Rows:
        parts = self._joined("or", lambda: self._all_of(depth))
        return lambda columns: np.logical_or.reduce([part(columns) for part in parts])

    def _all_of(self, depth: int) -> Rows:
        parts = self._joined("and", lambda: self._comparison(depth))
        return lambda columns: np.logical_and.reduce([part(columns) for part in parts])

    def _joined(self, word: str, part: Callable[[], Rows]) -> list[Rows]:
        parts = [part()]
        while self._peek() == ("name", word):
            self.place += 1
            parts.append(part())
        return parts

    def _comparison(self, depth: int) -> Rows:
        if depth > _DEEPEST:
            raise BadInput("has too many brackets", where="--where", wanted=_EXAMPLE)
        if self._peek() == ("mark", "("):
            self.place += 1
            inner = self.any_of(depth + 1)
            self._take("mark", "a closing bracket", ")")
            return inner
        kind = self._peek()[0]
        if kind == "number":
            number = float(self._take("number", "a number"))
            sign = self._take("sign", "== != < <= > >=")
            name = self._column()
            sign = _MIRRORED.get(sign, sign)
        else:
            name = self._column()
            sign = self._take("sign", "== != < <= > >=")
            number = float(self._take("number", "a number"))
        compare = _SIGNS[sign]
        return lambda columns: compare(columns[name], number) & ~np.isnan(columns[name])

    def _column(self) -> str:
        kind, word = self._peek()
        if kind not in ("name", "quoted") or (kind == "name" and word in ("and", "or")):
            raise self.stopped("the name of a column")
        self.place += 1
        self.columns.append(word)
        return word

    def _take(self, kind: str, wanted: str, word: str | None = None) -> str:
        found = self._peek()
        if found[0] != kind or (word is not None and found[1] != word):
            raise self.stopped(wanted)
        self.place += 1
        return found[1]

    def _peek(self) -> tuple[str, str]:
        return self.tokens[self.place] if self.place < len(self.tokens) else ("end", "")

    def stopped(self, wanted: str) -> BadInput:
        kind, word = self._peek()
        found = "it ends" if kind == "end" else f"stands {clip(word, 20)!r}"
        return BadInput(f"where {wanted} should stand, {found}", where=f"--where {clip(self.text)!r}", wanted=_EXAMPLE)
