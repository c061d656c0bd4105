"""A process that flies chunks for another one; see `workers`."""

from __future__ import annotations

import sys

from fluxtwin.sim.base.processes import end_when_asked, start_and_end_quickly

if __name__ == "__main__":
    end_when_asked()
    start_and_end_quickly()
    from fluxtwin.sim.run.ensemble.workers import serve  # slow to import

    try:
        serve(sys.stdin, sys.stdout)
    except (KeyboardInterrupt, BrokenPipeError):
        sys.stderr.close()
        sys.exit(130)
