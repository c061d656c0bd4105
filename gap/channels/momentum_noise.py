"""Noise of the momentum's balance: errors of the recorded attitude, and what moves the body that nobody recorded.

The attitude's error is a first-order Gauss-Markov process or white. Torquers and wheels change between rows: that is a
white torque and a white rate beside the modelled ones. Their sizes are those of the largest restricted likelihood with
every possible cause in the design, so that no cause can pass for noise (Patterson & Thompson 1971, Biometrika 58:545).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.linalg import cholesky, qr, qr_multiply, solve_triangular

from fluxtwin.gap.channels.momentum_arcs import Windows
from fluxtwin.gap.noise.budget import NoisePrior, prior_of
from fluxtwin.gap.problem.problem import Budget
from fluxtwin.sim.base.types import FloatArray

_TAUS_S = (0.0, 15.0, 30.0, 60.0, 120.0, 250.0, 500.0, 1000.0, 2000.0)
_RATIOS = (0.0, *np.geomspace(1e-4, 1e4, 17))
"""Variance at the nodes by a white torque, or rate, over that of the attitude's error."""
_PLAIN = 0.5
"""Of log likelihood a decade: where the data do not say, little moves the body unrecorded."""
_FINEST_RAD = float(np.radians(0.002))
"""No attitude is taken to be better: what wheels do between rows, and short arcs, are not known better."""
_ROUNDS = 3
_NEAR = 4


@dataclass(frozen=True)
class MomentumNoise:
    """sigma is that of the recorded attitude [rad]."""

    sigma_rad: float
    tau_s: float
    torque: float = 0.0
    """Ratio of variances, as above."""
    rate: float = 0.0

    @property
    def words(self) -> str:
        """For the provenance."""
        tau = "white" if self.tau_s == 0.0 else f"time constant {self.tau_s:.3g} s"
        extra = [
            f"{name} that moves nodes by {np.degrees(self.sigma_rad * np.sqrt(ratio)):.2g} deg"
            for name, ratio in (("white torque", self.torque), ("white rate", self.rate))
            if ratio
        ]
        return "; ".join([f"attitude error {np.degrees(self.sigma_rad):.3g} deg, {tau}", *extra])


class MomentumWhitener:
    """Makes the noise of all nodes white with variance 1, beside the free starts of the windows."""

    def __init__(self, windows: Windows, noise: MomentumNoise) -> None:
        self.windows, self.noise = windows, noise
        self.log_determinant = 0.0
        self.roots: list[FloatArray] = []
        self.starts: list[FloatArray] = []
        for number, window in enumerate(windows.windows):
            root = np.asarray(cholesky(self._covariance(number, noise), lower=True, check_finite=False))
            start = windows.starts[number].reshape(3 * window.size, 6)
            start = start / np.linalg.norm(start, axis=0)
            white = solve_triangular(root, start, lower=True, check_finite=False)
            Q, R, _ = qr(white / np.linalg.norm(white, axis=0), mode="economic", pivoting=True)
            size = np.abs(np.diag(R))
            self.log_determinant += 2.0 * float(np.log(np.diag(root)).sum())
            self.log_determinant += 2.0 * float(np.log(np.maximum(size, 1e-12)).sum())
            self.log_determinant += 2.0 * float(np.log(np.linalg.norm(white, axis=0)).sum())
            self.roots.append(root)
            self.starts.append(Q[:, size > 1e-9])

    @property
    def measured(self) -> int:
        """Scalar measurements less what the starts take."""
        return 3 * int(self.windows.rows.size) - sum(int(start.shape[1]) for start in self.starts)

    def apply(self, columns: FloatArray) -> FloatArray:
        """Columns (M, 3) or (M, 3, P), whitened, beside the best start of each window."""
        flat = columns[:, :, None] if columns.ndim == 2 else columns
        out = np.empty(flat.shape)
        for window, root, start in zip(self.windows.windows, self.roots, self.starts, strict=True):
            part = flat[window.place].reshape(3 * window.size, flat.shape[2])
            white = solve_triangular(root, part, lower=True, check_finite=False)
            white -= start @ (start.T @ white)
            out[window.place] = white.reshape(window.size, 3, flat.shape[2])
        return np.asarray(out.reshape(columns.shape))

    def left(self, columns: FloatArray) -> FloatArray:
        """The same in radians: columns less the best start of each window."""
        white = self.apply(columns)
        out = np.empty(columns.shape)
        for window, root in zip(self.windows.windows, self.roots, strict=True):
            part = white[window.place]
            out[window.place] = (root @ part.reshape(3 * window.size, -1)).reshape(part.shape)
        return np.asarray(out.reshape(columns.shape))

    @cached_property
    def by_attitude(self) -> MomentumWhitener:
        """Weights of the attitude's error alone: for figures, in which a wandering torque must not be taken for granted."""
        return MomentumWhitener(self.windows, replace(self.noise, torque=0.0, rate=0.0))

    def floor_rad(self, noise: MomentumNoise) -> float:
        """rms per component that a noise leaves beside the best starts by these weights."""
        total = 0.0
        for number, (root, start) in enumerate(zip(self.roots, self.starts, strict=True)):
            inner = solve_triangular(root, self._covariance(number, noise), lower=True, check_finite=False)
            inner = solve_triangular(root, inner.T, lower=True, check_finite=False)
            kept = np.eye(len(root)) - start @ start.T
            total += float(np.trace(root @ kept @ inner @ kept @ root.T))
        return float(np.sqrt(total / (3 * self.windows.rows.size)))

    def _covariance(self, number: int, noise: MomentumNoise) -> FloatArray:
        window = self.windows.windows[number]
        apart = np.abs(window.seconds[:, None] - window.seconds)
        same = np.eye(window.size) if noise.tau_s == 0.0 else np.exp(-apart / noise.tau_s)
        torque, rate = self.windows.wander[number]
        whole = noise.torque * torque + noise.rate * rate
        for axis in range(3):  # the attitude's errors about the three axes are independent
            whole[axis::3, axis::3] += same + 1e-9 * np.eye(window.size)
        return np.asarray(noise.sigma_rad**2 * whole)


