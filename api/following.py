"""The verb `follow`: rows as they come, an alarm that is valid at any time, then the diagnosis of what was seen."""

from __future__ import annotations

import contextlib
import os
import select
import stat
import sys
import tempfile
import time
import warnings
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Unpack

import numpy as np

from fluxtwin.calib.common.apply import apply_calibration
from fluxtwin.calib.common.digits import plain
from fluxtwin.calib.common.records import Calibration
from fluxtwin.diagnosing import AssumedAndReading, budget_of, declared_in, diagnose, with_assumed
from fluxtwin.gap.diagnose import new_rounding
from fluxtwin.gap.watch import FIRST_ROWS, FIRST_S, RUN, Changed, Watch, begin, enough
from fluxtwin.notebook import usual
from fluxtwin.sim.base.errors import BadInput, NoAnswer, amount
from fluxtwin.sim.base.processes import stop_if_asked
from fluxtwin.sim.base.progress import Progress
from fluxtwin.sim.base.shown import Shown
from fluxtwin.sim.base.types import BoolArray
from fluxtwin.sim.earth import epoch
from fluxtwin.sim.telemetry.csv_files import without_comments
from fluxtwin.sim.telemetry.record import Telemetry, concatenate
from fluxtwin.sim.telemetry.selection import NoneTaken, selection
from fluxtwin.sim.telemetry.telemetry_files import Readable, Reading, is_path, read_telemetry
from fluxtwin.verbs import as_calibration, as_model, as_record, on_one_blas_thread, reading_of, with_reading

if TYPE_CHECKING:
    from fluxtwin.gap.records.diagnosis import Diagnosis

_LOOK_S = 0.2
"""Between two looks at a file; rows that come faster are taken together."""
_PIECE = 1 << 22
"""Bytes that are read at once: some 20,000 rows."""
_AT_ONCE = 250
"""Rows that the watch takes at once."""
_KEPT_ROWS = 1_000_000
"""For the diagnosis; of a longer stream the last ones."""


@dataclass(frozen=True)
class Followed(Shown):
    """What a stream of rows has shown."""

    changed: Changed | None
    """What rang the alarm; None where the stream ended first."""
    rows: int
    """That were watched, with those passed over because they repeat the rounding of others."""
    last: np.datetime64
    """Time of the last of them, UTC."""
    calibration: str
    """Name of the calibration that was watched; empty for one that the first rows gave."""
    diagnosis: Diagnosis
    """Of all that was seen."""
    line: str
    """The answer of the watch in a sentence."""

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        changed = None
        if self.changed is not None:
            times = {"time": epoch.iso(self.changed.time), "since": epoch.iso(self.changed.since)}
            changed = times | {"rows": self.changed.rows, "what": self.changed.what}
        watched = {"rows": self.rows, "last": epoch.iso(self.last), "calibration": self.calibration, "line": self.line}
        return {"alarm": changed, **watched, "mean_run_rows": RUN, "diagnosis": self.diagnosis.to_dict()}


@on_one_blas_thread
@with_reading
@with_assumed
def follow(
    telemetry: Readable | Iterable[Readable],
    *,
    calibration: Calibration | Path | str | None = None,
    modelled: Sequence[str] | None = None,
    said: Callable[[str], None] = lambda line: None,
    progress: Progress = usual,
    **options: Unpack[AssumedAndReading],
) -> Followed:
    """Watch rows as they come until something changes or the stream ends, and diagnose what was seen.

    telemetry: a CSV that grows (followed until the alarm, or the first row at `end`), "-" for standard input, a record, or
    records one after the other.
    calibration: tested against the readings from the first row on; without it the first orbit gives S and b.
    modelled: as for `diagnose`. said: takes a line for each hour of telemetry.

    The first 600 rows or more, and an orbit, give the noise. Raises BadInput and NoAnswer as `diagnose` does.
    """
    assumed = dict(options)
    reading, declared = reading_of(assumed), declared_in(assumed)
    end = selection(reading.get("start"), reading.pop("end", None), reading.get("where")).end
    known = None if calibration is None else as_calibration(calibration)
    name = "" if known is None else str(calibration) if is_path(calibration) else known.digest[:12]
    with contextlib.ExitStack() as opened:
        blocks: Iterator[Telemetry]
        if isinstance(telemetry, str | Path):
            blocks = opened.enter_context(contextlib.closing(_records(str(telemetry), reading)))
        else:
            # A table of pandas or xarray would give the names of its columns one after the other.
            records: Any = (
                [telemetry] if hasattr(telemetry, "attrs") or not isinstance(telemetry, Iterable) else telemetry
            )
            blocks = _taken(records, reading)
        rows = _Rows(_later(_until(blocks, end)))
        first, tested = rows.to_begin_with()
        model, budget = as_model(declared.field or "igrf14", declared.degree), budget_of(None, (), declared)
        watch = begin(first.select(tested), model, budget, known)
        said(f"watching: {watch.found.words}; {_manner(watch)}")
        hours = _Hours(watch, said)
        changed = None if known is None else hours.take(first, tested)
        while changed is None and (more := rows.one_more()) is not None:
            changed = hours.take(*more)
    whole = rows.all()
    line = _line(changed, name, watch.rows, whole)
    with contextlib.suppress(BrokenPipeError):  # an alarm is one, and the diagnosis due, whether or not anyone reads it
        said(line)
        said(f"diagnosing {len(whole)} rows")
    if known is not None:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # that it is of another time is what is asked
            whole = apply_calibration(whole, known, force=True)
    found = diagnose(whole, modelled=modelled, progress=progress, **vars(declared))
    return Followed(changed, watch.rows, whole.time[-1], name, found, line)


