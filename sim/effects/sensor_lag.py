"""A magnetometer that is slow."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.effects.base import Parameter, SignalEffect
from fluxtwin.sim.effects.field_history import field_history
from fluxtwin.sim.effects.history import low_pass, restarts
from fluxtwin.sim.effects.instrument import in_reading
from fluxtwin.sim.effects.signal import Signal


@dataclass(frozen=True)
class SensorLag(SignalEffect):
    """The reading is smoothed and late.

    First-order low-pass of the reading with the time constant `lag`.

    Between stamps the ambient field's part is followed by its value and its rate of change, at moments between two
    stamps too where the body turns far in a step, so a lag far below the sampling interval comes out right; the rest
    of the reading (torquers, stray fields) as straight lines. After a gap the filter starts anew, as if the body had
    turned at that rate before.
    """

    name: ClassVar[str] = "sensor_lag"
    stage: ClassVar[str] = "sensor"
    frame: ClassVar[str | None] = None
    follows: ClassVar[str | None] = None
    settled_by: ClassVar[str] = "a spin of 2 rpm, or torquer edges sampled fast"
    equivalent_stages: ClassVar[tuple[str, ...]] = ("time",)
    about: ClassVar[str] = (
        "first-order low-pass, lag dy/dt + y = x: the reading is late by the lag and smoothed "
        "(RC low-pass: Oppenheim & Willsky, Signals and Systems, section 3.10)"
    )

    parameters = (Parameter("lag", "s", 0.5, 0.0, 600.0),)

    def apply(self, signal: Signal, theta: FloatArray) -> Signal:
        setting, lag_s = signal.setting, float(theta[0])
        if setting.seconds.size < 2:
            return signal
        field = field_history(signal)
        start = field.steady_B_nT(lag_s)
        late = low_pass(field.time_s, field.along_B_nT, lag_s, field.restart, field.slope_B_nT_s, start)
        late = late - field.along_B_nT
        shift = in_reading(setting, signal.with_own_turn(late[field.stamps]))
        rest = signal.reading - in_reading(setting, signal.field_B_nT)
        late_rest = low_pass(setting.seconds, rest, lag_s, restarts(setting.seconds)) - rest
        return signal.with_reading(signal.reading + shift + late_rest)
