"""A guess at the recipe for time of a foreign file, by the names and the sizes of its columns."""

from __future__ import annotations

import itertools
import json
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from datetime import datetime
from functools import cache

import numpy as np

from fluxtwin.sim.base.errors import BadInput
from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.telemetry.column_map_draft_header import Header
from fluxtwin.sim.telemetry.time_stamps import unix_of_size

_LIKELY = re.compile(
    r"time|date|utc|tai|stamp|epoch|unix|zeit|year|jahr|(^|_)yr|^t($|\W|_)|^ts|sec|week|tow|sow|clock|sclk|obt|t_?tag|(^|_)(met|jd|sod|et)(_|$)",
    re.IGNORECASE,
)
_WEEK = re.compile(r"week|(^|_)sem(_|$)|(^|_)(gps_?)?(wn|wno|wk)(_|$)|(^|_)gpsw(_|$)", re.IGNORECASE)
_OF_WEEK = re.compile(r"tow|sow|(^|_)sec_sem|week.*sec|sec.*week|seconds?_?of|gps_?s(ec(onds?)?)?(_|$)", re.IGNORECASE)
_WEEK_S = 604800.0
_GROUND = re.compile(r"rece|ground|arriv|download|(^|_)rx(_|$)", re.IGNORECASE)
_COUNTS = (
    ("mjd", r"mjd", 3.0e4, 7.0e4, "that these days are UTC"),
    ("jd", r"jd|jul", 2.43e6, 2.47e6, "that these days are UTC"),
    ("mjd2000", r"mjd|2000|2k", 3.0e3, 2.0e4, "that these are days of UTC since 2000"),
    ("gps_s", r"gps", 6.0e8, 4.0e9, "{} looks like seconds of GPS time since 1980"),
    ("tai_s", r"tai", 1.5e9, 4.0e9, "{} looks like seconds of TAI since 1958"),
    ("j2000_s", r"j2000|j2k|(^|_)et(_|$)|tdb", 1.0e8, 3.0e9, "{} looks like seconds since 2000-01-01 12:00 TT"),
)
"""Recipes that a name states: what is in it, the smallest and largest median, what is doubtful."""
_DAYS = (
    ("jd", 2.4425e6, 2.49e6, "of the Julian date"),
    ("datenum", 7.2145e5, 7.67e5, "of MATLAB's datenum"),
    ("mjd", 51544.0, 9.0e4, "of the modified Julian date"),
    ("excel", 27760.0, 51544.0, "of a spreadsheet, from 1899-12-30"),
)
"""Counts of days by their size: the first and last of 1976 to about 2100. The last two share numbers: 51,544 is the year
2000 as the one and 2041 as the other, and that is where one is taken for the other."""
_CALENDAR = {
    "%Y": r"y(ea)?r|y{4}|jahr",
    "%m": r"mon(th)?|mo|monat",
    "%d": r"d(ay)?|dd|dom|tag",
    "%j": r"doy|day_?of_?y(ea)?r|yday|jday",
    "%H": r"h(ou)?rs?|hh?|stunde",
    "%M": r"min(ute)?s?|mi|mm",
    "%S": r"s(ec(ond)?s?)?|ss",
}
"""Names of columns that hold one part of a date and time each."""
_DATES = (
    "%Y-%m-%d",
    "%Y/%m/%d",
    "%d/%m/%Y",
    "%m/%d/%Y",
    "%d.%m.%Y",
    "%Y%m%d",
    "%Y-%j",
    "%Y/%j",
    "%Y:%j",
    "%d-%b-%Y",
    "%d %b %Y",
)
_TIMES = ("%H:%M:%S.%f", "%H:%M:%S", "%I:%M:%S %p", "%I:%M:%S.%f %p", "%H:%M", "%I:%M %p")
"""With %I: of a 12-hour clock."""
_ENDS = ("", "Z", " %z", "%z")
_BETWEEN = (" ", "T", "-", "_", ":", "/")
_FASTEST_S = 0.01  # between readings; as days it would be a quarter of an hour
_FEW = 0.01  # steps back, of all: a packet that was sent twice, not a number that swings


_Found = tuple[str, set[str], str]
"""The recipe as it stands in a map, the columns that it takes, and what is doubtful in it."""


def recipe(header: Header) -> _Found:
    """Raises BadInput where no column looks like time."""
    if header.cf:
        return _recipe("cf", header.cf[:1], "")
    for name in sorted(header.iso, key=lambda one: not _LIKELY.search(one)):
        ground = f"that {name} is the spacecraft's own stamp, not that of the ground" if _GROUND.search(name) else ""
        return _recipe("iso", [name], ground)
    written = text_format(header.texts) or _parts(header.texts)
    if written is not None:
        names, form, doubt = written
        return _recipe("text", names, doubt, format=form)
    numbers = {name: value for name, value in header.values.items() if value.ndim == 1 and np.isfinite(value).any()}
    found = _weeks(numbers) or _stated(numbers) or _unix(numbers) or _days(numbers) or _years(numbers, header.texts)
    found = found or _counted(numbers)
    if found is None:
        raise BadInput(
            f"no column looks like time; the columns are: {', '.join(header.names[:12])}",
            where=str(header.path),
            wanted="ISO 8601 stamps, Unix time, GPS week and seconds, or seconds since an epoch",
        )
    return found


