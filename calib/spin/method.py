"""The methods for a spinning spacecraft with sun pulses, `batch` and `iterative`, and their options."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from fluxtwin.calib.common import options as of

if TYPE_CHECKING:
    from fluxtwin.sim.base.types import FloatArray

_SUN_ALIGNMENT_DEG = of.Option(
    "How well the mounting of the sun sensor is known; iterative; default: 0.05.",
    float,
    "DEG",
    allowed=lambda value: 0.0 < value < 90.0,
    wanted="degrees, positive, below 90",
)
_INERTIA_RATIO = of.Option(
    "Moment of inertia about the spin axis over that across it; iterative.",
    float,
    "JS/JT",
    allowed=lambda value: 0.0 < value < 2.0,
    wanted="Js/Jt, above 0 and below 2",
)
_TORQUE_WALK_RAD_S = of.Option(
    "Process noise of the filter; iterative.", allowed=lambda value: value >= 0.0, wanted="rad/s, not negative"
)


@dataclass(frozen=True, kw_only=True)
class SpinOptions(of.Options):
    """How the motion and the magnetometer are found."""

    method: str = field(default="batch", metadata=of.METHOD("batch", "iterative"))
    parameters: str = field(default="b,S", metadata=of.PARAMETERS("b,S"))
    driver: Sequence[str] = field(default=(), metadata=of.DRIVER())
    noise_nT: float | FloatArray | None = field(default=None, metadata=of.NOISE_NT())
    lsb_nT: float | FloatArray | None = field(default=None, metadata=of.LSB_NT())
    sun_sigma_deg: float | None = field(default=None, metadata=of.SUN_SIGMA_DEG())
    """None: found in the residual (batch), or 0.2."""
    sun_alignment_deg: float = field(default=0.05, metadata=_SUN_ALIGNMENT_DEG())
    inertia_ratio: float | None = field(default=None, metadata=_INERTIA_RATIO())
    """None: that of the blind start."""
    torque_walk_rad_s: float = field(default=0.0, metadata=_TORQUE_WALK_RAD_S())
    covariance: str = field(default="blocks", metadata=of.COVARIANCE("white", "blocks"))
    robust: str = field(default="tukey", metadata=of.ROBUST("tukey", "none"))
    """`tukey`: readings beyond six robust sigma are left out, the others weigh alike."""


_HOME = "fluxtwin.calib.spin.calibrate:calibrate_spin"
ESTIMATORS = tuple(
    of.Estimator(name, ("positions", "sun pulses"), SpinOptions, _HOME, drivers_by=of.SCALAR)
    for name in ("batch", "iterative")
)
