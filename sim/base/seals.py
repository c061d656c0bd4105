"""Digests and versions in the files that fluxtwin writes and reads again, so that a damaged one is not taken for a good one.

A text has them in a comment, JSON in the keys `format` and `sha256`, NetCDF in attributes, a CSV in a column
(`sim.telemetry.csv_files`). What was changed by hand on purpose is read once the digest is taken out, as the message says.
"""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Mapping
from typing import Any

from fluxtwin.sim.base.errors import BadInput

FORMAT = 1
"""Of every file that fluxtwin writes and reads again; raised when one means something else than before. What was written
in an earlier format is read for ever (`tests/reference/data`)."""
COMMENTS = ("#", "//", "%", "COMMENT")
"""What begins a comment: in TOML and parameter files, in C, in MATLAB, in messages of CCSDS."""
_MARKED = re.compile(rf"(?:{'|'.join(COMMENTS)}) Written by fluxtwin")
_DRAFT = "fluxtwin, to be edited;"
_MARK = re.compile(
    rf"{_MARKED.pattern}, (?:to be edited|format (?P<format>\d{{1,4}}));"
    r" SHA-256 of the other lines: (?P<digest>[0-9a-f]{64})"
)
_SHA = "sha256"
_MARKED_LINES, _MARK_BYTES = 3, 4096


def sealed(text: str, comment: str, what: str = f"format {FORMAT}", *, after: int = 0) -> str:
    """`text` with its digest in a comment after so many lines. comment: what begins one in such a file, of `COMMENTS`."""
    lines = text.split("\n")
    lines.insert(after, f"{comment} Written by fluxtwin, {what}; SHA-256 of the other lines: {_digest(text)}")
    return "\n".join(lines)


def is_sealed(text: str, where: str | None = None) -> bool | None:
    """Whether a text is as `sealed` left it; None where no line among its first says that fluxtwin wrote it.

    The ends of lines do not count: editors and mail change them. Raises BadInput for a format of a later fluxtwin.
    """
    lines = text.replace("\r\n", "\n").split("\n")
    place = next((k for k, line in enumerate(lines[:_MARKED_LINES]) if _MARKED.match(line)), None)
    if place is None:
        return None
    mark = _MARK.fullmatch(lines.pop(place))
    if mark is None or mark["digest"] != _digest("\n".join(lines)):
        return False
    require_format(int(mark["format"] or FORMAT), where)
    return True


def require_sealed(text: str, *, where: str) -> None:
    """Raises BadInput for a text that fluxtwin wrote and that was damaged or edited since."""
    lines = text[:_MARK_BYTES].splitlines()[:_MARKED_LINES]
    if is_sealed(text, where) is False and not any(_DRAFT in line for line in lines):
        place = next(k for k, line in enumerate(lines, 1) if _MARKED.match(line))
        raise BadInput(
            "is not as fluxtwin wrote it: damaged, or changed by hand",
            where=where,
            wanted=f"the file as it was written; or, where the change was meant, the file without line {place},"
            " which holds the SHA-256 of the others",
        )


def require_format(number: object, where: str | None = None) -> None:
    """Raises BadInput for a file of a later format than is known here."""
    if not (isinstance(number, int) and 1 <= number <= FORMAT):
        raise BadInput(
            f"its format is {number!r:.20}; this fluxtwin knows format {FORMAT}", where=where, wanted="a newer fluxtwin"
        )


def _digest(text: str) -> str:
    return hashlib.sha256(text.encode("utf-8")).hexdigest()


def digest_of(content: Any) -> str:
    """SHA-256 over content as JSON with sorted keys and no blanks; numbers count by their shortest exact decimals."""
    return _digest(json.dumps(content, sort_keys=True, separators=(",", ":"), default=str))


def sealed_json(content: Mapping[str, Any]) -> dict[str, Any]:
    """The content with `format` behind its first key, and at its end `sha256`, of all before it as `digest_of` has it."""
    first, *others = content.items()
    whole = dict([first, ("format", FORMAT), *others])
    return {**whole, _SHA: digest_of(json.loads(json.dumps(whole)))}  # as it is read: keys are text there


def unsealed_json(text: str, *, where: str, wanted: str) -> dict[str, Any]:
    """What JSON text says, without its `format` and `sha256`.

    wanted: what the file should be, for the message. Raises BadInput where it is no JSON with keys, the digest does not fit,
    or the format is a later one.
    """
    try:
        content = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise BadInput(f"is not valid JSON ({str(error)[:80]})", where=where, wanted=wanted) from None
    if not isinstance(content, dict):
        raise BadInput("is JSON without keys", where=where, wanted=wanted)
    rest = {key: value for key, value in content.items() if key != _SHA}
    require_format(rest.pop("format", FORMAT), where)
    if _SHA in content and content[_SHA] != digest_of({key: content[key] for key in content if key != _SHA}):
        raise BadInput(
            "is not as fluxtwin wrote it: damaged, or changed by hand",
            where=where,
            wanted=f"the file as it was written; or, where the change was meant, the file without the key {_SHA}",
        )
    return rest
