"""Time stamps of telemetry files: ISO 8601 text, counted seconds, GPS weeks; all become datetime64[ns] UTC."""

from __future__ import annotations

import numpy as np

from fluxtwin.sim.base.errors import BadInput
from fluxtwin.sim.base.types import BoolArray, FloatArray, TimeArray
from fluxtwin.sim.earth import epoch

GPS_EPOCH = np.datetime64("1980-01-06T00:00:00", "ns")
"""Origin of GPS time (IS-GPS-200); GPS time has no leap seconds, so SI seconds since then are the GPS count."""
_LONGEST = 36
_FIRST_YEAR, _LAST_YEAR = 1900, 2200
_NAT = np.datetime64("NaT", "ns")
_DIGITS = (0, 1, 2, 3, 5, 6, 8, 9, 11, 12, 14, 15, 17, 18)
_PUNCTUATION = ((4, "-"), (7, "-"), (13, ":"), (16, ":"))


def parse_iso(text: np.ndarray, where: str) -> TimeArray:
    """datetime64[ns] (N,) of ISO 8601 UTC stamps, an array of bytes (N,); a blank is NaT.

    Accepted: `1978-07-24T06:00:00`, a blank in place of T, up to nine decimals, an ending Z or +00:00. Raises
    BadInput naming the first row that is anything else (other zones, leap seconds, dates that do not exist).
    """
    stripped = np.char.strip(text) if _has_blanks(text) else text
    if stripped.size == 0:
        return np.empty(0, dtype="datetime64[ns]")
    stamps, good = _parse(_padded(stripped))
    blank = stripped == b""
    stamps[blank] = _NAT
    wrong = np.flatnonzero(~(good | blank))
    if wrong.size:
        row = int(wrong[0])
        raw = bytes(stripped[row]).decode("utf-8", "replace")[:40]
        leap = " (a stamp cannot lie inside a leap second)" if raw[16:19] == ":60" else ""
        raise BadInput(
            f"time in row {row + 1} is {raw!r}{leap}",
            where=where,
            wanted="ISO 8601 UTC, as 1978-07-24T06:00:00.5Z",
        )
    return stamps


def zone_assumed(text: np.ndarray, column: str) -> list[str]:
    """One sentence where ISO 8601 stamps, an array of bytes (N,), do not say that they are UTC; else none."""
    stripped = np.char.strip(text)
    bare = (stripped != b"") & ~np.isin(_last(stripped), (b"Z", b"z")) & ~np.char.endswith(stripped, b"+00:00")
    count = int(bare.sum())
    if not count:
        return []
    rows = "" if count == text.size else f" in {count} of {text.size} rows"
    return [
        f"column {column} has no Z and no zone{rows}: taken as UTC (for local time, a column map with time.offset_s)"
    ]


def _last(stripped: np.ndarray) -> np.ndarray:
    """The last character of each text, (N,)."""
    length = np.char.str_len(stripped)
    wide = np.ascontiguousarray(stripped.astype(f"S{max(int(length.max(initial=1)), 1)}"))
    raw = wide.view("S1").reshape(stripped.size, -1)
    return np.asarray(raw[np.arange(stripped.size), np.maximum(length - 1, 0)])


def format_iso(time: TimeArray) -> list[str]:
    """ISO 8601 with a Z, with as many decimals (0, 3, 6 or 9) as the whole column needs to be exact."""
    ns = time.astype("int64")
    unit = next(u for u, n in (("s", 10**9), ("ms", 10**6), ("us", 10**3), ("ns", 1)) if not (ns % n).any())
    return [f"{stamp}Z" for stamp in np.datetime_as_string(time, unit=unit).tolist()]  # type: ignore[call-overload]


def from_unix(seconds: FloatArray, nanoseconds: FloatArray | float = 0.0) -> TimeArray:
    """UTC from Unix seconds (N,), leap seconds not counted, and nanoseconds; NaN becomes NaT.

    The whole seconds and the rest are rounded apart, so that a separate nanosecond count stays exact.
    """
    s, ns = np.broadcast_arrays(np.asarray(seconds, dtype=np.float64), np.asarray(nanoseconds, dtype=np.float64))
    good = np.isfinite(s) & np.isfinite(ns) & (np.abs(s) < 9.0e9)
    whole = np.floor(np.where(good, s, 0.0))
    rest = np.rint((np.where(good, s, 0.0) - whole) * 1e9 + np.where(good, ns, 0.0))
    stamps: TimeArray = (whole.astype("int64") * 10**9 + rest.astype("int64")).astype("datetime64[ns]")
    stamps[~good] = _NAT
    return stamps


