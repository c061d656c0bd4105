"""What reaches the terminal: plain tables, progress, messages, JSON.

Rich's markup is off everywhere, because it eats units: `[nT]` would vanish. Foreign text (file names, column
names) loses its control characters first, so that no file can move the cursor or forge a line. Results go to
standard output; progress and messages go to standard error. NO_COLOR is honoured (rich does).
"""

from __future__ import annotations

import io
import math
import os
import re
import shlex
import shutil
import sys
import textwrap
import threading
import unicodedata
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fluxtwin.sim.base.processes import stop_if_asked

if TYPE_CHECKING:
    from rich.console import Console

    from fluxtwin.outputs import Kind
    from fluxtwin.scenarios.page import Table

_QUIET_SECONDS = 1.0  # shorter work shows no progress at all
GIVEN: list[str] = []
"""The arguments of this call of the command line."""
_unread: set[int] = set()
"""Streams (1, 2) of this process whose reader has gone."""
_NUMBER = re.compile(r"-?\d+(\.\d+)?(e[+-]\d+)?")


class _Patient(io.FileIO):
    """A stream of this process: once its reader has gone, as `| head` does, what else is written to it goes nowhere, and the
    work goes on to its files and its exit status."""

    def write(self, data: Any) -> int:
        try:
            return int(super().write(data) or 0)
        except BrokenPipeError:
            nowhere = os.open(os.devnull, os.O_WRONLY)
            os.dup2(nowhere, self.fileno())
            os.close(nowhere)
            _unread.add(self.fileno())
            return memoryview(data).nbytes


def heed_no_reader() -> None:
    """From now on standard output and error, where they are files or pipes, may lose their readers."""
    for name in ("stdout", "stderr"):
        stream = getattr(sys, name)
        buffer = getattr(stream, "buffer", None)
        ours = stream is getattr(sys, f"__{name}__")  # which keeps it open
        if ours and isinstance(getattr(buffer, "raw", buffer), io.FileIO):
            stream.flush()
            how = {"encoding": stream.encoding, "errors": stream.errors, "line_buffering": stream.line_buffering}
            patient = io.BufferedWriter(_Patient(stream.fileno(), "w", closefd=False))
            setattr(sys, name, io.TextIOWrapper(patient, write_through=stream.write_through, **how))


def command_line() -> str:
    """This call of the command line, as a shell takes it: what repeats a result."""
    return shlex.join(["fluxtwin", *GIVEN])


def is_number(cell: object) -> bool:
    """Whether a cell is set flush right: a number, or the text of one."""
    if isinstance(cell, str):
        return _NUMBER.fullmatch(cell) is not None
    return isinstance(cell, int | float) and not isinstance(cell, bool)


@dataclass
class Manners:
    """How much is said beside the result; the options -q and -v set it for one call of the command line."""

    quiet: bool = False
    """No progress, no notes, nothing but the result."""
    verbose: bool = False
    """Also the lists that a message leaves out."""


manners = Manners()


def clean(text: str) -> str:
    """`text` with control and direction-changing characters made visible; line ends and tabs stay."""
    return "".join(
        character
        if character in "\n\t" or unicodedata.category(character) not in ("Cc", "Cf", "Cs")
        else character.encode("unicode_escape", "backslashreplace").decode("ascii")
        for character in text
    )


def shown(value: object) -> str:
    """One cell as text: floats with four significant digits, large ones in full units, None blank, yes and no for bool."""
    if value is None:
        return ""
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        return f"{value:.4g}" if abs(value) < 1e4 else f"{value:.0f}"
    return clean(str(value))


def wrapped(text: str, width: int = 80, indent: str = "") -> str:
    """`text` in lines of at most `width`, later ones behind `indent`, where its words allow it: long names stay whole."""
    if len(text) <= width:
        return text
    return textwrap.fill(text, width, subsequent_indent=indent, break_long_words=False, break_on_hyphens=False)


