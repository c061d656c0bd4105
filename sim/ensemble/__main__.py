"""A process that flies chunks for another one; see `workers`."""

from __future__ import annotations

import signal
import sys
from types import FrameType

from fluxtwin.sim.ensemble.workers import serve
from fluxtwin.sim.processes import start_and_end_quickly


def _stop(number: int, frame: FrameType | None) -> None:
    raise KeyboardInterrupt


if __name__ == "__main__":
    start_and_end_quickly()
    signal.signal(signal.SIGTERM, _stop)  # so that a file half-written is taken away
    try:
        serve(sys.stdin, sys.stdout)
    except (KeyboardInterrupt, BrokenPipeError):
        sys.stderr.close()
        sys.exit(130)
