"""Noise of the readings as physics has it, and its whitening.

A residual is e_t = v_t + (I + S)^-1 (theta_t x B_t) + signal: v white (sensor and rounding), theta the error of the
reference attitude, a first-order Gauss-Markov process per body axis; what it does to the field reaches the reading
through the sensor's own matrix. An autoregression cannot stand for it (it is a moving
average as well, and always perpendicular to the field), so the whitening is the innovation form of the Kalman
filter of exactly this model (Harvey 1989, Forecasting, Structural Time Series Models and the Kalman Filter,
section 3.4). The gains depend on the design alone: residual and Jacobians pass through the same linear map W with
W V W' = I.

A bias that walks is known by its rate alone, so it belongs to the covariance and not to the parameters (a random effect of a
linear mixed model: Harville 1977, J. Am. Stat. Assoc. 72, 320). Causes that are sought under the whitening with a walk are
those that a walk of that rate does not make, and the likelihoods of "these causes" and of "a walk, and those causes" are on
one scale.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from scipy.optimize import minimize_scalar

from fluxtwin.calib.common.criterion import THRESHOLD, samples_of, worth
from fluxtwin.gap.linear.projection import span_of
from fluxtwin.gap.problem.problem import ALIKE, Roll
from fluxtwin.gap.problem.row_axes import RowAxes
from fluxtwin.sim.base.processes import stop_if_asked
from fluxtwin.sim.base.types import FloatArray

RMS = (0.003, 100.0)
"""Of the walk at the end of the record, over the noise of a reading: its prior is even in the logarithm between these."""


@dataclass(frozen=True)
class NoiseModel:
    """White noise of the readings and error of the reference attitude."""

    sigma_nT: float
    """White noise of a reading, 1 sigma per axis, rounding (LSB**2 / 12) included."""
    theta_rad: float
    """Error of the reference attitude, 1 sigma per body axis; rms over the axes."""
    tau_s: float
    """Its time constant; 0: white."""
    axis_factor: tuple[float, float, float] = (1.0, 1.0, 1.0)
    """White noise of each body axis over sigma_nT; ones unless the axes differ by more than a quarter."""
    roll: Roll = ALIKE
    """How the attitude error differs from axis to axis."""
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

    def axis_variance(self, axes: RowAxes | None) -> FloatArray:
        """(3,), or (N, 3) where rows have axes of their own: white variance of each component over sigma_nT**2."""
        squares = np.square(self.axis_factor)
        return np.asarray(squares if axes is None else np.square(axes.turn) @ squares)

    @property
    def white_rms_nT(self) -> float:
        """White noise, rms over the axes."""
        return float(np.sqrt(np.mean(self.white_nT**2)))

    @property
    def words(self) -> str:
        """For the provenance."""
        white = f"white noise {self.sigma_nT:.3g} nT per axis"
        if self.axis_factor != (1.0, 1.0, 1.0):
            white = "white noise " + ", ".join(f"{v:.3g}" for v in self.white_nT) + " nT in x, y, z"
        if self.theta_rad <= 0:
            return f"{white}, no attitude error"
        memory = "white" if self.tau_s <= 0 else f"over {self.tau_s:.3g} s"
        roll, where = self.roll, ""
        if roll.factor != 1.0:
            where = (
                f", {roll.factor:.3g} times as large about ({', '.join(f'{v:.2f}' for v in roll.axis)}) as across it"
            )
        return f"{white}, attitude error {np.degrees(self.theta_rad):.2g} deg per axis{where}, {memory}"


@dataclass(frozen=True, eq=False)
class Whitener:
    """The linear map that whitens; N rows. Made by `make_whitener`."""

    noise: NoiseModel
    weights: FloatArray
    """(N, 3) weight of each component; 0: not measured, its row of the result is zero and it moves no state."""
    log_det: float
    """log determinant of the covariance of the measured components [nT**2]."""
    load: FloatArray
    """(N, 3, n) what the state adds to each component, in units of sigma; see `kernels`."""
    decay: FloatArray
    """(N,) share of the attitude error that is left since the row before."""
    gains: FloatArray
    """(N, 3, n + 1), see `kernels.fill_gains`."""
    covariance: FloatArray
    """(N, n, n) of the state before each row; of no rows unless it was asked for."""
    seconds: FloatArray
    """(N,)."""
    axes: RowAxes | None = None
    """Turns columns in body axes into the axes in which the rows are compared; None: those are the body axes."""

    @property
    def measured(self) -> int:
        """Number of scalar measurements; degrees of freedom before any fit."""
        return int((self.weights > 0).sum())

    @cached_property
    def turns(self) -> FloatArray:
        """(N, 3, 3) that make each row's axes those nearest the body axes."""
        turns = np.empty((self.weights.shape[0], 3, 3))
        kernels().fill_turns(self.load, self.gains, turns)
        return turns

    def apply(self, columns: FloatArray) -> FloatArray:
        """Whiten (N, 3) or (N, 3, P), in nT (per unit): unit variance, same shape, axes near the body axes."""
        stop_if_asked()  # whatever takes long in a diagnosis whitens, or flies the chain of effects
        columns = np.asarray(columns, dtype=np.float64)
        return self.apply_in_row_axes(columns if self.axes is None else self.axes.in_row_axes(columns))

    def apply_in_row_axes(self, columns: FloatArray, *, turned: bool = True) -> FloatArray:
        """As `apply`, for what is in the rows' own axes already; not turned: the components of a row are innovations of one
        after the other, which is all the same where only sums of squares and products are wanted."""
        wide = np.ascontiguousarray(columns if columns.ndim == 3 else columns[:, :, None])
        out, turns = np.empty_like(wide), self.turns if turned else np.empty((0, 3, 3))
        kernels().whiten(self.load, self.decay, self.gains, turns, 1.0 / self.noise.sigma_nT, wide, out)
        return out.reshape(columns.shape)


