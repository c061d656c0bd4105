"""The errors a user may meet.

Every error carries one message that says what is wrong, where, what was found and what is wanted.
The command line prints that message and ends with `exit_status`; it never shows a traceback for them.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any


class FluxtwinError(Exception):
    """Base of all errors that are meant for the user."""

    exit_status = 2


class BadInput(FluxtwinError, ValueError):
    """Input that cannot be used: a missing file, column, unit, an unknown key, an impossible value."""

    def __init__(
        self, message: str, *, where: str | None = None, wanted: str | None = None, details: str | None = None
    ) -> None:
        """Compose `where: message. Wanted: wanted`.

        where: the file, row, key or argument at fault. wanted: what would be accepted, or what to do. details: what the
        command line shows with --verbose only, as a long list of known names.
        """
        text = message if where is None else f"{where}: {message}"
        if wanted is not None:
            text = f"{text}{'' if text.endswith('?') else '.'} Wanted: {wanted}"
        super().__init__(text)
        self.where = where
        self.wanted = wanted
        self.details = details


class NoAnswer(FluxtwinError):
    """The data are readable but do not allow an answer: too few samples, no excitation, nothing usable.

    `evidence` hands back what was found on the way (an estimate, a rank, a null direction).
    """

    exit_status = 1

    def __init__(self, message: str, *, evidence: dict[str, Any] | None = None) -> None:
        super().__init__(message)
        self.evidence = {} if evidence is None else evidence


class OutOfRange(BadInput):
    """An epoch, altitude or degree outside what a model covers; the message names the range."""


def nearest(word: str, known: Iterable[str], words: str = "; did you mean {}?", *, cutoff: float = 0.5) -> str:
    """A hint at the known word that is nearest to another one, empty where none is near. words: with {} for it.

    A name that has the word as a whole part, as `torquer_coupling` has `torquer`, is nearer than one that is spelled alike.
    """
    import difflib  # a wrong word is rare

    known = list(known)
    longer = [name for name in known if f"_{word}_" in f"_{name}_"]
    near = difflib.get_close_matches(word, longer or known, n=1, cutoff=0.0 if longer else cutoff)
    return words.format(near[0]) if near else ""


def kind_of(given: object) -> str:
    """The type of an object and the package that it is of, as `pandas DataFrame`."""
    return f"{type(given).__module__.partition('.')[0]} {type(given).__name__}".removeprefix("builtins ")


def amount(count: int, words: str) -> str:
    """A number and the words that fit it, of `one|many`: `1 row has` or `2 rows have` of "row has|rows have"."""
    one, _, many = words.partition("|")
    return f"{count} {one if count == 1 else many}"


def names_in(given: str | Iterable[str]) -> list[str]:
    """Each name once, of several or of a text with commas between them; `none` alone is an empty list."""
    if isinstance(given, str):
        given = [] if given.strip() == "none" else [name.strip() for name in given.split(",") if name.strip()]
    return list(dict.fromkeys(given))
