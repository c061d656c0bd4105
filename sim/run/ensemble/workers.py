"""Chunks on several cores: processes of their own, told chunk numbers on standard input.

A process knows the plan as text, so nothing of the caller's is copied, and scripts, notebooks and standard input may
call alike. An interrupt reaches only the caller; it ends the processes, and what they were writing is taken away. A
process whose caller is gone ends after its chunk.
"""

from __future__ import annotations

import contextlib
import json
import os
import subprocess
import sys
import threading
from collections import deque
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import IO, Any

from fluxtwin.sim.base import errors
from fluxtwin.sim.base.errors import BadInput
from fluxtwin.sim.base.processes import stop_if_asked

_LOOK_S = 0.2  # between two looks whether the user asked for an end
_PATIENCE_S = 0.5  # with a process that was asked to end

Event = dict[str, Any]
"""{"flown": 1} after each vehicle; after each chunk what `chunk.told` says of it."""


def fly_in_processes(record: Mapping[str, Any], folder: Path, numbers: Iterable[int], jobs: int) -> Iterator[Event]:
    """Fly and write these chunks by so many processes; yields what they tell.

    Raises the error of a chunk as this process would, and BadInput for a process that ends unasked.
    """
    waiting = deque(numbers)
    events: SimpleQueue[tuple[int, Event | None]] = SimpleQueue()
    crew: list[subprocess.Popen[str]] = []
    threads: list[threading.Thread] = []
    try:
        for place in range(min(jobs, len(waiting))):
            crew.append(_start())
            threads.append(threading.Thread(target=_listen, args=(place, crew[place].stdout, events), daemon=True))
            threads[place].start()
            _tell(crew[place], {"plan": dict(record), "folder": str(folder.resolve())})
        busy = len(crew)
        while busy:
            place, event = _next(events)
            if event is None:
                busy -= 1
                _require_good_end(crew[place])
            elif "error" in event:
                raise _error(event)
            else:
                if "flown" not in event:  # it is ready for the next one
                    _tell(crew[place], {"chunk": waiting.popleft()} if waiting else {})
                if "ready" not in event:
                    yield event
    finally:
        for process in crew:
            _end(process)
        for thread in threads:
            thread.join()
        for process in crew:
            if process.stdout is not None:
                process.stdout.close()


def serve(lines: Iterable[str], out: IO[str]) -> None:
    """What a process does: the plan first, then a chunk a line, until there is nothing more."""
    from fluxtwin.sim.run.ensemble.chunk import Flyer, told, write_chunk
    from fluxtwin.sim.run.ensemble.plan import Plan

    def tell(event: Event) -> None:
        out.write(json.dumps(event) + "\n")
        out.flush()

    orders = (json.loads(line) for line in lines)
    try:
        first = next(orders)
        plan, folder = Plan.from_record(first["plan"]), Path(first["folder"])
        flyer = Flyer(plan)
        tell({"ready": True})
        for order in orders:
            if "chunk" not in order:
                return
            made = flyer.chunk(order["chunk"], lambda: tell({"flown": 1}))
            write_chunk(plan, made, folder, order["chunk"])
            tell(told(made, order["chunk"]))
    except errors.FluxtwinError as error:
        tell({"error": str(error), "kind": type(error).__name__})


def _start() -> subprocess.Popen[str]:
    paths = os.pathsep.join(path or "." for path in sys.path)
    return subprocess.Popen(
        [sys.executable, "-m", "fluxtwin.sim.run.ensemble"],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        encoding="utf-8",
        env={**os.environ, "PYTHONPATH": paths, "OPENBLAS_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"},
        start_new_session=os.name == "posix",  # so that Ctrl-C in a terminal comes to the caller alone
    )


def _next(events: SimpleQueue[tuple[int, Event | None]]) -> tuple[int, Event | None]:
    while True:
        stop_if_asked()
        with contextlib.suppress(Empty):
            return events.get(timeout=_LOOK_S)


def _listen(place: int, stdout: IO[str] | None, events: SimpleQueue[tuple[int, Event | None]]) -> None:
    with contextlib.suppress(ValueError, OSError):  # cut off in the middle of a line
        for line in stdout or ():
            events.put((place, json.loads(line)))
    events.put((place, None))


def _tell(process: subprocess.Popen[str], order: Mapping[str, Any]) -> None:
    assert process.stdin is not None
    with contextlib.suppress(OSError):  # it is gone: its end says why
        process.stdin.write(json.dumps(order) + "\n")
        process.stdin.flush()


def _error(event: Event) -> Exception:
    kind = getattr(errors, event["kind"], BadInput)
    error: Exception = kind.__new__(kind)
    error.args = (event["error"],)  # the words are composed already
    return error


def _require_good_end(process: subprocess.Popen[str]) -> None:
    status = process.wait()
    if status != 0:
        raise BadInput(
            f"a process ended with status {status} (what it said stands above)",
            where="ensemble",
            wanted="fewer --jobs where memory is short; --resume goes on with what is there",
        )


def _end(process: subprocess.Popen[str]) -> None:
    if process.stdin is not None:
        with contextlib.suppress(OSError):
            process.stdin.close()
    if process.poll() is None:
        process.terminate()
    try:
        process.wait(_PATIENCE_S)
    except subprocess.TimeoutExpired:  # in a kernel, which hears nothing: then it is not writing either
        process.kill()
        process.wait()