def _line(changed: Changed | None, name: str, rows: int, whole: Telemetry) -> str:
    named = f"calibration {name}" if name else "what the first rows showed"
    if changed is None:
        return f"No alarm in {amount(rows, 'row|rows')} up to {epoch.iso(whole.time[-1])}: {named} still holds."
    after = int((whole.time >= changed.since).sum())
    return (
        f"ALARM {epoch.iso(changed.time)}: {named} no longer holds, since about {epoch.iso(changed.since)}. Most likely "
        f"change: {changed.what}. False alarms come at most once in {RUN:,.0f} rows on average. The diagnosis below "
        f"includes the {after} rows since the change; once there are more, run diagnose without --follow."
    )


class _Rows:
    """What has come, for the diagnosis, and what comes next."""

    def __init__(self, blocks: Iterator[Telemetry]) -> None:
        self._blocks, self._seen, self._count, self._every = blocks, list[Telemetry](), 0, 1

    def all(self) -> Telemetry:
        return concatenate(list(self._seen))

    def to_begin_with(self) -> tuple[Telemetry, BoolArray]:
        """The first rows, and (N,) which are tested: as few as it takes for the rounding to be new from one to the next."""
        while self._next() is not None:
            if enough(whole := self.all()):
                thinned, self._every = new_rounding(whole)
                if enough(thinned):
                    return whole, self._tested(0)
        alike = f", of which one in {self._every} counts as the readings repeat" if self._every > 1 else ""
        raise NoAnswer(
            f"the stream ended after {amount(self._count, 'row|rows')}{alike}: watching starts after {FIRST_ROWS} rows with "
            f"reading and position, over at least {FIRST_S / 60:.0f} minutes, from which "
            "the noise is estimated; diagnose without --follow needs fewer",
            evidence={"rows": self._count, "needed": FIRST_ROWS},
        )

    def one_more(self) -> tuple[Telemetry, BoolArray] | None:
        """The next rows and which are tested, each n-th of the whole stream; None where it has ended."""
        before, block = self._count, self._next()
        return None if block is None else (block, self._tested(before))

    def _tested(self, before: int) -> BoolArray:
        return np.asarray(np.arange(before, self._count) % self._every == 0)

    def _next(self) -> Telemetry | None:
        stop_if_asked()
        block = next(self._blocks, None)
        if block is None:
            return None
        self._count += len(block)
        self._seen.append(block)
        while len(self._seen) > 1 and len(self._seen[-2]) <= len(self._seen[-1]):  # each row is copied seldom
            self._seen[-2:] = [concatenate(self._seen[-2:])]
        if len(self._seen[0]) > 2 * _KEPT_ROWS:
            self._seen[0] = self._seen[0].select(slice(-_KEPT_ROWS, None))
        return block


def _taken(records: Iterable[Readable], reading: Reading) -> Iterator[Telemetry]:
    for record in records:
        with contextlib.suppress(NoneTaken):
            yield as_record(record, **reading)


def _until(blocks: Iterator[Telemetry], end: np.datetime64 | None) -> Iterator[Telemetry]:
    """The rows before `end`; the first at it ends the stream."""
    for block in blocks:
        before = np.ones(len(block), dtype=np.bool_) if end is None else block.time < end
        if before.any():
            yield block if before.all() else block.select(before)
        if not before.all():
            return


