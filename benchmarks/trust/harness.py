"""Trials in processes of their own, so that what ends, fills or holds up a process is counted and costs one trial."""

from __future__ import annotations

import contextlib
import io
import os
import resource
import signal
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from fluxtwin.sim.base.errors import FluxtwinError

MEMORY_BYTES = 6 * 1024**3
_INTERNAL, _LIMIT_S = 70, 5.0
_BLOCKED_S = 120.0
"""On the clock, however busy the machine: work that uses no processor is ended then."""


@dataclass
class Row:
    """One line of the table."""

    name: str
    trials: int = 0
    faults: list[str] = field(default_factory=list)
    reach: str = "0 faults"
    note: str = ""
    commit: str = ""
    seconds: float = 0.0

    def fault(self, what: str) -> None:
        """Count a fault, in words."""
        self.faults.append(" ".join(what.split())[:200])


@contextlib.contextmanager
def timed(row: Row) -> Iterator[Row]:
    """Add what this takes to the row."""
    began = time.monotonic()
    try:
        yield row
    finally:
        row.seconds += time.monotonic() - began


def in_child(work: Callable[[], str], *, seconds: float = 60.0, memory: int = MEMORY_BYTES) -> str:
    """What `work` answers in a forked process, or `signal N`."""
    return next(in_children([work], seconds=seconds, memory=memory))


def in_children(
    works: Sequence[Callable[[], str]], *, seconds: float = _LIMIT_S, memory: int = MEMORY_BYTES
) -> Iterator[str]:
    """The answer of each, many in one forked process; where a signal ends it, `signal N` for that work (27: more than
    `seconds` of processor time; 14: it was blocked)."""
    done = 0
    while done < len(works):
        source, sink = os.pipe()
        child = os.fork()
        if child == 0:
            os.close(source)
            _work(works[done:], sink, seconds, memory)
        os.close(sink)
        with open(source, encoding="utf-8", errors="replace") as answers:
            for line in answers:
                done += 1
                yield line.rstrip("\n")
        status = os.waitpid(child, 0)[1]
        if done < len(works):
            done += 1
            yield f"signal {os.WTERMSIG(status)}" if os.WIFSIGNALED(status) else f"ended with {status >> 8}"


def _work(works: Sequence[Callable[[], str]], sink: int, seconds: float, memory: int) -> None:
    resource.setrlimit(resource.RLIMIT_AS, (memory, memory))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    silence = os.open(os.devnull, os.O_WRONLY)
    os.dup2(silence, 1)
    os.dup2(silence, 2)
    limits = ((signal.ITIMER_PROF, signal.SIGPROF, seconds), (signal.ITIMER_REAL, signal.SIGALRM, _BLOCKED_S))
    for _, number, _ in limits:
        signal.signal(number, signal.SIG_DFL)
    for work in works:
        for timer, _, limit_s in limits:
            signal.setitimer(timer, limit_s)
        before_s = _of_others_s()
        try:
            answer = work()
        except BaseException as error:
            answer = f"escaped {type(error).__name__}: {error}"
        if (took_s := _of_others_s() - before_s) > seconds:
            answer = f"took {took_s:.1f} s of processor time in a process of its own"
        for timer, _, _ in limits:
            signal.setitimer(timer, 0.0)
        os.write(sink, (" ".join(answer.split())[:300] + "\n").encode("utf-8", "replace"))
    os._exit(0)


def _of_others_s() -> float:
    """Processor time of the processes that this one has begun and that have ended; the timers do not count it."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def reading(read: Callable[[Path], object], path: Path, content: bytes) -> Callable[[], str]:
    """Work: write `content`, read it; the answer is `read`, `refused`, or what is wrong."""

    def work() -> str:
        path.write_bytes(content)
        try:
            read(path)
        except FluxtwinError as error:
            return "refused" if _names(str(error), path.name) else f"does not name the file: {error}"
        return "read"

    return work


def _names(text: str, name: str) -> bool:
    """Whether a message names a file; or the one that a map is for, where the two do not fit."""
    return name in text or ("foreign.csv: " in text and name.endswith("toml")) or "is given twice" in text


def command(arguments: Sequence[str], folder: Path, named: str | None = None) -> Callable[[], str]:
    """Work: the command line in that folder. The answer is `status N`, or what is wrong with how it ended."""

    def work() -> str:
        from fluxtwin.cli import main

        os.chdir(folder)
        said = io.StringIO()
        sys.stdout, sys.stderr = io.StringIO(), said
        status = main(list(arguments))
        text = said.getvalue()
        if status not in (0, 1, 2) or status == _INTERNAL or "Traceback" in text:
            return f"{' '.join(arguments)}: status {status}: {text[-200:]}"
        if status == 2 and named is not None and not _names(text, named):
            return f"{' '.join(arguments)}: does not name {named}: {text[-200:]}"
        return f"status {status}"

    return work


def spoken(arguments: Sequence[str], folder: Path, seconds: float = 120.0) -> tuple[int, str]:
    """The command line in that folder, in a forked process: its status (minus the signal that ended it), and all it said."""
    with open(folder / ".said", "w+b") as said:
        child = os.fork()
        if child == 0:
            status = _INTERNAL
            try:
                os.chdir(folder)
                os.dup2(said.fileno(), 1)
                os.dup2(said.fileno(), 2)
                sys.stdout = sys.stderr = open(1, "w", encoding="utf-8", errors="replace", closefd=False)  # noqa: SIM115
                signal.signal(signal.SIGALRM, signal.SIG_DFL)
                signal.setitimer(signal.ITIMER_REAL, seconds)
                from fluxtwin.cli import main

                status = main(list(arguments))
                sys.stdout.flush()
            finally:
                os._exit(status)
        status = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
        said.seek(0)
        text = said.read().decode("utf-8", "replace")
    (folder / ".said").unlink()
    return status, text


def peak_bytes() -> int:
    """The most memory that this process has held."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024


TOKENS = [
    b"nan",
    b"-inf",
    b"1e400",
    b"9" * 5000,
    b"[" * 2000,
    b'"',
    b"'''",
    b"\0",
    b"\xff\xfe",
    b"\r",
    b",,,,",
    b"=",
    b"\n\n",
    b"a." * 50,
    b"true",
    b"1970-01-01T00:00:60Z",
    b"-0",
    b"0x10",
    b"{",
    b"../..",
]


def mutated(content: bytes, rng: np.random.Generator) -> bytes:
    """A damaged copy: bits, bytes, pieces lost, doubled, moved, cut; something nasty put in, a number or word replaced."""
    data = bytearray(content)
    kind = int(rng.integers(0, 8))
    place = int(rng.integers(0, len(data)))
    if kind == 0:
        data[place] ^= 1 << int(rng.integers(0, 8))
    elif kind == 1:
        for where in rng.integers(0, len(data), 4):
            data[where] = int(rng.integers(0, 256))
    elif kind == 2:
        del data[place:]
    elif kind == 3:
        del data[place : place + int(rng.integers(1, 60))]
    elif kind == 4:
        other = int(rng.integers(0, len(data)))
        data[other:other] = data[place : place + 100]
    elif kind == 5:
        for where in rng.integers(0, min(len(data), 3000), 3):
            data[where] = int(rng.integers(0, 256))
    elif kind == 6:
        data[place:place] = TOKENS[int(rng.integers(0, len(TOKENS)))]
    else:
        token = TOKENS[int(rng.integers(0, len(TOKENS)))]
        end = next((k for k in range(place, min(place + 40, len(data))) if data[k] in b" ,\n=]}"), place + 1)
        data[place:end] = token
    return bytes(data)
