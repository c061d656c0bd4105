"""A first column map from the header of a foreign file: what is plain is written, what was guessed is marked so."""

from __future__ import annotations

import itertools
import json
import re
import shlex
from collections.abc import Sequence
from dataclasses import replace
from fnmatch import fnmatchcase
from pathlib import Path

import numpy as np

from fluxtwin.sim.base.errors import BadInput
from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.telemetry.column_map_draft_header import FILLS, Header, fill_values, headers_of
from fluxtwin.sim.telemetry.column_map_draft_time import falls, recipe
from fluxtwin.sim.telemetry.column_map_words import FRAMES, POSITIONS, canonical
from fluxtwin.sim.telemetry.columns import TORQUER
from fluxtwin.sim.telemetry.formats.catalogue import READ, format_of
from fluxtwin.sim.telemetry.quantities import BY_MAP_NAME

CONFIRM = "# to be confirmed:"
_AXES = (("x", "y", "z"), ("1", "2", "3"), ("0", "1", "2"), ("u", "v", "w"), ("a", "b", "c"))
_QUATERNIONS = (
    ("xyzw", ("x", "y", "z", "w"), False),
    ("wxyz", ("w", "x", "y", "z"), False),
    ("wxyz", ("s", "1", "2", "3"), False),
    ("wxyz", ("s", "x", "y", "z"), False),
    ("wxyz", ("s", "v1", "v2", "v3"), False),
    ("wxyz", ("s", "vx", "vy", "vz"), False),
    ("xyzw", ("x", "y", "z", "s"), False),
    ("xyzw", ("1", "2", "3", "4"), True),
    ("wxyz", ("0", "1", "2", "3"), True),
    ("xyzw", ("i", "j", "k", "r"), False),
    ("xyzw", ("i", "j", "k", "s"), False),
    ("wxyz", ("w", "i", "j", "k"), False),
    ("wxyz", ("a", "b", "c", "d"), True),
)
"""Order that the endings of four names suggest, and whether that is a guess."""
_UNIT_NAMES = {
    word: unit
    for unit, words in {
        "nT": "nt nanotesla",
        "uT": "ut microtesla",
        "mG": "mg milligauss mgauss",
        "G": "g gauss",
        "T": "t tesla",
        "km": "km",
        "m": "m",
        "km/s": "kms kmps",
        "m/s": "ms mps",
        "deg/s": "degs dps degps",
        "rad/s": "rads radps",
        "degC": "degc c",
        "K": "k",
        "rpm": "rpm",
        "Am2": "am2",
    }.items()
    for word in words.split()
}
_FRAME_WORDS = {
    "ecef ecf itrf itrs wgs": "ITRS",
    "gcrs gcrf": "GCRS",
    "j2000 j2k eme2000": "J2000",
    "teme": "TEME",
    "tod": "TOD",
    "gei": "GEI",
    "eci": "ECI",
    "nec": "NEC",
    "lvlh orb": "orbital",
}
"""Frame by the words that a name may have; the first that fits counts."""
_KINDS = (
    ("dipole", re.compile(rf"^(?!.*(pct|percent|duty|pwm)).*(dipole|{TORQUER})")),
    ("mag", re.compile(r"mag|fgm|tam|field|fluxgate|compass|mtm|mgm|hmc|rm3100|lis3mdl|bmm|mmc5")),
    ("rate", re.compile(r"rate|gyr|omega|ang_?vel")),
    ("velocity", re.compile(r"vel|(gps|gnss|orb|sc|sat|eci|ecef)v(_|$)")),
    ("sun", re.compile(r"sun")),
    ("nadir", re.compile(r"nadir")),
    ("mag", re.compile(r"(^|_)b(_|$)")),
    ("velocity", re.compile(r"(^|_)v(_|$)")),
    ("rate", re.compile(r"(^|_)w(_|$)")),
    ("position", re.compile(r"pos|ecef|eci|teme|itr[fs]|gcr[fs]|j2000|(^|_)r(_|$)|orb|gps|gnss")),
)
"""What the name of three columns without their axes says; the first that fits counts."""
_LIKELY = (
    ("mag", re.compile(r"^(m|h|f)(_[a-z]*|$)|(^|_)(mg|mgn|fg|fm|bf|mm\d?|raw)(_|$)")),
    ("velocity", re.compile(r"^(km_?s|m_?s|kmps|mps)$|(^|_)state_?v(_|$)")),
    ("position", re.compile(r"^(km|m|)$|(^|_)(p|sc|sat|xyz|state|cis|geo|coord[a-z]*|loc[a-z]*|s)(_|$)")),
    ("rate", re.compile(r"(^|_)(om|g|gy|imu)(_|$)")),
    ("dipole", re.compile(r"(^|_)(dip|mt|mtr|tq|trq|rod)(_|$)")),
)
"""Likewise where no other columns of the file are that quantity; a guess."""
_ELSEWHERE = re.compile(r"igrf|wmm|model|pred|expect|eci|j2000|gcr[sf]|inertial|teme|(^|_)ned(_|$)")
"""Of vectors that are no readings in body axes."""
_NO_STATE = re.compile(r"(^|_)(ref|err|error|bias|innov|tgt|target|std)(_|$)|std_dev|sigma|desired")
"""Of numbers about a quantity that are not the quantity."""
_ATTITUDE = re.compile(r"q|att|eul|(^|_)(eps|beta)|orient", re.IGNORECASE)
"""Of four columns, or their file, that are a quaternion if they have the norm 1."""
_IN_BODY = ("mag", "rate", "dipole", "sun", "nadir")
_WHEEL = re.compile(r"^(?!.*(curr|torq|temp|duty|cmd|volt)).*(wheel|(^|_)rwa?_?\d)")
_GOOD = re.compile(r"valid|good|usable|(^|_)(ok|qual(ity)?)(_|$)", re.IGNORECASE)
_SIZES = {
    "mag": (("nT", 1e3, 2e5), ("mG", 100.0, 1e3), ("uT", 5.0, 100.0), ("G", 0.08, 1.0), ("T", 5e-6, 1e-4)),
    "position": (("m", 6e6, 1e9), ("km", 6e3, 1e6)),
    "velocity": (("m/s", 300.0, 12e3), ("km/s", 0.3, 12.0)),
    "dipole": (("Am2", 0.0, 20.0), ("mAm2", 20.0, 1e6)),
}
"""Typical sizes of a vector by unit: a guess where the name says none. Torquers of small spacecraft have up to 15 A m2."""
_SUNLIT = re.compile(r"sun_?(lit|light|flag|presen)|in_sun|illum|(?P<shadow>eclipse|shadow|umbra)")
_CURRENT = re.compile(
    r"curr|(^|_)cur(_|$)|(?<!st)amp(s|ere)?(_|$)|^i_?(sa|sol|bat|load|bus)|(^|_)i_|_i(_|$)|_m?a$|duty|pwm|pct|percent|heater|load|(^|_)on(_|$)|enabled"
)
_WHICH_FRAME = "the frame (GCRS J2000 true_of_date ITRS; `fluxtwin check` says which fits)"
_COUNTS = re.compile(r"cnt|count|adc|(^|_)raw(_|$)", re.IGNORECASE)
_MOST_A = 30.0
"""More than a small spacecraft has in one wire: then it is in mA."""
_ALIKE = 0.02
"""Share of its changes that a linear function of one magnetometer leaves of another: noise, and a few hundred nT of currents
nearby. Of position or sun it leaves 0.03 to 0.8 in the packaged scenarios."""
_FEWEST = 50  # rows, for twelve unknowns
_ELEMENTS = (".tle", ".3le")
_TABLES = (".csv", ".csv.gz", ".nc", ".nc4", ".h5", *READ)


