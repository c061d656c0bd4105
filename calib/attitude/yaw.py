"""Yaw from the magnetometer, with roll and pitch known from elsewhere (a horizon scanner).

B is the calibrated field in body axes, B0 the model field in the orbital frame; yaw y, roll r, pitch p are
the 3-1-2 angles from O to B.

    y = [B02 (B1 + p B3) - B01 (B2 - r B3)] / (B01^2 + B02^2)          first order, journal eq. 12 (1979 eq. 10)
    var y = (sigma_B^2 + B03^2 sigma_a^2) / (B01^2 + B02^2)            journal eq. 14 (1979 eq. 11)

The journal's eq. 12 prints B2 where B3 stands (the pseudo-inverse of eq. 13 gives B3, and the conference paper
prints it). The full solution takes roll and pitch out of B exactly and compares azimuths about z.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from fluxtwin.calib.common.design import joined, rows_with
from fluxtwin.calib.common.records import Calibration
from fluxtwin.sim.base.errors import BadInput, NoAnswer
from fluxtwin.sim.base.shown import Shown
from fluxtwin.sim.base.types import FloatArray, TimeArray
from fluxtwin.sim.earth import epoch, frames
from fluxtwin.sim.earth.field import FieldModel, field_N_nT
from fluxtwin.sim.telemetry.record import Telemetry

AVERAGE_S = 120.0
"""The averaging interval of the papers' figures 1 and 2."""


@dataclass(frozen=True)
class YawAverages:
    """Means over fixed intervals; K intervals that hold at least one sample."""

    time: TimeArray
    """(K,) middle of the interval, UTC."""
    yaw_rad: FloatArray
    """(K,) mean of the full solution."""
    samples: np.ndarray
    """(K,) samples in each."""


@dataclass(frozen=True)
class YawSolution(Shown):
    """N rows that have a reading, a position, roll and pitch."""

    time: TimeArray
    """(N,) UTC."""
    yaw_rad: FloatArray
    """(N,) full solution."""
    yaw_first_order_rad: FloatArray
    """(N,) journal eq. 12."""
    sigma_rad: FloatArray
    """(N,) journal eq. 14."""
    roll_rad: FloatArray
    """(N,) taken as known."""
    pitch_rad: FloatArray
    """(N,) taken as known."""
    yaw_reference_rad: FloatArray
    """(N,) of the reference attitude; NaN where it is not known."""
    averages: YawAverages
    rows: np.ndarray
    """(N,) indices into the joined telemetry."""
    left_out: Mapping[str, int]
    """Rows not used, by reason."""

    def rms_error_rad(self, estimate_rad: FloatArray | None = None) -> float | None:
        """rms of (estimate - reference) where the reference is known; None where it never is.

        estimate_rad: (N,), the full solution when not given; zeros test "yaw = 0".
        """
        known = np.isfinite(self.yaw_reference_rad)
        if not known.any():
            return None
        estimate = self.yaw_rad if estimate_rad is None else estimate_rad
        off = (estimate - self.yaw_reference_rad + np.pi) % (2.0 * np.pi) - np.pi
        return float(np.sqrt((off[known] ** 2).mean()))

    @property
    def summary(self) -> dict[str, Any]:
        """Samples, sigmas and rms against the reference in degrees, for JSON; None where a number is not known."""
        low, middle, high = _degrees(np.quantile(self.sigma_rad, [0.0, 0.5, 1.0], method="nearest"))
        estimates = (self.yaw_rad, self.yaw_first_order_rad, np.zeros_like(self.yaw_rad))
        rms = _degrees(np.array([self.rms_error_rad(one) for one in estimates], dtype=np.float64))
        return {
            "samples": len(self.time),
            "left_out": dict(self.left_out),
            "sigma_deg": {"smallest": low, "median": middle, "largest": high},
            "rms_against_reference_deg": dict(zip(("full", "first_order", "zero_yaw"), rms, strict=True)),
        }

    def to_dict(self) -> dict[str, Any]:
        """Degrees and UTC text for JSON; None where a number is not known (no reference, a vertical field)."""
        return {
            "time": [epoch.iso(t, "ms") for t in self.time],
            "yaw_deg": _degrees(self.yaw_rad),
            "yaw_first_order_deg": _degrees(self.yaw_first_order_rad),
            "sigma_deg": _degrees(self.sigma_rad),
            "yaw_reference_deg": _degrees(self.yaw_reference_rad),
            "averages": {
                "time": [epoch.iso(t, "ms") for t in self.averages.time],
                "yaw_deg": _degrees(self.averages.yaw_rad),
                "samples": self.averages.samples.tolist(),
            },
            "left_out": dict(self.left_out),
        }


