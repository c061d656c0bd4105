"""Time stamps of telemetry files: as text, as counts by a recipe, in local time; all become datetime64[ns] UTC.

A recipe that counts (a row of `COUNTED`) makes calendar stamps in its own time scale, days of 86,400 s without leap seconds;
only then are they taken to UTC. So GPS, TAI, TT and Unix time are one sum, and the leap seconds come in at one place
(`epoch.utc_of`). Zones are given by their offset (`+02:00`) or by their name (`Europe/Berlin`), with summer time.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from datetime import datetime, timedelta, timezone, tzinfo
from typing import TYPE_CHECKING
from zoneinfo import ZoneInfo, ZoneInfoNotFoundError

import numpy as np

from fluxtwin.sim.base.errors import BadInput
from fluxtwin.sim.base.types import FloatArray, TimeArray
from fluxtwin.sim.earth import epoch

if TYPE_CHECKING:
    from fluxtwin.sim.telemetry.column_map import TimeRecipe

_FIRST_YEAR, _LAST_YEAR = 1900, 2200
_NAT = np.datetime64("NaT", "ns")
_AHEAD = r"[Zz]|UTC|[+-](?:0\d|1[0-4])(?::?[0-5]\d)?"  # from -12:00 to +14:00 are in use
_STAMP = re.compile(rf"(\d{{4}}-\d\d-\d\d[Tt ]\d\d:\d\d(?::\d\d(?:[.,]\d{{1,9}})?)?) ?({_AHEAD})?", re.ASCII)
_STEP = np.timedelta64(15, "m")
"""Zones change at full quarters of an hour."""
GPS_EPOCH = np.datetime64("1980-01-06T00:00:00", "ns")
"""Origin of GPS time (IS-GPS-200), whose days have no leap seconds."""
J2000 = np.datetime64("2000-01-01T12:00:00", "ns")
"""Origin of J2000 seconds, in TT."""
_UNIX = np.datetime64("1970-01-01T00:00:00", "ns")
_MJD = np.datetime64("1858-11-17T00:00:00", "ns")
_DAY = 86400.0
_LARGEST_S = 9.0e9
"""Stamps further from their origin than this are none: datetime64[ns] ends there."""
TEXT = {
    "iso": "ISO 8601 text",
    "text": "text in the given `format`",
    "cf": "stamps of the file itself (CF, CDF, tables)",
}
"""Recipes that are not counted."""


def parse_iso(
    text: np.ndarray,
    where: str,
    notices: list[str] | None = None,
    column: str = "time",
    zone: str | None = None,
) -> TimeArray:
    """datetime64[ns] (N,) of ISO 8601 UTC stamps, an array of bytes (N,); a blank is NaT.

    notices: takes a sentence where stamps do not say that they are UTC, those of the column named. zone: that of stamps
    without one (`utc_of_local`); None is UTC.

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
        stamps[known] -= np.array([_minutes(one) for one in stated], dtype="timedelta64[m]")
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
        stamps[local] = utc_of_local(stamps[local], zone, where)
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


@dataclass(frozen=True)
class Counted:
    """A recipe that counts from an origin."""

    units_s: tuple[float, ...]
    """Seconds that one unit of each of its columns has; the columns are added up."""
    origin: np.datetime64 | None
    """In the time scale; None: the map's `epoch`."""
    scale: str
    """Time scale that is counted where the map states no other."""


COUNTED: dict[str, Counted] = {
    "unix_s": Counted((1.0,), _UNIX, "UTC"),
    "unix_ms": Counted((1e-3,), _UNIX, "UTC"),
    "unix_us": Counted((1e-6,), _UNIX, "UTC"),
    "unix_ns": Counted((1e-9,), _UNIX, "UTC"),
    "seconds_ns": Counted((1.0, 1e-9), _UNIX, "UTC"),
    "gps_week_tow": Counted((604800.0, 1.0), GPS_EPOCH, "GPS"),
    "gps_s": Counted((1.0,), GPS_EPOCH, "GPS"),
    "tai_s": Counted((1.0,), np.datetime64("1958-01-01T00:00:00", "ns"), "TAI"),
    "j2000_s": Counted((1.0,), J2000, "TT"),
    "mjd": Counted((_DAY,), _MJD, "UTC"),
    "mjd2000": Counted((_DAY,), epoch.MJD2000, "UTC"),
    "jd": Counted((_DAY,), _MJD - np.timedelta64(12, "h"), "UTC"),
    "excel": Counted((_DAY,), np.datetime64("1899-12-30", "ns"), "UTC"),
    "datenum": Counted((_DAY,), _UNIX, "UTC"),
    "seconds_since": Counted((1.0,), None, "UTC"),
}
_DAY_OF_ORIGIN = {"jd": 2_400_000.0, "datenum": 719_529.0}
"""Days of counts that begin before the stamps do, at their origin above: 1858-11-16T12:00 and 1970-01-01."""
YEAR = "year"
"""The recipe that counts years, which are not of one length."""
NAMES = (*TEXT, YEAR, *COUNTED)
_SPACE_AGE, _LATEST = np.datetime64("1957-10-04", "ns"), np.datetime64(f"{_LAST_YEAR}-01-01", "ns")


