"""The signal on its way from the world to the reading, and the chain that carries it.

One chain serves both directions. *Simulating*, the motion given is the true one, and effects on time, orbit
and attitude spoil what is reported. *Predicting*, the motion given is the reported one, and the same effects
turn it back into the true one. Everything after that (field, spacecraft, sensor) runs forward in both. The
prediction has no noise and no rounding, so its differences are the Jacobians of a diagnosis.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Literal, Protocol

import numpy as np
from scipy.spatial.transform import Rotation

from fluxtwin.sim import epoch, frames, sun
from fluxtwin.sim.field import field_N_nT
from fluxtwin.sim.field_models import FieldModel
from fluxtwin.sim.sensors.magnetometer import Magnetometer
from fluxtwin.sim.types import FloatArray, TimeArray

Direction = Literal["simulate", "predict"]


class Motion(Protocol):
    """Orbit and attitude as functions of time."""

    def at(self, offset_s: float) -> tuple[FloatArray, FloatArray, Rotation]:
        """Position [km] and velocity [km/s] (N, 3), GCRS, and R_BN, `offset_s` after each stamp."""


@dataclass(frozen=True)
class Setting:
    """What no effect changes; N rows."""

    time: TimeArray
    """(N,) stamps, UTC."""
    motion: Motion
    direction: Direction
    model: FieldModel
    """Field model of the baseline."""
    instrument: Magnetometer
    """S, b, T of the baseline; its noise and LSB are not used here."""
    columns: Mapping[str, FloatArray] = field(default_factory=dict)
    """Recorded columns by telemetry name (`dipole_B_Am2`, `temperature_degC`, ...), (N,) or (N, k), may hold NaN."""
    full_scale_nT: float | None = None
    field_N_nT: FloatArray | None = None
    """(N, 3) the model at the stamps and given positions, if at hand: spares one evaluation."""
    unknown_B_nT: FloatArray | None = None
    """(N, 3) field at the sensor of a source that the baseline has and nobody has explained."""

    @cached_property
    def seconds(self) -> FloatArray:
        """(N,) elapsed seconds from the first stamp."""
        return epoch.seconds_since(self.time, self.time[0])

    @cached_property
    def given(self) -> tuple[FloatArray, FloatArray, Rotation]:
        """Position, velocity and R_BN at the stamps, as given."""
        return self.motion.at(0.0)

    @cached_property
    def R_ON(self) -> Rotation:
        """GCRS to the orbital frame at the given motion."""
        return frames.rotation_ON(*self.given[:2])

    @cached_property
    def R_EN(self) -> Rotation:
        """GCRS to Earth-fixed at the stamps."""
        return frames.rotation_EN(self.time)

    @cached_property
    def sun_N(self) -> FloatArray:
        """(N, 3) unit vectors to the sun."""
        return sun.sun_direction_N(self.time, self.given[0])

    @cached_property
    def illumination(self) -> FloatArray:
        """(N,) share of the sun's disc in view, from geometry."""
        return sun.illumination(self.given[0], sun.sun_N_km(self.time))

    @cached_property
    def latitude_rad(self) -> FloatArray:
        """(N,) geocentric latitude."""
        return frames.geocentric(self.R_EN.apply(self.given[0]))[0]

    @cached_property
    def rate_B_rad_s(self) -> FloatArray:
        """(N, 3) body rate relative to N, components in B, from the motion one second to either side."""
        after, before = self.motion.at(1.0)[2], self.motion.at(-1.0)[2]
        rate: FloatArray = -np.atleast_2d((after * before.inv()).as_rotvec()) / 2.0
        return rate

    @cached_property
    def field_rate_N_nT_s(self) -> FloatArray:
        """(N, 3) rate of change of the model field along the orbit, GCRS, from the motion one second to either side."""
        after, before = (
            field_N_nT(self.model, epoch.add_seconds(self.time[0], self.seconds + offset), self.motion.at(offset)[0])
            for offset in (1.0, -1.0)
        )
        rate: FloatArray = (after - before) / 2.0
        return rate

    def column(self, name: str) -> FloatArray | None:
        """A recorded column, or None."""
        return self.columns.get(name)


