"""Time: UTC stamps, elapsed seconds, and the scales that earth rotation and the sun need.

A stamp is numpy datetime64[ns] in UTC. datetime64 knows no leap seconds, so a stamp cannot lie inside one
(23:59:60), but *elapsed* time between stamps is counted in SI seconds, through TAI, with the leap seconds
of ERFA's table. UT1 is taken as UTC (|UT1 - UTC| < 0.9 s: under 0.42 km at the equator), so that everything
works offline.

All functions take arrays of any length and are vectorised. Source of the scales: ERFA (SOFA) routines.
"""

from __future__ import annotations

import re
from functools import cache

import erfa
import numpy as np

from fluxtwin.sim.base.errors import BadInput, OutOfRange
from fluxtwin.sim.base.types import FloatArray, TimeArray

_JD_UNIX = 2440587.5
_STAMP = re.compile(r"[0-9]{4}-[0-9]{2}-[0-9]{2}([T ][0-9]{2}(:[0-9]{2}(:[0-9]{2}(\.[0-9]+)?)?)?)?")
_FIRST_YEAR, _LAST_YEAR = 1678, 2261  # what datetime64[ns] holds in full
_NS_PER_DAY = 86400 * 1_000_000_000
_AHEAD_OF_TAI_S = {"TAI": 0.0, "GPS": -19.0, "TT": 32.184}
"""GPS time stays 19 s behind TAI (IS-GPS-200), TT 32.184 s ahead of it (IAU 1991)."""
MJD2000 = np.datetime64("2000-01-01T00:00:00", "ns")
"""Origin of the modified Julian day used by field models (1 January 2000, 0 h UTC)."""


def parse_time(text: str, *, where: str = "time") -> np.datetime64:
    """One ISO 8601 UTC stamp, with or without a final Z; raises BadInput for anything else."""
    raw = text.strip()
    wanted = "ISO 8601 UTC, as 1978-07-24T06:00:00Z"
    cleaned = raw[:-1] if raw.endswith(("Z", "z")) else raw
    # The pattern comes first: numpy would take other zones, and wrap years that nanoseconds cannot hold.
    if not _STAMP.fullmatch(cleaned):
        raise BadInput(f"{raw!r} is not a time", where=where, wanted=wanted)
    if not _FIRST_YEAR <= int(cleaned[:4]) <= _LAST_YEAR:
        raise BadInput(f"{raw!r} is out of range", where=where, wanted=f"{_FIRST_YEAR} to {_LAST_YEAR}")
    try:
        return np.datetime64(cleaned.replace(" ", "T"), "ns")
    except ValueError:
        raise BadInput(f"{raw!r} is not a time", where=where, wanted=wanted) from None


def as_times(time: TimeArray | np.datetime64) -> TimeArray:
    """datetime64[ns] array, at least one-dimensional; raises OutOfRange for missing stamps."""
    stamps = np.atleast_1d(np.asarray(time, dtype="datetime64[ns]"))
    if np.isnat(stamps).any():
        raise OutOfRange("a time stamp is missing (NaT)", where="time", wanted="UTC stamps in every row")
    return stamps


def jd_utc(time: TimeArray | np.datetime64) -> tuple[FloatArray, FloatArray]:
    """Two-part quasi Julian date of UTC (day at 0 h, fraction), as ERFA counts it.

    On a day that ends with a leap second the fraction runs over 86401 s.
    """
    stamps = as_times(time)
    ns = stamps.astype("int64")
    days = ns // _NS_PER_DAY
    nanoseconds = ns - days * _NS_PER_DAY
    midnight: TimeArray = days.astype("datetime64[D]")
    length = 86400.0 + _leap_seconds(midnight + np.timedelta64(1, "D")) - _leap_seconds(midnight)
    return _JD_UNIX + days.astype(np.float64), nanoseconds * 1e-9 / length


def jd_tai(time: TimeArray | np.datetime64) -> tuple[FloatArray, FloatArray]:
    """Two-part Julian date of TAI (ERFA utctai)."""
    days, fraction, _ = erfa.ufunc.utctai(*jd_utc(time))  # its status: "dubious year", far future, no leap second known
    return days, fraction


def jd_tt(time: TimeArray | np.datetime64) -> tuple[FloatArray, FloatArray]:
    """Two-part Julian date of TT (ERFA taitt)."""
    return erfa.taitt(*jd_tai(time))  # type: ignore[no-any-return]


def jd_ut1(time: TimeArray | np.datetime64) -> tuple[FloatArray, FloatArray]:
    """Two-part Julian date of UT1, taken equal to UTC."""
    ns = as_times(time).astype("int64")
    days = ns // _NS_PER_DAY
    return _JD_UNIX + days.astype(np.float64), (ns - days * _NS_PER_DAY) / _NS_PER_DAY


