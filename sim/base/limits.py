"""What is read of a foreign file at most, decided in one place, and the one way to its bytes.

A file must not fill the memory, nor hold up for ever: its size, its lines and what it claims to unpack to are looked at
before they are read, a device is refused, and a pipe is waited for only while somebody writes into it.
"""

from __future__ import annotations

import os
import select
import stat
import time
from collections.abc import Callable, Iterator
from pathlib import Path

from fluxtwin.sim.base.errors import BadInput

MAX_SAMPLES = 5_000_000
"""Default limit of rows: five times the largest record the project is built for."""
MAX_COLUMNS = 5_000
TEXT_BYTES = 1_000_000
"""A file that people write: a scenario, a calibration, a column map, two-line elements."""
TOML_ITEMS = 50_000
"""Values and brackets of a TOML file, and `TOML_DEPTH` the parts of a key: the parser takes 0.2 s for as many."""
TOML_DEPTH = 16
TABLE_BYTES = 4 * 1024**3
MODEL_BYTES = 100_000_000
"""A field model in a file of its own; the largest CHAOS file has 10 MB."""
LINE_BYTES = 1_000_000
"""`MAX_COLUMNS` numbers of 17 digits, ten times over."""
_EXPANSION, _FREE_BYTES = 200, 100_000_000
"""A file unpacks to no more than 200 times its size, where that is more than 0.1 GB. Noisy telemetry packs 2 to 20 times."""
_PATIENCE_S = 2.0  # with a pipe into which nobody writes
_PIECE = 1 << 20


def content_of(path: Path | str, *, most: int, wanted: str, look: Callable[[bytes], None] | None = None) -> bytes:
    """The bytes of a file or a pipe.

    most: bytes. wanted: what the file should be, for the messages. look: is shown each piece before the next is read, and
    may raise BadInput. Raises BadInput for a folder, a device, a missing or too large file, a pipe into which nobody writes.
    """
    where = str(path)
    try:
        handle = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0))
        with open(handle, "rb", buffering=0) as opened:
            found = os.fstat(handle)
            require_kind(found, where, wanted)
            if found.st_size > most:
                raise _too_large(most, where, wanted)
            is_pipe = stat.S_ISFIFO(found.st_mode)
            if look is None and not is_pipe:
                return opened.read(most + 1) if found.st_size == 0 else opened.readall()
            pieces, size = [], 0
            for piece in _of_pipe(handle, where) if is_pipe else iter(lambda: opened.read(_PIECE), b""):
                size += len(piece)
                if size > most:
                    raise _too_large(most, where, wanted)
                if look is not None:
                    look(piece)
                if is_pipe:
                    pieces.append(piece)
            if is_pipe:
                return b"".join(pieces)
            opened.seek(0)  # once more: pieces and their sum would take twice the memory
            return opened.readall()
    except IsADirectoryError:
        raise BadInput("is a folder", where=where, wanted=wanted) from None
    except FileNotFoundError:
        raise BadInput("there is no such file", where=where, wanted=wanted) from None
    except OSError as error:
        raise BadInput(f"cannot be read ({error.strerror or error})", where=where) from None


def text_of(path: Path | str, *, wanted: str) -> str:
    """A small file as UTF-8 text, without the byte order mark. Raises BadInput as `content_of`, and where it is no text."""
    try:
        return content_of(path, most=TEXT_BYTES, wanted=wanted).decode("utf-8-sig")
    except UnicodeDecodeError:
        raise BadInput("is not UTF-8 text", where=str(path), wanted=wanted) from None


def require_kind(found: os.stat_result, where: str, wanted: str, *, pipe: bool = True) -> None:
    """Raises BadInput for a folder, a device, a socket; and for a pipe, where the reader has to move about in the file."""
    if stat.S_ISDIR(found.st_mode):
        raise BadInput("is a folder", where=where, wanted=wanted)
    if stat.S_ISREG(found.st_mode) or (pipe and stat.S_ISFIFO(found.st_mode)):
        return
    raise BadInput("is a pipe" if stat.S_ISFIFO(found.st_mode) else "is a device", where=where, wanted=wanted)


def require_expansion(unpacked: float, packed: int, where: str) -> None:
    """Raises BadInput where a file of `packed` bytes claims `unpacked` ones: small on the disk may be large in memory."""
    most = max(_FREE_BYTES, _EXPANSION * packed)
    if unpacked > most:
        raise BadInput(
            f"unpacks to {unpacked / 1e6:.3g} MB or more, from {packed / 1e6:.3g} MB",
            where=where,
            wanted=f"at most {_FREE_BYTES / 1e6:g} MB, or {_EXPANSION} times its size",
        )


def require_rows(rows: int, max_samples: int, where: str, what: str = "has") -> int:
    """`rows`. Raises BadInput for more than wanted."""
    if rows > max_samples:
        raise BadInput(f"{what} {rows} rows", where=where, wanted=f"at most {max_samples} (--max-samples N reads more)")
    return rows


class Lines:
    """Looks at the pieces of a table of text as they come: lines of a sane length, and no more of them than wanted."""

    def __init__(self, max_samples: int, where: str, *, beside: int = 1000) -> None:
        """beside: how many lines may be no rows; the reader counts the rows themselves."""
        self._max_samples, self._most, self._where = max_samples, max_samples + beside, where
        self._lines, self._begun = 0, 0

    def __call__(self, piece: bytes) -> None:
        """The next piece, of a megabyte at most. Raises BadInput for a line that is too long, and for too many."""
        first = piece.find(b"\n")
        if self._begun + (len(piece) if first < 0 else first) > LINE_BYTES:
            raise BadInput(
                f"line {self._lines + 1} is longer than {LINE_BYTES} bytes", where=self._where, wanted="a table of text"
            )
        self._lines += piece.count(b"\n")
        self._begun = self._begun + len(piece) if first < 0 else len(piece) - piece.rfind(b"\n") - 1
        if self._lines > self._most:
            require_rows(self._lines, self._max_samples, self._where, "has more than")


def _of_pipe(handle: int, where: str) -> Iterator[bytes]:
    """The pieces as they come. A pipe that nobody has opened for writing reads as ended; one that is silent blocks."""
    patience = time.monotonic() + _PATIENCE_S
    begun = False
    while True:
        try:
            piece = os.read(handle, _PIECE)
        except BlockingIOError:  # somebody holds it and has nothing to say as yet
            select.select([handle], [], [], 1.0)
            begun = True
            continue
        if piece:
            begun = True
            yield piece
        elif begun:
            return
        elif time.monotonic() > patience:
            raise BadInput(
                f"is a pipe to which nothing was written for {_PATIENCE_S:g} s", where=where, wanted="a file"
            )
        else:
            time.sleep(0.02)


def _too_large(most: int, where: str, wanted: str) -> BadInput:
    return BadInput(f"is larger than {most} bytes", where=where, wanted=wanted)
