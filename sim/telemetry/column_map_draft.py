"""A first column map from the header of a foreign file: what is plain is written, what was guessed is marked so."""

from __future__ import annotations

import itertools
import json
import re
from collections.abc import MutableMapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from fluxtwin.sim.base.errors import BadInput
from fluxtwin.sim.base.limits import MAX_SAMPLES
from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.telemetry.column_map_draft_time import text_format
from fluxtwin.sim.telemetry.column_map_values import from_lists
from fluxtwin.sim.telemetry.csv_files import CsvFile, open_csv
from fluxtwin.sim.telemetry.formats.catalogue import table_of
from fluxtwin.sim.telemetry.formats.table import Table
from fluxtwin.sim.telemetry.netcdf_files import NetcdfFile
from fluxtwin.sim.telemetry.quantities import BY_MAP_NAME

CONFIRM = "# to be confirmed:"
_AXES = (("x", "y", "z"), ("1", "2", "3"), ("0", "1", "2"))
_QUATERNIONS = (
    ("xyzw", ("x", "y", "z", "w"), False),
    ("wxyz", ("w", "x", "y", "z"), False),
    ("xyzw", ("1", "2", "3", "4"), True),
    ("wxyz", ("0", "1", "2", "3"), True),
    ("xyzw", ("i", "j", "k", "r"), False),
)
"""Order that the endings of four names suggest, and whether that is a guess."""
_UNIT_NAMES = {
    word: unit
    for unit, words in {
        "nT": "nt",
        "uT": "ut",
        "mG": "mg",
        "G": "g gauss",
        "T": "t",
        "km": "km",
        "m": "m",
        "km/s": "kms",
        "m/s": "ms",
        "deg/s": "degs dps",
        "rad/s": "rads",
        "degC": "degc c",
        "K": "k",
        "rpm": "rpm",
        "Am2": "am2",
    }.items()
    for word in words.split()
}
_FRAME_WORDS = {
    "ecef itrf itrs": "ITRS",
    "gcrs gcrf": "GCRS",
    "j2000": "J2000",
    "teme": "TEME",
    "tod": "TOD",
    "gei": "GEI",
    "eci": "ECI",
    "nec": "NEC",
    "lvlh orb": "orbital",
}
"""Frame by the words that a name may have; the first that fits counts."""
_KINDS = (
    ("mag", re.compile(r"mag|(^|_)b(_|$)|fgm|tam|field|^b$|bfield")),
    ("velocity", re.compile(r"vel|^v(_|$)|(_|^)v$")),
    ("position", re.compile(r"pos|ecef|eci|^r(_|$)|(_|^)r$|orbit|gps|gnss")),
    ("rate", re.compile(r"rate|gyr|omega|angvel|^w(_|$)")),
    ("dipole", re.compile(r"dipole|mtq|torquer")),
    ("sun", re.compile(r"sun")),
    ("nadir", re.compile(r"nadir")),
)
_SIZES = {
    "mag": (("nT", 1e3, 2e5), ("mG", 100.0, 1e3), ("uT", 5.0, 100.0), ("G", 0.08, 1.0), ("T", 5e-6, 1e-4)),
    "position": (("m", 6e6, 1e9), ("km", 6e3, 1e6)),
    "velocity": (("m/s", 300.0, 12e3), ("km/s", 0.3, 12.0)),
}
"""Typical sizes of a vector by unit: a guess where the name says none."""
_SAMPLE = 2000
_FILLS = (-9999.0, -99999.0, -999.0, 9999.0, 99999.0, 65535.0, 32767.0, -32768.0, 1e31, -1e31)
"""What programs write where there is nothing."""


@dataclass
class Header:
    """Names of the columns of one file, and numbers of a few rows."""

    path: Path
    names: list[str]
    values: MutableMapping[str, FloatArray] = field(default_factory=dict)
    """Columns (n,) or variables (n, k) that are numbers."""
    iso: list[str] = field(default_factory=list)
    """Columns of ISO 8601 stamps."""
    cf: list[str] = field(default_factory=list)
    """NetCDF variables with units "... since"."""
    units: dict[str, str] = field(default_factory=dict)
    rows: int = 0
    texts: dict[str, list[str]] = field(default_factory=dict)
    """Some cells of the columns of a CSV as they stand."""


