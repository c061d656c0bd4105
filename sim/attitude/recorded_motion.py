"""Orbit and attitude as functions of time along a record.

A scenario gives the same things exactly (`run.true_attitude`), so an effect that samples late or remembers need not
know which it has.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.spatial.transform import Rotation

from fluxtwin.sim.attitude import smoothed_track as attitude_track
from fluxtwin.sim.attitude.smoothed_track import AttitudeTrack
from fluxtwin.sim.base.types import BoolArray, FloatArray, TimeArray
from fluxtwin.sim.earth import epoch, frames

_STEP_S = 60.0  # of the integration from a recorded position: 1e-4 km
_REMEMBERED = 6
_SAME_S = 1e-6  # between seconds of one stamp, worked out in two ways
_FEWEST = 5  # rows without attitude that make a track of their own


@dataclass(frozen=True, eq=False)
class RecordedAttitudes:
    """Attitudes at M rising stamps, as they were recorded."""

    time: TimeArray
    R_BN: Rotation
    rate_B_rad_s: FloatArray | None = None
    """(M, 3) measured body rate; rows may be NaN."""


@dataclass(frozen=True)
class RecordedMotion:
    """Motion along recorded positions, velocities and attitudes; N rows, all known, stamps rising.

    Positions between two stamps come from both, each carried by its velocity and the pull of the Earth. A recorded
    attitude has an error of its own, so what an offset adds to a row is the motion of a smoothed track relative to
    the row's stamp: the error of its own attitude stays with the row, and those of its neighbours are averaged.
    """

    time: TimeArray
    r_N_km: FloatArray
    v_N_km_s: FloatArray
    R_BN: Rotation
    gyro_B_rad_s: FloatArray | None = None
    """(N, 3) measured body rate; rows may be NaN."""
    attitude_known: BoolArray | None = None
    """(N,) False where R_BN is only one that fits the reading: it tells nothing of the others' motion. None: all known."""
    denser: RecordedAttitudes | None = None
    """Of a record that these rows are thinned from, all known rows among them: the motion between two rows may be fast."""

    def at(self, offset_s: float | FloatArray) -> tuple[FloatArray, FloatArray, Rotation]:
        """Position, velocity (N, 3) and R_BN `offset_s` (one number, or (N,)) after each stamp.

        R(t + d) = R_s(t + d) R_s(t)^-1 R(t), R_s being the smoothed track.
        """
        if not np.any(offset_s):
            return self.r_N_km, self.v_N_km_s, self.R_BN
        if np.ndim(offset_s):
            return self._at(offset_s)
        key = float(offset_s)
        if key not in self._latest:
            while len(self._latest) >= _REMEMBERED:
                del self._latest[next(iter(self._latest))]
            self._latest[key] = self._at(key)
        return self._latest[key]

    def orbit(self, offset_s: float | FloatArray) -> tuple[FloatArray, FloatArray]:
        """Position and velocity (N, 3) as `at` has them, without the attitude, which takes most of the time."""
        place = attitude_track.places(self.seconds, self._stretch, self.seconds + offset_s)
        r, v = carried(self.r_N_km[place.row], self.v_N_km_s[place.row], place.after_s)
        blended = np.flatnonzero(place.weights)
        if blended.size:
            other = place.other[blended]
            r_other, v_other = carried(self.r_N_km[other], self.v_N_km_s[other], place.other_after_s[blended])
            weight = place.weights[blended, None]
            r[blended] += weight * (r_other - r[blended])
            v[blended] += weight * (v_other - v[blended])
        return r, v

    def track(self, offset_s: float | FloatArray) -> Rotation:
        """R_BN along the smoothed track, `offset_s` (one number, or (N,)) after each stamp."""
        return self._track_of(np.ones(self.time.size, dtype=np.bool_), offset_s)

    def _track_of(self, rows: BoolArray, offset_s: float | FloatArray) -> Rotation:
        """The same of some rows (N,) alone."""
        moments = self.seconds + offset_s
        if self._beyond is None:
            return self.smoothed.at(moments[rows])
        beyond, own = self._beyond
        quaternions = np.empty((self.time.size, 4))
        for part, track in ((rows & ~beyond, self.smoothed), (rows & beyond, own)):
            if part.any():
                quaternions[part] = track.at(moments[part]).as_quat()
        return Rotation.from_quat(quaternions[rows])

    def with_errors(self, errors_rad: Callable[[TimeArray], FloatArray]) -> RecordedMotion:
        """The same motion with one more error in each known attitude: rotation vectors (M, 3), body axes, at stamps (M,)."""
        if self.denser is None:
            turn = errors_rad(self.time)
            if self.attitude_known is not None:
                turn[~self.attitude_known] = 0.0
            return dataclasses.replace(self, R_BN=Rotation.from_rotvec(turn) * self.R_BN)
        turn = errors_rad(self.denser.time)
        own = np.zeros((self.time.size, 3))
        own[slice(None) if self.attitude_known is None else self.attitude_known] = turn[self._among(self._denser_s)]
        denser = dataclasses.replace(self.denser, R_BN=Rotation.from_rotvec(turn) * self.denser.R_BN)
        return dataclasses.replace(self, R_BN=Rotation.from_rotvec(own) * self.R_BN, denser=denser)

    def reaches(self, offset_s: float | FloatArray) -> BoolArray:
        """(N,) whether the moment `offset_s` (or (N,)) after each stamp lies among the known attitudes of its stretch, or at
        most half a spacing beyond: further out the attitude is a guess."""
        reached = self.smoothed.reaches(self.seconds + offset_s)
        return reached if self.attitude_known is None else reached | ~self.attitude_known

    def along_track(self) -> RecordedMotion:
        """The same motion with the smoothed attitudes in place of the recorded ones, where those are known."""
        smooth = self.track(0.0)
        if self.attitude_known is not None:
            rows = self.attitude_known
            turn = np.where(rows[:, None], (smooth * self.R_BN.inv()).as_rotvec(), 0.0)
            smooth = Rotation.from_rotvec(turn) * self.R_BN
        moved = dataclasses.replace(self, R_BN=smooth)
        moved.__dict__["smoothed"] = self.smoothed  # not smoothed once more
        return moved

    @cached_property
    def seconds(self) -> FloatArray:
        """(N,) elapsed seconds from the first stamp."""
        return epoch.seconds_since(self.time, self.time[0])

    @cached_property
    def _stretch(self) -> attitude_track.RowArray:
        """(N,)"""
        return attitude_track.stretches(self.seconds)

    @cached_property
    def smoothed(self) -> AttitudeTrack:
        known = np.flatnonzero(np.ones(self.time.size) if self.attitude_known is None else self.attitude_known)
        if not known.size:
            known = np.zeros(1, dtype=np.intp)
        gyro = None if self.gyro_B_rad_s is None else self.gyro_B_rad_s[known]
        track = attitude_track.smoothed(self.seconds[known], self.R_BN[known], gyro)
        if self.denser is None:
            return track
        stamps = self._denser_s.copy()
        stamps[self._among(stamps)] = track.time_s
        return attitude_track.better(track, attitude_track.smoothed(stamps, self.denser.R_BN, self.denser.rate_B_rad_s))

    @cached_property
    def _beyond(self) -> tuple[BoolArray, AttitudeTrack] | None:
        """Rows without attitude that no known one is near (N,), and the track through the attitudes that fit their
        readings: of the turning about the field it tells nothing, of the field's way through the body it does."""
        if self.attitude_known is None:
            return None
        rows = ~self.attitude_known
        if self.attitude_known.any():
            rows &= ~self.smoothed.reaches(self.seconds)
        if rows.sum() < _FEWEST:
            return None
        gyro = None if self.gyro_B_rad_s is None else self.gyro_B_rad_s[rows]
        return rows, attitude_track.smoothed(self.seconds[rows], self.R_BN[rows], gyro)

    @cached_property
    def _stamps(self) -> attitude_track.RowArray:
        """Stamps of the track that the rows with a known attitude are."""
        return self._among(self.smoothed.time_s)

    @cached_property
    def _denser_s(self) -> FloatArray:
        """(M,) stamps of the denser record, from the first stamp of these rows; none without one."""
        return np.zeros(0) if self.denser is None else epoch.seconds_since(self.denser.time, self.time[0])

    def _among(self, stamps_s: FloatArray) -> attitude_track.RowArray:
        """Which of rising stamps (M,) the rows with a known attitude are."""
        known = self.seconds if self.attitude_known is None else self.seconds[self.attitude_known]
        return np.searchsorted(stamps_s, known - _SAME_S)

    @cached_property
    def _from_track(self) -> Rotation:
        return self.track(0.0).inv()

    @cached_property
    def _latest(self) -> dict[float, tuple[FloatArray, FloatArray, Rotation]]:
        return {}

    def _at(self, offset_s: float | FloatArray) -> tuple[FloatArray, FloatArray, Rotation]:
        return *self.orbit(offset_s), frames.product(self._turned_on(offset_s), self.R_BN)

    def _turned_on(self, offset_s: float | FloatArray) -> Rotation:
        """From the attitude at each stamp to that `offset_s` after it; where no attitude is known by the gyro alone, or
        without one along the track."""
        known = self.attitude_known
        if known is None or known.all():
            return self.smoothed.onward(offset_s, self._stamps)
        turns, after_s = np.empty((known.size, 4)), np.broadcast_to(offset_s, known.shape)
        by_gyro = np.zeros_like(known)
        if self.gyro_B_rad_s is not None:
            by_gyro = ~known & np.isfinite(self.gyro_B_rad_s).all(axis=1)
            turns[by_gyro] = Rotation.from_rotvec(-after_s[by_gyro, None] * self.gyro_B_rad_s[by_gyro]).as_quat()
        if known.any():
            turns[known] = self.smoothed.onward(after_s[known], self._stamps).as_quat()
        by_track = ~known & ~by_gyro
        if by_track.any():
            turns[by_track] = frames.product(self._track_of(by_track, offset_s), self._from_track[by_track]).as_quat()
        return Rotation.from_quat(turns)


def carried(r_N_km: FloatArray, v_N_km_s: FloatArray, after_s: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Position and velocity (M, 3) `after_s` (M,) later, by the pull of the Earth with its flattening (Runge-Kutta)."""
    from fluxtwin.sim.attitude import track_kernels

    steps = max(1, int(np.ceil(float(np.abs(after_s).max(initial=0.0)) / _STEP_S)))
    return track_kernels.carried(r_N_km, v_N_km_s, after_s / steps, steps)