def draft(paths: Sequence[Path | str]) -> str:
    """The text of a column map for the files, one `[[file]]` each; guesses stand behind comments.

    What is not found stands there as a comment that says how to write it. Raises BadInput for a file that cannot be read.
    """
    tables = [one for path in paths for one in _inside(Path(path))]
    headers = _alike([header for path in tables for header in headers_of(path)])
    alone = len({header.path for header in headers}) == 1 and not headers[0].pattern
    parts = [
        "# A first column map. Every guess is marked: confirm or correct it, and delete the comment.",
        f"# Then: fluxtwin check {shlex.quote(str(headers[0].path if alone else headers[0].path.parent))} --map THIS.toml",
    ]
    blocks, seen = _blocks(headers, named=len(tables) > 1, by_size=False)
    if "mag" not in seen:
        blocks, seen = _blocks(headers, named=len(tables) > 1, by_size=True)
    parts += blocks
    elements = [] if "position" in seen else _elements(paths)
    if len(elements) == 1:
        parts[2:2] = [f"{CONFIRM} that positions come from these two-line elements", f'tle = "{elements[0]}"']
    elif "position" not in seen:
        here = f", of {', '.join(elements)}" if elements else ""
        missing = "no positions were found: write `position` for columns that are not used, or here"
        parts.insert(2, f'{CONFIRM} {missing} `tle = "satellite.tle"`{here}')
    if "mag" not in seen:
        mag = 'mag = { from = ["a", "b", "c"], unit = "nT" }'
        parts.insert(
            2, f"{CONFIRM} no three columns of numbers look like a magnetometer: write `{mag}` in [file.columns]"
        )
    return "\n".join(parts) + "\n"