class Output:
    """Where one command speaks. With `--json -` only JSON goes to standard output, and no table anywhere."""

    def __init__(self, json_target: str | None = None, *, force: bool = False) -> None:
        self.json_target = json_target
        self.force = force
        """The user's word against a refusal that names `--force`."""
        self._noted: set[str] = set()
        self._files = False  # whether any was asked for, beside what goes to standard output
        self.talks = json_target not in ("-", "/dev/stdout")

    def claim(self, targets: Mapping[str, tuple[Path | str | None, Kind]], inputs: Iterable[Path | str | None]) -> None:
        """As `outputs.claim`, with the JSON among the outputs."""
        from fluxtwin import outputs

        self._files = any(path is not None for path, _ in targets.values())
        self._files |= self.json_target is not None and self.talks
        outputs.claim({**targets, "--json": (self.json_target, outputs.JSON)}, inputs, force=self.force)

    def say(self, text: str = "") -> None:
        """One line of result."""
        if self.talks:
            print(clean(text))

    def line(self, text: str) -> None:
        """One line of a result that goes on: shown at once, also in a file or a pipe. Raises BrokenPipeError where nobody
        reads it any more and no file was asked for."""
        self.say(text)
        sys.stdout.flush()
        if 1 in _unread and not self._files:
            raise BrokenPipeError

    def prose(self, *texts: str, indent: str = "") -> None:
        """Sentences of a result: on a terminal they are broken between words, later lines behind `indent`."""
        wraps = self.talks and sys.stdout.isatty()
        for text in texts:
            self.say(wrapped(text, shutil.get_terminal_size().columns, indent) if wraps else text)

    def note(self, text: str) -> None:
        """One line beside the result, on standard error; the same line only once, and none with --quiet."""
        if not manners.quiet and text not in self._noted:
            self._noted.add(text)
            print(clean(text), file=sys.stderr, flush=True)  # with PYTHONUNBUFFERED a line end does not do it

    def table(self, title: str, columns: Sequence[str], rows: Sequence[Sequence[object]], note: str = "") -> None:
        """A table under its title, as wide as the terminal; where there is none, only long sentences wrap."""
        if not self.talks:
            return
        from rich import box
        from rich.table import Table
        from rich.text import Text

        table = Table(box=box.SIMPLE_HEAD, pad_edge=False, show_edge=False)
        for index, name in enumerate(columns):
            cells = [row[index] for row in rows if row[index] not in (None, "")]
            numeric = bool(cells) and all(is_number(cell) for cell in cells)
            words = all(" " not in shown(cell) for cell in cells)  # names and numbers stay whole, sentences wrap
            table.add_column(Text(clean(name)), justify="right" if numeric else "left", overflow="fold", no_wrap=words)
        console = _console()
        whole = console.is_terminal  # a terminal wraps by itself
        for row in rows:
            table.add_row(*(Text(shown(cell) if whole else wrapped(shown(cell))) for cell in row))
        if title:
            console.print(Text(clean(title)), style="bold")
        if whole:
            console.print(table)
        else:
            wide = console.options.update(width=100_000)
            lines = console.render_lines(table, wide, pad=False)
            print("\n".join("".join(segment.text for segment in line).rstrip() for line in lines))
        if note:
            console.print(Text(clean(note) if whole else wrapped(clean(note), 120)), soft_wrap=not whole)
        console.print()

    def tables(self, tables: Iterable[Table]) -> None:
        """Each table of a page's kind."""
        for one in tables:
            self.table(one.title, one.columns, one.rows, one.note)

    def files(self, written: Iterable[Path | str | None], lead: str = "  ") -> None:
        """A line for each file that was written; None is none."""
        for path in filter(None, written):
            self.say(f"{lead}{path}")

    def result(self, record: Mapping[str, Any]) -> None:
        """The machine-readable result, where `--json` asked for it; a number that is none becomes null."""
        if self.json_target is None:
            return
        import fluxtwin
        from fluxtwin.outputs import JSON_MARK
        from fluxtwin.sim.base.files import plain_tree, to_json, write_text
        from fluxtwin.sim.base.seals import sealed_json

        known = plain_tree(record, lambda one: None if isinstance(one, float) and not math.isfinite(one) else one)
        text = to_json(sealed_json({JSON_MARK: fluxtwin.__version__, **known}))
        if self.json_target == "-":
            print(end="", flush=True)
            raw = getattr(sys.stdout, "buffer", None)  # JSON is UTF-8, whatever the terminal speaks
            sys.stdout.write(text) if raw is None else raw.write(text.encode("utf-8"))
            sys.stdout.flush()
        else:
            write_text(self.json_target, text)

    @contextmanager
    def progress(self, words: str) -> Iterator[Callable[[str, float], None]]:
        """Show on a terminal that work is going on, nothing in a log; yields `progress(words, fraction)`, where it can be
        stopped."""
        shows = _LiveProgress(words) if sys.stderr.isatty() and not manners.quiet else None

        def update(words: str, fraction: float) -> None:
            stop_if_asked()
            if shows is not None:
                shows.update(words, fraction)

        try:
            stop_if_asked()
            yield update
        finally:
            if shows is not None:
                shows.stop()


class _LiveProgress:
    """A bar that redraws itself, gone when the work is done; it starts only when the work lasts."""

    def __init__(self, words: str) -> None:
        self._words, self._fraction = words, 0.0
        self._bar: Any = None
        self._task: Any = None
        self._timer = threading.Timer(_QUIET_SECONDS, self._start)
        self._timer.daemon = True
        self._timer.start()

    def _start(self) -> None:
        from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

        bar = Progress(
            SpinnerColumn(),
            TextColumn("{task.description}", markup=False),
            BarColumn(),
            TimeElapsedColumn(),
            console=_console(stderr=True),
            transient=True,
        )
        self._task, self._bar = bar.add_task(clean(self._words), total=None), bar
        bar.start()
        self.update(self._words, self._fraction)

    def update(self, words: str, fraction: float) -> None:
        self._words, self._fraction = words, fraction
        if self._bar is not None:
            total = 1.0 if fraction > 0 else None
            self._bar.update(self._task, description=clean(words), completed=fraction, total=total)

    def stop(self) -> None:
        self._timer.cancel()
        self._timer.join()  # a bar that is just being started is there then
        if self._bar is not None:
            self._bar.stop()


def _console(*, stderr: bool = False) -> Console:
    from rich.console import Console

    return Console(stderr=stderr, markup=False, highlight=False, emoji=False)
