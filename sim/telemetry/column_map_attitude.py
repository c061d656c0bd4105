"""Attitudes as foreign files have them: quaternions in any order, Euler angles in any sequence, two directions."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

import numpy as np
from scipy.spatial.transform import Rotation

from fluxtwin.sim.base.errors import BadInput
from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.earth.references import triad
from fluxtwin.sim.telemetry import column_map_words as words

if TYPE_CHECKING:
    from fluxtwin.sim.telemetry.column_map import ColumnSpec

MEASURED = ("sun nadir", "nadir sun")
"""Directions that are measured in body axes: the attitude is relative to axes made of the same two."""
_BODY_AXES = tuple(f"{a} {b}" for a in "xyz" for b in "xyz" if a != b)
VECTORS = (*MEASURED, *_BODY_AXES)
_OLD_ANGLES = {"yaw_roll_pitch_deg": "deg", "yaw_roll_pitch_rad": "rad"}
_EULER = re.compile(r"([xyz]{3}|[XYZ]{3})")
_PARALLEL = 0.02
"""Sine of the angle between two directions below which they make no attitude."""


def check(spec: ColumnSpec) -> None:
    """Raises ValueError in words where the keys of an attitude do not say one."""
    stated = [key for key in ("order", "angles", "euler", "vectors") if getattr(spec, key) is not None]
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
    wanted = components(spec)
    if isinstance(spec.source, list) and len(spec.source) not in (wanted, 1):
        raise ValueError(f"attitude takes {wanted} columns here")


def components(spec: ColumnSpec) -> int:
    """Numbers of a row that the attitude is made of."""
    return 6 if spec.vectors is not None else 4 if spec.order in ("xyzw", "wxyz") else 3


def quaternion(value: FloatArray, spec: ColumnSpec, where: str) -> FloatArray:
    """Textbook quaternion (N, 4), scalar last, of the body relative to the map's reference, from the columns (N, k).

    Rows with a blank are NaN. Raises BadInput for quaternions without the norm 1.
    """
    if value.shape[1] != components(spec):
        raise BadInput(
            f"attitude has {value.shape[1]} components", where=where, wanted=f"{components(spec)} of them here"
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
    elif spec.order is None:
        unit = spec.unit or _OLD_ANGLES[str(spec.angles)]
        turned = Rotation.from_euler(spec.euler or "ZXY", value, degrees=unit == "deg")
    else:
        return _ordered(value, spec.order, where, rows)
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