def make_whitener(
    image_nT: FloatArray,
    seconds: FloatArray,
    segment: FloatArray,
    noise: NoiseModel,
    weights: FloatArray | None = None,
    axes: RowAxes | None = None,
    *,
    walk: float = 0.0,
    covariance: bool = False,
) -> Whitener:
    """The whitening of one noise model on one design.

    image_nT (N, 3, 3) of a turn, as from `turn_images`; seconds (N,) increasing; segment (N,): where it
    changes, nothing is known of the attitude error any more; weights (N, 3): the white variance of a
    component is sigma**2 / weight, 0 for one that is to be passed over. axes: where rows have no attitude, the axes
    of images and weights; what is whitened is given in body axes all the same. walk: see `with_walk`; covariance:
    whether that of the state is kept.
    """
    rows = image_nT.shape[0]
    full = (np.ones((rows, 3)) if weights is None else weights) / noise.axis_variance(axes)
    if axes is not None:
        full = np.where(axes.measured, full, 0.0)
    load = np.asarray(image_nT, dtype=np.float64) * (noise.theta_rad / noise.sigma_nT)
    if noise.roll.factor != 1.0:
        load = load @ noise.roll.turns
    decay = np.zeros(rows)
    if noise.tau_s > 0:
        same = np.diff(segment, prepend=np.nan) == 0
        decay[same] = np.exp(-np.diff(seconds, prepend=np.nan)[same] / noise.tau_s)
    plain = Whitener(noise, full, 0.0, load, decay, np.empty(0), np.empty(0), seconds, axes)
    return with_walk(plain, walk, covariance=covariance)


def with_walk(whitener: Whitener, rate: float, *, covariance: bool = False) -> Whitener:
    """The same whitening, but for a bias that begins with the record and walks at a rate in each body axis [nT/sqrt(s)]."""
    noise, weights, seconds, axes = whitener.noise, whitener.weights, whitener.seconds, whitener.axes
    load, rows = whitener.load[:, :, :3], len(weights)
    if rate > 0:
        bias = np.broadcast_to(np.eye(3), load.shape) if axes is None else axes.turn
        load = np.concatenate([load, bias], axis=2)
    step = np.diff(seconds, prepend=seconds[:1]) * (rate / noise.sigma_nT) ** 2
    states = load.shape[2]
    gains = np.empty((rows, 3, states + 1))
    kept = np.empty((rows if covariance else 0, states, states))
    load, weights = np.ascontiguousarray(load), np.ascontiguousarray(weights)
    log_det = kernels().fill_gains(load, whitener.decay, step, weights, gains, kept)
    log_det += 2.0 * float(np.log(noise.sigma_nT)) * whitener.measured
    return Whitener(noise, weights, float(log_det), load, whitener.decay, gains, kept, seconds, axes)


def kernels() -> Any:
    """The compiled recursions; numba is loaded when they are first needed."""
    from fluxtwin.gap.noise import kernels

    return kernels


def likeliest_rate(whitener: Whitener, residual_nT: FloatArray, fitted_nT: FloatArray) -> float | None:
    """The likeliest rate [nT/sqrt(s)] of a walk in a residual (N, 3) beside fitted columns (N, 3, q); None where a walk is
    hardly more likely than none."""
    fit = _fits(whitener, residual_nT, fitted_nT)
    degrees = max(whitener.measured - fitted_nT.shape[2], 1)
    energy, log_det = fit(0.0)

    def lost(log_rate: float) -> float:
        chi2, wider = fit(float(np.exp(log_rate)))
        # The noise level is profiled out: one that was declared wrong is no walk.
        return -float(log_det - wider - degrees * np.log(chi2 / energy))

    unit = whitener.noise.sigma_nT / np.sqrt(float(whitener.seconds[-1] - whitener.seconds[0]))
    # A tolerance of a fifth of the standard deviation where 50 modes of the walk show.
    found = minimize_scalar(lost, bounds=np.log(unit * np.array(RMS)), options={"xatol": 0.02})
    found_worth = worth(-float(found.fun), 1, samples_of(whitener.measured), 0.0)
    return float(np.exp(found.x)) if found_worth > THRESHOLD else None


def gain(whitener: Whitener, residual_nT: FloatArray, fitted_nT: FloatArray, rate: float) -> float:
    """Twice the log likelihood that a walk of that rate wins on a residual, for noise of unit variance."""
    fit = _fits(whitener, residual_nT, fitted_nT)
    (before, log_det), (now, wider) = fit(0.0), fit(rate)
    return before - now + log_det - wider


def _fits(whitener: Whitener, residual_nT: FloatArray, fitted_nT: FloatArray) -> Callable[[float], tuple[float, float]]:
    """Of a rate: chi-square beside the fitted columns, and the log determinant of the restricted likelihood."""
    flat = whitener.apply(fitted_nT).reshape(residual_nT.size, -1)
    columns = np.concatenate([fitted_nT[:, :, span_of(flat).number], residual_nT[:, :, None]], axis=2)

    def fit(rate: float) -> tuple[float, float]:
        walking = with_walk(whitener, rate)
        R = np.linalg.qr(walking.apply(columns).reshape(residual_nT.size, -1), mode="r")
        size = np.abs(np.diag(R))
        return float(size[-1] ** 2), walking.log_det + 2.0 * float(np.log(size[:-1]).sum())

    return fit