def _recipe(how: str, columns: list[str], doubt: str, **more: object) -> _Found:
    shown = {"recipe": how, "columns": columns if len(columns) > 1 else columns[0], **more}
    return f"{{ {', '.join(f'{key} = {json.dumps(value)}' for key, value in shown.items())} }}", set(columns), doubt


def _weeks(numbers: Mapping[str, FloatArray]) -> _Found | None:
    """GPS week and second of week."""
    weeks = [n for n, v in numbers.items() if _WEEK.search(n) and np.nanmax(v) < 1e4 and not np.any(v % 1.0 > 0.0)]
    seconds = [n for n, v in numbers.items() if _OF_WEEK.search(n) and np.nanmin(v) >= 0.0]
    for (week, second), unit_s in itertools.product(itertools.product(weeks, seconds), (1.0, 1e-3)):
        if week != second and np.nanmax(numbers[second]) * unit_s <= _WEEK_S:
            doubt = "the week counts from 1980 (no roll-over), seconds of week are GPS time"
            unit = {} if unit_s == 1.0 else {"unit_s": [604800, unit_s]}
            return _recipe("gps_week_tow", [week, second], doubt, **unit)
    return None


def _stated(numbers: Mapping[str, FloatArray]) -> _Found | None:
    """A recipe that the name of a column states and its size confirms."""
    for how, word, first, last, doubt in _COUNTS:
        for name, value in numbers.items():
            of_size = first < float(np.nanmedian(value)) < last and (_runs(value) or falls(value))
            if re.search(word, name, re.IGNORECASE) and of_size:
                return _recipe(how, [name], doubt.format(name))
    return None


def _unix(numbers: Mapping[str, FloatArray]) -> _Found | None:
    """Unix time by its size: in a column with a likely name, or in any other that runs on."""
    for name in sorted(numbers, key=lambda one: not _LIKELY.search(one)):
        size = float(np.nanmedian(numbers[name])) if _LIKELY.search(name) or _runs(numbers[name]) else 0.0
        how = unix_of_size(size)
        if how is not None and not re.search("tai|2000", name, re.IGNORECASE):
            nano = [n for n in numbers if n != name and re.search(r"ns$|nano|nsec", n, re.IGNORECASE)]
            doubt = f"{name} looks like Unix time; that it is UTC, and the spacecraft's own stamp, is a guess"
            if how == "unix_s" and nano:
                return _recipe("seconds_ns", [name, nano[0]], doubt)
            return _recipe(how, [name], doubt)
    return None


def _days(numbers: Mapping[str, FloatArray]) -> _Found | None:
    """Days by their size, where seconds of that size would follow each other faster than a magnetometer is read."""
    for name, value in numbers.items():
        step = np.diff(value[np.isfinite(value)])
        if not (_LIKELY.search(name) and step.size and _runs(value) and np.median(step) < _FASTEST_S):
            continue
        for how, first, last, of in _DAYS:
            if first <= float(np.nanmedian(value)) < last:
                return _recipe(how, [name], f"{name} looks like days {of}; that they are UTC is a guess")
    return None


def _years(numbers: Mapping[str, FloatArray], texts: Mapping[str, Sequence[str]]) -> _Found | None:
    """Decimal years by their size, as `_days`; or the year and a day of the year."""
    within = {n: v for n, v in numbers.items() if np.nanmin(v) >= 1957.0 and np.nanmax(v) < 2200.0}  # the space age
    for name, value in within.items():
        step = np.diff(value[np.isfinite(value)])
        if _LIKELY.search(name) and step.size and _runs(value) and np.median(step) < _FASTEST_S / 365.0:
            decimals = max((len(cell.partition(".")[2]) for cell in texts.get(name, ())), default=0)
            digits = f" (its last digit is {10.0**-decimals * 365.0 * 86400.0:.1g} s)" if decimals else ""
            doubt = (
                f"{name} looks like decimal years{digits}; that they are UTC, and parts of 365 or 366 days, is a guess"
            )
            return _recipe("year", [name], doubt)
    years = [name for name in within if re.fullmatch(_CALENDAR["%Y"], name, re.IGNORECASE)]
    for name, value in numbers.items():
        if (
            years
            and re.fullmatch(_CALENDAR["%j"], name, re.IGNORECASE)
            and np.nanmin(value) >= 1.0
            and np.any(value % 1.0)
        ):
            return _recipe("year", [years[0], name], f"that {name} is 1.0 where the year begins, and UTC")
    return None


