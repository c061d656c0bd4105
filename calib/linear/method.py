"""The methods against a reference attitude, `linear` and `forward`, and their options."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from fluxtwin.calib.common import options as of
from fluxtwin.sim.base.errors import BadInput

if TYPE_CHECKING:
    from fluxtwin.sim.base.types import FloatArray

_EIV = of.Option("Correct S for its attenuation by the noise of the reading; on for linear.", bool)
_WEIGHTS = of.Option("(N,) weights of the joined rows, any scale (journal eq. 4).")


@dataclass(frozen=True, kw_only=True)
class LinearOptions(of.Options):
    """How the regression is done."""

    method: str = field(default="linear", metadata=of.METHOD("linear", "forward"))
    parameters: str = field(default="b,S", metadata=of.PARAMETERS("b", "b,S", "b,S,T"))
    driver: Sequence[str] = field(default=(), metadata=of.DRIVER())
    errors_in_variables: bool | None = field(default=None, metadata=_EIV())
    """None: on for `linear`. It also takes out the shortening by errors of the attitude."""
    robust: str = field(default="tukey", metadata=of.ROBUST("none", "tukey"))
    covariance: str = field(default="blocks", metadata=of.COVARIANCE("white", "blocks"))
    block_s: float | None = field(default=None, metadata=of.BLOCK_S())
    field_error_nT: float | None = field(default=None, metadata=of.FIELD_ERROR_NT())
    attitude_sigma_deg: float | None = field(default=None, metadata=of.ATTITUDE_SIGMA_DEG())
    attitude_tau_s: float | None = field(default=None, metadata=of.ATTITUDE_TAU_S())
    noise_nT: float | FloatArray | None = field(default=None, metadata=of.NOISE_NT())
    lsb_nT: float | FloatArray | None = field(default=None, metadata=of.LSB_NT())
    weights: FloatArray | None = field(default=None, metadata=_WEIGHTS())
    passes: Sequence[object] | None = field(default=None, metadata=of.PASSES())

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.errors_in_variables and self.method == "forward":
            raise BadInput(
                "method forward needs no correction for noise in the reading",
                where="errors_in_variables",
                wanted="method linear, or the correction off",
            )

    @property
    def corrects(self) -> bool:
        """Whether the errors-in-variables correction is made."""
        wanted = self.method == "linear" if self.errors_in_variables is None else self.errors_in_variables
        return wanted and self.parameters != "b"


_HOME = "fluxtwin.calib.linear.calibrate:calibrate_linear"
ESTIMATORS = tuple(
    of.Estimator(name, ("positions", "attitude"), LinearOptions, _HOME) for name in ("linear", "forward")
)