def yaw_first_order(field_B_nT: FloatArray, field_O_nT: FloatArray, roll: FloatArray, pitch: FloatArray) -> FloatArray:
    """(N,) yaw [rad] by journal eq. 12. Fields (N, 3); roll, pitch (N,) rad, small, as yaw must be.

    Not finite where the field is vertical.
    """
    b1, b2, b3 = np.asarray(field_B_nT).T
    b01, b02, _ = np.asarray(field_O_nT).T
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray((b02 * (b1 + pitch * b3) - b01 * (b2 - roll * b3)) / _horizontal_squared(field_O_nT))


def yaw_full(field_B_nT: FloatArray, field_O_nT: FloatArray, roll: FloatArray, pitch: FloatArray) -> FloatArray:
    """(N,) yaw [rad] in (-pi, pi], for angles of any size. Arguments as `yaw_first_order`."""
    tilt = frames.rotation_BO(np.zeros_like(roll), roll, pitch)  # O to B without yaw
    c = tilt.inv().apply(field_B_nT)
    b0 = np.asarray(field_O_nT)
    return np.asarray(np.arctan2(b0[:, 1] * c[:, 0] - b0[:, 0] * c[:, 1], b0[:, 0] * c[:, 0] + b0[:, 1] * c[:, 1]))


def yaw_sigma(field_O_nT: FloatArray, sigma_B_nT: float, sigma_angle_rad: float) -> FloatArray:
    """(N,) 1 sigma of yaw [rad] by journal eq. 14; infinite where the field is vertical.

    sigma_B_nT: of one component of the calibrated field; sigma_angle_rad: of roll and of pitch.
    """
    vertical = np.asarray(field_O_nT)[:, 2]
    with np.errstate(divide="ignore"):
        return np.asarray(
            np.sqrt((sigma_B_nT**2 + (vertical * sigma_angle_rad) ** 2) / _horizontal_squared(field_O_nT))
        )


def average_yaw(time: TimeArray, yaw_rad: FloatArray, interval_s: float = AVERAGE_S) -> YawAverages:
    """Means over intervals counted from the first stamp; angles are averaged on the circle."""
    if not interval_s > 0:
        raise BadInput(f"{interval_s!r}", where="--average-s", wanted="seconds, positive")
    seconds = epoch.seconds_since(time, time[0])
    number, interval = np.unique(np.floor(seconds / interval_s).astype(int), return_inverse=True)
    samples = np.bincount(interval)
    sine = np.bincount(interval, np.sin(yaw_rad)) / samples
    cosine = np.bincount(interval, np.cos(yaw_rad)) / samples
    return YawAverages(epoch.add_seconds(time[0], (number + 0.5) * interval_s), np.arctan2(sine, cosine), samples)


