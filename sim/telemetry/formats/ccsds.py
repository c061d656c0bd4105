"""CCSDS attitude and orbit ephemeris messages (AEM, OEM) as KVN: quaternions, positions and velocities at epochs.

Sources: CCSDS 504.0-B-1 and B-2 (attitude data messages), 502.0-B-2 and B-3 (orbit data messages).
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TypeAlias

import numpy as np

from fluxtwin.sim.base.errors import BadInput
from fluxtwin.sim.base.files import escaped, write_text
from fluxtwin.sim.base.limits import MAX_SAMPLES, Lines, require_rows
from fluxtwin.sim.base.seals import require_sealed, sealed
from fluxtwin.sim.base.types import FloatArray, TimeArray
from fluxtwin.sim.earth import epoch
from fluxtwin.sim.telemetry.columns import clip
from fluxtwin.sim.telemetry.formats.table import Table, content_of
from fluxtwin.sim.telemetry.record import Telemetry, plain_text
from fluxtwin.sim.telemetry.time_stamps import format_iso

_ITRF = re.compile(r"ITR[FS][-_]?\d*")
_SCALES = {"UTC": "UTC", "TAI": "TAI", "GPS": "GPS", "TT": "TT", "TDB": "TT", "TDT": "TT"}
"""Time systems, TDB as TT, which it follows within 2 ms."""
_DAY_OF_YEAR = re.compile(r"\d{4}-\d{3}(T.*)?")
_GAP_STEPS = 10.0
_BODY = ("SC_BODY", "SC_FRAME", "BODY")
"""How the names of a spacecraft's own axes begin."""
_TYPES = ("QUATERNION", "QUATERNION/DERIVATIVE", "QUATERNION/RATE", "QUATERNION/ANGVEL")
_CHOICES = (("QUATERNION_TYPE", ("LAST", "FIRST")), ("ATTITUDE_DIR", ("A2B", "B2A")))
"""Of version 1; the first is what version 2 means."""

Row: TypeAlias = list[float]
"""Numbers behind an epoch, in the units of the message."""


@dataclass
class Segment:
    """Metadata and rows between META_START and the next one."""

    meta: dict[str, str] = field(default_factory=dict)
    epochs: list[str] = field(default_factory=list)
    rows: list[Row] = field(default_factory=list)


def read_aem(path: Path, max_samples: int = MAX_SAMPLES) -> Table:
    """Columns `time`, `q_x q_y q_z q_w`: the textbook quaternion of the body relative to the attribute `frame`.

    Version 1 states the direction and whether the scalar is first; version 2 is from A to B, scalar last. Raises BadInput
    for other attitude types, and for frames that differ between segments or are not known.
    """
    segments, digest = read_message(path, "AEM", 4, max_samples)
    where = str(path)
    parts = [_attitude(one, where) for one in segments]
    frames = {frame for frame, _ in parts}
    if len(frames) > 1:
        raise BadInput(f"its segments are relative to {', '.join(sorted(frames))}", where=where, wanted="one frame")
    names = ("q_x", "q_y", "q_z", "q_w")
    columns = _columns(segments, names, np.concatenate([value for _, value in parts]), where)
    return Table(where, columns, {}, _attributes(segments, frames.pop()), sha256=digest)


def write_aem(telemetry: Telemetry, path: Path | str) -> Path:
    """The reference attitude, from GCRF to SC_BODY_1, version 2. Raises BadInput where there is none."""
    q = np.full((len(telemetry), 4), np.nan) if telemetry.q_NB is None else np.array(telemetry.q_NB)
    frames = [("REF_FRAME_A", "GCRF"), ("REF_FRAME_B", "SC_BODY_1")]
    return write_message(telemetry, path, "AEM", frames, q, after=[("ATTITUDE_TYPE", "QUATERNION")])


def read_oem(path: Path, max_samples: int = MAX_SAMPLES) -> Table:
    """Columns `time`, `x`, `y`, `z` [km], `vx`, `vy`, `vz` [km/s]; attribute `frame`, the same in all segments."""
    segments, digest = read_message(path, "OEM", 6, max_samples)
    where = str(path)
    frames = {frame_of(one, "REF_FRAME", where) for one in segments}
    centres = {one.meta.get("CENTER_NAME", "EARTH").upper() for one in segments}
    if len(frames) > 1 or centres != {"EARTH"}:
        found = ", ".join(sorted(frames) if len(frames) > 1 else sorted(centres))
        raise BadInput(f"its segments are in {found}", where=where, wanted="one frame with the Earth at its centre")
    units = dict.fromkeys(("x", "y", "z"), "km") | dict.fromkeys(("vx", "vy", "vz"), "km/s")
    columns = _columns(segments, units, np.array([row[:6] for one in segments for row in one.rows]), where)
    return Table(where, columns, units, _attributes(segments, frames.pop()), sha256=digest)