def draft(paths: Sequence[Path | str]) -> str:
    """The text of a column map for the files, one `[[file]]` each; guesses stand behind comments.

    Raises BadInput for a file that cannot be read, or where no magnetometer or no time is found.
    """
    headers = [header_of(Path(path)) for path in paths]
    parts = [
        "# A first column map. Whatever was guessed says so: look at it, mend it, delete the comment.",
        f"# Then: fluxtwin check {_shown(headers)} --map THIS.toml",
    ]
    seen: set[str] = set()
    for header in headers:
        lines = _file(header, named=len(headers) > 1, seen=seen)
        parts += ["", *lines]
    if "mag" not in seen:
        listed = ", ".join(header.path.name for header in headers)
        raise BadInput(
            "no three columns look like a magnetometer",
            where=listed,
            wanted='names such as mag_x mag_y mag_z; or write `mag = { from = ["a", "b", "c"], unit = "nT" }` yourself',
        )
    if "position" not in seen:
        parts.insert(2, '# No positions were found: give two-line elements, `tle = "satellite.tle"` on the next line.')
    return "\n".join(parts) + "\n"


def _shown(headers: list[Header]) -> str:
    return str(headers[0].path if len(headers) == 1 else headers[0].path.parent)


def _file(header: Header, *, named: bool, seen: set[str]) -> list[str]:
    lines = ["[[file]]"]
    if named:
        lines.append(f"path = {json.dumps(header.path.name)}")
    recipe, used, doubt = _time(header)
    lines += [f"{CONFIRM} {doubt}"] * bool(doubt) + [f"time = {recipe}", "[file.columns]"]
    free = [name for name in header.names if name not in used]
    for quantity, columns, keys, doubts in _quantities(header, free):
        source = columns[0] if len(columns) == 1 else columns
        inner = ", ".join(
            [f"from = {json.dumps(source)}", *(f"{key} = {json.dumps(value)}" for key, value in keys.items())]
        )
        if quantity in seen:
            another = f"; if of another sensor: mag2 = {{ {inner} }}" if quantity == "mag" else ""
            lines.append(f"# left out, a second {quantity}: {', '.join(columns)}{another}")
            continue
        seen.add(quantity)
        lines += [f"{CONFIRM} {text}" for text in doubts]
        lines.append(f"{quantity} = {{ {inner} }}")
        used |= set(columns)
    rest = [name for name in header.names if name not in used]
    if rest:
        lines.append(f"# not used: {', '.join(rest[:30])}{' ...' if len(rest) > 30 else ''}")
    return lines