def yaw_from_field(
    records: Telemetry | Sequence[Telemetry],
    calibration: Calibration,
    model: FieldModel,
    *,
    sigma_B_nT: float | None = None,
    sigma_angle_rad: float = np.radians(0.1),
    average_s: float = AVERAGE_S,
) -> YawSolution:
    """Yaw for every row with a reading, a position, and roll and pitch.

    Roll and pitch come from the reference attitude, or, in rows without one, from the measured nadir; the yaw
    of the reference is never used, only handed on for comparison. sigma_B_nT: default the calibration's
    residual. sigma_angle_rad: of roll and pitch, for eq. 14.

    Raises NoAnswer when no row is complete, BadInput when the calibration needs a dipole that is absent.
    """
    telemetry = joined(records)
    velocity = velocity_of(telemetry)
    known = telemetry.has_position & np.isfinite(velocity).all(axis=1)
    roll, pitch, reference = _known_angles(telemetry, velocity, known)
    corrected = calibration.apply(telemetry.mag_B_nT, telemetry.dipole_B_Am2, calibration.columns_of(telemetry))
    complete = np.asarray(np.isfinite(corrected).all(axis=1))
    rows, left_out = rows_with({"no reading": complete, "no position": known, "no roll and pitch": np.isfinite(roll)})
    if not rows.size:
        raise NoAnswer(
            "no row has a reading, a position, and roll and pitch (a reference attitude or a measured nadir)",
            evidence={"left_out": left_out},
        )
    assert telemetry.r_N_km is not None
    r, time = telemetry.r_N_km[rows], telemetry.time[rows]
    field_O = frames.rotation_ON(r, velocity[rows]).apply(field_N_nT(model, time, r))
    yaw = yaw_full(corrected[rows], field_O, roll[rows], pitch[rows])
    return YawSolution(
        time=time,
        yaw_rad=yaw,
        yaw_first_order_rad=yaw_first_order(corrected[rows], field_O, roll[rows], pitch[rows]),
        sigma_rad=yaw_sigma(field_O, calibration.sigma_nT if sigma_B_nT is None else sigma_B_nT, sigma_angle_rad),
        roll_rad=roll[rows],
        pitch_rad=pitch[rows],
        yaw_reference_rad=reference[rows],
        averages=average_yaw(time, yaw, average_s),
        rows=rows,
        left_out=left_out,
    )


def _known_angles(
    telemetry: Telemetry, velocity: FloatArray, known: np.ndarray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Roll, pitch and the reference's yaw, each (N,), NaN where not known."""
    roll, pitch, yaw = (np.full(len(telemetry), np.nan) for _ in range(3))
    if telemetry.nadir_B is not None:
        seen = known & np.isfinite(telemetry.nadir_B).all(axis=1)
        roll[seen], pitch[seen] = frames.roll_pitch(telemetry.nadir_B[seen]).T
    attitude = np.flatnonzero(known & telemetry.has_attitude)
    if attitude.size and telemetry.q_NB is not None and telemetry.r_N_km is not None:
        R_ON = frames.rotation_ON(telemetry.r_N_km[attitude], velocity[attitude])
        R_BO: Rotation = frames.rotation_from_q(telemetry.q_NB[attitude]) * R_ON.inv()
        yaw[attitude], roll[attitude], pitch[attitude] = frames.yaw_roll_pitch(R_BO)
    return roll, pitch, yaw


def velocity_of(telemetry: Telemetry) -> FloatArray:
    """(N, 3) velocity as given, else a direction in the orbital plane from neighbouring positions."""
    if telemetry.r_N_km is None:
        return np.full((len(telemetry), 3), np.nan)
    if telemetry.v_N_km_s is not None:
        return telemetry.v_N_km_s
    if len(telemetry) < 2:
        return np.full((1, 3), np.nan)
    seconds = epoch.seconds_since(telemetry.time, telemetry.time[0])
    return np.asarray(np.gradient(telemetry.r_N_km, seconds, axis=0))


def _horizontal_squared(field_O_nT: FloatArray) -> FloatArray:
    b0 = np.asarray(field_O_nT)
    return np.asarray(b0[:, 0] ** 2 + b0[:, 1] ** 2)


def _degrees(angle_rad: FloatArray) -> list[float | None]:
    return [float(value) if np.isfinite(value) else None for value in np.degrees(angle_rad)]
