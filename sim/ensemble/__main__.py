"""A process that flies chunks for another one; see `workers`."""

from __future__ import annotations

import gc
import signal
import sys
from types import FrameType

from fluxtwin.sim.ensemble.workers import serve


def _stop(number: int, frame: FrameType | None) -> None:
    raise KeyboardInterrupt


if __name__ == "__main__":
    gc.set_threshold(50_000)  # what is imported stays: looking through it again and again is a tenth of a start
    signal.signal(signal.SIGTERM, _stop)  # so that a file half-written is taken away
    try:
        serve(sys.stdin, sys.stdout)
    except (KeyboardInterrupt, BrokenPipeError):
        sys.stderr.close()
        sys.exit(130)
