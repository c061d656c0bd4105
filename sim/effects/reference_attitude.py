"""Errors of the reference attitude: its sensors, and the gyro that carries it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.spatial.transform import Rotation

from fluxtwin.sim.base.types import BoolArray, FloatArray
from fluxtwin.sim.earth import frames, sun
from fluxtwin.sim.effects.base import Effect, Parameter, SignalEffect, vector_parameters
from fluxtwin.sim.effects.calibration import TurningStep
from fluxtwin.sim.effects.drivers import lit
from fluxtwin.sim.effects.signal import Setting, Signal

_LONGEST_ECLIPSE_S = 4500.0  # geostationary: 72 minutes
_STEP_S = 10.0
_SAME_PASS_S = 300.0
_SAME_AXIS_RAD = float(np.radians(1.0))  # the two images then differ by less than two parts in a hundred


@dataclass(frozen=True)
class SunSensorHeadMisalignment(SignalEffect):
    """A sun-sensor head is not mounted as stated.

    The reference attitude is turned while that head gives it, and so is the sun that the head measures.
    """

    head: int = 0
    """Number of the head; 0 stands for whichever is in use, so: wherever the sun is seen."""

    name = "sun_sensor_head_misalignment"
    stage = "attitude"
    follows = "head"
    settled_by = (
        "the number of the active head in the telemetry, and rotations of 90 deg that point each head at the sun "
        "for half an orbit"
    )
    about = (
        "while head k is in use, the reported attitude is rotated by this rotation vector in body axes, so a field v is "
        "predicted as v + turn x v (mounting error as in Wertz 1978, section 7.1; tenths of a degree before alignment "
        "in flight)"
    )
    parameters = vector_parameters("turn", "deg", 0.2, -20.0, 20.0)

    def alternatives(self, setting: Setting) -> tuple[Effect, ...]:
        return tuple(SunSensorHeadMisalignment(head) for head in _heads(setting)) or (self,)

    def untestable(self, setting: Setting) -> str | None:
        if setting.column("sun_sensor_head") is None:
            return "the telemetry has no column sun_sensor_head"
        heads = _heads(setting)
        if not heads:
            return "no sun-sensor head is ever in use"
        if self.head and self.head not in heads:
            return f"head {self.head} is never in use (in use: {', '.join(map(str, heads))})"
        return None

    def apply(self, signal: Signal, theta: FloatArray) -> Signal:
        column = signal.setting.column("sun_sensor_head")
        if column is None:
            return signal
        used = column == self.head if self.head else column > 0
        return signal.attitude_reported_turned(np.where(used[:, None], np.radians(theta), 0.0), "sun_B")


def _heads(setting: Setting) -> list[int]:
    column = setting.column("sun_sensor_head")
    if column is None:
        return []
    return [int(head) for head in np.unique(column[np.isfinite(column)]) if head > 0]


@dataclass(frozen=True)
class HorizonScannerBias(SignalEffect):
    """Roll and pitch errors follow the latitude.

    Those of the reference attitude, and of the nadir that the scanner measures.
    """

    name = "horizon_scanner_bias"
    stage = "attitude"
    frame = "orbital"
    follows = "latitude"
    settled_by = "a second attitude sensor, in addition to the scanner"
    about = (
        "reported roll and pitch (3-1-2) are each too large by a sin(lat) + b cos(2 lat) of the geocentric latitude, "
        "with two parameters a, b each: the Earth's 15-micron radiance depends on latitude and season (Wertz 1978, "
        "section 4.2; Phenneger et al. 1985: 0.05-0.2 deg); a constant part would be absorbed by S"
    )

    parameters = tuple(
        Parameter(name, "deg", 0.2, -20.0, 20.0) for name in ("roll_sin", "roll_cos2", "pitch_sin", "pitch_cos2")
    )

    def apply(self, signal: Signal, theta: FloatArray) -> Signal:
        latitude = signal.setting.latitude_rad
        shapes = np.stack([np.sin(latitude), np.cos(2.0 * latitude)], axis=1)
        roll, pitch = shapes @ np.radians(theta[:2]), shapes @ np.radians(theta[2:])
        about_y = pitch[:, None] * np.array([0.0, 1.0, 0.0])
        # A larger angle turns the axes one way, so it turns the vectors the other way. Pitch is the last of the rotations.
        if signal.setting.direction == "simulate":
            turned = signal.attitude_reported_turned(
                -roll[:, None] * _roll_axis_B(signal.R_reported_BN, signal), "nadir_B"
            )
            return turned.attitude_reported_turned(-about_y, "nadir_B")
        turned = signal.attitude_reported_turned(-about_y, "nadir_B")
        return turned.attitude_reported_turned(-roll[:, None] * _roll_axis_B(turned.R_BN, signal), "nadir_B")


@dataclass(frozen=True)
class YawDrift(SignalEffect):
    """The reported yaw drifts with time."""

    when: Literal["always", "eclipse"] = "always"
    """eclipse: the gyro coasts in the shadow, from zero at each entry; right in sunlight."""
    axis: Literal["nadir", "body_z"] = "nadir"
    """nadir: the yaw of the 3-1-2 set drifts. body_z: the attitude turns about the axis of a gyro along body z."""

    name = "yaw_drift"
    stage = "attitude"
    frame = "orbital"
    follows = "time"
    settled_by = "a second attitude sensor through the eclipse"
    about = (
        "reported yaw (3-1-2, so about nadir; with axis = body_z the rotation about body z) is too large by rate x time "
        "since the first stamp or, with when = eclipse, since entering the shadow (it is right outside). A gyro that "
        "propagates yaw while no sensor measures it drifts in this way (rate integration, Wertz 1978, section 6.5: "
        "0.01-0.1 deg/h for a good gyro, 10 deg/h for a small one)"
    )

    def condition_on(self, setting: Setting) -> str | None:
        return "eclipse" if self.when == "eclipse" else self.follows

    parameters = (Parameter("rate", "deg/h", 0.1, -100.0, 100.0),)

    def alternatives(self, setting: Setting) -> tuple[Effect, ...]:
        """Always, and in eclipse if there is one; about body z too where the body leans enough to tell."""
        whens: tuple[Literal["always", "eclipse"], ...] = ("always", "eclipse")
        axes: tuple[Literal["nadir", "body_z"], ...] = ("nadir", "body_z") if _leans(setting) else ("nadir",)
        choices = [YawDrift(when, axis) for axis in axes for when in whens]
        return tuple(one for one in choices if one.when == "always" or one.untestable(setting) is None)

    def untestable(self, setting: Setting) -> str | None:
        if setting.time.size < 2:
            return "one row alone shows no drift"
        if self.when == "eclipse" and not in_eclipse(setting).any():
            return "no row is in eclipse"
        return None

    def apply(self, signal: Signal, theta: FloatArray) -> Signal:
        setting = signal.setting
        since_s = setting.seconds if self.when == "always" else seconds_in_eclipse(setting)
        yaw = np.radians(float(theta[0])) / 3600.0 * since_s
        # A larger angle turns the axes one way, so it turns the vectors the other way.
        return signal.attitude_reported_turned(-yaw[:, None] * self._axis_B(signal))

    def _axis_B(self, signal: Signal) -> FloatArray:
        """(N, 3) or (3,) unit axis of the turn, body axes."""
        if self.axis == "body_z":
            return np.array([0.0, 0.0, 1.0])
        if signal.setting.direction == "simulate":
            return _nadir_B(signal.R_reported_BN, signal.setting.given[0])
        # A turn about nadir leaves nadir alone, so the reported attitude says where it is in the true body too.
        return _nadir_B(signal.R_BN, signal.r_N_km)


@dataclass(frozen=True)
class AttitudeStep(TurningStep):
    """The reported attitude is wrong from a moment on."""

    name = "attitude_step"
    stage = "attitude"
    settled_by = "a second attitude sensor, or a second magnetometer, during the step"
    equivalent_stages = ("sensor", "spacecraft")
    about = (
        "from that moment on, the reported attitude is rotated by this rotation vector in body axes, so a field v is "
        "predicted as v + turn x v (another sensor in use, or another alignment table; mounting errors are tenths of a "
        "degree before alignment in flight: Wertz 1978, section 7.1)"
    )

    def apply(self, signal: Signal, theta: FloatArray) -> Signal:
        return signal.attitude_reported_turned(self.turns_rad(signal.setting, theta))


@dataclass(frozen=True)
class AttitudeLag(SignalEffect):
    """The attitude is older than its time stamp.

    Position and reading are right at the stamp.
    """

    name = "attitude_lag"
    stage = "attitude"
    follows = "rate"
    settled_by = "slews about several axes, over an orbit or more"
    about = (
        "the reported attitude was that of the body so long before the stamp: sensors that integrate, filters and the way "
        "to the telemetry take time (star trackers some 0.1 s: Advances in Space Research 72, 200, 2023; a whole cycle of "
        "the software, if the last known attitude is reported)"
    )
    parameters = (Parameter("lag", "s", 0.5, 0.0, 600.0),)

    def untestable(self, setting: Setting) -> str | None:
        return "one row alone shows no motion" if setting.time.size < 2 else None

    def apply(self, signal: Signal, theta: FloatArray) -> Signal:
        motion, lag_s, simulated = signal.setting.motion, float(theta[0]), signal.setting.direction == "simulate"
        # The reported one is that of the true motion earlier, the true one that of the reported motion later.
        then, now = (motion.at(offset_s)[2] for offset_s in (-lag_s if simulated else lag_s, 0.0))
        turn = frames.product(then, now.inv()).as_rotvec()
        return signal.attitude_reported_turned(turn if simulated else -turn)


def _nadir_B(R_BN: Rotation, r_N_km: FloatArray) -> FloatArray:
    """(N, 3) unit vectors to the Earth's centre, body axes."""
    return np.asarray(R_BN.apply(-r_N_km / np.linalg.norm(r_N_km, axis=1)[:, None]))