def _blocks(headers: list[Header], *, named: bool, by_size: bool) -> tuple[list[str], set[str]]:
    """The lines of all [[file]], and the quantities found; by_size: whether size alone may make a magnetometer."""
    parts, seen = list[str](), set[str]()
    for header in headers:
        known = len(seen)
        lines, timed = _file(header, named=named, seen=seen, by_size=by_size)
        if len(headers) > 1 and not timed and len(seen) == known:
            lines = [f"# {header.sheet or header.path.name}: left out, no column looks like time or is known"]
        parts += ["", *lines]
    return parts, seen


def _elements(paths: Sequence[Path | str]) -> list[str]:
    """Names of the files of two-line elements beside the tables."""
    folders = dict.fromkeys(path if path.is_dir() else path.parent for path in map(Path, paths))
    return sorted(one.name for folder in folders for one in folder.iterdir() if one.suffix.lower() in _ELEMENTS)


def _alike(headers: list[Header]) -> list[Header]:
    """One header for files with the same columns, where a pattern names these and no others."""
    found: list[Header] = []
    for header in headers:
        same = [one for one in headers if one.names == header.names and one.sheet == header.sheet]
        names = [one.path.name for one in same]
        pattern = f"{_common(names)}*{_common([name[::-1] for name in names])[::-1]}"
        others = [one.path.name for one in headers if one not in same]
        if len(same) == 1 or pattern.startswith("*") or any(fnmatchcase(name, pattern) for name in others):
            found.append(header)
        elif header is same[0]:
            found.append(replace(header, pattern=pattern))
    return found


def _common(names: Sequence[str]) -> str:
    return "".join(one[0] for one in itertools.takewhile(lambda one: len(set(one)) == 1, zip(*names, strict=False)))


def _inside(path: Path) -> list[Path]:
    """The tables in a folder, or the file itself."""
    if not path.is_dir() or format_of(path) is not None:
        return [path]
    found = sorted(one for one in path.iterdir() if one.name.lower().endswith(_TABLES))
    if not found:
        raise BadInput("has no tables", where=str(path), wanted=", ".join(_TABLES))
    return found


def _file(header: Header, *, named: bool, seen: set[str], by_size: bool) -> tuple[list[str], bool]:
    """The lines of one [[file]], and whether it has a time."""
    lines = ["[[file]]"]
    if named:
        lines.append(f"path = {json.dumps(header.pattern or header.path.name)}")
    if header.sheet is not None:
        lines.append(f"sheet = {json.dumps(header.sheet)}")
    if header.pattern:
        lines += [
            f"{CONFIRM} that the pieces may overlap, so that rows are sorted and repeated ones dropped",
            "sort = true",
        ]
    try:
        how, used, doubt = recipe(header)
        lines += [f"{CONFIRM} {doubt}"] * bool(doubt) + [f"time = {how}"]
    except BadInput as error:
        how, used = "", set[str]()
        lines.append(
            f"{CONFIRM} {str(error).partition(': ')[2].partition(';')[0]}: write it, by one of the recipes for time"
        )
        lines.append('# time = { recipe = "iso", columns = "NAME" }')
    if not header.pattern and any(name in header.values and falls(header.values[name]) for name in used):
        lines += [f"{CONFIRM} that rows are out of order, or repeated", "sort = true"]
    lines += _rows_that_count(header)
    lines.append("[file.columns]")
    free, here = [name for name in header.names if name not in used], dict[str, list[str]]()
    for quantity, columns, keys, doubts in _quantities(header, free, by_size=by_size):
        source = columns[0] if len(columns) == 1 else columns
        inner = ", ".join(
            [f"from = {json.dumps(source)}", *(f"{key} = {json.dumps(value)}" for key, value in keys.items())]
        )
        if (
            quantity == "mag"
            and "mag" in seen
            and "mag2" not in seen
            and ("mag" not in here or _left(header, here["mag"], columns)[0] > 1.0)
        ):
            doubts = [text.replace("mag:", "mag2:") for text in doubts]
            quantity, doubts = "mag2", ["mag2: that it is of another sensor", *doubts]
        if quantity in seen:
            another = f"; if of another sensor: mag2 = {{ {inner} }}" if quantity == "mag" else ""
            lines.append(f"# left out, a second {quantity}: {', '.join(columns)}{another}")
            continue
        seen.add(quantity)
        here[quantity] = columns
        marked = [f"{CONFIRM} {text}" for text in doubts]
        lines += [*(line for line in marked if line not in lines), f"{quantity} = {{ {inner} }}"]
        used |= set(columns)
    rest = [
        name if name in header.values else f"{name} (not all numbers{header.odd.get(name, '')})"
        for name in header.names
        if name and name not in used
    ]
    if rest:
        lines.append(f"# not used: {', '.join(rest[:30])}{' ...' if len(rest) > 30 else ''}")
    return lines, bool(how)


