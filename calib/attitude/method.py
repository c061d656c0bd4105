"""The method `recursive`, a filter that estimates the attitude too, and its options."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

from fluxtwin.calib.common import options as of
from fluxtwin.sim.base.errors import BadInput


@dataclass(frozen=True, kw_only=True)
class RecursiveOptions(of.Options):
    """What is known to the filter. The slow errors are states, so the covariance is always of the kind `blocks`."""

    method: str = field(default="recursive", metadata=of.METHOD("recursive"))
    parameters: str = field(default="b,S", metadata=of.PARAMETERS("b,S", "b"))
    driver: Sequence[str] = field(default=(), metadata=of.DRIVER())
    noise_nT: float | None = field(default=None, metadata=of.NOISE_NT())
    lsb_nT: float | None = field(default=None, metadata=of.LSB_NT())
    attitude_sigma_deg: float | None = field(default=None, metadata=of.ATTITUDE_SIGMA_DEG())
    attitude_tau_s: float | None = field(default=None, metadata=of.ATTITUDE_TAU_S())
    sun_sigma_deg: float | None = field(default=None, metadata=of.SUN_SIGMA_DEG())
    robust: str = field(default="tukey", metadata=of.ROBUST("tukey"))
    covariance: str = field(default="blocks", metadata=of.COVARIANCE("blocks"))

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.lsb_nT is not None and self.noise_nT is None:
            raise BadInput(
                f"{self.lsb_nT!r}",
                where="--lsb-nT",
                wanted="--noise-nT too: noise that is found includes rounding",
            )


_HOME = "fluxtwin.calib.attitude.recursive:calibrate_recursive"
_NEEDS = ("positions", "attitude, or nadir and sun")
ESTIMATORS = (of.Estimator("recursive", _NEEDS, RecursiveOptions, _HOME, drivers_by=of.SCALAR),)
