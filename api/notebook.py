"""In a notebook long work shows a line of what is being done, which goes when the cell is done; elsewhere nothing."""

from __future__ import annotations

import sys
from importlib import import_module
from time import monotonic
from typing import Any

from fluxtwin.sim.base.progress import silent

_DISPLAY = "IPython.display"
"""Imported where a notebook runs, which has it, and nowhere else."""
_QUIET_S = 1.0
"""Shorter work shows nothing."""
_BETWEEN_S = 0.2
"""Faster than this nobody reads."""


class _Line:
    """The line of the cell that runs."""

    def __init__(self) -> None:
        self.events: Any = None
        self.handle: Any = None
        self.begun = self.said = 0.0

    def say(self, shell: Any, text: str) -> None:
        """Show the text, once the work has lasted for a while."""
        now = monotonic()
        if self.events is None:
            self.events, self.begun, self.said = shell.events, now, 0.0
            self.events.register("post_run_cell", self.done)
        if now - self.begun < _QUIET_S or now - self.said < _BETWEEN_S:
            return
        self.said, show = now, import_module(_DISPLAY)
        if self.handle is None:
            self.handle = show.display(show.Pretty(text), display_id=True)
        else:
            self.handle.update(show.Pretty(text))

    def done(self, *_: Any) -> None:
        """Take the line away after the cell."""
        if self.handle is not None:
            self.handle.update(import_module(_DISPLAY).Pretty(""))
        self.events.unregister("post_run_cell", self.done)
        self.events = self.handle = None


_LINE = _Line()


def usual(words: str, fraction: float) -> None:
    """The default of the verbs that take a `progress`: a line in a notebook, nothing elsewhere."""
    silent(words, fraction)
    ipython = sys.modules.get("IPython")
    shell = ipython.get_ipython() if ipython is not None else None
    if shell is not None and hasattr(shell, "kernel"):
        _LINE.say(shell, f"{words} {100.0 * fraction:.0f} %")
