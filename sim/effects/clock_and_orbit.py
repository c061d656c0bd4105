"""Stamps and positions that are not those of the readings."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar, Literal, Self

import numpy as np

from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.earth import epoch
from fluxtwin.sim.effects.base import GOES_ON, Effect, Parameter, SignalEffect, elapsed_s
from fluxtwin.sim.effects.signal import Setting, Signal


@dataclass(frozen=True)
class Drifting(SignalEffect):
    """Base of errors that are constant over the record, or grow in proportion to time."""

    frame: ClassVar[str | None] = None
    both: ClassVar[tuple[Parameter, Parameter]]
    """The error, and its rate."""
    rate_s: ClassVar[float]
    """Seconds in the rate's unit of time."""
    course: Literal["constant", "linear"] = "constant"
    """linear: the rate is a parameter too, and the error is that of the moment `since`."""
    since: str | None = None
    """ISO 8601 UTC; None: the first row."""

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        return self.both if self.course == "linear" else self.both[:1]

    @property
    def forms(self) -> tuple[Self, ...]:
        return (replace(self, course="constant"), replace(self, course="linear"))

    def alternatives(self, setting: Setting) -> tuple[Self, ...]:
        return self.forms if self == type(self)() and setting.time.size > 1 else (self,)

    def modulates(self, setting: Setting) -> tuple[Effect, FloatArray] | None:
        if self.course == "constant":
            return None
        grown = elapsed_s(setting, self.since) / self.rate_s
        return replace(self, course="constant"), np.stack([np.ones_like(grown), grown], axis=1)

    def pinned(self, setting: Setting, reading_B_nT: FloatArray) -> Self:
        given = self.course == "constant" or self.since is not None
        return self if given else replace(self, since=epoch.iso(setting.time[0], "ms"))

    @property
    def bound(self) -> str | None:
        return GOES_ON if self.course == "linear" else None

    def size(self, setting: Setting, theta: FloatArray) -> float | FloatArray:
        """The error, one for all rows or (N,)."""
        first = float(theta[0])
        if self.course == "constant":
            return first
        return first + float(theta[1]) / self.rate_s * elapsed_s(setting, self.since)


@dataclass(frozen=True)
class TimeTagOffset(Drifting):
    """The time stamps are early (+) or late (-).

    Orbit and attitude are right at the stamp; the field is that of the moment `offset_s` later.
    """

    name = "time_tag_offset"
    stage = "time"
    settled_by = "a spin of 2 rpm, which shows milliseconds, or a slow tumble of 0.25 deg/s"
    about = (
        "sampled this much later (negative: earlier) than the stamp and, with course = linear, later by this much more each "
        "day (DMSP, Alken et al. 2014; GRACE-FO, Stolle et al. 2021; a quartz of 20 ppm drifts by 1.7 s a day)"
    )
    both = (Parameter("offset", "s", 0.5, -600.0, 600.0), Parameter("rate", "s/day", 2.0, -8640.0, 8640.0))
    rate_s = 86400.0

    def apply(self, signal: Signal, theta: FloatArray) -> Signal:
        return signal.sampled_later(self.size(signal.setting, theta))


@dataclass(frozen=True)
class AlongTrackError(Drifting):
    """The position is wrong along the orbit.

    Position and velocity moved along the orbit by the time ahead / |v|; the attitude is right.
    """

    name = "along_track_error"
    stage = "orbit"
    frame = "orbital"
    settled_by = "a rotation of the body; a slow tumble of 0.25 deg/s is enough"
    about = (
        "the reported position is ahead of the true one by this arc along the orbit and, with course = linear, by this "
        "much more each hour. Two-line elements are wrong by 1-5 km at their epoch and by tens of km a week later, "
        "nearly all of it along track (Vallado & Cefola 2012); those of another satellite of the same launch, by up to "
        "half an orbit"
    )
    both = (Parameter("ahead", "km", 5.0, -20_000.0, 20_000.0), Parameter("rate", "km/h", 0.5, -1000.0, 1000.0))
    rate_s = 3600.0

    def apply(self, signal: Signal, theta: FloatArray) -> Signal:
        return signal.position_reported_ahead(self.size(signal.setting, theta))
