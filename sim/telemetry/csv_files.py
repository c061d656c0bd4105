"""Telemetry as CSV: a strict front, then a fast parser; and a writer that loses nothing.

The front settles what a CSV parser would otherwise settle silently: encoding, delimiter, the number of fields of
every row, doubled columns, a last row that may be cut, numbers that are text or infinite. Only then do the bytes
go to the parser of numpy, which converts decimals exactly.
"""

from __future__ import annotations

import csv
import gzip
import hashlib
import io
import re
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from fluxtwin.sim.base.errors import BadInput, amount
from fluxtwin.sim.base.files import write_with
from fluxtwin.sim.base.limits import (
    MAX_COLUMNS,
    MAX_SAMPLES,
    TABLE_BYTES,
    Lines,
    content_of,
    require_expansion,
    require_rows,
)
from fluxtwin.sim.base.seals import FORMAT, require_format
from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.telemetry.columns import (
    TEXTS,
    FileTable,
    clip,
    file_columns,
    file_texts,
    resolve,
    texts_in,
    truths_in,
)
from fluxtwin.sim.telemetry.record import TEXT_BYTES, Telemetry
from fluxtwin.sim.telemetry.time_stamps import format_iso, parse_iso

CHECK = f"row_crc32_v{FORMAT}"
"""The last column of what fluxtwin writes: CRC-32 of the header and the row, without this column and its comma.

A column and not a comment, so that every reader takes the file, and rows may be sorted, cut or joined.
"""
_CHECKS = re.compile(r"row_crc32_v(\d{1,4})")
_CRC_BYTES = len(",01234567")
_MISSING = ["", "NaN", "nan", "NAN"]
_NUMBER = re.compile(r"\s*[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?\s*")
_BEGINS = re.compile(r"[+-]?\.?\d")
"""How numbers and stamps begin."""
_STAMP = re.compile(r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d(\.(\d{3}){1,3})?Z")
"""A stamp as `format_iso` writes it."""
_ROWS_AT_ONCE = 50_000
_OF_QUOTED = b"\x1f"
"""What stands between the cells of a table with quotes once these are off."""
_MARKS = {b";": "semicolons", b"\t": "tabs", b"|": "bars"}
_NO_DECIMAL_COMMA = re.compile(rb"\.\d{0,20},|,\d{0,20}[.,]|[^\d;\t|\n+ -],|,[^\d;\t|\neE ]")
"""Where a comma is no decimal comma: 1.234,5, 1,234,567, text."""
_DECIMAL_POINT = re.compile(rb"(?:^|[;\t|\n]) *[+-]?\d+\.\d+(?:[eE][+-]?\d+)? *(?=[;\t|\r\n]|$)")
"""A number with a point in a cell of its own: beside it 1,234 is as likely a thousand."""


@dataclass(frozen=True)
class CsvFile:
    """A CSV file that passed the front: names, rows of equal width, not yet numbers."""

    where: str
    names: tuple[str, ...]
    mark: bytes
    """Between two cells: a comma, or what no cell has where the file uses quotes."""
    body: bytes
    """Rows, LF line ends, without quotes."""
    rows: int
    sha256: str
    notices: tuple[str, ...]

    def text(self, name: str, width: int = TEXT_BYTES) -> np.ndarray:
        """One column as bytes (N,), cut at `width`."""
        place = self.names.index(name)
        rows = self.body.split(b"\n")[:-1]
        return np.array([row.split(self.mark, place + 1)[place] for row in rows], dtype=f"S{width}")

    def numbers(self, names: list[str]) -> dict[str, FloatArray]:
        """Columns as float64, blank and NaN missing; columns of nothing but true and false as 1 and 0.

        Raises BadInput naming the first cell that is no number.
        """
        if not names:
            return {}
        places, mark = [self.names.index(name) for name in names], self.mark.decode()
        opened = io.BytesIO(_without_blanks(self.body, self.mark))
        try:
            table = np.loadtxt(opened, delimiter=mark, comments=None, usecols=places, ndmin=2, encoding="latin1")
        except ValueError:
            truths = {name: said for name in names if (said := truths_in(self.text(name))) is not None}
            if truths:
                return truths | self.numbers([name for name in names if name not in truths])
            raise self._bad_cell(names) from None
        found = {name: np.ascontiguousarray(column) for name, column in zip(names, table.T, strict=True)}
        for name, value in found.items() if np.isinf(table).any() else ():
            rows = np.flatnonzero(np.isinf(value))
            if rows.size:
                raise BadInput(
                    f"{clip(name)} in row {rows[0] + 1} is infinite or too large for a number",
                    where=self.where,
                    wanted="finite numbers; blank or NaN where a value is missing",
                )
        return found

    def _bad_cell(self, names: list[str]) -> BadInput:
        for name in names:
            for row, raw in enumerate(self.text(name).tolist()):
                text = raw.decode("utf-8", "replace")
                if not _is_number(text):
                    return BadInput(
                        f"{clip(name)} in row {row + 1} is {clip(text, 30)!r}, which is no number",
                        where=self.where,
                        wanted="plain decimal numbers in every row below the header; blank or NaN where a value is missing",
                    )
        return BadInput("a number could not be read", where=self.where, wanted="plain decimal numbers")


def read_table(path: Path | str, *, max_samples: int = MAX_SAMPLES, others: Sequence[str] = ()) -> FileTable:
    """The contract columns of a CSV file, and `others` where it has them. BadInput names the file and the fault."""
    opened = open_csv(path, max_samples=max_samples)
    if "time" not in opened.names:
        listed = ", ".join(clip(name) for name in opened.names[:12])
        raise BadInput(
            f"column time is missing; the columns are: {listed}",
            where=opened.where,
            wanted="time (ISO 8601 UTC), or a column map (--map; `fluxtwin map` drafts one)",
        )
    found = resolve([name for name in opened.names if name not in TEXTS], opened.where)
    used = set(found.used)
    beside = [name for name in others if name in opened.names and name not in used]
    columns = opened.numbers([name for name in opened.names if name in used])
    notices = [*opened.notices, *found.notices]
    texts = {name: np.unique(opened.text(name)).tolist() for name in TEXTS if name in opened.names}
    stated = {key: text for key, text in texts_in(texts, opened.where).items() if text}
    return FileTable(
        where=opened.where,
        time=parse_iso(opened.text("time"), opened.where, notices),
        columns=columns,
        notices=notices,
        provenance={**stated, "source": Path(path).name, "sha256": opened.sha256},
        others=opened.numbers(beside),
    )


def write(telemetry: Telemetry, path: Path | str) -> Path:
    """Write the record as CSV (or .csv.gz) atomically; numbers read back bit-equal, NaN is a blank cell."""
    columns = file_columns(telemetry)
    compressed = str(path).endswith(".gz")

    def fill(temporary: Path) -> None:
        with open(temporary, "wb") as plain:
            if not compressed:
                _write_rows(plain, telemetry, columns)
                return
            with gzip.GzipFile(filename="", mode="wb", fileobj=plain, mtime=0, compresslevel=6) as packed:
                _write_rows(packed, telemetry, columns)

    return write_with(path, fill)


def open_csv(path: Path | str, *, max_samples: int = MAX_SAMPLES) -> CsvFile:
    """Read the bytes and pass them through the front. Raises BadInput; never a parser's own error."""
    where = str(path)
    look = Lines(max_samples, where)
    # `look` for the pieces of a file that may be packed; what is packed is looked at when it is unpacked.
    packed: list[bool] = []

    def shown(piece: bytes) -> None:
        packed.append(piece[:2] == b"\x1f\x8b") if not packed else None
        if not packed[0]:
            look(piece)

    content = content_of(path, most=TABLE_BYTES, wanted="a telemetry file (.csv, .csv.gz or .nc)", look=shown)
    if not content:
        raise BadInput("the file is empty", where=where, wanted="a header and at least one row of data")
    digest = hashlib.sha256(content).hexdigest()
    data = _decoded(_unpacked(content, look, where), where)
    notices: list[str] = []
    data, above = without_comments(data, notices)
    data = _with_commas(data, notices, where, above)
    head, _, body = data.partition(b"\n")
    names = _names(head, where)
    body = _whole_rows(body, notices, where)
    if any(map(_CHECKS.fullmatch, names)):
        names, body = _without_checks(head, names, body, where)
    mark = b","
    if b'"' in body:
        mark, body = _OF_QUOTED, _without_quotes(body, where)
    rows = _checked_rows(body, mark, len(names), max_samples, where)
    lines = io.BytesIO(body)  # shares the bytes, where splitting them would copy the file
    first, second = ([cell.decode("utf-8").strip() for cell in lines.readline().split(mark)] for _ in range(2))
    require_no_units(first, second, where)
    return CsvFile(where, names, mark, body, rows, digest, tuple(notices))


def _unpacked(content: bytes, look: Lines, where: str) -> bytes:
    """gzip undone in pieces, so that a bomb is refused before it is large."""
    if content[:2] != b"\x1f\x8b":
        return content
    pieces, size = [], 0
    try:
        with gzip.GzipFile(fileobj=io.BytesIO(content)) as packed:
            while piece := packed.read(1 << 20):
                size += len(piece)
                require_expansion(size, len(content), where)
                look(piece)
                pieces.append(piece)
    except (OSError, EOFError, zlib.error) as error:
        raise BadInput(f"the gzip data are damaged ({error})", where=where) from None
    return b"".join(pieces)


def _decoded(data: bytes, where: str) -> bytes:
    """UTF-8 without BOM, LF line ends."""
    if data[:2] in (b"\xff\xfe", b"\xfe\xff") or b"\0" in data[:4]:
        raise BadInput("is UTF-16", where=where, wanted="UTF-8 (save it again as CSV UTF-8)")
    data = data.removeprefix(b"\xef\xbb\xbf")
    if b"\0" in data:
        line = data.count(b"\n", 0, data.index(b"\0")) + 1
        raise BadInput(f"has a NUL byte in line {line}: the file is damaged or not text", where=where)
    if not data.isascii():
        try:
            data.decode("utf-8")
        except UnicodeDecodeError as error:
            line = data.count(b"\n", 0, error.start) + 1
            raise BadInput(
                f"is not UTF-8: byte 0x{data[error.start]:02X} in line {line}, as in latin-1 or Windows-1252",
                where=where,
                wanted="UTF-8 (save it again as CSV UTF-8)",
            ) from None
    data = data.replace(b"\r\n", b"\n")
    if b"\r" in data:
        line = data.count(b"\n", 0, data.index(b"\r")) + 1
        raise BadInput(f"has a bare carriage return in line {line}", where=where, wanted="LF or CRLF line ends")
    return data


def without_comments(data: bytes, notices: list[str]) -> tuple[bytes, int]:
    """The table below lines that begin with #, and how many were cut. Where a row of numbers follows, the last of them is
    the header, as numpy writes it."""
    starts, at = list[int](), 0
    while data.startswith(b"#", at) and (end := data.find(b"\n", at)) >= 0:
        starts.append(at)
        at = end + 1
    if not starts:
        return data, 0
    row = data[at : data.find(b"\n", at) + 1].strip()
    cells = re.split(rb"[,;\t|]" if re.search(rb"[,;\t|]", row) else rb" +", row)
    is_row = any(cell.strip() and _is_number(cell.decode("utf-8", "replace")) for cell in cells)
    lines = len(starts) - is_row
    if lines:
        said = amount(lines, "line above the header begins with # and was|lines above the header begin with # and were")
        notices.append(f"{said} skipped")
    return data[starts[-1] + 1 if is_row else at :], lines


def _with_commas(data: bytes, notices: list[str], where: str, above: int) -> bytes:
    """A table between semicolons, tabs, bars or blanks with commas and decimal points instead, and a notice of that.

    above: number of lines cut above it.
    """
    head, newline, rest = data.partition(b"\n")
    if head.lower().startswith(b"sep="):  # a spreadsheet's own first line
        data, (head, newline, rest) = rest, rest.partition(b"\n")
    mark, word = next(((mark, word) for mark, word in _MARKS.items() if mark in head), (b"", ""))
    if not mark and b"," not in head and b" " in head.strip() and b" " in rest.partition(b"\n")[0].strip():
        mark, word = b"\t", "blanks"
        head, newline, rest = _words_by_tabs(data, where, above).partition(b"\n")
    if not mark or b"," in head:
        return data
    if b'"' in data:
        raise BadInput(f"its columns are separated by {word}, and it has quotes", where=where, wanted="commas")
    said = f"its columns are separated by {word}"
    if b"," in rest:
        odd = _NO_DECIMAL_COMMA.search(rest) or _DECIMAL_POINT.search(rest)
        if odd is not None:
            line = above + rest.count(b"\n", 0, odd.end()) + 2
            cell = re.split(rb"[;\t|\n]", rest[max(odd.start() - 30, 0) : odd.end()])[-1].decode("utf-8", "replace")
            raise BadInput(
                f"{said}, there are commas in cells, and line {line} has {clip(cell, 30)!r}",
                where=where,
                wanted="all decimals as 1.5, or all as 1,5, and no marks between thousands",
            )
        rest, said = rest.replace(b",", b"."), f"{said}, decimals by commas"
    notices.append(said)
    return head.replace(mark, b",") + newline + rest.replace(mark, b",")


def _words_by_tabs(data: bytes, where: str, above: int) -> bytes:
    """A table between blanks, with tabs instead. Raises BadInput for a row of more or fewer words than the header."""
    rows = [b"\t".join(row.split()) for row in data.split(b"\n")]
    counts = [row.count(b"\t") + 1 for row in rows]
    odd = next((k for k, row in enumerate(rows[:-1]) if row and counts[k] != counts[0]), None)  # the last may be cut
    if odd is not None:
        raise BadInput(
            f"its columns are separated by blanks, and line {above + odd + 1} has {counts[odd]} words, "
            f"the header {counts[0]}",
            where=where,
            wanted="the header first (lines above it begin with #) and as many words in every line (none with a blank "
            "inside), or commas between columns",
        )
    return b"\n".join(rows)


def _names(head: bytes, where: str) -> tuple[str, ...]:
    text = head.decode("utf-8")
    if text.count(",") >= MAX_COLUMNS:
        raise BadInput(f"has more than {MAX_COLUMNS} columns", where=where)
    try:
        names = tuple(name.strip() for name in next(csv.reader([text], strict=True), []))
    except csv.Error as error:
        raise BadInput(f"the header cannot be split ({error})", where=where) from None
    if 2 * sum(_NUMBER.fullmatch(name) is not None for name in names) > len(names):
        raise BadInput(
            "has no header: its first line is a row of numbers",
            where=where,
            wanted="the names of the columns in the first line, with units, as time, r_x_km, mag_x_nT (docs/telemetry.md)",
        )
    if 2 * names.count("") > len(names):
        few = [clip(name) for name in names if name]
        raise BadInput(
            f"has no header: its first line names {len(few)} of {amount(len(names), 'column|columns')} ({', '.join(few)})",
            where=where,
            wanted="the names of all columns in the first line; a title above it begins with #, or is taken away",
        )
    doubled = sorted({name for name in names if name and names.count(name) > 1}) if len(set(names)) < len(names) else []
    if doubled:
        raise BadInput(f"column {clip(doubled[0])} is there twice", where=where, wanted="each once")
    return names


def _whole_rows(body: bytes, notices: list[str], where: str) -> bytes:
    if body and not body.endswith(b"\n"):
        body = body[: body.rfind(b"\n") + 1]
        notices.append("the last row has no line end and was left out (it may be cut)")
    if body.startswith(b"\n") or body.endswith(b"\n\n"):  # a copy only where there is something to cut
        body = body.rstrip(b"\n") + b"\n"
    if len(body) < 2:
        raise BadInput("there are no rows", where=where, wanted="a header and at least one row of data")
    return body


def _without_checks(head: bytes, names: tuple[str, ...], body: bytes, where: str) -> tuple[tuple[str, ...], bytes]:
    """Names and rows without the checks of the rows, which fit. Raises BadInput, for the first that does not."""
    found = next(filter(None, map(_CHECKS.fullmatch, names)))
    require_format(int(found[1]), where)
    rows = body.split(b"\n")
    rows.pop()
    cut = [row[:-_CRC_BYTES] for row in rows]
    start = zlib.crc32(head.rpartition(b",")[0])
    wrong = (k for k, row in enumerate(cut) if b",%08x" % zlib.crc32(row, start) != rows[k][-_CRC_BYTES:])
    first = 0 if names[-1] != CHECK else next(wrong, None)
    if first is not None:
        raise BadInput(
            f"row {first + 1} is not as fluxtwin wrote it: it does not agree with its column {found[0]}",
            where=where,
            wanted=f"the file as it was written; or, where the change was meant, the file without the column {found[0]}",
        )
    return names[:-1], b"\n".join([*cut, b""])


def _checked_rows(body: bytes, mark: bytes, width: int, max_samples: int, where: str) -> int:
    raw = np.frombuffer(body, dtype=np.uint8)
    ends = np.flatnonzero(raw == 10)
    require_rows(ends.size, max_samples, where)
    marks = np.flatnonzero(raw == ord(mark))
    wrong = np.flatnonzero(np.searchsorted(marks, ends) != np.arange(1, ends.size + 1) * (width - 1))
    if wrong.size:
        row = int(wrong[0])
        start = 0 if row == 0 else int(ends[row - 1]) + 1
        found = body.count(mark, start, ends[row]) + 1
        blank = int(ends[row]) == start
        what = "is blank" if blank else f"has {amount(found, 'field|fields')}, the header has {width}"
        raise BadInput(f"row {row + 1} {what}", where=where, wanted="as many fields in every row as in the header")
    return int(ends.size)


def require_no_units(first: Sequence[str], second: Sequence[str], where: str) -> None:
    """Raises BadInput for words in the row below the header where the next row has numbers, as a row of units."""
    if any(map(_BEGINS.match, first)) or all(
        _is_number(word) or not _BEGINS.match(number) for word, number in zip(first, second, strict=False)
    ):
        return
    raise BadInput(
        f"the row below the header has words where the others have numbers: {clip(', '.join(filter(None, first)))}",
        where=where,
        wanted="a file without that row; units may be part of the names, as mag_x_nT",
    )


def _without_quotes(body: bytes, where: str) -> bytes:
    """The rows with another mark between cells, which may then hold commas. Raises BadInput where quotes do not match."""
    try:
        cells = list(csv.reader(io.StringIO(body.decode("utf-8"), newline=""), strict=True))
    except csv.Error as error:
        raise BadInput(f"the quotes do not match ({error})", where=where) from None
    mark = _OF_QUOTED.decode()
    rows = [mark.join(re.sub(f"[{mark}\n]", " ", cell).strip() for cell in row) for row in cells]
    return "\n".join([*rows, ""]).encode("utf-8")


def _without_blanks(body: bytes, mark: bytes) -> bytes:
    """With nan in blank cells, which the parser does not take."""
    body = b"\n" + body
    for before, after in ((mark, mark), (mark, b"\n"), (b"\n", mark), (b"\n", b"\n")):
        while before + after in body:
            body = body.replace(before + after, before + b"nan" + after)
    return body[1:]


def _is_number(text: str) -> bool:
    return text.strip() in _MISSING or _NUMBER.fullmatch(text) is not None


def _write_rows(out: Any, telemetry: Telemetry, columns: dict[str, FloatArray]) -> None:
    texts = file_texts(telemetry)
    head = ",".join(["time", *columns, *texts]).encode("utf-8")
    out.write(head + f",{CHECK}\n".encode())
    start = zlib.crc32(head)
    stamps = format_iso(telemetry.time)
    for first in range(0, len(telemetry), _ROWS_AT_ONCE):
        part = slice(first, first + _ROWS_AT_ONCE)
        cells = [stamps[part]] + [
            ["" if x != x else repr(x) for x in value[part].tolist()] for value in columns.values()
        ]
        cells += [[text] * len(cells[0]) for text in texts.values()]
        rows = [row.encode("utf-8") for row in map(",".join, zip(*cells, strict=True))]
        out.write(b"".join(b"%b,%08x\n" % (row, zlib.crc32(row, start)) for row in rows))
