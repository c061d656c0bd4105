"""CENTER: the bias from differences of |B|^2 - |H|^2, one linear solution.

z = |B|^2 - |H|^2 = 2 B.b - |b|^2 + v (Alonso & Shuster 2002, J. Astronaut. Sci. 50, 455). Taking means off drops |b|^2
and with it all that is quadratic:

    b = [sum 4 Bt Bt']^-1 sum 2 Bt zt,     Bt = B - <B>, zt = z - <z>

Gambhir (1975) in RESIDG. It needs no start, and throws away what the means know. Numbers are free of units.
"""

from __future__ import annotations

import numpy as np

from fluxtwin.calib.scalar.model import ScalarData
from fluxtwin.sim.base.types import FloatArray


def center(data: ScalarData, a: FloatArray | None = None) -> FloatArray:
    """(3,) b, of least size where the readings do not span space; a: (N,) weights."""
    w = np.full(len(data.H), 1.0 / len(data.H)) if a is None else a / a.sum()
    z = (data.B**2).sum(axis=1) - data.H**2
    B = data.B - w @ data.B
    gram = 4.0 * ((B * w[:, None]).T @ B)
    right = 2.0 * ((B * w[:, None]).T @ (z - w @ z))
    return np.asarray(np.linalg.lstsq(gram, right, rcond=1e-10)[0])


def center_terms(
    b: FloatArray, data: ScalarData, a: FloatArray | None = None
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Scores (N, 3), their slope (3, 3) and its factors (N, 3): the error of b is slope^-1 times the sum of the scores.

    a: (N,) weights, one each where not given.
    """
    w = np.ones(len(data.H)) if a is None else a
    z = (data.B**2).sum(axis=1) - data.H**2
    rows = 2.0 * (data.B - w @ data.B / w.sum())
    left = z - w @ z / w.sum() - rows @ b
    return rows * (w * left)[:, None], np.asarray((rows * w[:, None]).T @ rows), rows
