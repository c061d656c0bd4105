"""The orbit that the ground is given runs ahead of the true one."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.effects.base import Parameter, SignalEffect
from fluxtwin.sim.effects.signal import Signal


@dataclass(frozen=True)
class AlongTrackError(SignalEffect):
    """The position is wrong along the orbit.

    Position and velocity moved along the orbit by the time ahead / |v|; the attitude is right.
    """

    name: ClassVar[str] = "along_track_error"
    stage: ClassVar[str] = "orbit"
    frame: ClassVar[str | None] = "orbital"
    follows: ClassVar[str | None] = None
    settled_by: ClassVar[str] = "any body rate; a slow tumble of 0.25 deg/s is enough"
    about: ClassVar[str] = (
        "the reported position is ahead of the true one by this arc along the orbit, constant over the record; two-line "
        "elements are off by 1-5 km at their epoch and tens of km a week later, nearly all of it along track "
        "(Vallado & Cefola 2012)"
    )

    parameters = (Parameter("ahead", "km", 5.0, -1000.0, 1000.0),)

    def apply(self, signal: Signal, theta: FloatArray) -> Signal:
        return signal.position_reported_ahead(float(theta[0]))