def _left(header: Header, columns: list[str], others: list[str]) -> tuple[float, float]:
    """What a linear function of the one vector leaves of the other, rms: in its steps, and as a share of its changes.

    Below a step it is the same reading in other units or axes, or corrected; a share well below 1 is the same field.
    """
    one, two = (_stacked(header, names) for names in (columns, others))
    both = (
        np.isfinite(one).all(axis=1) & np.isfinite(two).all(axis=1) & ~np.isin(np.hstack([one, two]), FILLS).any(axis=1)
    )
    if both.sum() < _FEWEST:
        return 0.0, np.inf
    one, two = one[both], two[both] - two[both].mean(axis=0)
    design = np.hstack([one - one.mean(axis=0), np.ones((len(one), 1))])
    rest = two - design @ np.linalg.lstsq(design, two, rcond=None)[0]
    step = np.abs(np.diff(two, axis=0))
    least = float(step[step > 1e-9 * np.abs(two).max(initial=0.0)].min(initial=np.inf))
    size = float(np.sqrt(np.mean(rest**2)))
    return size / least, size / max(float(np.sqrt(np.mean(two**2))), np.finfo(float).tiny)


_Found = tuple[str, list[str], dict[str, object], list[str]]


def _quantities(header: Header, free: list[str], *, by_size: bool) -> list[_Found]:
    out: list[_Found] = []
    ours = [name for name in free if not (_NO_STATE.search(_stem([name])) or "cmd" in name.lower())]
    attitude = _quaternion(header, ours) or _angles(header, ours) or _matrix(header, ours)
    if attitude is not None:
        out.append(attitude)
        stem = attitude[1][0][:-2] if "vectors" in attitude[2] else None  # the middle column of a matrix goes with it
        free = [n for n in free if n not in attitude[1] and not (stem is not None and n[:-2] == stem)]
    triples = _triples(header, free)
    kinds = [_kind(_stem(columns)) for columns in triples]
    for columns, kind in zip(triples, kinds, strict=True):
        if kind is not None:
            out.append(_vector(header, kind, columns))
    for columns in (columns for columns, kind in zip(triples, kinds, strict=True) if kind is None):
        likely, said = _unnamed(header, columns, out, by_size=by_size)
        if likely is not None:
            quantity, _, keys, doubts = _vector(header, likely, columns)
            out.append((quantity, columns, keys, [f"{quantity}: that {said}", *doubts]))
    if not any(one[0] == "position" for one in out):
        out += _place(header, ours)
    place = next((keys["frame"] for quantity, _, keys, _ in out if quantity == "position"), None)
    for quantity, _, keys, doubts in out:
        if (
            quantity == "velocity"
            and canonical(str(place)) in FRAMES
            and any(_WHICH_FRAME in doubt for doubt in doubts)
        ):
            keys["frame"] = place  # one source, one frame
    out = [_with_fills(header, one) for one in out]
    taken = {name for _, columns, _, _ in out for name in columns}
    wheels = [name for name in free if name not in taken and _WHEEL.search(name.lower()) and _is_number(header, name)]
    if wheels:
        out.append(("wheel_speed", wheels, {"unit": "rpm"}, [f"that {', '.join(wheels)} are speeds, and the unit"]))
        taken |= set(wheels)
    for name in free:
        low = re.sub(r"[^a-z0-9]+", "_", name.lower()).strip("_")
        if name in taken or not _is_number(header, name):
            continue
        if re.search(r"temp|^tm(ag|tm)(_|$)|^t_|_t$|deg_?c$", low) and "temperature" not in [one[0] for one in out]:
            hot = float(np.nanmedian(header.values[name])) > 150.0
            unit = "K" if hot else "degC"
            out.append(
                ("temperature", [name], {"unit": unit}, [f"the unit of {name}, and that it is the magnetometer's"])
            )
        elif _CURRENT.search(low) or header.units.get(name) in ("A", "mA"):
            out.append(_current(header, name))
        elif (lit := _SUNLIT.search(low)) is not None and _is_switch(header.values[name]):
            dark: dict[str, object] = {"scale": -1, "offset": 1} if lit["shadow"] else {}
            doubt = f"sunlit: that {name} is {'1 in shadow' if dark else '1 in sunlight'}"
            out.append(("sunlit", [name], dark, [] if low.startswith("sunlit") else [doubt]))
    if header.frame is not None:  # the format states it, with units and order
        words = {"attitude": "relative_to", "position": "frame", "velocity": "frame"}
        out = [(name, columns, own | {words[name]: header.frame}, []) for name, columns, own, _ in out]
    return sorted(out, key=lambda one: one[0] != "mag")


