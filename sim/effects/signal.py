"""The signal on its way from the world to the reading, and the chain that carries it.

One chain serves both directions. *Simulating*, the motion given is the true one, and effects on time, orbit
and attitude distort what is reported. *Predicting*, the motion given is the reported one, and the same effects
turn it back into the true one. Everything after that (field, spacecraft, sensor) runs forward in both. The
prediction has no noise and no rounding, so its differences are the Jacobians of a diagnosis.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Hashable, Mapping, MutableMapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Literal, Protocol, TypeVar

import numpy as np
from scipy.spatial.transform import Rotation

from fluxtwin.sim.attitude.recorded_motion import RecordedMotion
from fluxtwin.sim.base.types import BoolArray, FloatArray, TimeArray
from fluxtwin.sim.earth import epoch, frames, sun
from fluxtwin.sim.earth.constants import GM_EARTH_KM3_S2
from fluxtwin.sim.earth.field import field_N_nT
from fluxtwin.sim.earth.field_models import FieldModel
from fluxtwin.sim.earth.orbit import argument_of_latitude
from fluxtwin.sim.spacecraft.sensors.magnetometer import Magnetometer

Direction = Literal["simulate", "predict"]
Made = TypeVar("Made")

_BESIDE_S = 0.05  # to either side of a moment, for the body rate there: a spin of ten turns a second is still seen
_REMEMBERED_ROWS = 100_000  # in all: a few megabytes
_NEWTON_STEPS = 8


class Motion(Protocol):
    """Orbit and attitude as functions of time."""

    def at(self, offset_s: float | FloatArray) -> tuple[FloatArray, FloatArray, Rotation]:
        """Position [km] and velocity [km/s] (N, 3), GCRS, and R_BN, `offset_s` (or (N,)) after each stamp."""


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
    attitude_known: BoolArray | None = None
    """(N,) False where no attitude was reported and R_BN is only one that fits the reading. None: all known."""

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
    def geocentric(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Latitude [rad], east longitude [rad] and radius [km], each (N,)."""
        return frames.geocentric(self.R_EN.apply(self.given[0]))

    @property
    def latitude_rad(self) -> FloatArray:
        """(N,) geocentric latitude."""
        return self.geocentric[0]

    @cached_property
    def orbit_phase_rad(self) -> FloatArray:
        """(N,) argument of latitude."""
        return argument_of_latitude(self.time, *self.given[:2])

    @property
    def rate_B_rad_s(self) -> FloatArray:
        """(N, 3) body rate relative to N, components in B."""
        return self.rates(0.0)[0]

    def rates(self, offset_s: float | FloatArray) -> tuple[FloatArray, FloatArray]:
        """Body rate relative to N (N, 3), components in B, and rate of change of the model field along the orbit (N, 3),
        GCRS, nT/s, both `offset_s` (or (N,)) after the stamps."""

        def made() -> tuple[FloatArray, FloatArray]:
            after, before = (
                field_N_nT(
                    self.model, epoch.add_seconds(self.time[0], self.seconds + moment), self._position_N_km(moment)
                )
                for moment in (offset_s + 1.0, offset_s - 1.0)
            )
            return self.turning(offset_s), np.asarray((after - before) / 2.0)

        return self.once(("rates", np.asarray(offset_s).tobytes()), made)

    def once(self, key: Hashable, make: Callable[[], Made]) -> Made:
        """What `make` makes of the setting alone: once, as long as it is among what was asked for lately."""
        return _once(self._made, self.time.size, key, make)

    @cached_property
    def _made(self) -> dict[Hashable, Any]:
        return {}

    def _position_N_km(self, offset_s: float | FloatArray) -> FloatArray:
        """(N, 3) `offset_s` (or (N,)) after the stamps."""
        motion = self.motion
        return motion.orbit(offset_s)[0] if isinstance(motion, RecordedMotion) else motion.at(offset_s)[0]

    def track(self, offset_s: float | FloatArray) -> Rotation:
        """R_BN `offset_s` (or (N,)) after the stamps, without the error that a row's own recorded attitude has."""
        if isinstance(self.motion, RecordedMotion) and self.direction == "predict":
            return self.motion.track(offset_s)
        return self.motion.at(offset_s)[2]

    def within_steps(
        self, offset_s: float | FloatArray, step_s: FloatArray, parts: int
    ) -> Sequence[tuple[FloatArray, Rotation, FloatArray]]:
        """The moments that cut the steps (N,) before the stamps into parts: offset [s] (N,), track, body rate (N, 3).

        All of them `offset_s` later; the offset counts from the stamp.
        """
        key = (np.asarray(offset_s).tobytes(), step_s.tobytes(), parts)
        if key not in self._within:
            moments = [offset_s + (number / parts - 1.0) * step_s for number in range(1, parts)]
            self._within.clear()
            self._within[key] = [(moment, self.track(moment), self.turning(moment)) for moment in moments]
        return self._within[key]

    @cached_property
    def _within(self) -> dict[tuple[bytes, bytes, int], list[tuple[FloatArray, Rotation, FloatArray]]]:
        return {}

    def turning(self, offset_s: float | FloatArray) -> FloatArray:
        """(N, 3) body rate relative to N, components in B, `offset_s` (or (N,)) after the stamps."""
        from fluxtwin.sim.attitude.track_kernels import turn_between

        after, before = (self.track(offset_s + by_s).as_quat() for by_s in (_BESIDE_S, -_BESIDE_S))
        return np.asarray(-turn_between(np.atleast_2d(before), np.atleast_2d(after)) / (2.0 * _BESIDE_S))

    @cached_property
    def own_turn_N(self) -> Rotation | None:
        """What each row's given attitude adds to the track, R_BN = track own_turn_N; None where the motion is exact."""
        exact = self.direction == "simulate" or not isinstance(self.motion, RecordedMotion)
        return None if exact else frames.product(self.track(0.0).inv(), self.given[2])

    def column(self, name: str) -> FloatArray | None:
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
    sample_offset_s: float | FloatArray = 0.0
    """How much later than its stamp the field is sampled; one for all, or (N,)."""
    field_N_nT: FloatArray | None = None
    """Ambient field; None before the field stage."""
    stray_B_nT: FloatArray | None = None
    """Field of the spacecraft at the sensor (the baseline's torquer coupling is in the instrument's T)."""
    here_alone_B_nT: FloatArray | None = None
    """What of it no other magnetometer sees: the unknown source, the turn of a boom."""
    reading_B_nT: FloatArray | None = None
    """Reading; None before the sensor stage."""
    ideal_B_nT: FloatArray | None = None
    """Reading before noise, saturation at full scale and rounding; only while simulating."""
    measured_turns: Mapping[str, Rotation] = field(default_factory=dict)
    """By how much what a sensor at fault measures is turned: `sun_B`, `nadir_B`; only while simulating."""
    _of_ambient: dict[Hashable, Any] = field(default_factory=dict, init=False, repr=False)
    """What was made of attitude and ambient field, the latest few: every signal that has the same shares it."""
    _of_reading: MutableMapping[int, FloatArray] = field(default_factory=dict, init=False, repr=False)
    """Products of the reading's components, by their degree."""

    @property
    def rows(self) -> int:
        return int(self.setting.time.size)

    @property
    def sampled_time(self) -> TimeArray:
        """(N,) UTC at which the field is sampled."""
        if not np.any(self.sample_offset_s):
            return self.setting.time
        return epoch.add_seconds(self.setting.time[0], self.setting.seconds + self.sample_offset_s)

    @property
    def R_EN(self) -> Rotation:
        """GCRS to Earth-fixed at the moment of sampling."""
        return frames.rotation_EN(self.sampled_time) if np.any(self.sample_offset_s) else self.setting.R_EN

    @cached_property
    def field_B_nT(self) -> FloatArray:
        """(N, 3) ambient field in true body axes."""
        return np.asarray(self.R_BN.apply(self.ambient_N_nT))

    @property
    def ambient_N_nT(self) -> FloatArray:
        """(N, 3) ambient field, GCRS; only from the field stage on."""
        assert self.field_N_nT is not None
        return self.field_N_nT

    @property
    def at_sensor_B_nT(self) -> FloatArray:
        """(N, 3) field at the sensor, that of the spacecraft included, in true body axes."""
        return self.field_B_nT if self.stray_B_nT is None else self.field_B_nT + self.stray_B_nT

    @property
    def reading(self) -> FloatArray:
        """(N, 3) reading; only from the sensor stage on."""
        assert self.reading_B_nT is not None
        return self.reading_B_nT

    def sampled_later(self, offset_s: float | FloatArray) -> Signal:
        """The field is sampled `offset_s` (or (N,)) after the stamp; orbit and attitude are right at the stamp."""
        offset = self.sample_offset_s + offset_s
        r, v, R = self.setting.motion.at(offset)
        return dataclasses.replace(self, r_N_km=r, v_N_km_s=v, R_BN=R, sample_offset_s=offset)

    def position_reported_ahead(self, along_km: FloatArray | float) -> Signal:
        """The reported position is `along_km` ahead of the true one along the orbit; attitude is right."""
        ahead = np.asarray(along_km, dtype=np.float64)
        if self.setting.direction == "simulate":
            r_N_km, v_N_km_s = _along_orbit(self.r_reported_N_km, self.v_reported_N_km_s, ahead)
            return dataclasses.replace(self, r_reported_N_km=r_N_km, v_reported_N_km_s=v_N_km_s)
        r_N_km, v_N_km_s = _along_orbit(self.r_N_km, self.v_N_km_s, -ahead)
        return dataclasses.replace(self, r_N_km=r_N_km, v_N_km_s=v_N_km_s)

    def attitude_reported_turned(self, theta_B_rad: FloatArray, sensor: str | None = None) -> Signal:
        """The reported attitude is turned: R_reported = exp([theta x]) R_true, theta (N, 3) in body axes.

        sensor: `sun_B` or `nadir_B`, if the fault is that sensor's: what it measures is then turned as well.
        """
        if self.setting.direction == "simulate":
            turn, turns = Rotation.from_rotvec(theta_B_rad), dict(self.measured_turns)
            if sensor is not None:
                turns[sensor] = turn * turns[sensor] if sensor in turns else turn
            return dataclasses.replace(
                self, R_reported_BN=frames.product(turn, self.R_reported_BN), measured_turns=turns
            )
        if self.setting.attitude_known is not None:
            theta_B_rad = np.where(self.setting.attitude_known[:, None], theta_B_rad, 0.0)  # nothing was reported
        return dataclasses.replace(self, R_BN=frames.product(Rotation.from_rotvec(-theta_B_rad), self.R_BN))

    @property
    def field_rate_B_nT_s(self) -> FloatArray:
        """(N, 3) rate of change of the ambient field as the body sees it, along the orbit and by its own turning."""
        rate, along = self.setting.rates(self.sample_offset_s)
        turned: FloatArray = self.R_BN.apply(along)
        return turned - np.cross(rate, self.field_B_nT)

    @property
    def R_track_BN(self) -> Rotation:
        """Attitude at the moment of sampling along the track: what looks back along the rows must use this one, or
        it would see the attitude errors of the rows before as motion."""
        own = self.setting.own_turn_N
        return self.R_BN if own is None else frames.product(self.R_BN, own.inv())

    def with_own_turn(self, vector_B: FloatArray) -> FloatArray:
        """(N, 3) vectors in the track's body axes, turned into those of each row's own attitude."""
        own = self.setting.own_turn_N
        if own is None:
            return vector_B
        return np.asarray(self.R_BN.apply(own.apply(self.R_BN.inv().apply(vector_B))))

    def with_ambient(self, extra_N_nT: FloatArray) -> Signal:
        """More ambient field, GCRS components."""
        assert self.field_N_nT is not None
        return dataclasses.replace(self, field_N_nT=self.field_N_nT + extra_N_nT)

    def with_stray(self, extra_B_nT: FloatArray, *, here_alone: bool = False) -> Signal:
        """More field of the spacecraft at the sensor; here_alone: no other magnetometer sees it."""
        stray = self._none_or(self.stray_B_nT) + extra_B_nT
        alone = self._none_or(self.here_alone_B_nT) + extra_B_nT if here_alone else self.here_alone_B_nT
        return self._changed(stray_B_nT=stray, here_alone_B_nT=alone)

    def of_ambient(self, key: Hashable, make: Callable[[], Made]) -> Made:
        """What `make` makes of attitude and ambient field alone: once for all signals that have the same."""
        return _once(self._of_ambient, self.rows, key, make)

    @property
    def spacecraft_B_nT(self) -> FloatArray:
        """(N, 3) field of the spacecraft's effects at the sensor, without what this sensor alone sees."""
        stray = self._none_or(self.stray_B_nT)
        return stray if self.here_alone_B_nT is None else stray - self.here_alone_B_nT

    def _none_or(self, field_B_nT: FloatArray | None) -> FloatArray:
        return np.zeros((self.rows, 3)) if field_B_nT is None else field_B_nT

    def with_reading(self, reading_B_nT: FloatArray) -> Signal:
        return self._changed(reading_B_nT=reading_B_nT, _of_reading={})

    def products(self, degree: int, make: Callable[[FloatArray, int], FloatArray]) -> FloatArray:
        """(N, M) products of the reading's components that `make` makes, once."""
        if degree not in self._of_reading:
            self._of_reading[degree] = make(self.reading, degree)
        return self._of_reading[degree]

    def _changed(self, **values: FloatArray | MutableMapping[int, FloatArray] | None) -> Signal:
        """Other values of what comes after the ambient field: copied by hand, which takes a tenth of the time."""
        changed = object.__new__(Signal)
        changed.__dict__.update(self.__dict__, **values)
        return changed


