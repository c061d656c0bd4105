"""The magnetometer is sampled later than its time stamp."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.effects.base import Parameter, SignalEffect
from fluxtwin.sim.effects.signal import Signal


@dataclass(frozen=True)
class TimeTagOffset(SignalEffect):
    """The reading is taken later than its stamp says.

    Orbit and attitude are right at the stamp; the field is that of a moment later.
    """

    name: ClassVar[str] = "time_tag_offset"
    stage: ClassVar[str] = "time"
    frame: ClassVar[str | None] = None
    follows: ClassVar[str | None] = None
    settled_by: ClassVar[str] = "a spin of 2 rpm (milliseconds show), or a slow tumble of 0.25 deg/s"
    about: ClassVar[str] = "sampled later than the stamp (DMSP, Alken et al. 2014; GRACE-FO, Stolle et al. 2021)"

    parameters = (Parameter("offset", "s", 0.5, -600.0, 600.0),)

    def apply(self, signal: Signal, theta: FloatArray) -> Signal:
        return signal.sampled_later(float(theta[0]))
