"""Choosing the noise model by restricted maximum likelihood on a saturated design.

With V = sigma**2 W(theta / sigma, tau) and one orthonormal basis Q of the design, the restricted likelihood
(Patterson & Thompson 1971, doi 10.1093/biomet/58.3.545) plus the log prior of the budget is

    l = -1/2 [log det W + log det Q' W^-1 Q + nu log sigma**2 + RSS / sigma**2] + log prior(sigma, theta, tau).

Q is the same at every point of the search: a basis that moves with the point, or columns that repeat each other,
would tilt the choice.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from fluxtwin.gap.noise_budget import NoisePrior
from fluxtwin.gap.whitening import NoiseModel, make_whitener
from fluxtwin.sim.types import FloatArray

_RATIOS = (0.1, 0.3, 0.6, 1.0, 1.7, 3.0, 10.0)  # attitude error times field over white noise, where nothing is declared
_AROUND = (0.4, 0.7, 1.0, 1.5, 2.5)  # over the declared ratio
_TAUS_S = (10.0, 30.0, 80.0, 200.0, 500.0, 1200.0)
_LONGEST_S = 3000.0
_RANK_TOLERANCE = 1e-10  # of the eigenvalues of the Gram matrix: directions weaker than 1e-5 of the strongest


@dataclass(frozen=True, eq=False)
class Data:
    """What the likelihood is taken of; n rows, possibly means of several readings."""

    residual_nT: FloatArray
    """(n, 3)."""
    design: FloatArray
    """(n, 3, P), any rank, any units."""
    field_B_nT: FloatArray
    seconds: FloatArray
    segment: FloatArray
    weights: FloatArray
    """(n, 3): the readings in each mean; 0 not measured."""
    count: FloatArray
    """(n,) readings in each row, and"""
    spacing_s: FloatArray
    """(n,) their spacing: a mean over a stretch sees less of a fast attitude error."""


@dataclass(frozen=True, eq=False)
class Choice:
    """The best point, and the fit there."""

    noise: NoiseModel
    log_posterior: float
    coefficients: FloatArray
    """(P,) generalised least-squares coefficients of the design's columns."""
    dof: int


class Likelihood:
    """The restricted likelihood of one set of data, as a function of the noise model."""

    def __init__(
        self, data: Data, prior: NoisePrior, axis_factor: tuple[float, float, float] = (1.0, 1.0, 1.0)
    ) -> None:
        self.data, self.prior, self.axis_factor = data, prior, axis_factor
        self.basis, self.to_columns = _orthonormal(data)
        self.stacked = np.concatenate([self.basis, data.residual_nT[:, :, None]], axis=2)
        self.dof = int((data.weights > 0).sum()) - self.basis.shape[2]
        self.field_nT = float(np.sqrt(np.mean(np.sum(data.field_B_nT**2, axis=1)))) if data.residual_nT.size else 0.0
        self.field_nT = max(self.field_nT, 1.0)

    def at(self, ratio: float, tau_s: float) -> Choice:
        """The best sigma at a ratio (theta times field over sigma) and a time constant."""
        data = self.data
        share = np.sqrt(mean_share(data.count, data.spacing_s, tau_s))
        unit = NoiseModel(1.0, ratio / self.field_nT, tau_s, axis_factor=self.axis_factor)
        whitener = make_whitener(data.field_B_nT * share[:, None], data.seconds, data.segment, unit, data.weights)
        white = whitener.apply(self.stacked).reshape(-1, self.stacked.shape[2])
        gram = white.T @ white
        rank = self.basis.shape[2]
        factor, log_q = np.zeros(rank), 0.0
        if rank:
            L = np.linalg.cholesky(gram[:rank, :rank])
            log_q = 2.0 * float(np.log(np.diag(L)).sum())
            half = np.linalg.solve(L, gram[:rank, rank])
            factor = np.linalg.solve(L.T, half)
            rss = float(gram[rank, rank] - half @ half)
        else:
            rss = float(gram[0, 0])
        rss = max(rss, 1e-12 * float(gram[rank, rank]), 1e-30)
        log_sigma = self._best_sigma(rss, ratio)
        sigma = float(np.exp(log_sigma))
        fit = -0.5 * (whitener.log_det + log_q + 2.0 * self.dof * log_sigma + rss / sigma**2)
        theta = ratio * sigma / self.field_nT
        noise = NoiseModel(sigma, theta, tau_s, axis_factor=self.axis_factor)
        return Choice(noise, fit + self.prior.log_density(sigma, theta, tau_s), self.to_columns @ factor, self.dof)

    def _best_sigma(self, rss: float, ratio: float) -> float:
        """log sigma that maximises the posterior at fixed ratio: Newton on a concave function."""
        prior = self.prior
        s0, p0 = np.log(prior.sigma_nT), prior.sigma_log_sd**-2
        p1, s1 = 0.0, 0.0
        if ratio > 0 and prior.theta_rad:
            p1, s1 = prior.theta_log_sd**-2, np.log(prior.theta_rad * self.field_nT / ratio)
        s = 0.5 * np.log(rss / max(self.dof, 1)) if self.dof > 0 else s0
        s = max(s, s0 - 20.0)
        for _ in range(60):
            pull = rss * np.exp(-2.0 * s)
            slope = -self.dof + pull - p0 * (s - s0) - p1 * (s - s1)
            step = slope / (2.0 * pull + p0 + p1)
            s += float(np.clip(step, -1.0, 1.0))
            if abs(step) < 1e-10:
                break
        return float(s)