def _unnamed(header: Header, columns: list[str], out: list[_Found], *, by_size: bool) -> tuple[str | None, str]:
    """What three columns may be whose name does not say it, beside what was found, and why."""
    seen = {one[0]: one[1] for one in out}
    by_file = _kind((header.sheet or header.path.stem).lower())
    likely = _likely(header, columns, list(seen))
    if likely is not None and _stem(columns) not in ("", "km", "m"):
        return likely, f"{', '.join(columns)} are one"
    if by_file is not None and by_file not in seen:
        return by_file, "it is one (by the name of the file)"
    if (
        likely is None
        and "mag" in seen
        and _is_field(header, columns)
        and _left(header, seen["mag"], columns)[1] < _ALIKE
    ):
        return "mag", f"{', '.join(columns)} are one (they change as the other does)"
    if likely is None and by_size and "mag" not in seen and _is_field(header, columns):
        return "mag", f"{', '.join(columns)} are one (by their size)"
    return likely, f"{', '.join(columns)} are one"


def _is_field(header: Header, columns: list[str]) -> bool:
    """Whether a vector has the size of the Earth's field in some unit, and turns."""
    size, turns = _size(header, columns), np.nanmin(_stacked(header, columns), axis=0) < 0.0
    return bool(turns.any() and any(low <= size <= high for _, low, high in _SIZES["mag"]))


def _kind(stem: str) -> str | None:
    found = next((quantity for quantity, pattern in _KINDS if pattern.search(stem)), None)
    found = None if _NO_STATE.search(stem) else found
    return None if found in _IN_BODY and _ELSEWHERE.search(stem) else found


def _likely(header: Header, columns: list[str], seen: list[str]) -> str | None:
    """A quantity that is not there yet, whose size these columns have if it has a typical one."""
    stem = _stem(columns)
    for quantity, pattern in _LIKELY:
        if _NO_STATE.search(stem):
            return None
        if quantity not in seen and pattern.search(stem) and not (quantity in _IN_BODY and _ELSEWHERE.search(stem)):
            size = _size(header, columns)
            if quantity not in _SIZES or any(low <= size <= high for _, low, high in _SIZES[quantity]):
                return quantity
    return None


def _is_number(header: Header, name: str) -> bool:
    return name in header.values and header.values[name].ndim == 1


def _is_switch(value: FloatArray) -> bool:
    """Whether there is nothing but 0 and 1."""
    return bool(np.isfinite(value).any()) and set(np.unique(value[np.isfinite(value)])) <= {0.0, 1.0}


def _rows_that_count(header: Header) -> list[str]:
    """A line on the columns that look as if they said which rows are good."""
    found = [
        name
        for name, value in header.values.items()
        if _GOOD.search(name) and value.ndim == 1 and _is_switch(value) and np.ptp(value[np.isfinite(value)]) > 0.0
    ]
    text = " and ".join(f'"{name}" == 1' if re.search(r"\W", name) else f"{name} == 1" for name in found)
    return [f"{CONFIRM} which rows count; if those with 1: where = {json.dumps(text)}"] if found else []


