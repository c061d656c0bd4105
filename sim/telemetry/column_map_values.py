"""From what is stored to what is meant: lists in cells, values that mean "missing", counts, turned axes, latitudes."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

import numpy as np

from fluxtwin.sim.base.errors import BadInput
from fluxtwin.sim.base.types import BoolArray, FloatArray
from fluxtwin.sim.earth import frames
from fluxtwin.sim.telemetry.columns import clip
from fluxtwin.sim.telemetry.quantities import Quantity

if TYPE_CHECKING:
    from fluxtwin.sim.telemetry.column_map import ColumnSpec

_BETWEEN = re.compile(rb"[\s,;|\\\[\](){}]+")
_FILL_TOLERANCE = 1e-6
"""A fill value as 1e31 was often stored in single precision."""


def from_lists(text: np.ndarray, name: str, where: str) -> FloatArray:
    """(N, k) of cells that hold k numbers, an array of bytes (N,): `[x, y, z]`, `x \\ y \\ z`, `x;y;z`; blank is NaN.

    Raises BadInput naming the first cell that is no list of numbers, or one of another length.
    """
    parts = [[word for word in _BETWEEN.split(bytes(cell)) if word] for cell in text.tolist()]
    width = max(map(len, parts), default=0)
    out = np.full((len(parts), width), np.nan)
    for row, words in enumerate(parts):
        if not words:
            continue
        try:
            if len(words) == width:
                out[row] = [float(word) for word in words]
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


PLACES = ("geodetic", "geocentric")
"""Frames of a position whose columns are latitude, longitude and height."""