def stamps_of_counts(raw: FloatArray, recipe: TimeRecipe) -> TimeArray:
    """UTC stamps (N,) of the counts (N, k), the columns of `recipe`; NaN and what is far beyond any mission become NaT."""
    if recipe.recipe == YEAR:
        return epoch.utc_of(_in_years(raw), recipe.scale or "UTC")
    how = COUNTED[recipe.recipe]
    parts = raw - _DAY_OF_ORIGIN.get(recipe.recipe, 0.0)
    scale, units_s = recipe.scale or how.scale, tuple(recipe.unit_s or how.units_s)
    if how.origin is not None:
        return epoch.utc_of(_added(how.origin, parts, units_s), scale)
    origin = epoch.parse_time(str(recipe.epoch), where="column map: epoch")
    if scale != "UTC":
        return epoch.utc_of(_added(origin, parts, units_s), scale)
    in_tai = epoch.stamp_in(origin, "TAI")[0]  # SI seconds since a UTC instant, leap seconds counted
    return epoch.utc_of(_added(in_tai, parts, units_s), "TAI")


def _in_years(raw: FloatArray) -> TimeArray:
    """Stamps (N,) of decimal years (N, 1), or of years and days of the year, which begin with 1 (N, 2)."""
    year = np.floor(raw[:, 0])
    good = np.isfinite(raw).all(axis=1) & (year >= _FIRST_YEAR) & (year <= _LAST_YEAR)
    years = np.where(good, year - 1970.0, 0.0).astype("int64").astype("datetime64[Y]")
    begins, ends = years.astype("datetime64[ns]"), (years + np.timedelta64(1, "Y")).astype("datetime64[ns]")
    passed_ns = (raw[:, 0] - year) * (ends - begins).astype("int64")
    if raw.shape[1] == 2:
        passed_ns = (raw[:, 1] - 1.0) * (_DAY * 1e9)
        good &= (raw[:, 1] >= 1.0) & (raw[:, 1] < 367.0)
    out: TimeArray = begins + np.rint(np.where(good, passed_ns, 0.0)).astype("int64").astype("timedelta64[ns]")
    out[~good] = _NAT
    return out


def beyond(first: FloatArray, recipe: TimeRecipe) -> str:
    """Words on the counts (k,) of a row that the recipe puts far beyond any mission, with a recipe that fits."""
    counts = " and ".join(f"{name} is {value:.15g}" for name, value in zip(recipe.names, first, strict=True))
    said = f"{counts}: far beyond any mission as {recipe.recipe}"
    for name, how in COUNTED.items():
        if len(how.units_s) == first.size and how.origin is not None and name.startswith("unix"):
            stamp = _added(how.origin, first[None], how.units_s)[0]
            if not np.isnat(stamp) and _SPACE_AGE <= stamp < _LATEST:
                return f"{said}; as {name} it is {format_iso(stamp[None])[0]}"
    return said


def unix_of_size(size: float) -> str | None:
    """The recipe by which a count of that size is Unix time from 1976 to 2096; None where there is none."""
    units = {name: how.units_s[0] for name, how in COUNTED.items() if name.startswith("unix")}
    return next((name for name, unit_s in units.items() if 2.0e8 < size * unit_s < 4.0e9), None)


def in_1970(first: FloatArray, recipe: TimeRecipe) -> str | None:
    """Words on the counts (k,) of a row that are of the first weeks of Unix time, and of our days in a coarser unit; None
    for others, and where the map says from when they count."""
    plain = recipe.recipe.startswith("unix") and not recipe.unit_s and not recipe.offset_s
    likely = unix_of_size(float(first[0])) if plain else None
    if likely in (None, recipe.recipe):
        return None
    stamps = [format_iso(_added(_UNIX, first[None], COUNTED[name].units_s))[0] for name in (recipe.recipe, likely)]
    return f"{recipe.names[0]} is {first[0]:.15g}: as {recipe.recipe} it is {stamps[0]}; as {likely} it is {stamps[1]}"