def _current(header: Header, name: str) -> _Found:
    """Of the array, of the battery, or of anything else that a field may follow."""
    low = name.lower()
    milli = float(np.nanmax(np.abs(header.values[name]))) > _MOST_A
    stated = header.units.get(name) or next(iter(re.findall(r"(?:^|_)(m?a)(?:_|$)", re.sub(r"\W+", "_", low))), "")
    unit = "mA" if stated.lower() == "ma" or (milli and stated.lower() != "a") else "A"
    if re.search(r"bat", low):
        doubt = f"{name}: the unit, and that it is positive when charging (else scale = -1)"
        return "battery_current", [name], {"unit": unit}, [doubt]
    if re.search(r"solar|array|panel|(^|_)i?sa(_|$)|^i_?sol", low):
        return "array_current", [name], {"unit": unit}, [f"{name}: the unit, and that it is the solar array's"]
    keys: dict[str, object] = {"unit": stated.replace("ma", "mA").replace("a", "A")} if stated in ("ma", "a") else {}
    plain = re.sub(r"[^a-z0-9]+", "_", low).strip("_").removeprefix("driver_")
    doubt = 'that torquers stay drivers; three of them make a dipole, with unit = "Am2" and scale = Am2 per unit'
    return f"driver_{plain}", [name], keys, [doubt] if re.search(TORQUER, low) else []


def _with_fills(header: Header, one: _Found) -> _Found:
    """The same with the fill values that stand in its columns."""
    quantity, columns, keys, doubts = one
    if not (fill := fill_values(_stacked(header, columns), alike=quantity == "mag")):
        return one
    doubt = f"{quantity}: that {', '.join(map(repr, fill))} means missing"
    return quantity, columns, keys | {"fill": fill}, [*doubts, doubt]


def _place(header: Header, free: list[str]) -> list[_Found]:
    """A position by latitude, longitude and height, if names say so."""
    found: list[str] = []
    for pattern in (r"lat", r"lon", r"alt|height|radius"):
        likely = [n for n in free if re.search(pattern, n.lower()) and header.values.get(n, np.empty((0, 2))).ndim == 1]
        if not likely:
            return []
        found.append(likely[0])
    unit = "m" if np.nanmedian(np.abs(header.values[found[2]])) > 1e5 else "km"
    keys: dict[str, object] = {"unit": unit, "frame": "geocentric" if "radius" in found[2].lower() else "geodetic"}
    if all(re.search(r"rad(ian)?s?\W*$", f"{name}{header.units.get(name, '')}".lower()) for name in found[:2]):
        keys["scale"] = [*2 * [float(np.degrees(1.0))], 1.0]
    doubts = [f"position: {keys['frame']} (geodetic: latitude and altitude above WGS 84; geocentric: radius) in {unit}"]
    return [("position", found, keys, doubts)]


def _triples(header: Header, free: list[str]) -> list[list[str]]:
    """Three columns whose names differ in one place by x y z, 1 2 3 or 0 1 2; or one variable of three components."""
    out = [[name] for name in free if name in header.values and header.values[name].shape[1:] == (3,)]
    known, taken = {name.lower(): name for name in free}, set[str]()
    for name in free:
        for others in (others for axes in _AXES for others in _companions(name, axes)):
            if all(o in known and known[o] in header.values for o in others) and not taken & set(others):
                taken |= set(others)
                out.append([known[o] for o in others])
    return out


def _companions(name: str, ends: Sequence[str]) -> list[list[str]]:
    """Names in small letters that differ in one place from this one, which has the first of `ends` there."""
    low = name.lower()
    return [
        [f"{low[: found.start()]}{end}{low[found.end() :]}" for end in ends]
        for found in re.finditer(re.escape(ends[0]), low)
    ]


def _quaternion(header: Header, free: list[str]) -> _Found | None:
    known = {name.lower(): name for name in free}
    for name, (order, ends, guess) in itertools.product(free, _QUATERNIONS):
        for others in _companions(name, ends):
            columns = [known[o] for o in others if o in known]
            said = _ATTITUDE.search(f"{header.sheet or header.path.stem} {name}") or len(name) == 1
            if len(columns) == 4 and said and _is_unit(header, columns):
                return _attitude(columns, order, guess)
    for name in free:
        if header.values.get(name, np.empty(0)).shape[1:] == (4,) and _is_unit(header, [name]):
            return _attitude([name], "xyzw", True)
    return None