def from_gps(week: FloatArray, seconds_of_week: FloatArray) -> TimeArray:
    """UTC from the full GPS week (since 1980) and seconds of the week, each (N,); NaN becomes NaT."""
    tow = np.asarray(seconds_of_week, dtype=np.float64)
    whole = np.floor(tow)  # apart from the rest, which a count since 1980 in float64 would cut to 0.1 us
    total = np.asarray(week, dtype=np.float64) * 604800.0 + whole
    good = np.isfinite(total)
    stamps = np.full(total.shape, _NAT)
    if good.any():
        rest = np.rint((tow - whole)[good] * 1e9).astype("int64").astype("timedelta64[ns]")
        stamps[good] = epoch.add_seconds(GPS_EPOCH, total[good]) + rest
    return stamps


def _has_blanks(text: np.ndarray) -> bool:
    if text.size == 0 or text.dtype.itemsize == 0:
        return False
    raw = np.ascontiguousarray(text).view(np.uint8).reshape(text.size, -1)
    first = raw[:, 0]
    return bool(((first == 32) | (first == 9)).any() or (np.char.endswith(text, b" ")).any())


def _padded(text: np.ndarray) -> np.ndarray:
    """(N, 36) bytes, zero padded; longer texts are cut and so fail to parse."""
    wide = np.ascontiguousarray(text.astype(f"S{_LONGEST}"))
    raw: np.ndarray = wide.view(np.uint8).reshape(text.size, _LONGEST)
    return raw


def _parse(raw: np.ndarray) -> tuple[TimeArray, BoolArray]:
    digit = raw.astype(np.int64) - 48
    good: BoolArray = np.ones(len(raw), dtype=bool)
    for place in _DIGITS:
        good &= (digit[:, place] >= 0) & (digit[:, place] <= 9)
    for place, mark in _PUNCTUATION:
        good &= raw[:, place] == ord(mark)
    good &= (raw[:, 10] == ord("T")) | (raw[:, 10] == ord(" ")) | (raw[:, 10] == ord("t"))
    year = digit[:, 0] * 1000 + digit[:, 1] * 100 + digit[:, 2] * 10 + digit[:, 3]
    month, day, hour, minute, second = (digit[:, p] * 10 + digit[:, p + 1] for p in (5, 8, 11, 14, 17))
    good &= (year >= _FIRST_YEAR) & (year <= _LAST_YEAR) & (month >= 1) & (month <= 12) & (day >= 1)
    good &= (hour <= 23) & (minute <= 59) & (second <= 59)
    fraction, end = _fraction(raw, digit)
    good &= _ends_well(raw, end)
    months = ((np.where(good, year, 2000) - 1970) * 12 + np.where(good, month, 1) - 1).astype("datetime64[M]")
    start = months.astype("datetime64[D]")
    length = ((months + np.timedelta64(1, "M")).astype("datetime64[D]") - start).astype("int64")
    good &= day <= length
    days = start.astype("int64") + day - 1
    seconds = ((days * 24 + hour) * 60 + minute) * 60 + second
    ns = np.where(good, seconds, 0) * 10**9 + np.where(good, fraction, 0)
    return ns.astype("datetime64[ns]"), good


def _fraction(raw: np.ndarray, digit: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Nanoseconds after the point, and the place where the stamp's number ends."""
    inside = raw[:, 19] == ord(".")
    end = np.where(inside, 20, 19)
    value = np.zeros(len(raw), dtype=np.int64)
    for place in range(20, 29):
        inside = inside & (digit[:, place] >= 0) & (digit[:, place] <= 9)
        value += np.where(inside, digit[:, place] * 10 ** (28 - place), 0)
        end = end + inside
    return value, end


def _ends_well(raw: np.ndarray, end: np.ndarray) -> BoolArray:
    """After the number: nothing, Z, or +00:00; and a point is followed by a digit."""
    rows = np.arange(len(raw))
    tail = np.stack([raw[rows, end + k] for k in range(7)], axis=1)
    good: BoolArray = np.zeros(len(raw), dtype=bool)
    for wanted in (b"", b"Z", b"z", b"+00:00"):
        pattern = np.frombuffer(wanted.ljust(7, b"\0"), dtype=np.uint8)
        good |= (tail == pattern).all(axis=1)
    good &= ~((end == 20) & (raw[:, 19] == ord(".")))
    return good
