"""Readings that no noise model explains: spikes and bit errors, found, counted and passed over.

A spike stands alone. What a component's neighbours and the noise model predict for it is compared with what it is;
the difference must stand out of the differences around it too, so that a run of rows that an unknown effect
moves is never taken for spikes and its evidence thrown away.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import median_filter

from fluxtwin.calib.common.robust import MAD_TO_SIGMA
from fluxtwin.gap.noise.whitening import Whitener, kernels
from fluxtwin.sim.base.types import BoolArray, FloatArray

CUT_SIGMA = 6.0  # two of a thousand million good components are cut


@dataclass(frozen=True, eq=False)
class RobustRows:
    """Weights of the components of N rows."""

    weights: FloatArray
    """(N, 3): 1 good, 0 cut. Give it to `make_whitener`."""
    difference_nT: FloatArray | None = None
    """(N, 3) each component less what the fit and all other readings predict for it."""
    measured: BoolArray | None = None
    """(N, 3) components that there are; None: all."""

    @property
    def cut(self) -> BoolArray:
        """(N, 3) True for components that are cut."""
        cut = self.weights <= 0
        return np.asarray(cut if self.measured is None else cut & self.measured, dtype=np.bool_)

    @property
    def cut_rows(self) -> BoolArray:
        """(N,) True for rows with a component cut."""
        return np.asarray(self.cut.any(axis=1), dtype=np.bool_)


def standing_out(difference: FloatArray, least: float = 0.0, measured: BoolArray | None = None) -> FloatArray:
    """(N, 3) how far each component stands out of its neighbourhood, in robust sigmas of it.

    difference (N, 3) in any unit; least: the sigma that noise alone would give, in that unit, if known; measured
    (N, 3): components that there are, the others do not stand out.
    """
    if measured is not None:
        found = np.zeros_like(difference)
        for axis, there in enumerate(measured.T):
            found[there, axis] = standing_out(difference[there, axis : axis + 1], least)[:, 0]
        return found
    rows = difference.shape[0]
    if rows < 3:
        return np.zeros_like(difference)
    level = median_filter(difference, size=(min(7, rows), 1), mode="reflect")  # three wrong ones of seven leave it
    apart = np.abs(difference - level)
    alone = np.minimum(np.abs(difference), apart)
    spread = MAD_TO_SIGMA * median_filter(apart, size=(min(25, rows), 1), mode="reflect")
    over_all = np.maximum(MAD_TO_SIGMA * np.median(apart, axis=0), 1e-9 + 1e-12 * np.max(apart, axis=0))  # never zero
    return np.asarray(alone / np.maximum(np.maximum(spread, least), over_all))


def weights_of(distance: FloatArray, measured: BoolArray | None = None) -> FloatArray:
    """(N, 3) weights from how far the components stand out: 1, and 0 from 6 sigma on.

    At most a tenth of the rows is cut, those that stand out most: more are no spikes but something that the diagnosis must
    see. What is not measured (N, 3) has weight 0.
    """
    worst = distance.max(axis=1)
    allowed = max(1, int(0.10 * worst.size))
    bar = max(CUT_SIGMA, float(np.partition(worst, -allowed - 1)[-allowed - 1]) if worst.size > allowed else 0.0)
    return np.where(distance > bar if measured is None else (distance > bar) | ~measured, 0.0, 1.0)


def with_clipped(weights: FloatArray, difference_nT: FloatArray, reading_nT: FloatArray | None) -> FloatArray:
    """The weights (N, 3), but of readings at an end of an axis's range that should have been beyond all that it reads:
    a range that is too small makes two and more of them, and spikes hardly ever two.

    difference_nT (N, 3): reading less what is predicted; reading_nT (N, 3): None where axes were turned.
    """
    if reading_nT is None or (weights > 0).all():
        return weights
    scatter_nT = MAD_TO_SIGMA * np.median(np.abs(difference_nT), axis=0)
    for value, off in ((reading_nT, difference_nT), (-reading_nT, -difference_nT)):
        top = np.nanmax(value, axis=0)
        clipped = (weights <= 0) & (value - off > top) & (value > top - CUT_SIGMA * scatter_nT)
        weights = np.where(clipped & (clipped.sum(axis=0) > 1), 1.0, weights)
    return weights


def spike_weights(
    left_nT: FloatArray,
    whitener: Whitener,
    there: BoolArray,
    most_nT: float = np.inf,
    reading_nT: FloatArray | None = None,
) -> tuple[FloatArray, FloatArray]:
    """Weights (N, 3) under a noise model, and each component less what all others predict for it [nT].

    left_nT (N, 3): residual after the fit; whitener: with the weights as they are now, and the state's covariance;
    there (N, 3): components that are measured. Those that are cut now are weighed like all others and may come back.
    most_nT: white noise that the budget allows at the most; reading_nT (N, 3): as for `with_clipped`.
    """
    noise = whitener.noise
    own = np.ones(left_nT.shape) / noise.axis_variance(whitener.axes)
    scaled = np.ascontiguousarray(left_nT / noise.sigma_nT)
    standard, plain = np.empty_like(scaled), np.empty_like(scaled)
    filtered = (whitener.load, whitener.decay, whitener.gains, whitener.covariance, whitener.weights)
    kernels().predict_each(*filtered, own, scaled, standard, plain)
    # Many spikes make the noise look large: then its budget says what they stand out of, and the differences around them.
    least = min(1.0, most_nT / noise.sigma_nT)
    plain_nT = plain * noise.sigma_nT
    return with_clipped(weights_of(standing_out(standard, least, there), there), plain_nT, reading_nT), plain_nT


def first_weights(
    residual_nT: FloatArray, design: FloatArray, there: BoolArray, reading_nT: FloatArray | None = None
) -> FloatArray:
    """Weights (N, 3) before anything is known of the noise: gross spikes only.

    Least squares first; if anything stands out of it, the fit of least absolute residuals, which a tenth of wild
    readings does not move. design: (N, 3, P); there (N, 3): components that are measured; reading_nT: as for `with_clipped`.
    """
    for rounds in (1, 15):
        left = residual_nT - design @ _fit(residual_nT[there], design[there], rounds)
        weights = weights_of(standing_out(left, measured=there), there)
        if (weights[there] > 0).all():
            break
    return with_clipped(weights, left, reading_nT)


def _fit(y: FloatArray, A: FloatArray, rounds: int) -> FloatArray:
    """Coefficients (P,) by iterated reweighting towards least absolute residuals; one round is least squares."""
    size = np.linalg.norm(A, axis=0)
    A = A / np.where(size > 0, size, 1.0)
    weight: FloatArray = np.ones(y.size)
    solution: FloatArray = np.zeros(A.shape[1])
    before = np.inf
    for _ in range(rounds):
        half = A * np.sqrt(weight)[:, None]
        gram = half.T @ half
        gram[np.diag_indices_from(gram)] += 1e-10 * max(float(np.trace(gram)) / max(len(gram), 1), 1e-300)
        solution = np.asarray(np.linalg.solve(gram, A.T @ (weight * y)), dtype=np.float64)
        off = np.abs(y - A @ solution)
        total = float(off.sum())
        if total > before * (1.0 - 2e-3):
            break
        before = total
        weight = np.asarray(1.0 / np.maximum(off, 0.3 * float(np.median(off)) + 1e-12), dtype=np.float64)
        weight /= float(weight.max())
    return np.asarray(solution / np.where(size > 0, size, 1.0))
