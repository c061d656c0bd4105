"""Calibration of a horizon scanner from the angle between sun and nadir.

The angle between two directions in space does not depend on attitude, so the measured one, from sun sensor and scanner,
can be compared with the computed one without knowing where the spacecraft points. Taking the sun sensor as right, the
scanner's biases are those that make the two agree best: the idea of S. G. Hotovy (AAS/AIAA Astrodynamics Conference,
Jackson Hole, 1977), as Lerner & Shuster (1979, 1981) describe it.

Nadir in body axes is (-sin p cos r, sin r, cos p cos r) for roll r and pitch p of the 3-1-2 set, whatever the yaw. The
sun moves through the body along an orbit, and so both biases can be separated; from one sun direction only the
tilt towards the sun is seen.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from fluxtwin.calib.common.covariance import segments, small_sample
from fluxtwin.sim.base.errors import BadInput, NoAnswer, amount
from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.earth import frames, sun
from fluxtwin.sim.telemetry.record import Telemetry

_FEWEST = 10
_NEAR_LINE = float(np.radians(3.0))
"""Rows with sun and nadir nearer to one line than this are left out: the angle says nothing of a small tilt there."""
_WEAK_DEG = 5.0


@dataclass(frozen=True)
class ScannerCalibration:
    """What is to be taken off measured roll and pitch. N rows used."""

    bias_rad: FloatArray
    """(2,) roll, pitch: measured less true."""
    covariance: FloatArray
    """(2, 2), errors within a pass taken as one."""
    samples: int
    passes: int
    rms_before_rad: float
    """Measured less computed sun-nadir angle, rms."""
    rms_after_rad: float
    rows: np.ndarray
    """(N,) rows of the record used."""

    @property
    def sigmas_rad(self) -> FloatArray:
        """(2,) 1 sigma of roll and pitch."""
        return np.asarray(np.sqrt(np.diag(self.covariance)))

    def apply(self, telemetry: Telemetry) -> Telemetry:
        """The record with its measured nadir corrected; attitude made from the old one is left as it is."""
        if telemetry.nadir_B is None:
            raise BadInput("there is no measured nadir", where="nadir_x nadir_y nadir_z", wanted="the three columns")
        angles = frames.roll_pitch(np.array(telemetry.nadir_B)) - self.bias_rad
        return telemetry.replace(nadir_B=frames.nadir_of(angles))


def calibrate_scanner(
    telemetry: Telemetry, *, heads: Sequence[int] | None = None, passes: np.ndarray | None = None
) -> ScannerCalibration:
    """Roll and pitch bias of the scanner from measured sun and nadir.

    heads: numbers of the sun-sensor heads that are trusted; all where not given. passes: (rows,) labels of stretches
    with a common error; gaps in time divide them where not given. Raises BadInput for absent columns, NoAnswer when
    fewer than ten rows have both directions or the sun stays so that a bias cannot be seen.
    """
    rows = sun_and_nadir(telemetry)
    if heads is not None:
        if telemetry.sun_sensor_head is None:
            raise BadInput("heads are chosen, and the record does not say which saw the sun", where="sun_sensor_head")
        rows = rows[np.isin(telemetry.sun_sensor_head[rows], heads)]
    if rows.size < _FEWEST:
        raise NoAnswer(
            f"{amount(rows.size, 'row has|rows have')} both a sun and a nadir measurement of trusted heads; {_FEWEST} are "
            "needed",
            evidence={"rows": int(rows.size)},
        )
    assert telemetry.sun_B is not None and telemetry.nadir_B is not None and telemetry.r_N_km is not None
    r_N_km = np.array(telemetry.r_N_km)[rows]
    computed = frames.angle_between(-r_N_km, sun.sun_direction_N(telemetry.time[rows], r_N_km))
    sun_B = np.array(telemetry.sun_B)[rows]
    measured = frames.roll_pitch(np.array(telemetry.nadir_B)[rows])

    def residual_of(bias: FloatArray) -> FloatArray:
        return frames.angle_between(sun_B, frames.nadir_of(measured - bias)) - computed

    first = residual_of(np.zeros(2))
    found = least_squares(residual_of, np.zeros(2), jac="3-point", xtol=1e-14, ftol=1e-14, gtol=1e-14)
    bias, residual, J = found.x, found.fun, np.asarray(found.jac)
    # Both biases must come out better than five degrees for the scatter at hand.
    values, vectors = np.linalg.eigh(J.T @ J)
    sigma_deg = float(np.degrees(max(float(np.sqrt(np.mean(residual**2))), 1e-4) / np.sqrt(max(values[0], 1e-30))))
    if sigma_deg > _WEAK_DEG:
        roll, pitch = vectors[:, 0]
        raise NoAnswer(
            f"the sun stays where {roll:+.2f} roll {pitch:+.2f} pitch cannot be seen; more of the orbit is needed",
            evidence={"direction": [float(roll), float(pitch)], "sigma_deg": sigma_deg},
        )
    label = segments(telemetry.time[rows]) if passes is None else np.asarray(passes)[rows]
    covariance, count = _by_pass(J, residual, label)
    return ScannerCalibration(
        bias_rad=bias,
        covariance=covariance,
        samples=int(rows.size),
        passes=count,
        rms_before_rad=float(np.sqrt(np.mean(first**2))),
        rms_after_rad=float(np.sqrt(np.mean(residual**2))),
        rows=rows,
    )


def sun_and_nadir(telemetry: Telemetry) -> np.ndarray:
    """Rows with measured sun and nadir, well apart, and a position. Raises BadInput where a column is absent."""
    for name, columns in (("sun_B", "sun_x sun_y sun_z"), ("nadir_B", "nadir_x nadir_y nadir_z")):
        if getattr(telemetry, name) is None:
            raise BadInput("the record has no such columns", where=columns, wanted="measured unit vectors, body axes")
    assert telemetry.sun_B is not None and telemetry.nadir_B is not None
    good = np.isfinite(telemetry.sun_B).all(axis=1) & np.isfinite(telemetry.nadir_B).all(axis=1)
    rows = np.flatnonzero(good & telemetry.has_position)
    apart = frames.angle_between(np.array(telemetry.sun_B)[rows], np.array(telemetry.nadir_B)[rows])
    return rows[(apart > _NEAR_LINE) & (apart < np.pi - _NEAR_LINE)]


def _by_pass(J: FloatArray, residual: FloatArray, label: np.ndarray) -> tuple[FloatArray, int]:
    """Covariance from the scatter of the passes' own pulls (Huber 1967), and how many passes there are."""
    _, of_row = np.unique(label, return_inverse=True)
    count = int(of_row.max()) + 1
    inverse = np.linalg.inv(J.T @ J)
    if count < 3:
        return np.asarray(inverse * float(np.mean(residual**2))), count
    pull = np.zeros((count, 2))
    np.add.at(pull, of_row, J * residual[:, None])
    widened = small_sample(count) ** 2 * count / (count - 2)
    return np.asarray(widened * inverse @ (pull.T @ pull) @ inverse), count