def _counted(numbers: Mapping[str, FloatArray]) -> _Found | None:
    """Seconds since an epoch that is not known."""
    name = next((name for name, value in numbers.items() if _LIKELY.search(name) and _runs(value)), None)
    if name is None:
        return None
    scale = next((one for one in ("TAI", "GPS", "TT") if re.search(rf"(?i)(^|_| ){one}", name)), None)
    more: dict[str, object] = {"scale": scale} if scale else {}
    part = re.search(r"(?i)[^a-z](ms(?:ec)?|us(?:ec)?|ns(?:ec)?|milli|micro|nano)", name)
    if part is not None:
        more["unit_s"] = [{"m": 1e-3, "u": 1e-6, "n": 1e-9}["u" if part[1].lower() == "micro" else part[1][0].lower()]]
    origin = "2000-01-01T12:00:00Z" if "2000" in name else "YYYY-MM-DDThh:mm:ssZ"
    doubt = f"the epoch from which {name} counts seconds is not known"
    return _recipe("seconds_since", [name], doubt, epoch=origin, **more)


def _runs(value: FloatArray) -> bool:
    """Whether the numbers never fall, and mostly rise."""
    step = np.diff(value[np.isfinite(value)])
    return bool(np.all(step >= 0.0) and np.mean(step > 0.0) > 0.5) if step.size else True


def falls(value: FloatArray) -> bool:
    """Whether the numbers run on but for a few steps back, as stamps of rows that are out of order."""
    step = np.diff(value[np.isfinite(value)])
    return bool(step.size and 0.0 < np.mean(step < 0.0) < _FEW and np.mean(step > 0.0) > 0.5)


def text_format(texts: Mapping[str, Sequence[str]]) -> tuple[list[str], str, str] | None:
    """The columns, their format as strptime has it, and what is doubtful; None where no text is a stamp.

    texts: some cells of every column of text.
    """
    for name, cells in texts.items():
        forms = ["".join(p) for p in itertools.product(_DATES, _BETWEEN, _TIMES, _ENDS)]
        found = [form for form in forms if _fits(cells, form)]
        if found:
            found.sort(key=lambda form: "%p" in form and not form.startswith("%m"))  # both are usual in America only
            return [name], found[0], _doubt(found) + _lost(cells, found[0])
    for one, other in itertools.permutations(texts, 2):
        dates = [form for form in _DATES if _fits(texts[one], form)]
        times = [f"{form}{end}" for form in _TIMES for end in _ENDS if _fits(texts[other], f"{form}{end}")]
        if dates and times:
            return [one, other], f"{dates[0]} {times[0]}", _doubt(dates)
    return None


def _parts(texts: Mapping[str, Sequence[str]]) -> tuple[list[str], str, str] | None:
    """The columns that hold one part of the stamps each, and as `text_format`."""
    at = {
        part: next((n for n in texts if re.fullmatch(form, n, re.IGNORECASE)), None) for part, form in _CALENDAR.items()
    }
    for parts in (("%Y", "%m", "%d", "%H", "%M", "%S"), ("%Y", "%j", "%H", "%M", "%S")):
        names = [name for part in parts if (name := at[part]) is not None]
        if len(names) < len(parts):
            continue
        cells = [" ".join(row) for row in zip(*(texts[name] for name in names), strict=False)]
        for form in (" ".join(parts), f"{' '.join(parts)}.%f"):
            if _fits(cells, form):
                return names, form, _doubt([form])
    return None


def _doubt(found: Sequence[str]) -> str:
    """What the format leaves open."""
    rivals = f"; it could be {found[1]} as well" if len(found) > 1 else ""
    zone = (
        ""
        if "%z" in found[0] or found[0].endswith("Z")
        else ', taken as UTC (of local times: zone = "Europe/Berlin" or "+02:00")'
    )
    return f"the format of the stamps{zone}{rivals}"


def _lost(cells: Sequence[str], form: str) -> str:
    """Words where stamps to the minute repeat."""
    lost = "%M" in form and "%S" not in form and len(set(cells)) < len(cells)
    return "; the stamps repeat: their seconds are lost (a spreadsheet saves what it shows)" if lost else ""


def _fits(cells: Sequence[str], form: str) -> bool:
    # strptime makes a pattern anew for nearly each of some hundred formats, a millisecond each: few are in question.
    if not cells or not _literals(form) <= Counter(cells[0].upper()):
        return False
    try:
        return all(datetime.strptime(cell, form) for cell in cells)
    except ValueError:
        return False


@cache
def _literals(form: str) -> Counter[str]:
    """The characters that stand in a stamp as they stand in its format, in either case; blanks stand for any number."""
    return Counter(re.sub(r"%[A-Za-z]|\s", "", form).upper())
