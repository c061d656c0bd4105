"""The noise of the reading, Sigma_B: declared, or found in the data.

It is needed because the reading stands on the right side of journal eq. 1 and its noise attenuates S
(`linear`), and because a field that varies by no more than the noise does not vary. The quantisation of the
telemetry counts as noise of variance LSB^2/12 per axis.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fluxtwin.calib.moments import stretches
from fluxtwin.sim.errors import BadInput
from fluxtwin.sim.types import FloatArray, TimeArray

_MAD_TO_SIGMA = 1.482602218505602
_SMALLEST_LSB_NT = 1e-3
_FEWEST_PAIRS = 30
_ROWS = 50_000  # of a longer record, stretches that add up to this are looked at


@dataclass(frozen=True)
class ReadingNoise:
    """Variance of the reading per axis, and where it comes from."""

    variance_nT2: FloatArray
    """(3,) diagonal of Sigma_B, quantisation included."""
    source: str
    """In words."""
    relative_uncertainty: float = 0.0
    """1 sigma of the variance, as a share of it; 0 where it was declared."""

    @property
    def matrix(self) -> FloatArray:
        """(3, 3) Sigma_B."""
        return np.diag(self.variance_nT2)


def per_axis(value: float | FloatArray, name: str) -> FloatArray:
    """(3,) of a scalar or three numbers; raises BadInput for anything negative or not finite."""
    array = np.asarray(value, dtype=np.float64)
    if array.shape not in ((), (3,)) or not np.isfinite(array).all() or (array < 0).any():
        raise BadInput(f"{value!r}", where=name, wanted="one number or three, in nT, not negative")
    return np.array(np.broadcast_to(array, (3,)))


def lsb_from_spacing_nT(B_nT: FloatArray) -> FloatArray:
    """(3,) LSB of each axis from the spacing of the values that occur; 0 where the values are on no grid.

    The grid step is the smallest spacing that all the others are whole multiples of (to 2 %).
    """
    return np.array([_grid_step(B_nT[:, axis]) for axis in range(3)])


def reading_noise(
    B_nT: FloatArray,
    residual_nT: FloatArray,
    time: TimeArray,
    noise_nT: float | FloatArray | None,
    lsb_nT: float | FloatArray | None,
) -> ReadingNoise:
    """Sigma_B from what is declared, the rest from the data.

    residual_nT: (N, 3) of a first fit. Undeclared noise is read from short differences of the residual along
    the field, where the noise of the reference attitude does not show (it turns the field) and
    the errors of the field model, being smooth, cancel.
    """
    some = stretches(len(B_nT), _ROWS)
    B_nT, residual_nT, time = B_nT[some], residual_nT[some], time[some]
    lsb = lsb_from_spacing_nT(B_nT) if lsb_nT is None else per_axis(lsb_nT, "lsb_nT")
    found = "found in the spacing of the readings" if lsb.any() else "as no spacing of the readings is seen"
    lsb_words = f"LSB {_three(lsb)} nT {found if lsb_nT is None else 'declared'}"
    if noise_nT is not None:
        noise = per_axis(noise_nT, "noise_nT")
        return ReadingNoise(noise**2 + lsb**2 / 12.0, f"noise {_three(noise)} nT declared, {lsb_words}")
    differences = _along_field_differences(B_nT, residual_nT, time)
    if differences.size < _FEWEST_PAIRS:
        return ReadingNoise(lsb**2 / 12.0, f"{lsb_words}; too few neighbouring samples to find the noise beyond it")
    # The reading cannot be noisier than the whole residual.
    sigma = min(_clipped_sigma(differences) / np.sqrt(2.0), _clipped_sigma(residual_nT.ravel()))
    words = f"{sigma:.4g} nT a component from short differences of the residual along the field, {lsb_words}"
    # Differences share samples: the variance of n of them is known to sqrt(3/n), not sqrt(2/n).
    uncertainty = float(np.sqrt(3.0 / differences.size))
    return ReadingNoise(np.maximum(sigma**2, lsb**2 / 12.0), words, uncertainty)


def _clipped_sigma(values: FloatArray) -> float:
    """Standard deviation with what lies beyond four robust sigma clipped: sees no bit errors."""
    middle = float(np.median(values))
    robust = _MAD_TO_SIGMA * float(np.median(np.abs(values - middle)))
    if robust == 0.0:
        return 0.0
    inside = values[np.abs(values - middle) < 4.0 * robust]
    return float(np.std(inside))


def _along_field_differences(B_nT: FloatArray, residual_nT: FloatArray, time: TimeArray) -> FloatArray:
    size = np.linalg.norm(B_nT, axis=1)
    along = np.einsum("ij,ij->i", residual_nT, B_nT) / np.where(size > 0, size, 1.0)
    step = np.diff(time).astype("int64")
    if step.size == 0:
        return np.zeros(0)
    return np.asarray(np.diff(along)[step <= 1.5 * np.median(step)])


def _grid_step(values: FloatArray) -> float:
    spacing = np.diff(np.unique(values))
    spacing = spacing[spacing > _SMALLEST_LSB_NT]
    if spacing.size < 2:
        return 0.0
    for parts in (1, 2, 3):  # the smallest spacing that occurs may be two or three steps
        step = float(spacing.min()) / parts
        for _ in range(2):  # the mean of the short spacings sharpens a rounded step
            counts = np.rint(spacing / step)
            short = counts <= 3 * parts
            step = float(spacing[short].sum() / counts[short].sum())
        if np.abs(spacing / step - counts).max() < 0.02:
            return step
    return 0.0


def _three(values: FloatArray) -> str:
    return f"{values[0]:.4g}" if np.ptp(values) <= 0.01 * values.max() else "/".join(f"{v:.4g}" for v in values)
