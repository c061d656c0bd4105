"""The conventions of a magnetometer calibration, and the one place where they convert.

| form | equation | used by |
|---|---|---|
| correction | A H = (I+S) B + b + T D | Lerner & Shuster (journal eq. 1); scenarios and calibration files |
| forward | B = G A H + o + C D, G = I + K | simulators, "scale matrix and offset", "soft and hard iron" |
| offset first | A H = M (B - o) + T D | flight software: the offset comes off the reading, then the matrix acts |

A H is the true field in body axes, B the reading, both nT; the dipole of the torquers in A m2.

    I + S = G^-1 = M        o = -(I+S)^-1 b (the same in both)        C = -(I+S)^-1 T

The sign trap: Alonso & Shuster (TWOSTEP) write (I+D) B = O' A H + b_A with D symmetric and O orthogonal; their b_A and b
have opposite signs, b = -O b_A.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fluxtwin.sim.base.errors import BadInput
from fluxtwin.sim.base.types import FloatArray

PAIRS = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))
"""Places of the six numbers of a symmetric matrix: xx, yy, zz, xy, xz, yz, the order of ArduPilot and PX4 too."""


@dataclass(frozen=True)
class Correction:
    """A H = (I+S) B + b + T D (journal eq. 1): reading to true field."""

    S: FloatArray
    """(3, 3)."""
    b_nT: FloatArray
    """(3,)."""
    T_nT_per_Am2: FloatArray | None = None
    """(3, 3) or absent."""


@dataclass(frozen=True)
class Forward:
    """B = G A H + o + C D: true field to reading."""

    G: FloatArray
    """(3, 3)."""
    o_nT: FloatArray
    """(3,)."""
    C_nT_per_Am2: FloatArray | None = None
    """(3, 3) or absent: reading per dipole."""


@dataclass(frozen=True)
class OffsetFirst:
    """A H = M (B - o) + T D: reading to true field, as flight software holds it."""

    M: FloatArray
    """(3, 3)."""
    o_nT: FloatArray
    """(3,) what the sensor reads where there is no field."""
    T_nT_per_Am2: FloatArray | None = None
    """(3, 3) or absent, as in `Correction`."""

    def apply(self, reading_nT: FloatArray) -> FloatArray:
        """(..., 3) M (B - o), without the torquers."""
        return np.asarray((reading_nT - self.o_nT) @ self.M.T)

    def undo(self, corrected_nT: FloatArray) -> FloatArray:
        """(..., 3) the reading that `apply` made this of. Raises BadInput for a singular M."""
        return np.asarray(corrected_nT @ _inverse(self.M).T + self.o_nT)


def six_of(M: FloatArray) -> list[float]:
    """The numbers of a symmetric matrix (3, 3) at `PAIRS`."""
    return [float(M[at]) for at in PAIRS]


def symmetric(six: Sequence[float] | FloatArray) -> FloatArray:
    """(3, 3) of its six numbers at `PAIRS`."""
    xx, yy, zz, xy, xz, yz = six
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def polar_split(M: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(O, P) with M = O P, O orthogonal, P symmetric positive definite, through the SVD; each (3, 3).

    Raises BadInput for a singular matrix. Source: any text on the polar decomposition (Higham 2008, ch. 8).
    """
    left, size, right = np.linalg.svd(_matrix(M, "matrix"))
    if not size[-1] > 1e-9 * size[0]:
        raise BadInput(
            f"the matrix is singular (singular values {size.round(12).tolist()})", where="I + S", wanted="rank 3"
        )
    return left @ right, (right.T * size) @ right


def best_turn(cross: FloatArray) -> FloatArray:
    """The rotation matrix R, (3, 3), that maximises the trace of R' cross (Wahba's problem by Markley's SVD)."""
    U, _, Vt = np.linalg.svd(cross)
    return np.asarray(U @ np.diag([1.0, 1.0, np.linalg.det(U) * np.linalg.det(Vt)]) @ Vt)


def forward_from_correction(correction: Correction) -> Forward:
    """Invert journal eq. 1: B = (I+S)^-1 (A H - b - T D). Raises BadInput when I + S is singular."""
    G = _inverse(np.eye(3) + _matrix(correction.S, "S"))
    T = correction.T_nT_per_Am2
    return Forward(G, -G @ correction.b_nT, None if T is None else -G @ T)


def correction_from_forward(forward: Forward) -> Correction:
    """Inverse of `forward_from_correction`."""
    inverse = _inverse(_matrix(forward.G, "G"))
    C = forward.C_nT_per_Am2
    return Correction(inverse - np.eye(3), -inverse @ forward.o_nT, None if C is None else -inverse @ C)


def offset_first_from_correction(correction: Correction) -> OffsetFirst:
    """M = I + S, o = -M^-1 b. Raises BadInput when I + S is singular."""
    M = np.eye(3) + _matrix(correction.S, "S")
    return OffsetFirst(M, -_inverse(M) @ correction.b_nT, correction.T_nT_per_Am2)


def correction_from_offset_first(held: OffsetFirst) -> Correction:
    """Inverse of `offset_first_from_correction`."""
    M = _matrix(held.M, "M")
    return Correction(M - np.eye(3), -M @ held.o_nT, held.T_nT_per_Am2)


def forward_jacobian(correction: Correction) -> FloatArray:
    """(21, 21) derivative of (S, b, T) with respect to (G, o, C), each in the order of the calibration file.

    From d(I+S) = -(I+S) dG (I+S), db = -(I+S) (dG b + do), dT = -(I+S) (dG T + dC).
    """
    M = np.eye(3) + correction.S
    T = np.zeros((3, 3)) if correction.T_nT_per_Am2 is None else correction.T_nT_per_Am2
    jacobian = np.zeros((21, 21))
    for row in range(3):
        for column in range(3):
            unit = np.outer(M[:, row], np.eye(3)[column])  # (I+S) dG for a unit dG
            at = 3 * row + column
            jacobian[:9, at] = -(unit @ M).ravel()
            jacobian[9:12, at] = -(unit @ correction.b_nT)
            jacobian[12:, at] = -(unit @ T).ravel()
            jacobian[12:, 12 + at] = -unit.ravel()
        jacobian[9:12, 9 + row] = -M[:, row]
    return jacobian


def _matrix(value: FloatArray, name: str) -> FloatArray:
    matrix = np.asarray(value, dtype=np.float64)
    if matrix.shape != (3, 3) or not np.isfinite(matrix).all():
        raise BadInput(f"has shape {matrix.shape} or is not finite", where=name, wanted="a finite 3 x 3 matrix")
    return matrix


def _inverse(matrix: FloatArray) -> FloatArray:
    polar_split(matrix)  # refuses a singular matrix
    return np.asarray(np.linalg.solve(matrix, np.eye(3)), dtype=np.float64)


def of_S(vectors: FloatArray) -> FloatArray:
    """(N, 3, 9) of vectors (N, 3): times S, row by row, it is S v."""
    return np.asarray(np.einsum("ij,nk->nijk", np.eye(3), vectors).reshape(len(vectors), 3, 9))
