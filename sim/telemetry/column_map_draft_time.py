"""A guess at the format of stamps that are text but not ISO 8601: one column, or date and time apart."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from datetime import datetime

_DATES = (
    "%Y-%m-%d",
    "%Y/%m/%d",
    "%d/%m/%Y",
    "%m/%d/%Y",
    "%d.%m.%Y",
    "%Y%m%d",
    "%Y-%j",
    "%Y/%j",
    "%d-%b-%Y",
    "%d %b %Y",
)
_TIMES = ("%H:%M:%S.%f", "%H:%M:%S")
_ENDS = ("", "Z", " %z", "%z")
_BETWEEN = (" ", "T", "-", "_")


def text_format(texts: Mapping[str, Sequence[str]]) -> tuple[list[str], str, str] | None:
    """The columns, their format as strptime has it, and what is doubtful; None where no text is a stamp.

    texts: some cells of every column of text.
    """
    for name, cells in texts.items():
        forms = ["".join(p) for p in itertools.product(_DATES, _BETWEEN, _TIMES, _ENDS)]
        found = [form for form in forms if _fits(cells, form)]
        if found:
            return [name], found[0], _doubt(found)
    for one, other in itertools.permutations(texts, 2):
        dates = [form for form in _DATES if _fits(texts[one], form)]
        times = [f"{form}{end}" for form in _TIMES for end in _ENDS if _fits(texts[other], f"{form}{end}")]
        if dates and times:
            return [one, other], f"{dates[0]} {times[0]}", _doubt(dates)
    return None


def _doubt(found: Sequence[str]) -> str:
    """What the format leaves open."""
    rivals = f"; it could be {found[1]} as well" if len(found) > 1 else ""
    zone = "" if "%z" in found[0] or found[0].endswith("Z") else ", taken as UTC"
    return f"the format of the stamps{zone}{rivals}"


def _fits(cells: Sequence[str], form: str) -> bool:
    try:
        return bool(cells) and all(datetime.strptime(cell, form) for cell in cells)
    except ValueError:
        return False
