"""Stamps and positions that are not those of the readings."""

from __future__ import annotations

from dataclasses import dataclass

from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.effects.base import Parameter, SignalEffect
from fluxtwin.sim.effects.signal import Signal


@dataclass(frozen=True)
class TimeTagOffset(SignalEffect):
    """The reading is taken later than its stamp says.

    Orbit and attitude are right at the stamp; the field is that of a moment later.
    """

    name = "time_tag_offset"
    stage = "time"
    frame = None
    follows = None
    settled_by = "a spin of 2 rpm (milliseconds show), or a slow tumble of 0.25 deg/s"
    about = "sampled later than the stamp (DMSP, Alken et al. 2014; GRACE-FO, Stolle et al. 2021)"
    parameters = (Parameter("offset", "s", 0.5, -600.0, 600.0),)

    def apply(self, signal: Signal, theta: FloatArray) -> Signal:
        return signal.sampled_later(float(theta[0]))


@dataclass(frozen=True)
class AlongTrackError(SignalEffect):
    """The position is wrong along the orbit.

    Position and velocity moved along the orbit by the time ahead / |v|; the attitude is right.
    """

    name = "along_track_error"
    stage = "orbit"
    frame = "orbital"
    follows = None
    settled_by = "any body rate; a slow tumble of 0.25 deg/s is enough"
    about = (
        "the reported position is ahead of the true one by this arc along the orbit, constant over the record; two-line "
        "elements are off by 1-5 km at their epoch and tens of km a week later, nearly all of it along track "
        "(Vallado & Cefola 2012)"
    )
    parameters = (Parameter("ahead", "km", 5.0, -1000.0, 1000.0),)

    def apply(self, signal: Signal, theta: FloatArray) -> Signal:
        return signal.position_reported_ahead(float(theta[0]))
