"""GomSpace: the tables of the ADCS computer, as the commands that set them.

Offset, scale and rotation are float32; the reading is in mGauss. The offset is added, the sum is turned into the axes of the
soft iron, scaled axis by axis, and turned back: B = R' diag(scale) R (m + offset). Source: operators' tools for the
launch and early orbit phase of these computers (github.com/FaBa-GS/leop_tools: `lib/libcal.py`, `calibrate_mag` and
`mag_model`; names and tables in `lib/libconfig.py`: table 82, `mag_...`, for the magnetometer of the A3200, table 86 for the
external M315). They are not a manual of the maker: try the file on the ground first. No range of the tables is public;
scales of 0.5 to 2 are what the tools' own calibration (`mag_cal`) allows.
"""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np

from fluxtwin.calib.common.conventions import OffsetFirst
from fluxtwin.calib.onboard.target import Number, Target, as_float32, float32, scales_beyond
from fluxtwin.sim.base.errors import BadInput
from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.earth.constants import NT_PER_MG

_NODE = 4
_SCALE = (0.5, 2.0)
_TABLES = {1: 82, 2: 86}
_NAMES = {1: ("mag_offset", "mag_scale", "mag_rotation"), 2: ("offset", "scale", "rotation")}
_LINE = re.compile(r"\s*rparam\s+set\s+(?P<name>\w+?)(?:\[(?P<at>\d)\])?\s+(?P<values>[-+.\deE\s]+?)\s*$")


class GomSpace(Target):
    """The magnetometer of the A3200 (1) or the external M315 (2)."""

    name = "gomspace"
    what = "rparam commands of a GomSpace ADCS"
    formula = "B = R' diag(scale) R (m + offset); m, B, offset in mGauss"
    source = "github.com/FaBa-GS/leop_tools, lib/libcal.py, calibrate_mag"
    ending = ".txt"
    looks = re.compile(r"^\s*rparam\s+set\s", re.MULTILINE)
    comment = ""
    symmetric = True
    instances = 2

    def numbers(self, held: OffsetFirst, instance: int) -> tuple[Number, ...]:
        scale, R = _principal(held.M)
        offset, scaling, rotation = _NAMES[instance]
        vectors = (
            (offset, -held.o_nT / NT_PER_MG, "mGauss"),
            (scaling, scale, "1"),
            (rotation, R.ravel(), "1"),
        )
        return tuple(
            Number(f"{name}[{at}]", float32(value), unit)
            for name, values, unit in vectors
            for at, value in enumerate(values)
        )

    def lay_out(self, numbers: Sequence[Number], heading: Sequence[str], instance: int) -> str:
        commands = [f"rparam set {n.name} {n.text}" for n in numbers]
        return "\n".join([f"rparam download {_NODE} {_TABLES[instance]}", *commands, "rparam send", ""])

    def read(self, text: str, instance: int, where: str) -> OffsetFirst:
        found: dict[tuple[str, int], float] = {}
        for match in filter(None, map(_LINE.match, text.splitlines())):
            first = int(match["at"] or 0)
            for at, word in enumerate(match["values"].split()):
                found[match["name"], first + at] = as_float32(word, f"{where}: {match['name']}")
        offset, scale, R = (
            np.array([_element(found, name, at, where) for at in range(size)])
            for name, size in zip(_NAMES[instance], (3, 3, 9), strict=True)
        )
        R = R.reshape(3, 3)
        return OffsetFirst(R.T @ np.diag(scale) @ R, -NT_PER_MG * offset)

    def beyond(self, held: OffsetFirst) -> list[str]:
        return scales_beyond(_principal(held.M)[0], _SCALE)

    def notes(self, held: OffsetFirst) -> list[str]:
        return [
            f"the commands speak to node {_NODE}, as the tools they are taken from; load, check, then save on board"
        ]


def _element(found: dict[tuple[str, int], float], name: str, at: int, where: str) -> float:
    if (name, at) not in found:
        raise BadInput(f"{name}[{at}] is not set", where=where, wanted="rparam set of offset, scale and rotation")
    return found[name, at]


def _principal(M: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(scale, R) of a symmetric M = R' diag(scale) R, R a rotation as near to none as the order of the axes allows."""
    from scipy.optimize import linear_sum_assignment

    values, vectors = np.linalg.eigh(M)
    rows, order = linear_sum_assignment(-np.abs(vectors))
    R = vectors[:, order[rows]].T
    R = R * np.where(np.diag(R) < 0, -1.0, 1.0)[:, None]
    if np.linalg.det(R) < 0:
        R[int(np.argmin(np.diag(R)))] *= -1.0
    return values[order[rows]], R
