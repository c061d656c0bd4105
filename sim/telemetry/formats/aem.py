"""CCSDS attitude ephemeris messages as KVN: quaternions at epochs."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from fluxtwin.sim.base.errors import BadInput
from fluxtwin.sim.base.limits import MAX_SAMPLES
from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.telemetry.columns import clip
from fluxtwin.sim.telemetry.formats import ccsds
from fluxtwin.sim.telemetry.formats.table import Table
from fluxtwin.sim.telemetry.record import Telemetry

_BODY = ("SC_BODY", "SC_FRAME", "BODY")
"""How the names of a spacecraft's own axes begin."""
_TYPES = ("QUATERNION", "QUATERNION/DERIVATIVE", "QUATERNION/RATE", "QUATERNION/ANGVEL")
_CHOICES = (("QUATERNION_TYPE", ("LAST", "FIRST")), ("ATTITUDE_DIR", ("A2B", "B2A")))
"""Of version 1; the first is what version 2 means."""


def read(path: Path, max_samples: int = MAX_SAMPLES) -> Table:
    """Columns `time`, `q_x q_y q_z q_w`: the textbook quaternion of the body relative to the attribute `frame`.

    Version 1 states the direction and whether the scalar is first; version 2 is from A to B, scalar last. Raises BadInput
    for other attitude types, and for frames that differ between segments or are not known.
    """
    message = ccsds.read_message(path, "AEM", 4, max_samples)
    where = str(path)
    parts = [_segment(one, where) for one in message.segments]
    frames = {frame for frame, _ in parts}
    if len(frames) > 1:
        raise BadInput(f"its segments are relative to {', '.join(sorted(frames))}", where=where, wanted="one frame")
    time = np.concatenate([ccsds.times(one, where) for one in message.segments])
    q = np.concatenate([value for _, value in parts])
    time, first = np.unique(time, return_index=True)  # segments may share their ends
    columns = dict(zip(("q_x", "q_y", "q_z", "q_w"), q[first].T, strict=True))
    attributes = {"frame": frames.pop(), "spacecraft": message.segments[0].meta.get("OBJECT_NAME", "")}
    return Table(where, {"time": time, **columns}, {}, attributes, sha256=message.sha256)


def write(telemetry: Telemetry, path: Path | str) -> Path:
    """The reference attitude, from GCRF to SC_BODY_1, version 2. Raises BadInput where there is none."""
    q = np.full((len(telemetry), 4), np.nan) if telemetry.q_NB is None else np.array(telemetry.q_NB)
    frames = [("REF_FRAME_A", "GCRF"), ("REF_FRAME_B", "SC_BODY_1")]
    return ccsds.write_message(telemetry, path, "AEM", frames, q, after=[("ATTITUDE_TYPE", "QUATERNION")])


def _segment(segment: ccsds.Segment, where: str) -> tuple[str, FloatArray]:
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
    return ccsds.frame_of(segment, "REF_FRAME_A" if body_is_b else "REF_FRAME_B", where), value


def _one_of(meta: dict[str, str], key: str, words: tuple[str, ...], where: str) -> str:
    """What the metadata say, the first word where they do not. Raises BadInput for any other word."""
    said = meta.get(key, words[0]).upper()
    if said not in words:
        raise BadInput(f"{key} is {clip(said)}", where=where, wanted=" or ".join(words))
    return said
