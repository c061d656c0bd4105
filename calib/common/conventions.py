"""Every convention of a magnetometer calibration, and the one place where they convert.

| form | equation | used by |
|---|---|---|
| correction | A H = (I+S) B + b + T D | Lerner & Shuster (journal eq. 1); scenarios and calibration files |
| forward | B = G A H + o + C D, G = I + K | simulators, "scale matrix and offset" |
| scalar | (I+D) B = O' A H + b_A, D symmetric, O orthogonal | Alonso & Shuster (TWOSTEP) |
| iron | A H = M (B - h) | "soft iron M, hard iron h" of compass makers |

A H is the true field in body axes, B the reading, both nT; the dipole of the torquers in A m2.

    I + S = G^-1 = O (I + D) = M        o = h = -(I+S)^-1 b = (I+D)^-1 b_A        C = -(I+S)^-1 T

The sign trap: b and b_A have opposite signs, b = -O b_A.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fluxtwin.sim.base.errors import BadInput
from fluxtwin.sim.base.types import FloatArray


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

    @property
    def K(self) -> FloatArray:
        """(3, 3) G - I: scale errors on the diagonal, as the sensor makes them."""
        return self.G - np.eye(3)


@dataclass(frozen=True)
class ScalarForm:
    """(I+D) B = O' A H + b_A: the attitude-independent part (D symmetric, b_A) and the rotation O."""

    D: FloatArray
    """(3, 3) symmetric."""
    b_nT: FloatArray
    """(3,) b_A."""
    O: FloatArray  # noqa: E741  (the letter of Alonso & Shuster)
    """(3, 3) orthogonal, identity where nothing is known of it."""


@dataclass(frozen=True)
class Iron:
    """A H = M (B - h)."""

    M: FloatArray
    """(3, 3) soft-iron matrix, applied after the offset is taken off."""
    h_nT: FloatArray
    """(3,) hard-iron offset, in reading units."""


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


def forward_from_correction(correction: Correction) -> Forward:
    """Invert journal eq. 1: B = (I+S)^-1 (A H - b - T D). Raises BadInput when I + S is singular."""
    G = _inverse(np.eye(3) + _matrix(correction.S, "S"), "I + S")
    T = correction.T_nT_per_Am2
    return Forward(G, -G @ correction.b_nT, None if T is None else -G @ T)


def correction_from_forward(forward: Forward) -> Correction:
    """Inverse of `forward_from_correction`."""
    inverse = _inverse(_matrix(forward.G, "G"), "G")
    C = forward.C_nT_per_Am2
    return Correction(inverse - np.eye(3), -inverse @ forward.o_nT, None if C is None else -inverse @ C)


def scalar_from_correction(correction: Correction) -> ScalarForm:
    """Polar split of I + S; T has no place in this form and is left behind."""
    rotation, stretch = polar_split(np.eye(3) + correction.S)
    return ScalarForm(stretch - np.eye(3), -rotation.T @ correction.b_nT, rotation)


def correction_from_scalar(scalar: ScalarForm) -> Correction:
    """Inverse of `scalar_from_correction`. Raises BadInput when D is not symmetric or O not orthogonal."""
    D, rotation = _matrix(scalar.D, "D"), _matrix(scalar.O, "O")
    if not np.allclose(D, D.T, rtol=0.0, atol=1e-9):
        raise BadInput("the matrix is not symmetric", where="D", wanted="D = D'")
    if not np.allclose(rotation @ rotation.T, np.eye(3), rtol=0.0, atol=1e-9):
        raise BadInput("the matrix is not orthogonal", where="O", wanted="O O' = I")
    return Correction(rotation @ (np.eye(3) + D) - np.eye(3), -rotation @ scalar.b_nT)


def iron_from_correction(correction: Correction) -> Iron:
    """M = I + S, h = -(I+S)^-1 b; T is left behind."""
    return Iron(np.eye(3) + correction.S, forward_from_correction(correction).o_nT)


def correction_from_iron(iron: Iron) -> Correction:
    """Inverse of `iron_from_correction`."""
    M = _matrix(iron.M, "M")
    return Correction(M - np.eye(3), -M @ np.asarray(iron.h_nT, dtype=float))


def misalignment_rad(S: FloatArray) -> FloatArray:
    """(3,) rotation vector of the orthogonal part of I + S: v_true = exp([vector x]) v_scaled.

    For a small S it is the axial part of (S - S')/2.
    """
    rotation, _ = polar_split(np.eye(3) + _matrix(S, "S"))
    if np.linalg.det(rotation) < 0:
        raise BadInput("I + S turns a right-handed triad into a left-handed one", where="S", wanted="det(I+S) > 0")
    axial = 0.5 * np.array(
        [rotation[2, 1] - rotation[1, 2], rotation[0, 2] - rotation[2, 0], rotation[1, 0] - rotation[0, 1]]
    )
    sine = float(np.linalg.norm(axial))
    angle = float(np.arctan2(sine, 0.5 * (np.trace(rotation) - 1.0)))
    return axial if sine < 1e-12 else axial * (angle / sine)


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


def _inverse(matrix: FloatArray, name: str) -> FloatArray:
    polar_split(matrix)  # refuses a singular matrix by name
    try:
        return np.asarray(np.linalg.solve(matrix, np.eye(3)), dtype=np.float64)
    except np.linalg.LinAlgError:
        raise BadInput("the matrix is singular", where=name, wanted="rank 3") from None
