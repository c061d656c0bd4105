"""Processes of our own: the command line and what flies the chunks of an ensemble."""

from __future__ import annotations

import atexit
import gc


def start_and_end_quickly() -> None:
    """Spare this process the search for garbage among what it has imported, which stays to the end.

    While a hundred thousand objects are being made the search would go through them again and again, and at the exit
    once more: together a third of a second of processor time. Not for a process that belongs to somebody else.
    """
    gc.set_threshold(50_000)
    atexit.register(gc.freeze)