@dataclass(frozen=True)
class Signal:
    """The state of the signal between two stages; arrays (N, 3), body axes unless the name says N."""

    setting: Setting
    r_N_km: FloatArray
    """True position at the moment of sampling."""
    v_N_km_s: FloatArray
    R_BN: Rotation
    """True attitude at the moment of sampling."""
    r_reported_N_km: FloatArray
    v_reported_N_km_s: FloatArray
    R_reported_BN: Rotation
    sample_offset_s: float = 0.0
    """How much later than its stamp the field is sampled."""
    field_N_nT: FloatArray | None = None
    """Ambient field; None before the field stage."""
    stray_B_nT: FloatArray | None = None
    """Field of the spacecraft at the sensor (the baseline's torquer coupling is in the instrument's T)."""
    reading_B_nT: FloatArray | None = None
    """Reading; None before the sensor stage."""
    ideal_B_nT: FloatArray | None = None
    """Reading before noise, saturation at full scale and rounding; only while simulating."""

    @property
    def rows(self) -> int:
        return int(self.setting.time.size)

    @property
    def sampled_time(self) -> TimeArray:
        """(N,) UTC at which the field is sampled."""
        if not self.sample_offset_s:
            return self.setting.time
        return epoch.add_seconds(self.setting.time[0], self.setting.seconds + self.sample_offset_s)

    @property
    def R_EN(self) -> Rotation:
        """GCRS to Earth-fixed at the moment of sampling."""
        return frames.rotation_EN(self.sampled_time) if self.sample_offset_s else self.setting.R_EN

    @property
    def field_B_nT(self) -> FloatArray:
        """(N, 3) ambient field in true body axes."""
        assert self.field_N_nT is not None
        turned: FloatArray = self.R_BN.apply(self.field_N_nT)
        return turned

    @property
    def reading(self) -> FloatArray:
        """(N, 3) reading; only from the sensor stage on."""
        assert self.reading_B_nT is not None
        return self.reading_B_nT

    def sampled_later(self, offset_s: float) -> Signal:
        """The field is sampled `offset_s` after the stamp; orbit and attitude are right at the stamp."""
        offset = self.sample_offset_s + offset_s
        r, v, R = self.setting.motion.at(offset)
        return dataclasses.replace(self, r_N_km=r, v_N_km_s=v, R_BN=R, sample_offset_s=offset)

    def position_reported_ahead(self, along_km: FloatArray | float) -> Signal:
        """The reported position is `along_km` ahead of the true one along the orbit; attitude is right."""
        ahead = np.asarray(along_km, dtype=np.float64)
        if self.setting.direction == "simulate":
            turn = _along_orbit(self.r_reported_N_km, self.v_reported_N_km_s, ahead)
            return dataclasses.replace(
                self,
                r_reported_N_km=turn.apply(self.r_reported_N_km),
                v_reported_N_km_s=turn.apply(self.v_reported_N_km_s),
            )
        turn = _along_orbit(self.r_N_km, self.v_N_km_s, -ahead)
        return dataclasses.replace(self, r_N_km=turn.apply(self.r_N_km), v_N_km_s=turn.apply(self.v_N_km_s))

    def attitude_reported_turned(self, theta_B_rad: FloatArray) -> Signal:
        """The reported attitude is turned: R_reported = exp([theta x]) R_true, theta (N, 3) in body axes."""
        if self.setting.direction == "simulate":
            return dataclasses.replace(self, R_reported_BN=Rotation.from_rotvec(theta_B_rad) * self.R_reported_BN)
        return dataclasses.replace(self, R_BN=Rotation.from_rotvec(-theta_B_rad) * self.R_BN)

    @property
    def field_rate_B_nT_s(self) -> FloatArray:
        """(N, 3) rate of change of the ambient field as the body sees it, along the orbit and by its own turning."""
        turned: FloatArray = self.R_BN.apply(self.setting.field_rate_N_nT_s)
        return turned - np.cross(self.setting.rate_B_rad_s, self.field_B_nT)

    def with_ambient(self, extra_N_nT: FloatArray) -> Signal:
        """More ambient field, GCRS components."""
        assert self.field_N_nT is not None
        return dataclasses.replace(self, field_N_nT=self.field_N_nT + extra_N_nT)

    def with_stray(self, extra_B_nT: FloatArray) -> Signal:
        """More field of the spacecraft at the sensor."""
        before = np.zeros((self.rows, 3)) if self.stray_B_nT is None else self.stray_B_nT
        return dataclasses.replace(self, stray_B_nT=before + extra_B_nT)

    def with_reading(self, reading_B_nT: FloatArray) -> Signal:
        """Another reading."""
        return dataclasses.replace(self, reading_B_nT=reading_B_nT)


def start(setting: Setting) -> Signal:
    """The signal before any stage."""
    r, v, R = setting.given
    return Signal(setting, r, v, R, r, v, R, stray_B_nT=setting.unknown_B_nT)


def _along_orbit(r_N_km: FloatArray, v_N_km_s: FloatArray, along_km: FloatArray) -> Rotation:
    """The turn about the orbit normal by the angle along_km / r."""
    normal = np.cross(r_N_km, v_N_km_s)
    normal = normal / np.linalg.norm(normal, axis=1)[:, None]
    angle = np.broadcast_to(along_km, r_N_km.shape[:1]) / np.linalg.norm(r_N_km, axis=1)
    return Rotation.from_rotvec(normal * angle[:, None])
