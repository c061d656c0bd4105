"""Time stamps of telemetry files: ISO 8601 text, counted seconds, GPS weeks; all become datetime64[ns] UTC."""

from __future__ import annotations

import re

import numpy as np

from fluxtwin.sim.base.errors import BadInput
from fluxtwin.sim.base.types import FloatArray, TimeArray
from fluxtwin.sim.earth import epoch

GPS_EPOCH = np.datetime64("1980-01-06T00:00:00", "ns")
"""Origin of GPS time (IS-GPS-200); GPS time has no leap seconds, so SI seconds since then are the GPS count."""
_FIRST_YEAR, _LAST_YEAR = 1900, 2200
_NAT = np.datetime64("NaT", "ns")
_STAMP = re.compile(r"\d{4}-\d\d-\d\d[Tt ]\d\d:\d\d:\d\d(\.\d{1,9})?([Zz]|\+00:00)?", re.ASCII)


def parse_iso(text: np.ndarray, where: str) -> TimeArray:
    """datetime64[ns] (N,) of ISO 8601 UTC stamps, an array of bytes (N,); a blank is NaT.

    Accepted: `1978-07-24T06:00:00`, a blank in place of T, up to nine decimals, an ending Z or +00:00. Raises
    BadInput naming the first row that is anything else (other zones, leap seconds, dates that do not exist).
    """
    import pandas as pd  # here: it takes a third of a second to load

    stripped = np.char.strip(text)
    blank = stripped == b""
    words = [stamp.decode("utf-8", "replace") for stamp in stripped.tolist()]
    known = np.array([_STAMP.fullmatch(word) is not None for word in words], dtype=np.bool_)
    plain = [
        word[:19].upper() + word[19:].rstrip("Zz").removesuffix("+00:00")
        for word, k in zip(words, known, strict=True)
        if k
    ]
    stamps = np.full(text.size, _NAT)
    stamps[known] = pd.to_datetime(plain, format="ISO8601", errors="coerce").to_numpy().astype("datetime64[ns]")
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
