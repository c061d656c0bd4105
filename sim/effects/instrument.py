"""Matrices in the effects: the magnetometer's own, through which a change of the field shows in the reading."""

from __future__ import annotations

import numpy as np

from fluxtwin.sim.signal import Setting
from fluxtwin.sim.types import FloatArray


def in_reading(setting: Setting, field_B_nT: FloatArray) -> FloatArray:
    """(I + S)^-1 times a field (3,) or (N, 3): what equation 1 makes of it in the reading."""
    matrix = np.eye(3) + setting.instrument.S
    return np.asarray(np.linalg.solve(matrix, np.asarray(field_B_nT).T).T, dtype=np.float64)


def mapped(matrix: FloatArray, vectors: FloatArray) -> FloatArray:
    """(N, m) matrix (m, k) times each row of vectors (N, k), on one core: a threaded product of such a shape is slow."""
    product: FloatArray = np.einsum("nk,mk->nm", vectors, matrix)
    return product
