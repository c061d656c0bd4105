"""Matrices in the effects: the magnetometer's own, through which a change of the field shows in the reading."""

from __future__ import annotations

import numpy as np

from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.effects.signal import Setting


def in_reading(setting: Setting, field_B_nT: FloatArray) -> FloatArray:
    """(I + S)^-1 times a field (3,) or (N, 3): what equation 1 makes of it in the reading."""
    field = np.asarray(field_B_nT)
    if not setting.instrument.S.any():
        return np.array(field, dtype=np.float64)
    inverse = np.asarray(np.linalg.inv(np.eye(3) + setting.instrument.S), dtype=np.float64)
    return inverse @ field if field.ndim == 1 else mapped(inverse, field)


def mapped(matrix: FloatArray, vectors: FloatArray) -> FloatArray:
    """(N, m) matrix (m, k) times each row of vectors (N, k), on one core: a threaded product of such a shape is slow."""
    product: FloatArray = np.einsum("nk,mk->nm", vectors, matrix)
    return product