def write_oem(telemetry: Telemetry, path: Path | str) -> Path:
    """Positions and velocities in GCRF. Raises BadInput where there are none."""
    from fluxtwin.sim.telemetry.build import velocity_from_positions

    r = telemetry.r_N_km
    if r is None:
        where = telemetry.provenance.get("source", "telemetry")
        raise BadInput("has no positions", where=where, wanted="positions (columns, or --tle) for an OEM")
    v = telemetry.v_N_km_s
    v = velocity_from_positions(telemetry.time, r) if v is None else v
    return write_message(telemetry, path, "OEM", [("REF_FRAME", "GCRF")], np.hstack([r, v]))


def _columns(
    segments: Sequence[Segment], names: Iterable[str], values: FloatArray, where: str
) -> dict[str, np.ndarray]:
    """`time` and the columns of the values (N, k), ascending: segments may share their ends."""
    time, first = np.unique(np.concatenate([times(one, where) for one in segments]), return_index=True)
    return {"time": time, **dict(zip(names, values[first].T, strict=True))}


def _attributes(segments: Sequence[Segment], frame: str) -> dict[str, str]:
    return {"frame": frame, "spacecraft": segments[0].meta.get("OBJECT_NAME", "")}


def read_message(path: Path, kind: str, width: int, max_samples: int) -> tuple[list[Segment], str]:
    """Its segments, whose rows have at least `width` numbers, and its SHA-256. kind: AEM or OEM. BadInput names the line."""
    content, digest = content_of(path, Lines(max_samples, str(path), beside=max_samples + 10_000))
    text = content.decode("utf-8-sig", "replace")
    require_sealed(text, where=str(path))
    lines = text.splitlines()
    known = False
    segments: list[Segment] = []
    inside, skipped, rows = False, False, 0
    for number, raw in enumerate(lines, 1):
        line = raw.strip()
        if not line or line.startswith("COMMENT") or line in ("DATA_START", "DATA_STOP"):
            continue
        if line == "META_START":
            segments.append(Segment())
        if line in ("META_START", "META_STOP"):
            inside = line == "META_START"
        elif line in ("COVARIANCE_START", "COVARIANCE_STOP"):
            skipped = line == "COVARIANCE_START"
        elif skipped:
            continue
        elif "=" in line:
            key, _, value = (part.strip() for part in line.partition("="))
            known |= key == f"CCSDS_{kind}_VERS" and value != ""
            if inside:
                segments[-1].meta[key] = value
        else:
            _add_row(segments, inside, line, f"{path}, line {number}", width)
            rows = require_rows(rows + 1, max_samples, str(path), "has at least")
    if not known:
        raise BadInput(
            f"does not begin with CCSDS_{kind}_VERS", where=str(path), wanted=f"a CCSDS {kind} as KVN (not XML)"
        )
    segments = [one for one in segments if one.rows]
    if not segments:
        raise BadInput("holds no rows", where=str(path), wanted="at least one segment with data")
    objects = sorted({one.meta.get("OBJECT_ID", one.meta.get("OBJECT_NAME", "")) for one in segments})
    if len(objects) > 1:
        named = " and ".join(clip(name) or "none" for name in objects[:2])
        raise BadInput(
            f"its segments are of different objects: {named}", where=str(path), wanted="one object in a file"
        )
    return segments, digest


def is_oem(path: Path) -> bool:
    """Whether a file begins as an orbit ephemeris message."""
    try:
        with open(path, "rb") as opened:
            head = opened.read(4096)
    except OSError:
        return False
    return b"CCSDS_OEM_VERS" in head


def times(segment: Segment, where: str) -> TimeArray:
    """UTC stamps (N,) of the rows. Raises BadInput for a time system or an epoch that is not known."""
    system = segment.meta.get("TIME_SYSTEM", "").upper()
    if system not in _SCALES:
        raise BadInput(f"TIME_SYSTEM is {clip(system) or 'missing'}", where=where, wanted=", ".join(_SCALES))
    stamps = np.array([_stamp(text, where) for text in segment.epochs], dtype="datetime64[ns]")
    return epoch.utc_of(stamps, _SCALES[system])


def frame_of(segment: Segment, key: str, where: str) -> str:
    """The frame in the spelling of column maps. Raises BadInput for one that they do not know."""
    from fluxtwin.sim.telemetry import column_map_words as words

    said = segment.meta.get(key, "")
    try:
        spelled = words.frame("ITRS" if _ITRF.fullmatch(said.upper()) else {"GCRF": "GCRS"}.get(said.upper(), said))
    except ValueError as error:
        raise BadInput(f"{key}: {error}", where=where) from None
    return str(spelled)


