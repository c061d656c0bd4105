"""Local times: zones by their offset (`+02:00`) or by their name (`Europe/Berlin`), with summer time."""

from __future__ import annotations

import re
from datetime import datetime, timedelta, timezone, tzinfo
from zoneinfo import ZoneInfo, ZoneInfoNotFoundError

import numpy as np

from fluxtwin.sim.base.errors import BadInput
from fluxtwin.sim.base.types import TimeArray

AHEAD = r"[Zz]|UTC|[+-](?:0\d|1[0-4])(?::?[0-5]\d)?"  # from -12:00 to +14:00 are in use
_STEP = np.timedelta64(15, "m")
"""Zones change at full quarters of an hour."""


def minutes(offset: str | None) -> int:
    """Minutes that an offset is ahead of UTC."""
    if offset is None or offset in ("Z", "z", "UTC"):
        return 0
    digits = offset[1:].replace(":", "").ljust(4, "0")
    return (-1 if offset[0] == "-" else 1) * (60 * int(digits[:2]) + int(digits[2:]))


def named(zone: str) -> tzinfo:
    """The zone of that offset or name. Raises BadInput for one that is not known."""
    if re.fullmatch(AHEAD, zone):
        return timezone(timedelta(minutes=minutes(zone)))
    try:
        return ZoneInfo(zone)
    except (ZoneInfoNotFoundError, ValueError, OSError):
        wanted = "'+02:00' or a name of the IANA list, as 'Europe/Berlin' (pip install tzdata where no name is known)"
        raise BadInput(f"{zone[:40]!r} is not known", where="zone", wanted=wanted) from None


def utc(local: TimeArray, zone: str | None, where: str) -> TimeArray:
    """UTC of local stamps (N,) in the order of the file; NaT stays. zone None: they are UTC.

    The hour that comes twice in autumn is divided at the one step back in its stamps. Raises BadInput, with the row, where
    there is none, and for an hour that summer time skips.
    """
    if zone is None or not local.size:
        return local
    known, there = named(zone), np.flatnonzero(~np.isnat(local))
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
