"""A magnetometer that is slow."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from fluxtwin.sim.effects.base import Parameter, SignalEffect
from fluxtwin.sim.effects.history import low_pass, restarts
from fluxtwin.sim.effects.instrument import in_reading
from fluxtwin.sim.signal import Signal
from fluxtwin.sim.types import FloatArray


@dataclass(frozen=True)
class SensorLag(SignalEffect):
    """First-order low-pass of the reading with the time constant `lag`.

    Between stamps the ambient field's part is followed by its value and its rate of change, so a lag far below
    the sampling interval comes out right; the rest of the reading (torquers, stray fields) as straight lines.
    After a gap the filter starts anew.
    """

    name: ClassVar[str] = "sensor_lag"
    stage: ClassVar[str] = "sensor"
    equivalent_stages: ClassVar[tuple[str, ...]] = ("time",)
    about: ClassVar[str] = (
        "first-order low-pass, lag dy/dt + y = x: the reading is late by the lag and smoothed "
        "(RC low-pass: Oppenheim & Willsky, Signals and Systems, section 3.10)"
    )

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        return (Parameter("lag", "s", 0.5, 0.0, 600.0),)

    def apply(self, signal: Signal, theta: FloatArray) -> Signal:
        setting = signal.setting
        seconds, lag_s = setting.seconds, float(theta[0])
        if seconds.size < 2:
            return signal
        ambient = in_reading(setting, signal.field_B_nT)
        slope = in_reading(setting, signal.field_rate_B_nT_s)
        again = restarts(seconds)
        smooth = low_pass(seconds, ambient, lag_s, again, slope)
        return signal.with_reading(smooth + low_pass(seconds, signal.reading - ambient, lag_s, again))
