"""Compiled turns between N and the Earth-fixed frame along an orbit, one pass each way."""

from __future__ import annotations

from math import cos, sin

from fluxtwin.sim.base.kernel_cache import kernel
from fluxtwin.sim.base.types import FloatArray


@kernel(error_model="numpy", nogil=True)
def to_earth(
    vectors_N: FloatArray, slow: FloatArray, change: FloatArray, angle: FloatArray, turn: FloatArray, out: FloatArray
) -> None:
    """out (N, 3): N components turned by `slow` (3, 3), which grows by `change` a row, and then about z by angle (N,).

    turn (N, 2) takes up cosine and sine of the angle, for the way back.
    """
    for i in range(vectors_N.shape[0]):
        share = float(i)
        x, y, z = vectors_N[i, 0], vectors_N[i, 1], vectors_N[i, 2]
        a = (slow[0, 0] + share * change[0, 0]) * x
        a += (slow[0, 1] + share * change[0, 1]) * y + (slow[0, 2] + share * change[0, 2]) * z
        b = (slow[1, 0] + share * change[1, 0]) * x
        b += (slow[1, 1] + share * change[1, 1]) * y + (slow[1, 2] + share * change[1, 2]) * z
        d = (slow[2, 0] + share * change[2, 0]) * x
        d += (slow[2, 1] + share * change[2, 1]) * y + (slow[2, 2] + share * change[2, 2]) * z
        c, s = cos(angle[i]), sin(angle[i])
        turn[i, 0], turn[i, 1] = c, s
        out[i, 0], out[i, 1], out[i, 2] = c * a + s * b, c * b - s * a, d


@kernel(error_model="numpy", nogil=True)
def from_earth(vectors_E: FloatArray, slow: FloatArray, change: FloatArray, turn: FloatArray, out: FloatArray) -> None:
    """The way back: out (N, 3) may be `vectors_E` itself."""
    for i in range(vectors_E.shape[0]):
        share = float(i)
        c, s = turn[i, 0], turn[i, 1]
        a, b, d = c * vectors_E[i, 0] - s * vectors_E[i, 1], s * vectors_E[i, 0] + c * vectors_E[i, 1], vectors_E[i, 2]
        for k in range(3):
            out[i, k] = (slow[0, k] + share * change[0, k]) * a
            out[i, k] += (slow[1, k] + share * change[1, k]) * b + (slow[2, k] + share * change[2, k]) * d