def write_message(
    telemetry: Telemetry,
    path: Path | str,
    kind: str,
    meta: Sequence[tuple[str, str]],
    values: FloatArray,
    after: Sequence[tuple[str, str]] = (),
) -> Path:
    """Write the rows (N, k) that are known, version 2.0, UTC, a segment a stretch without gaps; atomically.

    meta, after: what stands before and behind the times in the metadata. Raises BadInput where no row is known.
    """
    rows = np.flatnonzero(np.isfinite(values).all(axis=1))
    if rows.size == 0:
        what = {"AEM": "attitude", "OEM": "position and velocity"}[kind]
        raise BadInput(
            f"no row has {what}", where=telemetry.provenance.get("source", "telemetry"), wanted=f"some for an {kind}"
        )
    made = format_iso(telemetry.time[-1:])[0].removesuffix("Z")
    lines = [f"CCSDS_{kind}_VERS = 2.0", f"CREATION_DATE = {made[:19]}", "ORIGINATOR = FLUXTWIN"]
    name = escaped(plain_text(telemetry.spacecraft)) or "UNKNOWN"
    comment = ["COMMENT CREATION_DATE is the last epoch of the record, so that the same record gives the same file"]
    for piece in _pieces(telemetry.time, rows):
        stamps = [stamp.removesuffix("Z") for stamp in format_iso(telemetry.time[piece])]
        head = [("OBJECT_NAME", name), ("OBJECT_ID", name), ("CENTER_NAME", "EARTH"), *meta]
        head += [("TIME_SYSTEM", "UTC"), ("START_TIME", stamps[0]), ("STOP_TIME", stamps[-1]), *after]
        lines += ["", "META_START", *comment, *(f"{key} = {value}" for key, value in head), "META_STOP", ""]
        lines += ["DATA_START"] * (kind == "AEM")
        numbers = (" ".join(f"{x:.15g}" for x in row) for row in values[piece].tolist())
        lines += [f"{stamp} {text}" for stamp, text in zip(stamps, numbers, strict=True)]
        lines += ["DATA_STOP"] * (kind == "AEM")
        comment = []
    return write_text(path, sealed("\n".join([*lines, ""]), "COMMENT", after=1))


def _pieces(time: TimeArray, rows: np.ndarray) -> Iterable[np.ndarray]:
    steps = np.diff(time[rows].astype("int64"))
    if steps.size == 0:
        return [rows]
    return np.split(rows, np.flatnonzero(steps > _GAP_STEPS * np.median(steps)) + 1)


def _add_row(segments: list[Segment], inside: bool, line: str, where: str, width: int) -> None:
    words = line.split()
    if not segments or inside:
        raise BadInput(f"{clip(line)!r} is neither a keyword nor inside the data", where=where)
    try:
        numbers = [float(word) for word in words[1:]]
    except ValueError:
        raise BadInput(f"{clip(line)!r} is no row of numbers", where=where) from None
    if len(numbers) < width:
        raise BadInput(f"has {len(numbers)} numbers", where=where, wanted=f"an epoch and at least {width}")
    segments[-1].epochs.append(words[0])
    segments[-1].rows.append(numbers)


def _stamp(text: str, where: str) -> np.datetime64:
    if _DAY_OF_YEAR.fullmatch(text):
        day = np.datetime64(f"{text[:4]}-01-01", "D") + np.timedelta64(int(text[5:8]) - 1, "D")
        if str(day)[:4] != text[:4]:
            raise BadInput(f"{text!r} is no day of that year", where=where, wanted="days 001 to 365 or 366")
        text = f"{day}{text[8:]}"
    return epoch.parse_time(text, where=where)


def _attitude(segment: Segment, where: str) -> tuple[str, FloatArray]:
    """Frame and quaternions (N, 4) of the body relative to it."""
    meta = segment.meta
    kind = meta.get("ATTITUDE_TYPE", "").upper()
    if kind not in _TYPES:
        raise BadInput(f"ATTITUDE_TYPE is {clip(kind) or 'missing'}", where=where, wanted=" or ".join(_TYPES))
    value = np.array([row[:4] for row in segment.rows])
    scalar, direction = (_one_of(meta, key, words, where) for key, words in _CHOICES)
    if scalar == "FIRST":
        value = value[:, [1, 2, 3, 0]]
    a, b = (meta.get(key, "").upper() for key in ("REF_FRAME_A", "REF_FRAME_B"))
    if a.startswith(_BODY) == b.startswith(_BODY):
        wanted = "one of them the spacecraft's (SC_BODY_1)"
        raise BadInput(f"the frames are {clip(a) or 'none'} and {clip(b) or 'none'}", where=where, wanted=wanted)
    body_is_b = b.startswith(_BODY)
    if body_is_b != (direction == "A2B"):
        value = value * [-1.0, -1.0, -1.0, 1.0]
    return frame_of(segment, "REF_FRAME_A" if body_is_b else "REF_FRAME_B", where), value


def _one_of(meta: dict[str, str], key: str, words: tuple[str, ...], where: str) -> str:
    """What the metadata say, the first word where they do not. Raises BadInput for any other word."""
    said = meta.get(key, words[0]).upper()
    if said not in words:
        raise BadInput(f"{key} is {clip(said)}", where=where, wanted=" or ".join(words))
    return said
