"""How stamps are made of the columns of a foreign file: a recipe is a row of `COUNTED`, or text.

A recipe that counts makes calendar stamps in its own time scale, days of 86,400 s without leap seconds; only then are they
taken to UTC. So GPS, TAI, TT and Unix time are one sum, and the leap seconds come in at one place (`epoch.utc_of`).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from fluxtwin.sim.base.types import FloatArray, TimeArray
from fluxtwin.sim.earth import epoch

if TYPE_CHECKING:
    from fluxtwin.sim.telemetry.column_map import TimeRecipe

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
    "seconds_since": Counted((1.0,), None, "UTC"),
}
_JD_OF_ORIGIN = 2_400_000.0
"""Day that `jd` is counted from: the origin above, 1858-11-16T12:00."""
NAMES = (*TEXT, *COUNTED)


def stamps(raw: FloatArray, recipe: TimeRecipe) -> TimeArray:
    """UTC stamps (N,) of the counts (N, k), the columns of `recipe`; NaN and what is far beyond any mission become NaT."""
    how = COUNTED[recipe.recipe]
    parts = raw - _JD_OF_ORIGIN if recipe.recipe == "jd" else raw
    scale, units_s = recipe.scale or how.scale, tuple(recipe.unit_s or how.units_s)
    if how.origin is not None:
        return epoch.utc_of(_added(how.origin, parts, units_s), scale)
    origin = epoch.parse_time(str(recipe.epoch), where="column map: epoch")
    if scale != "UTC":
        return epoch.utc_of(_added(origin, parts, units_s), scale)
    in_tai = epoch.stamp_in(origin, "TAI")[0]  # SI seconds since a UTC instant, leap seconds counted
    return epoch.utc_of(_added(in_tai, parts, units_s), "TAI")


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


Texts = Callable[[str], np.ndarray]


def joined(text: Texts, names: list[str]) -> np.ndarray:
    """The columns as one text (N,) of bytes, a blank between them; blank where all of them are."""
    if len(names) == 1:
        return text(names[0])
    cells = zip(*(text(name).tolist() for name in names), strict=True)
    return np.array([b" ".join(part.strip() for part in row).strip() for row in cells], dtype=np.bytes_)