def _time(header: Header) -> tuple[str, set[str], str]:
    """The recipe, the columns it takes, and what is doubtful in it."""
    if header.cf:
        return f'{{ recipe = "cf", columns = {json.dumps(header.cf[0])} }}', {header.cf[0]}, ""
    likely = re.compile(r"time|date|utc|stamp|epoch|unix|^t$|^ts|sec|week|tow", re.IGNORECASE)
    for name in sorted(header.iso, key=lambda one: not likely.search(one)):
        return f'{{ recipe = "iso", columns = {json.dumps(name)} }}', {name}, ""
    written = text_format(header.texts)
    if written is not None:
        names, form, doubt = written
        return f'{{ recipe = "text", columns = {json.dumps(names)}, format = {json.dumps(form)} }}', set(names), doubt
    week = [n for n in header.values if re.search(r"week", n, re.IGNORECASE)]
    tow = [n for n in header.values if re.search(r"tow|week.*sec|sec.*week|seconds_of", n, re.IGNORECASE)]
    if week and tow and week[0] != tow[-1]:
        text = f'{{ recipe = "gps_week_tow", columns = {json.dumps([week[0], tow[-1]])} }}'
        return text, {week[0], tow[-1]}, "the week counts from 1980 (no roll-over), seconds of week are GPS time"
    for name, value in sorted(header.values.items(), key=lambda one: not likely.search(one[0])):
        size = float(np.nanmedian(value)) if value.ndim == 1 and likely.search(name) else 0.0
        if re.search("gps", name, re.IGNORECASE) and 6.0e8 < size < 4.0e9:
            doubt = f"{name} looks like seconds of GPS time since 1980"
            return f'{{ recipe = "gps_s", columns = {json.dumps(name)} }}', {name}, doubt
        for recipe, unit in (("unix_us", 1e6), ("unix_ms", 1e3), ("unix_s", 1.0)):
            if 2.0e8 * unit < size < 4.0e9 * unit:
                nano = [n for n in header.values if n != name and re.search(r"ns$|nano", n, re.IGNORECASE)]
                doubt = f"{name} looks like Unix time; that it is UTC, and the spacecraft's own stamp, is a guess"
                if recipe == "unix_s" and nano and re.search("time|stamp|ns", nano[0], re.IGNORECASE):
                    text = f'{{ recipe = "seconds_ns", columns = {json.dumps([name, nano[0]])} }}'
                    return text, {name, nano[0]}, doubt
                return f'{{ recipe = "{recipe}", columns = {json.dumps(name)} }}', {name}, doubt
    counted = [n for n, value in header.values.items() if likely.search(n) and value.ndim == 1]
    if counted:
        text = f'{{ recipe = "seconds_since", columns = {json.dumps(counted[0])}, epoch = "2000-01-01T12:00:00Z" }}'
        return text, {counted[0]}, f"the epoch from which {counted[0]} counts seconds is not known"
    raise BadInput(
        f"no column looks like time; the columns are: {', '.join(header.names[:12])}",
        where=str(header.path),
        wanted="ISO 8601 stamps, Unix time, GPS week and seconds, or seconds since an epoch",
    )


_Found = tuple[str, list[str], dict[str, object], list[str]]


def _quantities(header: Header, free: list[str]) -> list[_Found]:
    """Quantity, columns, keys of the map, doubts."""
    out: list[_Found] = []
    quaternion = _quaternion(header, free)
    if quaternion is not None:
        out.append(quaternion)
        free = [name for name in free if name not in quaternion[1]]
    for columns in _triples(header, free):
        stem = _stem(columns)
        for quantity, pattern in _KINDS:
            if pattern.search(stem):
                out.append(_vector(header, quantity, columns))
                break
    if not any(one[0] == "position" for one in out):
        out += _place(header, free)
    taken = {name for _, columns, _, _ in out for name in columns}
    for name in free:
        low = name.lower()
        if name in taken or name not in header.values or header.values[name].ndim != 1:
            continue
        if re.search(r"temp", low) and "temperature" not in [one[0] for one in out]:
            hot = float(np.nanmedian(header.values[name])) > 150.0
            unit = "K" if hot else "degC"
            out.append(
                ("temperature", [name], {"unit": unit}, [f"the unit of {name}, and that it is the magnetometer's"])
            )
        elif low in ("sunlit", "sunlit_flag", "in_sun"):
            out.append(("sunlit", [name], {}, []))
    return sorted(out, key=lambda one: one[0] != "mag")


def _place(header: Header, free: list[str]) -> list[_Found]:
    """A position by latitude, longitude and height, if names say so."""
    found: list[str] = []
    for pattern in (r"lat", r"lon", r"alt|height|radius"):
        likely = [n for n in free if re.search(pattern, n.lower()) and header.values.get(n, np.empty((0, 2))).ndim == 1]
        if not likely:
            return []
        found.append(likely[0])
    size = float(np.nanmedian(np.abs(header.values[found[2]])))
    frame = "geocentric" if "radius" in found[2].lower() else "geodetic"
    unit = "m" if size > 1e5 else "km"
    doubts = [f"position: {frame} (geodetic: latitude and altitude above WGS 84; geocentric: radius) in {unit}"]
    return [("position", found, {"unit": unit, "frame": frame}, doubts)]


