"""The magnetometer: what it reads when a field is at it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from fluxtwin.sim.base.errors import BadInput
from fluxtwin.sim.base.types import FloatArray


@dataclass(frozen=True, eq=False)
class Magnetometer:
    """A three-axis magnetometer with the S, b, T of the papers' equation 1.

    Equation 1 (Lerner & Shuster 1981) maps the reading B to the true field in body axes:
    A B0 = (I + S) B + b + T D. The instrument does the inverse: B = (I + S)^-1 (A B0 - b - T D).
    """

    S: FloatArray
    """(3, 3) scale, misalignment and crosstalk; multiplies the *reading*."""
    b_nT: FloatArray
    """(3,) bias to be added to the corrected reading: a stray field f at the sensor is b = -f."""
    T_nT_per_Am2: FloatArray | None = None
    """(3, 3) torquer correction: a coupling C (field at the sensor per dipole) is T = -C."""
    noise_nT: float = 0.0
    """White noise of a single reading, 1 sigma per axis."""
    lsb_nT: float = 0.0
    """Spacing of the readings; 0 does not round."""
    range_nT: float | None = None
    """Full scale: readings beyond +-range_nT stay there, then are rounded. Give a multiple of the LSB: otherwise
    the nearest step may lie up to half an LSB beyond."""

    def __post_init__(self) -> None:
        if not np.linalg.cond(np.eye(3) + self.S) < 1e6:
            raise BadInput("I + S cannot be inverted", where="magnetometer S", wanted="small elements")

    def ideal_reading(self, field_B_nT: FloatArray, dipole_B_Am2: FloatArray | None = None) -> FloatArray:
        """Reading (N, 3) without noise, saturation and rounding: equation 1 solved for B.

        field_B_nT (N, 3) true field in body axes; dipole_B_Am2 (N, 3) the torquers' D, None for none.
        """
        corrected = np.atleast_2d(np.asarray(field_B_nT, dtype=np.float64)) - self.b_nT
        if self.T_nT_per_Am2 is not None and dipole_B_Am2 is not None:
            corrected = corrected - np.atleast_2d(dipole_B_Am2) @ self.T_nT_per_Am2.T
        return np.asarray(np.einsum("nk,mk->nm", corrected, self._inverse), dtype=np.float64)

    @cached_property
    def _inverse(self) -> FloatArray:
        return np.asarray(np.linalg.inv(np.eye(3) + self.S))

    def digitise(self, reading_nT: FloatArray) -> FloatArray:
        """Saturate at full scale, then round to the nearest multiple of the LSB, in that order."""
        reading: FloatArray = np.asarray(reading_nT, dtype=np.float64)
        if self.range_nT is not None:
            reading = np.minimum(np.maximum(reading, -self.range_nT), self.range_nT)
        if self.lsb_nT > 0:
            reading = self.lsb_nT * np.rint(reading / self.lsb_nT)
        return reading

    def reading(self, field_B_nT: FloatArray, dipole_B_Am2: FloatArray | None, rng: np.random.Generator) -> FloatArray:
        """Telemetered reading (N, 3): ideal reading, white noise, saturation, rounding, in that order.

        The noise is drawn even where its size is zero, so that the stream's later use does not move.
        """
        ideal = self.ideal_reading(field_B_nT, dipole_B_Am2)
        return self.digitise(ideal + self.noise_nT * rng.standard_normal(ideal.shape))