def choose_noise(windows: Windows, residual: FloatArray, saturated: FloatArray, budget: Budget) -> MomentumNoise:
    """The noise of the largest restricted likelihood; residual (M, 3), saturated (M, 3, P): every possible cause."""
    prior, tau = prior_of(budget), budget.attitude_tau_s
    taus = sorted({*(_TAUS_S[1:] if tau else _TAUS_S), *(() if tau is None else (tau,))})
    starts = [min(taus, key=lambda value: abs(value - near)) for near in ((60.0, 1000.0) if tau is None else (tau,))]
    seen: dict[MomentumNoise, tuple[float, float]] = {}

    def likelihood(noise: MomentumNoise) -> float:
        if noise not in seen:
            seen[noise] = _likelihood(windows, residual, saturated, noise, prior)
        return seen[noise][0]

    def climbed(best: MomentumNoise) -> MomentumNoise:
        for _ in range(_ROUNDS):
            for name, grid in (("torque", _RATIOS), ("rate", _RATIOS), ("tau_s", taus)):
                best = _climbed(best, name, grid, likelihood)
        return best

    best = max((climbed(MomentumNoise(1.0, start)) for start in starts), key=likelihood)
    sigma = max(seen[best][1], _FINEST_RAD)
    share = (seen[best][1] / sigma) ** 2
    return replace(best, sigma_rad=sigma, torque=share * best.torque, rate=share * best.rate)


def _climbed(
    noise: MomentumNoise, name: str, grid: Sequence[float], likelihood: Callable[[MomentumNoise], float]
) -> MomentumNoise:
    """The best along one axis of the grid: coarse first, then beside the best."""
    places = sorted({*range(0, len(grid), _NEAR), grid.index(getattr(noise, name)), len(grid) - 1})
    while True:
        best = max(places, key=lambda place: likelihood(replace(noise, **{name: grid[place]})))
        beside = [place for place in (best - 1, best + 1) if 0 <= place < len(grid) and place not in places]
        if not beside:
            return replace(noise, **{name: grid[best]})
        places = [*places, *beside]


def _likelihood(
    windows: Windows, residual: FloatArray, saturated: FloatArray, noise: MomentumNoise, prior: NoisePrior
) -> tuple[float, float]:
    """Restricted log likelihood with the best size of all noise, and that size [rad]."""
    whitener = MomentumWhitener(windows, noise)
    white = whitener.apply(residual).reshape(-1)
    design = whitener.apply(saturated).reshape(white.size, saturated.shape[2])
    design /= np.maximum(np.linalg.norm(saturated.reshape(white.size, saturated.shape[2]), axis=0), 1e-300)
    # Only what Q makes of one vector is wanted, not Q: half the time.
    along, R, _ = qr_multiply(design, white, mode="right", pivoting=True)
    size = np.abs(np.diag(R))
    kept = size > 1e-7 * max(float(size.max(initial=0.0)), 1e-300)
    free = max(whitener.measured - int(kept.sum()), 1)
    whole = float(white @ white)
    chi2 = max(whole - float(along[kept] @ along[kept]), 1e-14 * whole, 1e-300)  # not less than rounding
    sigma = float(np.sqrt(chi2 / free))
    value = -0.5 * (whitener.log_determinant + 2.0 * float(np.log(size[kept]).sum()) + free * np.log(chi2 / free))
    value += prior.log_density(prior.sigma_nT, sigma, noise.tau_s)
    value -= _PLAIN * sum(np.log10(ratio / _RATIOS[1]) for ratio in (noise.torque, noise.rate) if ratio)
    return float(value), sigma
