"""How well a calibrated magnetometer knows the direction of the field: an angle, at 95 % confidence.

The absolute knowledge error (AKE) of ECSS-E-ST-60-10C is the difference between what is known and what is, at any one
instant. Its statistical interpretation is the mixed one of that standard: over the instants of the record, and over the
calibrations that the covariance allows. The error of an instant is Gaussian, two components across the field,

    delta = dS B + db + dT D + (I+S) noise,     angle = |delta across the field| / |field|

with the joint covariance of S, b and T, and the noise of one reading. The quantile is that of the mixture over the rows.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq
from scipy.spatial.transform import Rotation

from fluxtwin.calib.common.conventions import best_turn, of_S
from fluxtwin.calib.common.records import Calibration
from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.earth.frames import angle_between

CONFIDENCE = 0.95
ROWS = 500
"""Of a longer record, evenly spread: they stand for all of it."""
_ANGLES = 64  # of the quadrature over the ellipse: exact to four digits for axes as different as 1 to 30


@dataclass(frozen=True)
class DirectionKnowledge:
    """Knowledge error of the field's direction, 95 % [deg]; what was not estimated is taken as zero.

    An absolute one (AKE), but for the methods that compare |B| alone: a rotation of the sensor in the body is not in it.
    """

    before_deg: float
    """Of the readings as they are: measured, against the model (without attitude: against the calibrated reading)."""
    after_deg: float
    """Of a calibrated reading: errors of the calibration and noise, not those of the reference attitude."""
    calibration_deg: float
    """Of that, the errors of the calibration alone."""
    calibration_anywhere_deg: float
    """The same for a field as strong in every direction of the body: in attitudes that the record does not have."""
    noise_deg: float
    """Of `after_deg`, the noise of one reading alone."""
    against_reference_deg: float | None
    """Of calibrated readings against the model in the reference attitude, measured; its error is in it. None without one."""
    rotation_counted: bool = True
    """Whether a rotation of the sensor in the body is in these angles: |B| alone does not show one."""
    rotation_deg: float | None = None
    """Where it is not: that of the calibrated readings to the model in the record's attitude. None without attitude."""


def direction_knowledge(
    calibration: Calibration,
    reading_nT: FloatArray,
    dipole_Am2: FloatArray | None,
    field_nT: FloatArray,
    true_nT: FloatArray,
    noise_nT2: FloatArray,
) -> DirectionKnowledge:
    """From readings B, dipoles D and calibrated fields (N, 3), and what stands for the true field (N, 3), body axes.

    noise_nT2: (3,) variance of a reading.
    """
    some = spread_rows(len(field_nT))
    dipole = None if dipole_Am2 is None else dipole_Am2[some]
    of_calibration = _of_calibration(calibration, reading_nT[some], dipole, field_nT[some])
    size = np.linalg.norm(field_nT[some], axis=1)
    turned = _across(field_nT[some]) @ (np.eye(3) + calibration.S)
    of_noise = (turned * noise_nT2) @ turned.transpose(0, 2, 1)
    even = even_directions(ROWS) * float(np.sqrt((size**2).mean()))
    return DirectionKnowledge(
        before_deg=float(np.degrees(np.quantile(angle_between(reading_nT, true_nT), CONFIDENCE))),
        after_deg=_quantile_deg(of_noise + of_calibration),
        calibration_deg=_quantile_deg(of_calibration),
        calibration_anywhere_deg=_quantile_deg(_of_calibration(calibration, even, None, even)),
        noise_deg=_quantile_deg(of_noise),
        against_reference_deg=float(np.degrees(np.quantile(angle_between(field_nT, true_nT), CONFIDENCE))),
    )


def rotation_deg(field_nT: FloatArray, true_nT: FloatArray) -> float | None:
    """Angle [deg] of the rotation that best turns fields (N, 3) into others; None where no row has both."""
    both = np.isfinite(field_nT).all(axis=1) & np.isfinite(true_nT).all(axis=1)
    if not both.any():
        return None
    turn = best_turn(true_nT[both].T @ field_nT[both])
    return float(np.degrees(np.linalg.norm(Rotation.from_matrix(turn).as_rotvec())))


def _across(field_nT: FloatArray) -> FloatArray:
    """(n, 3, 3) from an error [nT] to the angle [rad] by which it turns the field."""
    size = np.linalg.norm(field_nT, axis=1)
    u = field_nT / size[:, None]
    return np.asarray((np.eye(3) - u[:, :, None] * u[:, None, :]) / size[:, None, None])


def _of_calibration(calibration: Calibration, B: FloatArray, D: FloatArray | None, field_nT: FloatArray) -> FloatArray:
    """(n, 3, 3) covariance of the angle [rad2] that the errors of the parameters give."""
    T = None if calibration.T_nT_per_Am2 is None else D
    through = _across(field_nT) @ of_parameters(B, T, len(calibration.names))
    return np.asarray(through @ calibration.covariance @ through.transpose(0, 2, 1))


def spread_rows(count: int) -> np.ndarray:
    """Indices of at most `ROWS` rows, evenly spread over so many."""
    return np.unique(np.linspace(0, count - 1, min(ROWS, count)).astype(int))


def even_directions(count: int, first: float = 0.0) -> FloatArray:
    """(count, 3) unit vectors spread evenly over the sphere (Fibonacci's spiral); first: turn of the first one, in steps."""
    z = 1.0 - 2.0 * (np.arange(count) + 0.5) / count
    turn = np.pi * (1.0 + np.sqrt(5.0)) * (np.arange(count) + first)
    across = np.sqrt(1.0 - z**2)
    return np.stack([across * np.cos(turn), across * np.sin(turn), z], axis=1)


def of_parameters(B: FloatArray, D: FloatArray | None = None, size: int = 12) -> FloatArray:
    """(n, 3, size) derivative of (I+S) B + b + T D by the parameters, in the order of the covariance."""
    J = np.zeros((len(B), 3, size))
    J[:, :, :9], J[:, :, 9:12] = of_S(B), np.eye(3)
    if D is not None:
        J[:, :, 12:] = of_S(np.nan_to_num(D))
    return J


def _quantile_deg(covariance: FloatArray) -> float:
    """The angle [deg] that a mixture of Gaussian errors of (n, 3, 3) covariance [rad2] stays within, at `CONFIDENCE`.

    With z = rho (cos phi, sin phi) standard Gaussian, |error|^2 = rho^2 a(phi), a = l1 cos^2 phi + l2 sin^2 phi, and
    P(|error| < x) is the mean of 1 - exp(-x^2 / 2a) over phi.
    """
    values = np.maximum(np.linalg.eigvalsh(covariance)[:, 1:], 0.0)
    phi = np.pi * (np.arange(_ANGLES) + 0.5) / _ANGLES
    a = values[:, :1] * np.cos(phi) ** 2 + values[:, 1:] * np.sin(phi) ** 2
    if not a.max() > 0:
        return 0.0

    def too_far(angle_rad: float) -> float:
        return float(np.exp(-(angle_rad**2) / (2.0 * np.maximum(a, 1e-300))).mean()) - (1.0 - CONFIDENCE)

    largest = 10.0 * float(np.sqrt(a.max()))
    return float(np.degrees(brentq(too_far, 0.0, largest, xtol=1e-12 * largest)))