def seconds_since(time: TimeArray | np.datetime64, epoch: np.datetime64) -> FloatArray:
    """Elapsed SI seconds from `epoch` to each stamp, leap seconds counted. Shape (N,)."""
    stamps = as_times(time)
    plain: FloatArray = (stamps - as_times(epoch)[0]).astype("int64") * 1e-9
    return np.asarray(plain + _leap_seconds(stamps) - _leap_seconds(as_times(epoch))[0])


def add_seconds(epoch: np.datetime64, seconds: FloatArray | float) -> TimeArray:
    """UTC stamps `seconds` SI seconds after `epoch`. Shape (N,). Inverse of `seconds_since`.

    An instant inside a leap second has no stamp of its own; it gets that of the midnight after it.
    """
    elapsed = np.rint(np.atleast_1d(np.asarray(seconds, dtype=np.float64)) * 1e9).astype("int64")
    return utc_of(stamp_in(as_times(epoch), "TAI") + elapsed.astype("timedelta64[ns]"), "TAI")


def stamp_in(time: TimeArray | np.datetime64, scale: str) -> TimeArray:
    """The calendar stamps that UTC stamps (N,) have in `scale`: UTC, GPS, TAI or TT. NaT stays. Exact to 1 ns."""
    stamps = np.atleast_1d(np.asarray(time, dtype="datetime64[ns]"))
    if scale == "UTC":
        return stamps
    ahead = np.rint((_leap_seconds(stamps) + _AHEAD_OF_TAI_S[scale]) * 1e9).astype("int64")
    return np.asarray(stamps + ahead.astype("timedelta64[ns]"))


def utc_of(stamps: TimeArray, scale: str) -> TimeArray:
    """UTC of calendar stamps (N,) in `scale`: UTC, GPS, TAI or TT. NaT stays. Inverse of `stamp_in`, exact to 1 ns.

    An instant inside a leap second has no stamp of its own; it gets that of the midnight after it.
    """
    if scale == "UTC":
        return stamps
    tai = stamps - np.timedelta64(round(_AHEAD_OF_TAI_S[scale] * 1e9), "ns")
    at, seconds = _steps()
    ahead = np.rint(seconds * 1e9).astype("int64").astype("timedelta64[ns]")
    past = np.searchsorted(at + ahead[1:], tai, side="right")  # leap seconds that are over
    limit = np.append(at, np.datetime64(f"{_LAST_YEAR}-12-31", "ns"))
    return np.asarray(np.minimum(tai - ahead[past], limit[past]))


def decimal_year(time: TimeArray | np.datetime64) -> FloatArray:
    """Calendar year plus the fraction of that year (365 or 366 days) gone by. Shape (N,)."""
    stamps = as_times(time)
    years = stamps.astype("datetime64[Y]")
    start = years.astype("datetime64[ns]")
    length = (years + np.timedelta64(1, "Y")).astype("datetime64[ns]") - start
    fraction = (stamps - start).astype("int64") / length.astype("int64")
    return np.asarray(years.astype("int64") + 1970.0 + fraction)


def days_mjd2000(time: TimeArray | np.datetime64) -> FloatArray:
    """Days since 2000-01-01 0 h UTC, leap seconds not counted: the clock of the field models. Shape (N,)."""
    return (as_times(time) - MJD2000).astype("int64") / _NS_PER_DAY


def years(count: float) -> np.timedelta64:
    """So many years of 365.25 days."""
    return np.timedelta64(round(count * (365.25 * 86400e9)), "ns")


def iso(time: np.datetime64, unit: str = "s") -> str:
    """ISO 8601 with a Z, cut to `unit`."""
    return f"{np.datetime_as_string(np.datetime64(time, 'ns'), unit=unit)}Z"  # type: ignore[call-overload]


def _leap_seconds(stamps: TimeArray) -> FloatArray:
    """TAI - UTC [s] at each stamp; constant 10 s before 1972 so that elapsed time stays smooth."""
    at, seconds = _steps()
    return seconds[np.searchsorted(at, stamps, side="right")]


@cache
def _steps() -> tuple[TimeArray, FloatArray]:
    """When TAI - UTC changed since 1972, M stamps, and its M + 1 values before, between and after [s]; ERFA's table."""
    table = erfa.leap_seconds.get()
    table = table[table["year"] >= 1972]
    at = np.array([f"{year:04d}-{month:02d}-01" for year, month in table[["year", "month"]]], dtype="datetime64[ns]")
    return at, np.concatenate([[10.0], table["tai_utc"]])
