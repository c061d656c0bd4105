"""Time stamps of telemetry files as text, in and out; all become datetime64[ns] UTC."""

from __future__ import annotations

import re

import numpy as np

from fluxtwin.sim.base.errors import BadInput
from fluxtwin.sim.base.types import TimeArray
from fluxtwin.sim.telemetry import zones

_FIRST_YEAR, _LAST_YEAR = 1900, 2200
_NAT = np.datetime64("NaT", "ns")
_STAMP = re.compile(rf"(\d{{4}}-\d\d-\d\d[Tt ]\d\d:\d\d(?::\d\d(?:[.,]\d{{1,9}})?)?) ?({zones.AHEAD})?", re.ASCII)


def parse_iso(
    text: np.ndarray,
    where: str,
    notices: list[str] | None = None,
    column: str = "time",
    zone: str | None = None,
) -> TimeArray:
    """datetime64[ns] (N,) of ISO 8601 UTC stamps, an array of bytes (N,); a blank is NaT.

    notices: takes a sentence where stamps do not say that they are UTC, those of the column named. zone: that of stamps
    without one (`zones.utc`); None is UTC.

    Accepted: `1978-07-24T06:00:00`, a blank in place of T, no seconds or up to nine decimals after a point or comma, an
    ending Z or UTC, or a zone as +02:00, which is taken off. Raises BadInput naming the first row that is anything else
    (leap seconds, dates that do not exist).
    """
    stripped = np.char.strip(text)
    blank = stripped == b""
    matches = [_STAMP.fullmatch(stamp.decode("utf-8", "replace")) for stamp in stripped.tolist()]
    known = np.array([match is not None for match in matches], dtype=np.bool_)
    plain = [match[1].upper().replace(",", ".") for match in matches if match is not None]
    plain = [stamp if str(_FIRST_YEAR) <= stamp[:4] <= str(_LAST_YEAR) else "NaT" for stamp in plain]  # numpy wraps
    stated = [match[2] for match in matches if match is not None]
    stamps = np.full(text.size, _NAT)
    try:
        stamps[known] = plain
    except ValueError:
        stamps[known] = [_existing(stamp) for stamp in plain]
    if any(one not in (None, "Z", "z") for one in stated):
        stamps[known] -= np.array([zones.minutes(one) for one in stated], dtype="timedelta64[m]")
    year = stamps.astype("datetime64[Y]").astype("int64") + 1970
    good = ~np.isnat(stamps) & (year >= _FIRST_YEAR) & (year <= _LAST_YEAR)
    wrong = np.flatnonzero(~(good | blank))
    if wrong.size:
        row = int(wrong[0])
        raw = bytes(stripped[row]).decode("utf-8", "replace")[:40]
        leap = " (a stamp cannot lie inside a leap second)" if raw[16:19] == ":60" else ""
        raise BadInput(
            f"time in row {row + 1} is {raw!r}{leap}",
            where=where,
            wanted=f"ISO 8601 UTC, as 1978-07-24T06:00:00.5Z{_other_form(raw, column)}",
        )
    if zone is not None:
        local = np.flatnonzero(known)[[one is None for one in stated]]
        stamps[local] = zones.utc(stamps[local], zone, where)
    elif notices is not None and (count := stated.count(None)):
        rows = "" if count == text.size else f" in {count} of {text.size} rows"
        notices.append(
            f"column {column} has no Z and no zone{rows}: taken as UTC (for local time, a column map with time.zone)"
        )
    return stamps


def _other_form(stamp: str, column: str) -> str:
    """The recipe of a column map that reads a stamp of another usual form, or where to get one."""
    from fluxtwin.sim.telemetry.column_map_draft_time import text_format

    if _STAMP.fullmatch(stamp):
        return f", of a day that exists and a year from {_FIRST_YEAR} to {_LAST_YEAR}"
    found = text_format({column: [stamp]})
    if found is None:
        return (
            "; for numbers a column map (--map; `fluxtwin map` drafts one)"
            if stamp.replace(".", "", 1).isdigit()
            else ""
        )
    columns = ", ".join(f'"{name}"' for name in column.split(" and "))
    return f'; or in a column map: time = {{ recipe = "text", columns = [{columns}], format = "{found[1]}" }}'


def _existing(stamp: str) -> np.datetime64:
    """NaT for a date that does not exist."""
    try:
        return np.datetime64(stamp, "ns")
    except ValueError:
        return _NAT


def parse_text(text: np.ndarray, form: str, where: str) -> TimeArray:
    """datetime64[ns] (N,) of stamps, an array of bytes (N,), in the format `form` of strptime, UTC unless %z is in it.

    A blank is NaT. Raises BadInput naming the first row that is of another form, and for a format that is none.
    """
    from fluxtwin.sim.telemetry.formats.table import extra

    pd = extra("pandas", "pandas", where)
    words = [stamp.decode("utf-8", "replace") for stamp in np.char.strip(text).tolist()]
    blank = np.array([not word for word in words], dtype=np.bool_)
    try:
        found = pd.to_datetime(pd.Series(words), format=form, errors="coerce", utc=True)
    except (ValueError, TypeError) as error:
        raise BadInput(f"{error}", where="column map: format", wanted="as '%d/%m/%Y %H:%M:%S.%f'") from None
    stamps: TimeArray = found.dt.tz_localize(None).to_numpy().astype("datetime64[ns]")
    wrong = np.flatnonzero(np.isnat(stamps) & ~blank)
    if wrong.size:
        raise BadInput(
            f"time in row {wrong[0] + 1} is {words[wrong[0]][:40]!r}", where=where, wanted=f"the format {form!r}"
        )
    return stamps


def format_iso(time: TimeArray) -> list[str]:
    """ISO 8601 with a Z, with as many decimals (0, 3, 6 or 9) as the whole column needs to be exact."""
    ns = time.astype("int64")
    unit = next(u for u, n in (("s", 10**9), ("ms", 10**6), ("us", 10**3), ("ns", 1)) if not (ns % n).any())
    return [f"{stamp}Z" for stamp in np.datetime_as_string(time, unit=unit).tolist()]  # type: ignore[call-overload]