def _later(blocks: Iterator[Telemetry]) -> Iterator[Telemetry]:
    """Only rows that are later than all before, few at a time, so that no more are taken to begin with than it needs."""
    last = None
    for block in blocks:
        for start in range(0, len(block), _AT_ONCE):
            part = block if len(block) <= _AT_ONCE else block.select(slice(start, start + _AT_ONCE))
            if last is None or part.time[-1] > last:
                yield part if last is None or part.time[0] > last else part.select(part.time > last)
                last = part.time[-1]


def _manner(watch: Watch) -> str:
    if not watch.by_size:
        return "comparing reading and field in all three components"
    if watch.noise.theta_rad > 0:
        return "comparing |B| only, because of this attitude error (a smaller one can be declared with --attitude-sigma-deg)"
    return "comparing |B| only"


class _Hours:
    """Rows by the hour, with a line for each that has passed."""

    def __init__(self, watch: Watch, said: Callable[[str], None]) -> None:
        self._watch, self._said = watch, said
        self._hour: np.datetime64 | None = None
        self._rows, self._parts, self._squares = 0, 0, 0.0

    def take(self, block: Telemetry, tested: BoolArray) -> Changed | None:
        hours = block.time.astype("datetime64[h]")
        for hour in np.unique(hours):
            if self._hour is not None and hour != self._hour and self._rows:
                size = np.sqrt(self._squares / max(self._parts, 1))
                self._said(
                    f"{epoch.iso(self._hour, 'h')}: {amount(self._rows, 'row|rows')}, residual {size:.2f} times the "
                    f"expected noise, evidence of a change {plain(self._watch.level, 2)} (alarm at {RUN:,.0f})"
                )
                self._rows, self._parts, self._squares = 0, 0, 0.0
            self._hour = hour
            before = self._watch.rows
            inside = hours == hour
            changed = self._watch.take(block if inside.all() else block.select(inside), tested[inside])
            z = self._watch.innovations
            self._rows += self._watch.rows - before
            self._parts, self._squares = self._parts + int((z != 0).sum()), self._squares + float(np.sum(z**2))
            if changed is not None:
                return changed
        return None


def _records(path: str, reading: Reading) -> Generator[Telemetry, None, None]:
    """Records of the whole rows that have come, by the reader that also reads files; the first line that is no comment is
    the header."""
    name = "stdin.csv" if path == "-" else Path(path).name
    if name.lower().endswith((".nc", ".nc4", ".h5", ".gz", ".parquet", ".xlsx", ".cdf")):
        raise BadInput(
            "cannot be read while it is still being written",
            where=path,
            wanted="a file of text that grows by rows, or -",
        )
    head, rows = b"", 0
    with tempfile.TemporaryDirectory() as folder, open(Path(folder) / name, "wb", buffering=0) as part:
        for lines in _whole_lines(path):
            if not head:
                head, _, lines = without_comments(lines, [])[0].partition(b"\n")
            if not lines.strip():
                continue
            part.seek(0)
            part.truncate(part.write(head + b"\n" + lines))
            try:
                yield read_telemetry(part.name, **reading)
            except NoneTaken:
                pass
            except BadInput as error:
                words = str(error).replace(part.name, path)
                raise BadInput(f"{words} (row 1 of this part is row {rows + 1} of all)") from None
            rows += lines.count(b"\n")


def _whole_lines(path: str) -> Iterator[bytes]:
    """The bytes of a stream up to the last line end, as they come; a file is followed as long as it grows or may grow."""
    try:
        handle = os.dup(sys.stdin.fileno()) if path == "-" else os.open(path, os.O_RDONLY | getattr(os, "O_BINARY", 0))
    except OSError as error:
        raise BadInput(
            error.strerror or str(error), where=path, wanted="a file of text, or - for standard input"
        ) from None
    try:
        grows, rest, taken = path != "-" and stat.S_ISREG(os.fstat(handle).st_mode), b"", 0
        while True:
            stop_if_asked()
            if not grows and not select.select([handle], [], [], _LOOK_S)[0]:
                continue
            piece = os.read(handle, _PIECE)
            if not piece and not grows:
                break
            if not piece:
                if os.fstat(handle).st_size < taken:
                    raise BadInput(
                        "has become shorter while it was followed", where=path, wanted="a file that only grows"
                    )
                time.sleep(_LOOK_S)
                continue
            taken += len(piece)
            whole, end, rest = (rest + piece).rpartition(b"\n")
            if end:
                yield whole + end
    finally:
        os.close(handle)
    if rest.strip():
        yield rest + b"\n"