def _roll_axis_B(R_BN: Rotation, signal: Signal) -> FloatArray:
    """(N, 3) unit axis about which roll turns in a 3-1-2 set, body axes: across pitch and nadir; x where those are one."""
    nadir = _nadir_B(R_BN, signal.setting.given[0])
    across = np.cross(np.array([0.0, 1.0, 0.0]), nadir)
    length = np.linalg.norm(across, axis=1)[:, None]
    return np.where(length > 0.0, across / np.where(length > 0.0, length, 1.0), np.array([1.0, 0.0, 0.0]))


def _leans(setting: Setting) -> bool:
    """Whether body z leaves nadir so far that it matters about which of them yaw turns."""
    r_N_km, _, R_BN = setting.given
    lean = np.linalg.norm(_nadir_B(R_BN, r_N_km) - np.array([0.0, 0.0, 1.0]), axis=1)
    return float(np.sqrt(np.mean(lean**2))) > _SAME_AXIS_RAD


def in_eclipse(setting: Setting) -> BoolArray:
    """(N,) True in the shadow: as recorded, else from geometry."""
    return np.asarray(lit(setting) <= 0.5)


def seconds_in_eclipse(setting: Setting) -> FloatArray:
    """(N,) time since the shadow was entered; 0 outside it.

    The entry is found by running the orbit back from the first dark row, so neither the sampling nor a record that
    begins in the dark makes it wrong; but never before the last lit row.
    """
    dark, seconds = in_eclipse(setting), setting.seconds
    before_dark = np.concatenate([[False], dark[:-1]])
    step = np.concatenate([[np.inf], np.diff(seconds)])
    first = np.flatnonzero(dark & (~before_dark | (step > _SAME_PASS_S)))
    ago = np.minimum(_entry_ago_s(setting, first), np.where(before_dark[first], np.inf, step[first]))
    entry = np.full(seconds.size, np.nan)
    latest = np.nan
    for row, back in zip(first, ago, strict=True):
        if not (before_dark[row] and back >= step[row]):  # else it is the same eclipse, beyond a gap in the record
            latest = seconds[row] - back
        entry[row] = latest
    numbers = np.searchsorted(first, np.arange(seconds.size), side="right") - 1
    return np.where(dark, seconds - entry[first][numbers], 0.0) if first.size else np.zeros(seconds.size)


def _entry_ago_s(setting: Setting, rows: np.ndarray) -> FloatArray:
    """How long before these dark rows the spacecraft entered the shadow, on a circle through position and velocity."""
    r, v = (vector[rows] for vector in setting.given[:2])
    radius = np.linalg.norm(r, axis=1)
    normal = np.cross(r, v)
    rate = np.linalg.norm(normal, axis=1) / radius**2
    across = np.cross(normal, r) / np.linalg.norm(normal, axis=1)[:, None]
    sun_N_km = sun.sun_N_km(setting.time[rows]) if rows.size else np.zeros((0, 3))
    ago, left = np.zeros(rows.size), np.arange(rows.size)
    for back in np.arange(0.0, _LONGEST_ECLIPSE_S, _STEP_S):
        angle = (rate[left] * back)[:, None]
        there = r[left] * np.cos(angle) - across[left] * np.sin(angle)
        ago[left] = back
        left = left[sun.illumination(there, sun_N_km[left]) <= 0.5]
        if not left.size:
            break
    return ago
