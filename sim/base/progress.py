"""How long work tells that it is alive: a callable that takes a few words and the fraction done.

Between two steps is also where work can stop: every report looks whether the user asked for that, heard or not.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeAlias

from fluxtwin.sim.base.processes import stop_if_asked

Progress: TypeAlias = Callable[[str, float], None]
"""`progress(words, fraction)`: what is being done, and how much of the whole is done, 0 to 1."""


def silent(words: str, fraction: float) -> None:
    """Report nothing: the default of every function that takes a `progress`."""
    stop_if_asked()


def part_of(progress: Progress, start: float, end: float) -> Progress:
    """A progress for one step of a longer work: its 0 to 1 fills `start` to `end` of the whole."""

    def inner(words: str, fraction: float) -> None:
        progress(words, start + (end - start) * min(max(fraction, 0.0), 1.0))

    return inner