def best_noise(likelihood: Likelihood, start: NoiseModel | None = None) -> Choice:
    """Search a grid of (theta / sigma, tau), then refine the best point; from `start`, if given, only refine."""
    if start is not None and start.theta_rad > 0:
        best = likelihood.at(start.theta_rad * likelihood.field_nT / start.sigma_nT, start.tau_s)
    else:
        best = _searched(likelihood)
    return _with_uncertainty(likelihood, *_refined(likelihood, best))


def _searched(likelihood: Likelihood) -> Choice:
    """The best point of a grid; at each time constant the ratios are climbed from where the last one was best."""
    prior, field_nT = likelihood.prior, likelihood.field_nT
    best = likelihood.at(0.0, 0.0) if not prior.theta_rad else None
    if best is not None and prior.theta_rad is not None:
        return best
    declared = None if prior.theta_rad is None else prior.theta_rad * field_nT / prior.sigma_nT
    ratios = _RATIOS if declared is None else tuple(declared * f for f in _AROUND)
    place = len(ratios) // 2
    for tau in _taus_s(likelihood):
        here, place = _climbed(likelihood, ratios, tau, place)
        if best is None or here.log_posterior > best.log_posterior:
            best = here
    assert best is not None
    return best


def _taus_s(likelihood: Likelihood) -> list[float]:
    declared = likelihood.prior.tau_s
    if declared is not None:
        return [declared * f for f in (0.5, 1.0, 2.0)] if declared > 0 else [0.0]
    spacing = _usual_spacing(likelihood.data.seconds)
    return [0.0, *(t for t in _TAUS_S if t > 0.25 * spacing)]


def _climbed(likelihood: Likelihood, ratios: tuple[float, ...], tau_s: float, place: int) -> tuple[Choice, int]:
    """The best ratio at one time constant, from `place` uphill."""
    best = likelihood.at(ratios[place], tau_s)
    for way in (1, -1):
        moved = False
        while 0 <= place + way < len(ratios):
            there = likelihood.at(ratios[place + way], tau_s)
            if there.log_posterior <= best.log_posterior:
                break
            best, place, moved = there, place + way, True
        if moved:
            break
    return best, place


def _refined(likelihood: Likelihood, best: Choice) -> tuple[Choice, FloatArray]:
    """Parabolas through three points along log ratio and log tau, in turn; also the second derivatives there."""
    curvature, width = np.zeros(2), [0.35, 0.5]
    if best.noise.theta_rad <= 0:
        return best, curvature
    for number in range(3):
        before = best.log_posterior
        for axis in (0, 1):
            if axis == 1 and best.noise.tau_s <= 0:
                continue
            best, curvature[axis] = _along(likelihood, best, axis, width[axis])
            width[axis] *= 0.5
        if number and best.log_posterior - before < 0.02:
            break
    return best, curvature


