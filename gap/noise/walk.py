"""A bias that wanders, as noise: the whitening of readings that have a random walk in them.

A walk is known by its rate alone, so it belongs to the covariance and not to the parameters (a random effect of a
linear mixed model: Harville 1977, J. Am. Stat. Assoc. 72, 320). Causes that are sought under this whitening are those
that a walk of that rate does not make, and the likelihoods of "these causes" and of "a walk, and those causes" are on
one scale. The walk is taken along its Karhunen-Loeve modes, sines of k - 1/2 half periods over the record.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from fluxtwin.gap.linear.leftover import Leftover
from fluxtwin.gap.noise.whitening import NoiseModel, Whitener
from fluxtwin.sim.base.types import FloatArray

_MODES_A_ROOT = 4.0  # times the root of the rows: beyond, a walk of three times the noise is below it
_FEWEST = 24
_MOST = 160
LOG_RMS = np.linspace(np.log(0.003), np.log(100.0), 60)
"""Prior of the walk's spread at the end of the record over the noise of a reading: even in its logarithm."""
_LIVE = 1e-9
_LEAST_EVIDENCE = 6.0


@dataclass(frozen=True, eq=False)
class WalkWhitener(Whitener):
    """A whitening after which a walk of one rate is white as well: the symmetric root of its covariance, inverted."""

    span: FloatArray = field(default_factory=lambda: np.zeros((0, 0)))
    """(3N, k) orthonormal: where the walk is after the first whitening."""
    damping: FloatArray = field(default_factory=lambda: np.zeros(0))
    """(k,) what is taken from each direction."""

    def apply(self, columns: FloatArray, *, out: FloatArray | None = None) -> FloatArray:
        """As `Whitener.apply`."""
        white = super().apply(columns, out=out)
        flat = white.reshape(self.span.shape[0], -1)
        made = flat - self.span @ (self.damping[:, None] * (self.span.T @ flat))
        if out is None:
            return np.asarray(made.reshape(white.shape))
        out[...] = made.reshape(out.shape)
        return out


@dataclass(frozen=True, eq=False)
class Wander:
    """All walks on one design under one whitening."""

    whitener: Whitener
    seconds: FloatArray
    """(N,)."""

    @property
    def noise(self) -> NoiseModel:
        return self.whitener.noise

    @cached_property
    def columns(self) -> FloatArray:
        """(N, 3, 3k) what a walk of 1 nT/sqrt(s) is made of, with independent unit coefficients."""
        return three_axes(modes_of_a_walk(self.seconds))

    @cached_property
    def _white(self) -> FloatArray:
        return self.whitener.apply(self.columns).reshape(3 * self.seconds.size, -1)

    @cached_property
    def _span(self) -> tuple[FloatArray, FloatArray]:
        """Orthonormal directions (3N, k) and the energy of a unit walk in each."""
        value, vector = np.linalg.eigh(self._white.T @ self._white)
        live = value > _LIVE * value[-1]
        return self._white @ (vector[:, live] / np.sqrt(value[live])), value[live]

    def whitening(self, rate: float) -> WalkWhitener:
        """The whitening with a walk of that rate in nT/sqrt(s)."""
        span, energy = self._span
        plain = self.whitener
        damping = 1.0 - 1.0 / np.sqrt(1.0 + rate**2 * energy)
        return WalkWhitener(
            plain.image_nT, plain.gains, plain.noise, plain.weights, plain.log_det, plain.axes, span, damping
        )

    def rate(self, left: Leftover) -> float | None:
        """The likeliest rate of a walk in a whitened residual; None where a walk is hardly more likely than none."""
        span = float(self.seconds[-1] - self.seconds[0])
        rates = np.exp(LOG_RMS) * self.noise.sigma_nT / np.sqrt(span)
        chi2, log_det = self._beside(left, rates)
        # The noise level is profiled out: one that was declared wrong is no walk.
        gains = -log_det - max(left.degrees, 1) * np.log(chi2 / left.energy)
        best = int(np.argmax(gains))
        return float(rates[best]) if gains[best] >= 2.0 * _LEAST_EVIDENCE else None

    def gain(self, left: Leftover, rate: float) -> float:
        """Twice the log likelihood that a walk of that rate wins on a whitened residual, for noise of unit variance."""
        chi2, log_det = self._beside(left, np.array([rate]))
        return float(left.energy - chi2[0] - log_det[0])

    def _beside(self, left: Leftover, rates: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Chi-square (k,) with walks of rates (k,), and what they add to the log determinant of the covariance (k,)."""
        value, vector = np.linalg.eigh(self._free_gram(left.basis))
        live = value > _LIVE * value[-1]
        value, vector = value[live], vector[:, live]
        q = (vector.T @ (self._white.T @ left.residual)) ** 2 / value
        scaled = rates[:, None] ** 2 * value
        chi2 = left.energy - float(q.sum()) + np.sum(q / (1.0 + scaled), axis=1)
        return chi2, np.sum(np.log1p(scaled), axis=1)

    def _free_gram(self, basis: FloatArray) -> FloatArray:
        along = basis.T @ self._white
        return np.asarray(self._white.T @ self._white - along.T @ along)


def without_walk(whitener: Whitener) -> Whitener:
    """The whitening of the same noise with no walk in it."""
    if not isinstance(whitener, WalkWhitener):
        return whitener
    return Whitener(
        whitener.image_nT, whitener.gains, whitener.noise, whitener.weights, whitener.log_det, whitener.axes
    )


def modes_of_a_walk(seconds: FloatArray) -> FloatArray:
    """(N, k) Karhunen-Loeve modes of a walk of 1 nT/sqrt(s) that begins with the record, times their spread [sqrt(s)].

    Sines of k - 1/2 half periods over the record, of variance falling with the square of that number (Loeve 1978,
    Probability theory II, section 37.5).
    """
    begin = float(seconds[0])
    span = float(seconds[-1]) - begin
    count = int(np.clip(_MODES_A_ROOT * np.sqrt(seconds.size), _FEWEST, min(_MOST, max(seconds.size // 2, _FEWEST))))
    waves = np.pi * (np.arange(count) + 0.5)
    return np.asarray(np.sqrt(2.0 * span) * np.sin(waves * (seconds - begin)[:, None] / span) / waves)


def three_axes(shapes: FloatArray) -> FloatArray:
    """(N, 3, 3k): each shape in each axis, axes fastest."""
    spread = np.eye(3)[None, :, None, :] * shapes[:, None, :, None]
    return np.asarray(spread.reshape(shapes.shape[0], 3, -1))
