"""Noise of the readings as physics has it, and its whitening.

A residual is e_t = v_t + (I + S)^-1 (theta_t x B_t) + signal: v white (sensor and rounding), theta the error of the
reference attitude, a first-order Gauss-Markov process per body axis; what it does to the field reaches the reading
through the sensor's own matrix. An autoregression cannot stand for it (it is a moving
average as well, and always perpendicular to the field), so the whitening is the innovation form of the Kalman
filter of exactly this model (Harvey 1989, Forecasting, Structural Time Series Models and the Kalman Filter,
section 3.4). The gains depend on the design alone: residual and Jacobians pass through the same linear map W with
W V W' = I.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fluxtwin.gap.problem.row_axes import RowAxes
from fluxtwin.sim.base.processes import stop_if_asked
from fluxtwin.sim.base.types import FloatArray

Precise = NDArray[Any]
"""Single or double precision."""


@dataclass(frozen=True)
class NoiseModel:
    """White noise of the readings and error of the reference attitude."""

    sigma_nT: float
    """White noise of a reading, 1 sigma per axis, rounding (LSB**2 / 12) included."""
    theta_rad: float
    """Error of the reference attitude, 1 sigma per body axis."""
    tau_s: float
    """Its time constant; 0: white."""
    words: str = ""
    axis_factor: tuple[float, float, float] = (1.0, 1.0, 1.0)
    """White noise of each body axis over sigma_nT; ones unless the axes differ by more than a quarter."""
    sigma_log_sd: float = 0.0
    """Standard deviation of log sigma: data and declared budget together."""
    theta_log_sd: float = 0.0
    tau_log_sd: float = 0.0
    sigma_prior_nT: float = 0.0
    """What the budget says of sigma_nT before the data are looked at."""

    @property
    def white_nT(self) -> FloatArray:
        """(3,) white noise per body axis, 1 sigma."""
        return self.sigma_nT * np.asarray(self.axis_factor)


@dataclass(frozen=True, eq=False)
class Whitener:
    """The linear map that whitens; N rows. Made by `make_whitener`."""

    image_nT: FloatArray
    """(N, 3, 3) what a turn of a radian about each body axis does to a reading."""
    gains: FloatArray
    """(N, 16), see `noise_kernels.GAIN_COLUMNS`."""
    noise: NoiseModel
    weights: FloatArray
    """(N, 3) weight of each component; 0: not measured, its row of the result is zero and it moves no state."""
    log_det: float
    """log determinant of the covariance of the measured components [nT**2]."""
    axes: RowAxes | None = None
    """Turns columns in body axes into the axes in which the rows are judged; None: those are the body axes."""

    @property
    def measured(self) -> int:
        """Number of scalar measurements; degrees of freedom before any fit."""
        return int((self.weights > 0).sum())

    def apply(self, columns: FloatArray, *, out: FloatArray | None = None) -> FloatArray:
        """Whiten (N, 3) or (N, 3, P), in nT (per unit): unit variance, same shape, axes near the body axes.

        out: where to put it; it may be `columns` itself, which then costs no memory.
        """
        columns = np.asarray(columns, dtype=np.float64)
        wide = np.ascontiguousarray(columns if columns.ndim == 3 else columns[:, :, None])
        direct = out is not None and out.flags.c_contiguous and out.dtype == np.float64
        result = out.reshape(wide.shape) if out is not None and direct else np.empty_like(wide)
        self._whiten(0, np.zeros((3, wide.shape[2])), wide, result)
        if out is None:
            return result.reshape(columns.shape)
        if not direct:
            out[...] = result.reshape(out.shape)
        return out

    def apply_as_it_is(self, columns: Precise) -> Precise:
        """Whiten a contiguous (N, 3, P) that is in the rows' own axes already; single precision stays single."""
        out = np.empty_like(columns)
        self._whiten(0, np.zeros((3, columns.shape[2])), columns, out)
        return out

    def stream(self, chunks: Iterable[FloatArray]) -> Iterator[FloatArray]:
        """Whiten consecutive chunks of rows, each (n, 3, P), the filter carried from one to the next.

        With chunks made one at a time a million rows of sixty columns need the memory of one chunk.
        """
        row, state = 0, np.zeros((3, 0))
        for chunk in chunks:
            columns = np.ascontiguousarray(chunk, dtype=np.float64)
            if row == 0:
                state = np.zeros((3, columns.shape[2]))
            done = np.empty_like(columns)
            self._whiten(row, state, columns, done)
            row += columns.shape[0]
            yield done

    def _whiten(self, row: int, state: FloatArray, columns: Precise, out: Precise) -> None:
        from fluxtwin.gap.noise.kernels import whiten

        stop_if_asked()  # whatever takes long in a diagnosis whitens, or flies the chain of effects
        rows = slice(row, row + columns.shape[0])
        if self.axes is not None:
            columns = self.axes.judged(columns, row)
        ratio = self.noise.theta_rad / self.noise.sigma_nT
        whiten(self.image_nT[rows], self.gains[rows], self.noise.sigma_nT, ratio, state, columns, out)


def make_whitener(
    image_nT: FloatArray,
    seconds: FloatArray,
    segment: FloatArray,
    noise: NoiseModel,
    weights: FloatArray | None = None,
    axes: RowAxes | None = None,
) -> Whitener:
    """The whitening of one noise model on one design.

    image_nT (N, 3, 3) of a turn, as from `turn_images`; seconds (N,) increasing; segment (N,): where it
    changes, nothing is known of the attitude error any more; weights (N,) or (N, 3): the white variance of a
    component is sigma**2 / weight, 0 for one that is to be passed over. axes: where rows have no attitude, the axes
    of images and weights; what is whitened is given in body axes all the same.
    """
    from fluxtwin.gap.noise.kernels import GAIN_COLUMNS, fill_gains

    image = np.ascontiguousarray(image_nT, dtype=np.float64)
    full = full_weights(weights, image.shape[0]) / np.square(noise.axis_factor)
    if axes is not None:
        full = np.ascontiguousarray(np.where(axes.measured, full, 0.0))
    gains = np.empty((image.shape[0], GAIN_COLUMNS))
    ratio = noise.theta_rad / noise.sigma_nT
    seconds, segment = (np.ascontiguousarray(v, dtype=np.float64) for v in (seconds, segment))
    log_det = fill_gains(image, seconds, segment, full, ratio, float(noise.tau_s), gains)
    log_det += 2.0 * float(np.log(noise.sigma_nT)) * int((full > 0).sum())
    return Whitener(image, gains, noise, full, float(log_det), axes)


def full_weights(weights: FloatArray | None, rows: int) -> FloatArray:
    """(N, 3) weights from none, (N,) or (N, 3)."""
    if weights is None:
        return np.ones((rows, 3))
    given = np.asarray(weights, dtype=np.float64)
    wide = given[:, None] if given.ndim == 1 else given
    return np.ascontiguousarray(np.broadcast_to(wide, (rows, 3)))