def _along(likelihood: Likelihood, middle: Choice, axis: int, width: float) -> tuple[Choice, float]:
    """The best of three points and the top of their parabola along one axis; its second derivative."""
    ratio = middle.noise.theta_rad * likelihood.field_nT / middle.noise.sigma_nT

    def moved(by: float) -> Choice:
        tau = min(middle.noise.tau_s * np.exp(by), _LONGEST_S) if axis else middle.noise.tau_s
        return likelihood.at(ratio if axis else float(ratio * np.exp(by)), float(tau))

    low, high = moved(-width), moved(width)
    second = (low.log_posterior + high.log_posterior - 2.0 * middle.log_posterior) / width**2
    slope = (high.log_posterior - low.log_posterior) / (2.0 * width)
    candidates = [middle, low, high]
    if second < 0:
        top = float(np.clip(-slope / second, -3.0 * width, 3.0 * width))
        if abs(top) > 0.05 * width:
            candidates.append(moved(top))
    return max(candidates, key=lambda c: c.log_posterior), float(second)


def _with_uncertainty(likelihood: Likelihood, best: Choice, curvature: FloatArray) -> Choice:
    sigma_sd = float(1.0 / np.sqrt(2.0 * max(likelihood.dof, 0) + likelihood.prior.sigma_log_sd**-2))
    theta_sd, tau_sd = (float(1.0 / np.sqrt(-c)) if c < 0 else np.inf for c in curvature)
    noise = replace(
        best.noise,
        sigma_log_sd=sigma_sd,
        theta_log_sd=float(np.hypot(theta_sd, sigma_sd)),
        tau_log_sd=tau_sd,
        sigma_prior_nT=likelihood.prior.sigma_nT,
    )
    return replace(best, noise=replace(noise, words=noise_words(noise)))


def noise_words(noise: NoiseModel) -> str:
    """The model in words."""
    white = f"white noise {noise.sigma_nT:.3g} nT per axis"
    if noise.axis_factor != (1.0, 1.0, 1.0):
        white = "white noise " + ", ".join(f"{v:.3g}" for v in noise.white_nT) + " nT in x, y, z"
    if noise.theta_rad <= 0:
        return f"{white}, no attitude error"
    memory = "white" if noise.tau_s <= 0 else f"over {noise.tau_s:.3g} s"
    return f"{white}, attitude error {np.degrees(noise.theta_rad):.2g} deg per axis, {memory}"


def mean_share(count: FloatArray, spacing_s: FloatArray, tau_s: float) -> FloatArray:
    """Variance of the mean of `count` values of a Gauss-Markov process, `spacing_s` apart, over that of one."""
    n = np.maximum(count, 1.0)
    if tau_s <= 0:
        return np.asarray(1.0 / n)
    rho = np.exp(-np.maximum(spacing_s, 0.0) / tau_s)
    one = np.maximum(1.0 - rho, 1e-6)
    share = (n * (1.0 - rho**2) - 2.0 * rho * (1.0 - rho**n)) / (n * one) ** 2
    return np.asarray(np.where((n == 1.0) | (1.0 - rho < 1e-6), 1.0, share))


def _usual_spacing(seconds: FloatArray) -> float:
    return float(np.median(np.diff(seconds))) if seconds.size > 1 else 1.0


def _orthonormal(data: Data) -> tuple[FloatArray, FloatArray]:
    """(n, 3, r) orthonormal basis of the design on the measured components, and (P, r): columns = basis combinations."""
    P = data.design.shape[2]
    flat = np.where(data.weights[:, :, None] > 0, data.design, 0.0).reshape(data.weights.size, P)
    size = np.linalg.norm(flat, axis=0)
    live = size > 0
    scale = np.where(live, 1.0 / np.where(live, size, 1.0), 0.0)
    flat = flat * scale
    values, vectors = np.linalg.eigh(flat.T @ flat) if P else (np.zeros(0), np.zeros((0, 0)))
    kept = values > _RANK_TOLERANCE * max(float(values.max(initial=0.0)), 1e-300)
    mix = vectors[:, kept] / np.sqrt(values[kept])
    return (flat @ mix).reshape(*data.weights.shape, -1), scale[:, None] * mix