def _added(origin: np.datetime64, parts: FloatArray, units_s: tuple[float, ...]) -> TimeArray:
    """Origin and counts as stamps; whole units and the rest are rounded apart, so that nanoseconds stay exact."""
    good = np.isfinite(parts).all(axis=1) & (np.abs(parts @ np.array(units_s)) < _LARGEST_S)
    total = np.zeros(len(parts), dtype=np.int64)
    for column, unit in zip(np.where(good[:, None], parts, 0.0).T, units_s, strict=True):
        per_second = round(1.0 / unit) if unit < 1.0 else 1
        if unit < 1.0 and abs(per_second * unit - 1.0) > 1e-12:  # as 0.3: no whole number of them is a second
            total += np.rint(column * (unit * 1e9)).astype(np.int64)
            continue
        whole = np.floor(column / per_second)
        rest = column - whole * per_second
        total += whole.astype(np.int64) * round(unit * per_second * 1e9)
        total += np.rint(rest * (1e9 / per_second if unit < 1.0 else unit * 1e9)).astype(np.int64)
    out: TimeArray = origin + total.astype("timedelta64[ns]")
    out[~good] = np.datetime64("NaT", "ns")
    return out


def joined(text: Callable[[str], np.ndarray], names: list[str]) -> np.ndarray:
    """The columns as one text (N,) of bytes, a blank between them; blank where all of them are."""
    if len(names) == 1:
        return text(names[0])
    cells = zip(*(text(name).tolist() for name in names), strict=True)
    return np.array([b" ".join(part.strip() for part in row).strip() for row in cells], dtype=np.bytes_)


def _minutes(offset: str | None) -> int:
    """Minutes that an offset is ahead of UTC."""
    if offset is None or offset in ("Z", "z", "UTC"):
        return 0
    digits = offset[1:].replace(":", "").ljust(4, "0")
    return (-1 if offset[0] == "-" else 1) * (60 * int(digits[:2]) + int(digits[2:]))


def zone_named(zone: str) -> tzinfo:
    """The zone of that offset or name. Raises BadInput for one that is not known."""
    if re.fullmatch(_AHEAD, zone):
        return timezone(timedelta(minutes=_minutes(zone)))
    try:
        return ZoneInfo(zone)
    except (ZoneInfoNotFoundError, ValueError, OSError):
        wanted = "'+02:00' or a name of the IANA list, as 'Europe/Berlin' (pip install tzdata where no name is known)"
        raise BadInput(f"{zone[:40]!r} is not known", where="zone", wanted=wanted) from None


def utc_of_local(local: TimeArray, zone: str | None, where: str) -> TimeArray:
    """UTC of local stamps (N,) in the order of the file; NaT stays. zone None: they are UTC.

    The hour that comes twice in autumn is divided at the one step back in its stamps. Raises BadInput, with the row, where
    there is none, and for an hour that summer time skips.
    """
    if zone is None or not local.size:
        return local
    known, there = zone_named(zone), np.flatnonzero(~np.isnat(local))
    places, which = np.unique((local[there] - np.datetime64("1970-01-01", "ns")) // _STEP, return_inverse=True)
    begins = [datetime(1970, 1, 1) + timedelta(minutes=15 * int(place)) for place in places]
    first, second = (
        np.array([_ahead_s(begin.replace(fold=fold), known) for begin in begins])[which] for fold in (0, 1)
    )
    for row in there[first < second][:1]:
        raise BadInput(
            f"time in row {row + 1}, {str(local[row])[:19]}, does not exist in {zone}",
            where=where,
            wanted="local times",
        )
    ahead = first.copy()
    twice = np.flatnonzero(first > second)
    for autumn in np.split(twice, np.flatnonzero(np.abs(np.diff(local[there[twice]])) > np.timedelta64(1, "D")) + 1):
        back = np.flatnonzero(np.diff(local[there[autumn]]) < np.timedelta64(0, "ns"))
        if autumn.size and back.size != 1:
            row = there[autumn[0]]
            raise BadInput(
                f"time in row {row + 1}, {str(local[row])[:19]}, comes twice in {zone}, and the order does not say which",
                where=where,
                wanted="zone as an offset, '+02:00'; or `where` without this hour",
            )
        later = autumn[back[0] + 1 :] if autumn.size else autumn
        ahead[later] = second[later]
    out = local.copy()
    out[there] -= ahead.astype("timedelta64[s]")
    return out


def _ahead_s(moment: datetime, zone: tzinfo) -> int:
    offset = moment.replace(tzinfo=zone).utcoffset()
    return 0 if offset is None else round(offset.total_seconds())