def _triples(header: Header, free: list[str]) -> list[list[str]]:
    """Three columns whose names differ in one place by x y z, 1 2 3 or 0 1 2; or one variable of three components."""
    out = [[name] for name in free if name in header.values and header.values[name].shape[1:] == (3,)]
    known, taken = {name.lower(): name for name in free}, set[str]()
    for name in free:
        for axes in _AXES:
            for place in [m.start() for m in re.finditer(re.escape(axes[0]), name.lower())]:
                others = [f"{name.lower()[:place]}{axis}{name.lower()[place + 1 :]}" for axis in axes]
                if all(o in known and known[o] in header.values for o in others) and not taken & set(others):
                    taken |= set(others)
                    out.append([known[o] for o in others])
    return out


def _quaternion(header: Header, free: list[str]) -> _Found | None:
    known = {name.lower(): name for name in free}
    for name, (order, ends, guess) in itertools.product(free, _QUATERNIONS):
        for place in [m.start() for m in re.finditer(re.escape(ends[0]), name.lower())]:
            others = [f"{name.lower()[:place]}{end}{name.lower()[place + 1 :]}" for end in ends]
            columns = [known[o] for o in others if o in known]
            if len(columns) == 4 and "q" in name.lower() and _is_unit(header, columns):
                return _attitude(columns, order, guess)
    for name in free:
        if header.values.get(name, np.empty(0)).shape[1:] == (4,) and _is_unit(header, [name]):
            return _attitude([name], "xyzw", True)
    return None


def _attitude(columns: list[str], order: str, guess: bool) -> _Found:
    frame = _frame(_stem(columns))
    doubts = [f"order (is the scalar {'last' if order == 'xyzw' else 'first'}?)"] if guess else []
    doubts.append("sense (body relative to the reference, as Wertz; else sense = 'conjugate')")
    if frame is None:
        doubts.append("relative_to: GCRS J2000 true_of_date ITRS NEC or orbital; `fluxtwin check` tells which fits")
    text = "attitude: " + "; ".join(doubts)
    return "attitude", columns, {"order": order, "relative_to": frame or "GCRS"}, [text]


def _is_unit(header: Header, columns: list[str]) -> bool:
    if not all(column in header.values for column in columns):
        return False
    size = np.linalg.norm(_stacked(header, columns), axis=1)
    return bool(np.nanmedian(np.abs(size - 1.0)) < 0.02)


def _vector(header: Header, quantity: str, columns: list[str]) -> _Found:
    doubts: list[str] = []
    keys: dict[str, object] = {}
    size = float(np.nanmedian(np.linalg.norm(_stacked(header, columns), axis=1)))
    if quantity not in ("sun", "nadir"):
        stated = _stated_unit(header, quantity, columns)
        likely = [unit for unit, low, high in _SIZES.get(quantity, ()) if low <= size <= high]
        default = {"mag": "nT", "position": "km", "velocity": "km/s", "rate": "deg/s", "dipole": "Am2"}[quantity]
        keys["unit"] = stated or (likely[0] if likely else default)
        if stated is None:
            why = f"median size {size:.4g}" + (
                "" if likely else ", which fits no unit: counts? then add scale = nT per count"
            )
            doubts.append(f"{quantity}: the unit ({why})")
    fill = [value for value in _FILLS if (_stacked(header, columns) == value).any()]
    if fill:
        keys["fill"] = fill
        doubts.append(f"{quantity}: that {', '.join(map(repr, fill))} means missing")
    if quantity in ("position", "velocity"):
        frame = _frame(_stem(columns))
        keys["frame"] = frame or "GCRS"
        if frame is None:
            doubts.append(f"{quantity}: the frame (GCRS J2000 true_of_date ITRS)")
    return quantity, columns, dict(keys), doubts