def _once(known: dict[Hashable, Any], rows: int, key: Hashable, make: Callable[[], Made]) -> Made:
    """What is known by that key, or is made now; what was not asked for longest makes room for it."""
    if key in known:
        made: Made = known.pop(key)
    else:
        while known and len(known) * rows > _REMEMBERED_ROWS:
            del known[next(iter(known))]
        made = make()
    known[key] = made
    return made


def start(setting: Setting) -> Signal:
    """The signal before any stage."""
    r, v, R = setting.given
    return Signal(setting, r, v, R, r, v, R, stray_B_nT=setting.unknown_B_nT, here_alone_B_nT=setting.unknown_B_nT)


def _along_orbit(r_N_km: FloatArray, v_N_km_s: FloatArray, along_km: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Position and velocity where the two-body orbit is the time along_km / |v| later.

    Lagrange's coefficients by the change of eccentric anomaly, from Kepler's equation by Newton's steps (Battin 1999, An
    Introduction to the Mathematics and Methods of Astrodynamics, section 4.3). An orbit that is not closed is followed as if
    its axis were its radius: right to the second power of the time.
    """
    size = np.linalg.norm(r_N_km, axis=1)
    speed = np.linalg.norm(v_N_km_s, axis=1)
    t = np.broadcast_to(along_km, size.shape) / speed
    inverse = 2.0 / size - speed**2 / GM_EARTH_KM3_S2
    axis = 1.0 / np.where(inverse > 0.0, inverse, 1.0 / size)
    rate = np.sqrt(GM_EARTH_KM3_S2 / axis**3)
    sigma = np.einsum("ij,ij->i", r_N_km, v_N_km_s) / np.sqrt(GM_EARTH_KM3_S2 * axis)
    lean = 1.0 - size / axis
    turned = rate * t
    for _ in range(_NEWTON_STEPS):
        sine, cosine = np.sin(turned), np.cos(turned)
        missed = turned + sigma * (1.0 - cosine) - lean * sine - rate * t
        turned = turned - missed / (1.0 + sigma * sine - lean * cosine)
    sine, cosine = np.sin(turned), np.cos(turned)
    there = axis * (1.0 - lean * cosine + sigma * sine)
    f, g = 1.0 - axis / size * (1.0 - cosine), t - (turned - sine) / rate
    f_rate, g_rate = -(axis**2) * rate / (there * size) * sine, 1.0 - axis / there * (1.0 - cosine)
    return (
        f[:, None] * r_N_km + g[:, None] * v_N_km_s,
        f_rate[:, None] * r_N_km + g_rate[:, None] * v_N_km_s,
    )
