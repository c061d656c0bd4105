"""The methods without attitude, `center`, `twostep` and `scalar`, and their options."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from fluxtwin.calib.common import options as of
from fluxtwin.sim.base.errors import BadInput

if TYPE_CHECKING:
    from fluxtwin.sim.base.types import FloatArray

_TELEMETRY_BIAS = of.Option("An older name of --driver; method scalar.", list[str], "COLUMN")


@dataclass(frozen=True, kw_only=True)
class ScalarOptions(of.Options):
    """How the size of the field is compared."""

    method: str = field(default="scalar", metadata=of.METHOD("scalar", "twostep", "center"))
    parameters: str = field(default="", metadata=of.PARAMETERS("", "b", "b,S", "b,S,T"))
    """Empty: `b` for center, `b,S` for the others."""
    driver: Sequence[str] = field(default=(), metadata=of.DRIVER())
    """Columns of telemetry whose field is estimated too (Springmann & Cutler 2012)."""
    telemetry_bias: Sequence[str] = field(default=(), metadata=_TELEMETRY_BIAS())
    robust: str = field(default="tukey", metadata=of.ROBUST("none", "tukey"))
    covariance: str = field(default="blocks", metadata=of.COVARIANCE("white", "blocks"))
    block_s: float | None = field(default=None, metadata=of.BLOCK_S())
    field_error_nT: float | None = field(default=None, metadata=of.FIELD_ERROR_NT())
    noise_nT: float | FloatArray | None = field(default=None, metadata=of.NOISE_NT())
    lsb_nT: float | FloatArray | None = field(default=None, metadata=of.LSB_NT())
    passes: Sequence[object] | None = field(default=None, metadata=of.PASSES())

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.parameters:
            object.__setattr__(self, "parameters", "b" if self.method == "center" else "b,S")
        if self.method == "center" and self.parameters != "b":
            raise BadInput(f"{self.parameters!r}", where="parameters", wanted="'b': CENTER finds the bias alone")
        if self.method != "scalar" and "T" in self.parameters:
            raise BadInput("T", where="parameters", wanted="method scalar, which alone takes the torquers")


ESTIMATORS = (
    of.Estimator("center", ("positions",), ScalarOptions, of.SCALAR, drivers_by=of.SCALAR),
    of.Estimator("twostep", ("positions",), ScalarOptions, of.SCALAR, drivers_by=of.SCALAR),
    of.Estimator("scalar", ("positions",), ScalarOptions, of.SCALAR),
)