def _angles(header: Header, free: list[str]) -> _Found | None:
    """Yaw, pitch and roll, as aircraft have them."""
    columns = [
        next((n for n in free if word in n.lower() and n in header.values), "") for word in ("yaw", "pitch", "roll")
    ]
    if not all(columns):
        return None
    angles = _stacked(header, columns)
    small = np.nanmax(np.where(angles < 0.0, 2.0 * np.abs(angles), angles)) < 2.0 * np.pi  # below zero they end at -pi
    unit = "rad" if small and not any("deg" in column.lower() for column in columns) else "deg"
    keys: dict[str, object] = {"euler": "ZYX", "unit": unit, "relative_to": "orbital"}
    doubt = "attitude: the sequence (ZYX: yaw first, about the turning axes); the unit; relative_to; sense"
    return "attitude", columns, keys, [doubt]


def _matrix(header: Header, free: list[str]) -> _Found | None:
    """A rotation matrix in nine columns that end in 11 ... 33 or 00 ... 22."""
    known = {name.lower(): name for name in free if name in header.values}
    for name, first in itertools.product(known, (0, 1)):
        stem = name.removesuffix(f"{first}{first}")
        ends = [f"{stem}{i + first}{j + first}" for j in (0, 2) for i in range(3)]
        columns = [known.get(end, "") for end in ends]
        if stem != name and all(columns) and _is_unit(header, columns[:3]) and _is_unit(header, columns[3:]):
            keys: dict[str, object] = {"vectors": "x z", "relative_to": _frame(stem) or "GCRS"}
            doubt = (
                "attitude: that the matrix takes body components to those of the reference (else sense = 'conjugate')"
            )
            return (
                "attitude",
                columns,
                keys,
                [doubt, "attitude: relative_to: GCRS J2000 true_of_date ITRS NEC or orbital"],
            )
    return None


def _attitude(columns: list[str], order: str, guess: bool) -> _Found:
    frame = _frame(_stem(columns))
    doubts = [f"order (is the scalar {'last' if order == 'xyzw' else 'first'}?)"] if guess else []
    doubts.append("sense (body relative to the reference, as Wertz; else sense = 'conjugate')")
    if frame is None:
        doubts.append("relative_to: GCRS J2000 true_of_date ITRS NEC or orbital; `fluxtwin check` says which fits")
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
    size = _size(header, columns)
    if quantity not in ("sun", "nadir"):
        stated = _stated_unit(header, quantity, columns)
        likely = [unit for unit, low, high in _SIZES.get(quantity, ()) if low <= size <= high]
        default = {"mag": "nT", "position": "km", "velocity": "km/s", "rate": "deg/s", "dipole": "Am2"}[quantity]
        keys["unit"] = stated or (likely[0] if likely else default)
        if stated is None:
            odd = f", which fits no unit: counts? then add scale = {keys['unit']} per count"
            counts = odd if quantity in _SIZES and not likely else ""
            counts = ", counts by their name: then add scale and offset" if _COUNTS.search(columns[0]) else counts
            why = f"median size {size:.4g}{counts}"
            doubts.append(f"{quantity}: the unit ({why})")
        if quantity == "dipole" and _CURRENT.search(re.sub(r"[^a-z0-9]+", "_", columns[0].lower())):
            doubts.append(
                f"dipole: if {', '.join(columns)} are currents, scale = {keys['unit']} per unit (turns times area)"
            )
    if quantity in ("position", "velocity"):
        frame = _frame(_stem(columns))
        by_receiver = re.search(r"gps|gnss", " ".join([header.sheet or header.path.stem, *columns]).lower())
        frame = frame if frame in POSITIONS or canonical(str(frame)) in POSITIONS else None
        keys["frame"] = frame or ("ITRS" if by_receiver else "GCRS")
        if frame is None:
            doubts.append(f"{quantity}: {_WHICH_FRAME}")
    return quantity, columns, dict(keys), doubts


def _size(header: Header, columns: list[str]) -> float:
    """Median length of a vector; NaN where there is none."""
    length = np.linalg.norm(_stacked(header, columns), axis=1)
    return float(np.median(length[np.isfinite(length)])) if np.isfinite(length).any() else float("nan")


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
