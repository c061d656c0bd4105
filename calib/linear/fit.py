"""The answer of the linear regression."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from fluxtwin.calib.common.fit import Fit
from fluxtwin.sim.base.types import FloatArray


@dataclass(frozen=True, kw_only=True)
class LinearFit(Fit):
    """What the regression adds to the record of every method."""

    eiv_shift: FloatArray
    """(3, 3) change of S by the errors-in-variables correction; zero when off."""

    @property
    def direction(self) -> str:
        """`linear` or `forward`."""
        return self.method

    def to_dict(self) -> dict[str, Any]:
        """Plain numbers and text for JSON; no NaN."""
        return {
            **super().to_dict(),
            "direction": self.direction,
            "errors_in_variables_shift": self.eiv_shift.tolist(),
        }
