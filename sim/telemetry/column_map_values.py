"""From what is stored to what is meant: lists in cells, values that mean "missing", counts, turned axes, latitudes; and
attitudes as quaternions in any order, Euler angles in any sequence, or two directions."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

import numpy as np
from scipy.spatial.transform import Rotation

from fluxtwin.sim.base.errors import BadInput
from fluxtwin.sim.base.types import BoolArray, FloatArray
from fluxtwin.sim.earth import frames
from fluxtwin.sim.earth.references import triad
from fluxtwin.sim.telemetry import column_map_words as words
from fluxtwin.sim.telemetry.columns import clip
from fluxtwin.sim.telemetry.quantities import Quantity

if TYPE_CHECKING:
    from fluxtwin.sim.telemetry.column_map import ColumnSpec

PLACES = ("geodetic", "geocentric")
"""Frames of a position whose columns are latitude, longitude and height."""
_BETWEEN = re.compile(rb"[\s,;|\\\[\](){}]+")
LIST_BYTES = 400
"""Width of a cell that holds a list of numbers, at most."""
_FILL_TOLERANCE = 1e-6
"""A fill value as 1e31 was often stored in single precision."""
MEASURED = ("sun nadir", "nadir sun")
"""Directions that are measured in body axes: the attitude is relative to axes made of the same two."""
_BODY_AXES = tuple(f"{a} {b}" for a in "xyz" for b in "xyz" if a != b)
VECTORS = (*MEASURED, *_BODY_AXES)
_EULER = re.compile(r"([xyz]{3}|[XYZ]{3})")
_PARALLEL = 0.02
"""Sine of the angle between two directions below which they make no attitude."""


def from_lists(text: np.ndarray, name: str, where: str) -> FloatArray:
    """(N, k) of cells that hold k numbers, an array of bytes (N,): `[x, y, z]`, `x \\ y \\ z`, `x;y;z`; blank is NaN.

    Raises BadInput naming the first cell that is no list of numbers, or one of another length.
    """
    parts = [[number for number in _BETWEEN.split(bytes(cell)) if number] for cell in text.tolist()]
    width = max(map(len, parts), default=0)
    out = np.full((len(parts), width), np.nan)
    for row, numbers in enumerate(parts):
        if not numbers:
            continue
        try:
            if len(numbers) == width:
                out[row] = [float(number) for number in numbers]
                continue
        except ValueError:
            pass
        cell = bytes(text[row]).decode("utf-8", "replace")
        wanted = f"{width} numbers, as in the others: '[1.0, 2.0, 3.0]' or '1.0 \\ 2.0 \\ 3.0'"
        raise BadInput(f"{clip(name)} in row {row + 1} is {clip(cell, 40)!r}", where=where, wanted=wanted)
    return out


def missing(raw: FloatArray, spec: ColumnSpec, fill: list[float]) -> BoolArray:
    """(N,) True in rows (N, k) with a blank, a fill value in any component, or `invalid` ones in all of them."""
    out = np.isnan(raw).any(axis=1)
    if spec.invalid:
        out |= np.isin(raw, spec.invalid).all(axis=1)
    for value in (*fill, *spec.fill):
        out |= (np.abs(raw - value) <= _FILL_TOLERANCE * abs(value)).any(axis=1)
    return np.asarray(out, dtype=np.bool_)


def in_units(raw: FloatArray, spec: ColumnSpec, quantity: Quantity | None, where: str) -> FloatArray:
    """The stored numbers (N, k) times scale plus offset, in the record's unit; `matrix` turns them to the body's axes."""
    for key in ("scale", "offset"):
        stated = getattr(spec, key)
        if isinstance(stated, list) and len(stated) != raw.shape[1]:
            raise BadInput(
                f"{key} has {len(stated)} numbers for {raw.shape[1]} components",
                where=where,
                wanted="one for each, or one",
            )
    factor = np.asarray(quantity.map_units.get(spec.unit or "", 1.0) if quantity is not None else 1.0)
    if spec.frame in PLACES:  # the unit is that of the height
        factor = np.array([1.0, 1.0, factor])
    scale, offset = np.asarray(spec.scale) * factor, np.asarray(spec.offset) * factor
    value = raw if not np.any(scale != 1.0) and not np.any(offset) else raw * scale + offset
    if spec.unit == "K" and quantity is not None:
        value = value - 273.15
    return value if spec.matrix is None else value @ np.array(spec.matrix).T


def from_places(value: FloatArray, frame: str, where: str) -> FloatArray:
    """Earth-fixed positions (N, 3) in km of latitude and longitude [deg] and a height [km].

    geodetic: WGS 84 latitude and altitude. geocentric: latitude above the equator as seen from the centre, and radius.
    Raises BadInput for a latitude beyond 90 deg.
    """
    wrong = np.flatnonzero(np.abs(value[:, 0]) > 90.0)
    if wrong.size:
        raise BadInput(
            f"the latitude in row {wrong[0] + 1} is {value[wrong[0], 0]:g} deg",
            where=where,
            wanted="latitude, longitude [deg] and height, in this order; `fill` for values that mean missing",
        )
    latitude, longitude = np.radians(value[:, 0]), np.radians(value[:, 1])
    out = np.full_like(value, np.nan)
    rows = np.isfinite(value).all(axis=1)
    make = frames.from_geodetic if frame == "geodetic" else frames.from_geocentric
    if rows.any():
        out[rows] = make(latitude[rows], longitude[rows], value[rows, 2])
    return out


def check(name: str, spec: ColumnSpec, quantity: Quantity | None) -> None:
    """Raises ValueError in words for scales, matrices and places that cannot be meant."""
    if not np.all(np.asarray(spec.scale)):
        raise ValueError(f"{name}: scale is zero")
    vector = quantity is not None and quantity.components == 3
    if spec.matrix is not None:
        turn = np.array(spec.matrix) if all(len(row) == 3 for row in spec.matrix) and len(spec.matrix) == 3 else None
        if not vector or name in ("position", "velocity"):
            raise ValueError(f"{name} takes no matrix; only vectors in body axes do")
        if turn is None or not np.allclose(turn @ turn.T, np.eye(3), atol=1e-3):
            raise ValueError(
                f"{name}: matrix wants three rows of three numbers that turn or mirror, as [[0,1,0],[-1,0,0],[0,0,1]]"
            )
    if spec.frame in PLACES:
        if name != "position":
            raise ValueError(f"{name} cannot be {spec.frame}; only position can")
        if any(not isinstance(one, list) and one != plain for one, plain in ((spec.scale, 1.0), (spec.offset, 0.0))):
            raise ValueError(f"{name}: scale and offset of latitude, longitude and height want a list of three")


def check_attitude(spec: ColumnSpec) -> None:
    """Raises ValueError in words where the keys of an attitude do not say one."""
    stated = [key for key in ("order", "euler", "vectors") if getattr(spec, key) is not None]
    if len(stated) != 1:
        raise ValueError(
            "attitude wants either order (xyzw, wxyz, xyz), euler (ZYX and the like) or vectors"
            + (f"; found {' and '.join(stated)}" if stated else "")
        )
    if spec.euler is not None and (
        not _EULER.fullmatch(spec.euler) or spec.euler[0] == spec.euler[1] or spec.euler[1] == spec.euler[2]
    ):
        raise ValueError(
            f"euler {spec.euler[:20]!r} is no sequence; as 'ZYX' (turning with the body) or 'zyx' (fixed axes)"
        )
    if spec.euler is not None and spec.unit not in ("deg", "rad"):
        raise ValueError("euler wants a unit: deg, rad")
    if spec.euler is None and spec.unit is not None:
        raise ValueError("attitude takes no unit but with euler")
    if spec.vectors is not None and spec.vectors not in VECTORS:
        raise ValueError(f"vectors {spec.vectors[:20]!r} is not known; known: {', '.join(VECTORS)}")
    measured = spec.vectors in MEASURED
    if measured and spec.relative_to is not None:
        raise ValueError("measured vectors of sun and nadir define the reference: leave relative_to out")
    if not measured and spec.relative_to is None:
        raise ValueError(f"attitude wants relative_to: {', '.join(words.REFERENCES)}")
    wanted = attitude_components(spec)
    if isinstance(spec.source, list) and len(spec.source) not in (wanted, 1):
        raise ValueError(f"attitude takes {wanted} columns here")


def attitude_components(spec: ColumnSpec) -> int:
    """Numbers of a row that the attitude is made of."""
    return 6 if spec.vectors is not None else 4 if spec.order in ("xyzw", "wxyz") else 3


def quaternion(value: FloatArray, spec: ColumnSpec, where: str) -> FloatArray:
    """Textbook quaternion (N, 4), scalar last, of the body relative to the map's reference, from the columns (N, k).

    Rows with a blank are NaN. Raises BadInput for quaternions without the norm 1.
    """
    if value.shape[1] != attitude_components(spec):
        raise BadInput(
            f"attitude has {value.shape[1]} components", where=where, wanted=f"{attitude_components(spec)} of them here"
        )
    q = np.full((len(value), 4), np.nan)
    rows = np.flatnonzero(np.isfinite(value).all(axis=1))
    if spec.vectors is not None:
        sine = np.linalg.norm(np.cross(value[rows, :3], value[rows, 3:]), axis=1)
        sine /= np.maximum(np.linalg.norm(value[rows, :3], axis=1) * np.linalg.norm(value[rows, 3:], axis=1), 1e-12)
        rows = rows[sine > _PARALLEL]
    if rows.size:
        q[rows] = _of_rows(value[rows], spec, where, rows)
    return q * [-1.0, -1.0, -1.0, 1.0] if spec.sense == "conjugate" else q


def _of_rows(value: FloatArray, spec: ColumnSpec, where: str, rows: np.ndarray) -> FloatArray:
    if spec.vectors is not None:
        turned = _from_vectors(value, spec.vectors)
    elif spec.euler is not None:
        turned = Rotation.from_euler(spec.euler, value, degrees=spec.unit == "deg")
    else:
        return _ordered(value, str(spec.order), where, rows)
    return np.asarray(np.atleast_2d(turned.as_quat(canonical=True)))


def _from_vectors(value: FloatArray, vectors: str) -> Rotation:
    """Body components to those of the reference."""
    if vectors in MEASURED:
        return triad(value[:, :3], value[:, 3:])
    in_body = np.eye(3)[["xyz".index(axis) for axis in vectors.split()]]
    of_body = triad(in_body[:1], in_body[1:])
    return triad(value[:, :3], value[:, 3:]).inv() * of_body


def _ordered(value: FloatArray, order: str, where: str, rows: np.ndarray) -> FloatArray:
    if order == "xyz":
        value = np.column_stack([value, np.sqrt(np.maximum(1.0 - np.sum(value**2, axis=1), 0.0))])
    elif order == "wxyz":
        value = value[:, [1, 2, 3, 0]]
    size = np.linalg.norm(value, axis=1)
    wrong = np.flatnonzero(np.abs(size - 1.0) > 0.02)
    if wrong.size:
        raise BadInput(
            f"the quaternion in row {rows[wrong[0]] + 1} has norm {size[wrong[0]]:.4g}",
            where=where,
            wanted="norm 1 within 0.02; `invalid` for the rows without attitude",
        )
    return np.asarray(value / size[:, None])