def _stated_unit(header: Header, quantity: str, columns: list[str]) -> str | None:
    said = header.units.get(columns[0], "")
    words = [said, *re.split(r"[_\[\]() ]+", columns[0])[1:], "".join(re.split(r"[_/\[\]() ]+", columns[0])[-2:])]
    for word in words:
        unit = _UNIT_NAMES.get(re.sub(r"[^a-z0-9]", "", word.lower()))
        if quantity in BY_MAP_NAME and unit in BY_MAP_NAME[quantity].map_units:
            return unit
    return None


def _frame(stem: str) -> str | None:
    return next((frame for words, frame in _FRAME_WORDS.items() if any(w in stem for w in words.split())), None)


def _stem(columns: list[str]) -> str:
    """What the names have in common, in lower case, with marks between words."""
    first = columns[0]
    if len(columns) > 1:
        place = next((i for i, pair in enumerate(zip(*columns, strict=False)) if len(set(pair)) > 1), len(first))
        first = first[:place] + "_" + first[place + 1 :]
    return re.sub(r"[^a-z0-9]+", "_", re.sub(r"([a-z])([A-Z])", r"\1_\2", first).lower()).strip("_")


def _stacked(header: Header, columns: list[str]) -> FloatArray:
    parts = [header.values[column] for column in columns]
    return parts[0] if len(parts) == 1 and parts[0].ndim == 2 else np.stack(parts, axis=1)


def header_of(path: Path) -> Header:
    """The header of a file and numbers of its first rows. Raises BadInput for a file that cannot be read."""
    if path.name.lower().endswith((".nc", ".nc4", ".h5")):
        with NetcdfFile(path) as opened:
            return _netcdf_header(path, opened)
    if (table := table_of(path, MAX_SAMPLES)) is not None:
        return _table_header(path, table)
    csv = open_csv(path)
    found = Header(path, list(csv.names), rows=csv.rows)
    for name in csv.names:
        _look(csv, name, found)
    return found


def _look(csv: CsvFile, name: str, header: Header) -> None:
    """Whether a column holds numbers or stamps."""
    text = csv.text(name)[:_SAMPLE]
    header.texts[name] = [cell.decode("utf-8", "replace").strip() for cell in text[:20].tolist() if cell.strip()]
    if any(re.match(rb"\s*\d{4}-\d\d-\d\d[T ]\d\d:", bytes(cell)) for cell in text[:20]):
        header.iso.append(name)
        return
    try:
        header.values[name] = np.array([float(cell) if cell.strip() else np.nan for cell in text.tolist()])
        return
    except ValueError:
        pass
    try:
        listed = from_lists(csv.text(name, width=400)[:_SAMPLE], name, csv.where)
    except BadInput:
        return
    if listed.shape[1] in (3, 4):
        header.values[name] = listed


def _table_header(path: Path, table: Table) -> Header:
    found = Header(path, table.names(), units=dict(table.units))
    for name, value in table.columns.items():
        found.rows = max(found.rows, len(value))
        if value.dtype.kind == "M":
            found.cf.append(name)
        elif value.dtype.kind == "S":
            found.iso += (
                [name] if any(re.match(rb"\s*\d{4}-\d\d-\d\d[T ]\d\d:", cell) for cell in value[:20].tolist()) else []
            )
        elif value.ndim <= 2:
            found.values[name] = np.asarray(value[:_SAMPLE], dtype=np.float64)
    return found


def _netcdf_header(path: Path, opened: NetcdfFile) -> Header:
    header = Header(path, list(opened.names()))
    for name in header.names:
        units = str(opened.attributes(name).get("units", ""))
        header.units[name] = units
        if " since " in units:
            header.cf.append(name)
            continue
        try:
            value = np.asarray(opened.numbers(name))
        except BadInput:
            continue
        if value.ndim in (1, 2) and len(value):
            header.values[name] = value[:_SAMPLE]
            header.rows = max(header.rows, len(value))
    return header
