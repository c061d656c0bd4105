"""The horizon is not where the scanner's calibration puts it, and where it is depends on latitude."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.effects.base import Parameter, SignalEffect
from fluxtwin.sim.effects.signal import Signal


@dataclass(frozen=True)
class HorizonScannerBias(SignalEffect):
    """Roll and pitch are wrong in step with latitude.

    Roll and pitch of the reference attitude, and of the nadir that the scanner measures, are wrong by
    a sin(latitude) + b cos(2 latitude).
    """

    name: ClassVar[str] = "horizon_scanner_bias"
    stage: ClassVar[str] = "attitude"
    frame: ClassVar[str | None] = "orbital"
    follows: ClassVar[str | None] = "latitude"
    settled_by: ClassVar[str] = "a second attitude sensor beside the scanner"
    about: ClassVar[str] = (
        "reported roll and pitch are too large by sin p sin(latitude) + cos2 p cos(2 latitude), p the parameter and "
        "latitude geocentric: the Earth's 15-micron radiance goes with latitude and season (Wertz 1978, section 4.2; "
        "Phenneger et al. 1985: 0.05-0.2 deg); a constant part would be absorbed by S"
    )

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        names = ("roll_sin", "roll_cos2", "pitch_sin", "pitch_cos2")
        return tuple(Parameter(name, "deg", 0.2, -20.0, 20.0) for name in names)

    def apply(self, signal: Signal, theta: FloatArray) -> Signal:
        latitude = signal.setting.latitude_rad
        shapes = np.stack([np.sin(latitude), np.cos(2.0 * latitude)], axis=1)
        roll, pitch = shapes @ np.radians(theta[:2]), shapes @ np.radians(theta[2:])
        # A larger angle turns the axes one way, so it turns the vectors the other way.
        return signal.attitude_reported_turned(-np.stack([roll, pitch, np.zeros_like(roll)], axis=1), "nadir_B")
