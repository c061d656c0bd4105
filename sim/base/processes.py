"""Processes of our own, the command line and what flies the chunks of an ensemble: how they start, end, and are stopped.

An interrupt is a request, not an exception that may be raised anywhere: raised inside an import, a callback of a weak
reference or the interpreter's exit it is lost, or printed with a traceback. Ctrl-C and SIGTERM set a flag, and
`stop_if_asked` looks at it between steps, chunks and reports of progress. Work that comes to no step, such as a read
from a pipe that stays empty, is ended where it stands; a second Ctrl-C has the effect it has on any program.
"""

from __future__ import annotations

import _thread
import atexit
import contextlib
import gc
import os
import signal
import time
from collections.abc import Iterator
from typing import TYPE_CHECKING

if TYPE_CHECKING:  # this is imported before interrupts are heeded, so it imports little
    from pathlib import Path
    from types import FrameType

ENDING = "interrupted; nothing half-written is left behind"
_LOOKS, _LOOK_S = 24, 0.05  # after 1.2 s without a step the process is ended: people wait two seconds, not more

_asked = 0  # the signal that came; 0 for none
_answered = False  # the work has stopped, or is done
_unfinished: set[Path] = set()


class Stopped(KeyboardInterrupt):
    """The user asked for an end, and the work has come to a place where it can stop."""


def start_and_end_quickly() -> None:
    """Spare this process the search for garbage among what it has imported, which stays to the end.

    While a hundred thousand objects are being made the search would go through them again and again, and at the exit
    once more: together a third of a second of processor time. Not for a process that belongs to somebody else.
    """
    gc.set_threshold(50_000)
    atexit.register(gc.freeze)


def stop_when_asked() -> None:
    """Take Ctrl-C and SIGTERM as a request from now on. For the main thread of a process of our own.

    A signal that is ignored, as Ctrl-C is in a background job, stays so.
    """
    for number in (signal.SIGINT, signal.SIGTERM):
        if signal.getsignal(number) != signal.SIG_IGN:
            signal.signal(number, _take)


def work_for_another() -> None:
    """This process works for another one, which says what there is to say: it hears no Ctrl-C, ends at once and without a
    word on SIGTERM, and when the other is gone."""
    import multiprocessing
    import threading

    start_and_end_quickly()
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, lambda number, frame: _end(number))
    parent = multiprocessing.parent_process()

    def end_with_parent() -> None:
        if parent is not None:
            parent.join()
            _end(signal.SIGTERM)

    threading.Thread(target=end_with_parent, daemon=True).start()


@contextlib.contextmanager
def starting_others() -> Iterator[None]:
    """While inside, processes that `multiprocessing` starts hear no Ctrl-C, have a thread each, and do not run the caller's
    script again: what they are sent can be imported without it, so scripts, notebooks and standard input may call alike."""
    import sys

    main = sys.modules["__main__"]
    hidden = {name: value for name, value in vars(main).items() if name in ("__file__", "__spec__")}
    single = ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
    before = {name: os.environ.get(name) for name in single}
    block = getattr(signal, "pthread_sigmask", None)  # where there is none, Ctrl-C is not inherited in this way
    masked = block(signal.SIG_BLOCK, {signal.SIGINT}) if block is not None else None
    try:
        vars(main).pop("__file__", None)
        vars(main)["__spec__"] = None
        os.environ.update(dict.fromkeys(single, "1"))
        yield
    finally:
        vars(main).pop("__spec__", None)
        vars(main).update(hidden)
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value
        if block is not None:
            block(signal.SIG_SETMASK, masked)


def stop_if_asked() -> None:
    """Raise Stopped where an end was asked for."""
    global _answered
    if _asked:
        _answered = True
        raise Stopped


def nothing_left_to_stop() -> None:
    """From now on an interrupt comes too late: all was done, or its end has been said."""
    global _answered
    _answered = True
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.SIG_IGN)


def stopped_status() -> int:
    """The exit status of an interrupted command, as shells count: 130 after Ctrl-C, 143 after SIGTERM."""
    return 128 + (_asked or signal.SIGINT)


@contextlib.contextmanager
def unfinished(path: Path) -> Iterator[None]:
    """While inside, `path` is removed if the process is ended where it stands."""
    _unfinished.add(path)
    try:
        yield
    finally:
        _unfinished.discard(path)


def _take(number: int, frame: FrameType | None) -> None:
    global _asked
    _asked = number
    signal.signal(number, signal.SIG_DFL)
    with contextlib.suppress(RuntimeError):  # no new thread while the interpreter ends, and no need of one
        _thread.start_new_thread(_end_unless_answered, (number,))  # `threading` has locks, which may be held just now


def _end_unless_answered(number: int) -> None:
    for _ in range(_LOOKS):  # in small parts, so that work that let nobody else run has time to look at the flag
        time.sleep(_LOOK_S)
        if _answered:
            return
    with contextlib.suppress(OSError):
        cursor = b"\r\x1b[2K\x1b[?25h" if os.isatty(2) else b""  # a bar may have hidden it
        os.write(2, cursor + f"fluxtwin: {ENDING}\n".encode())
    _end(number)


def _end(number: int) -> None:
    for path in list(_unfinished):
        with contextlib.suppress(OSError):
            path.unlink()
    os._exit(128 + number)
