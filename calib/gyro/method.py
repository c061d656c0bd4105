"""The method from gyro and magnetometer alone, `gyro`, and its options."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from fluxtwin.calib.common import options as of

if TYPE_CHECKING:
    from fluxtwin.sim.base.types import FloatArray

_STRETCH_S = of.Option(
    "Length of a stretch over which the gyro is integrated [s]; gyro; default: the longest that fits three times.",
    float,
    "S",
    allowed=lambda value: 1.0 <= value <= 1800.0,
    wanted="seconds, 1 to 1800",
)


@dataclass(frozen=True, kw_only=True)
class GyroOptions(of.Options):
    """How the turning field is followed."""

    method: str = field(default="gyro", metadata=of.METHOD("gyro"))
    parameters: str = field(default="b,S", metadata=of.PARAMETERS("b", "b,S"))
    driver: Sequence[str] = field(default=(), metadata=of.DRIVER())
    robust: str = field(default="tukey", metadata=of.ROBUST("none", "tukey"))
    stretch_s: float | None = field(default=None, metadata=_STRETCH_S())
    noise_nT: float | FloatArray | None = field(default=None, metadata=of.NOISE_NT())


ESTIMATORS = (of.Estimator("gyro", ("body rates",), GyroOptions, "fluxtwin.calib.gyro.calibrate:calibrate_gyro"),)
