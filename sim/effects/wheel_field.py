"""The field of a magnetised wheel."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.effects.base import Parameter, SignalEffect, held
from fluxtwin.sim.effects.drivers import varies
from fluxtwin.sim.effects.signal import Setting, Signal


@dataclass(frozen=True)
class WheelField(SignalEffect):
    """Field of a dipole that turns with a wheel.

    Rotating dipole: a cos(phase) + b sin(phase) at the sensor, an ellipse as a and b are free vectors.

    The phase is the integral of the recorded speed of wheel number `wheel` (linear between stamps), or, where
    `frequency_Hz` is given, of that constant frequency; the sampling aliases both. A speed known to d rpm holds
    the phase for about 60 / (2 pi d) seconds only.
    """

    name: ClassVar[str] = "wheel_field"
    stage: ClassVar[str] = "spacecraft"
    frame: ClassVar[str | None] = "body"
    follows: ClassVar[str | None] = None
    settled_by: ClassVar[str] = "the wheel speed in the telemetry, or a few speeds held in turn"
    about: ClassVar[str] = (
        "field of a dipole that rotates with a wheel, a cos(phase) + b sin(phase), aliased by the sampling "
        "(dipole law: Jackson, section 5.6)"
    )
    wheel: int = 1
    """Number of the wheel, from 1."""
    frequency_Hz: float | None = None
    """Constant frequency; None: the recorded speed."""

    parameters = tuple(Parameter(f"{part}_{axis}", "nT", 50.0) for part in ("cos", "sin") for axis in "xyz")

    def phase_rad(self, setting: Setting, offset_s: float = 0.0) -> FloatArray | None:
        """(N,) phase since the first stamp, `offset_s` after each stamp; None when nothing tells."""
        if self.frequency_Hz is not None:
            return np.asarray(2.0 * np.pi * self.frequency_Hz * (setting.seconds + offset_s))
        rate = self._rate_rad_s(setting)
        if rate is None:
            return None
        turned = 0.5 * (rate[1:] + rate[:-1]) * np.diff(setting.seconds)
        return np.concatenate([[0.0], np.cumsum(turned)]) + rate * offset_s

    def _rate_rad_s(self, setting: Setting) -> FloatArray | None:
        speeds = setting.column("wheel_speed_rpm")
        if speeds is None:
            return None
        columns = speeds[:, None] if speeds.ndim == 1 else speeds
        if not 1 <= self.wheel <= columns.shape[1]:
            return None
        one = held(columns[:, self.wheel - 1])
        return None if one is None else one * (2.0 * np.pi / 60.0)

    def alternatives(self, setting: Setting) -> tuple[WheelField, ...]:
        speeds = setting.column("wheel_speed_rpm")
        if self.frequency_Hz is not None or speeds is None:
            return (self,)
        wheels = 1 if speeds.ndim == 1 else speeds.shape[1]
        choices = tuple(WheelField(number) for number in range(1, wheels + 1))
        return tuple(choice for choice in choices if choice.untestable(setting) is None) or (self,)

    def untestable(self, setting: Setting) -> str | None:
        phase = self.phase_rad(setting)
        if phase is None:
            return "the telemetry has no wheel speed; only a line found in the residual can stand in"
        return None if varies(phase) else "the wheel never turns"

    @property
    def bound(self) -> str:
        return "the phase is counted from the first sample of this record: only the amplitude is carried over"

    def apply(self, signal: Signal, theta: FloatArray) -> Signal:
        phase = self.phase_rad(signal.setting, signal.sample_offset_s)
        if phase is None:
            return signal
        return signal.with_stray(np.cos(phase)[:, None] * theta[:3] + np.sin(phase)[:, None] * theta[3:])
