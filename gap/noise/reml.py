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
from scipy.linalg import solve_triangular

from fluxtwin.gap.linear.leftover import share_of_errors
from fluxtwin.gap.linear.span import SHARE_LEFT, Span, span_of
from fluxtwin.gap.noise.budget import NoisePrior
from fluxtwin.gap.noise.whitening import NoiseModel, make_whitener
from fluxtwin.sim.base.types import BoolArray, FloatArray

RIDGE = 0.25
"""The likeliest ratio grows about as this power of the time constant."""
_UNKNOWN_RATIO = 0.6  # attitude error times field over white noise, where nothing is declared
_USUAL_TAU_S = 120.0  # where the search begins
_LONGEST_S = 3000.0
_MANY = (
    200  # columns; from there on single precision, which is good to 0.01 in the log likelihood of an orthonormal basis
)
_WIDTH = 0.35  # in the logarithm of the ratio: between the points of a parabola
_NARROW = 0.5  # standard deviations
_REFINEMENTS = 3  # where points are cheap
_FLAT = 0.02  # in log likelihood: a parabola that promises less is not followed
_TAU_FACTOR = 4.0  # between the time constants of the search
_MOST_MOVES = 6
_TRUSTED = 0.3  # in log likelihood: how far a parabola may be off before narrower points are taken
_SHARP = 10.0  # second derivative from which on it must be looked at
_HOPELESS_POSTERIOR = -1e12
_HOPELESS = 6.0  # log likelihood by which a white error must be behind to be left alone


@dataclass(frozen=True, eq=False)
class Data:
    """What the likelihood is taken of; n rows, possibly means of several readings."""

    residual_nT: FloatArray
    """(n, 3)."""
    design: FloatArray
    """(n, 3, P), any rank, any units."""
    image_nT: FloatArray
    """(n, 3, 3) of a turn, as from `row_axes.turn_images`."""
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
    along: FloatArray
    """(r,) generalised least-squares coordinates in the basis of the design."""
    dof: int


def span_of_design(
    design: FloatArray, there: BoolArray, first: int = 0, share_left: float = SHARE_LEFT
) -> tuple[Span, FloatArray]:
    """Span and orthonormal basis (n, 3, r) of a design (n, 3, P) on the components that are there (n, 3)."""
    masked = design if there.all() else np.where(there[:, :, None], design, 0.0)
    flat = np.ascontiguousarray(masked).reshape(there.size, design.shape[2])
    span = span_of(flat, first, share_left)
    return span, span.basis(flat).reshape(*there.shape, span.rank)


def least_share(prior: NoisePrior) -> float:
    """Of its energy that a column must have beside others: more than the attitude error that it was made with."""
    return share_of_errors(prior.theta_rad, SHARE_LEFT)


class Likelihood:
    """The restricted likelihood of one set of data, as a function of the noise model."""

    def __init__(
        self,
        data: Data,
        prior: NoisePrior,
        axis_factor: tuple[float, float, float] = (1.0, 1.0, 1.0),
        spanned: tuple[Span, FloatArray] | None = None,
    ) -> None:
        """spanned: of the design on the measured components, as from `span_of_design`, if at hand."""
        self.data, self.prior, self.axis_factor = data, prior, axis_factor
        self.columns = int(data.design.shape[2])
        self.span, basis = spanned or span_of_design(data.design, data.weights > 0, share_left=least_share(prior))
        flat = basis.reshape(data.weights.size, self.span.rank)
        # What the design explains by plain least squares changes nothing but the coordinates.
        y = np.where(data.weights > 0, data.residual_nT, 0.0).reshape(-1)
        self.plain = flat.T @ y
        y = (y - flat @ self.plain).reshape(*data.weights.shape, 1)
        kind = np.float32 if self.span.rank > _MANY else np.float64
        self.stacked = np.concatenate([basis, y], axis=2, dtype=kind, casting="same_kind")
        self.measured = int((data.weights > 0).sum())
        self.field_nT = (
            float(np.sqrt(0.5 * np.mean(np.sum(data.image_nT**2, axis=(1, 2))))) if data.residual_nT.size else 0.0
        )
        self.field_nT = max(self.field_nT, 1.0)
        self._known: dict[tuple[float, float], Choice] = {}

    @property
    def rank(self) -> int:
        """Directions of the design that are fitted."""
        return int(self.stacked.shape[2]) - 1

    @property
    def dof(self) -> int:
        """Degrees of freedom that are left."""
        return self.measured - self.rank

    def at(self, ratio: float, tau_s: float) -> Choice:
        """The best sigma at a ratio (theta times field over sigma) and a time constant."""
        key = (float(f"{ratio:.9g}"), float(f"{tau_s:.9g}"))
        if key not in self._known:
            self._known[key] = self._at(*key)
        return self._known[key]

    def point(self, noise: NoiseModel) -> tuple[float, float]:
        """Ratio and time constant of a noise model, as for `at`."""
        return noise.theta_rad * self.field_nT / noise.sigma_nT, noise.tau_s

    def coefficients(self, choice: Choice) -> FloatArray:
        """(P,) generalised least-squares coefficients of the design's columns at a choice."""
        return self.span.coefficients(self.plain + choice.along, self.columns)

    def _at(self, ratio: float, tau_s: float) -> Choice:
        data, rank = self.data, self.rank
        share = np.sqrt(mean_share(data.count, data.spacing_s, tau_s))
        unit = NoiseModel(1.0, ratio / self.field_nT, tau_s, axis_factor=self.axis_factor)
        whitener = make_whitener(data.image_nT * share[:, None, None], data.seconds, data.segment, unit, data.weights)
        white = whitener.apply_as_it_is(self.stacked).reshape(-1, rank + 1)
        total = float(np.sum(np.square(white[:, rank]), dtype=np.float64))
        along, log_q, rss = np.zeros(rank), 0.0, total
        if rank:
            gram = white.T @ white
            try:
                L = np.linalg.cholesky(gram[:rank, :rank])
            except np.linalg.LinAlgError:  # an attitude error so large that nothing is left of some column
                return Choice(unit, _HOPELESS_POSTERIOR, along, self.dof)
            log_q = 2.0 * float(np.log(np.diag(L)).sum(dtype=np.float64))
            half = solve_triangular(L, gram[:rank, rank], lower=True, check_finite=False)
            along = solve_triangular(L, half, lower=True, trans=1, check_finite=False).astype(np.float64)
            rss -= float(np.sum(np.square(half), dtype=np.float64))
        rss = max(rss, 1e-12 * total, 1e-30)
        log_sigma = self._best_sigma(rss, ratio)
        sigma = float(np.exp(log_sigma))
        fit = -0.5 * (whitener.log_det + log_q + 2.0 * self.dof * log_sigma + rss / sigma**2)
        theta = ratio * sigma / self.field_nT
        noise = NoiseModel(sigma, theta, tau_s, axis_factor=self.axis_factor)
        return Choice(noise, fit + self.prior.log_density(sigma, theta, tau_s), along, self.dof)

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
    """The best point: the likeliest ratio at a few time constants, and a parabola through them; from `start`, if given.

    A saturated design has hundreds of columns and a point costs their Gram matrix, so points are few.
    """
    prior = likelihood.prior
    none = [likelihood.at(0.0, 0.0)] if not prior.theta_rad else []
    if none and prior.theta_rad is not None:
        return _with_uncertainty(likelihood, none[0], np.zeros(2))
    ratio, tau_s = _start(likelihood, start)
    best, curvature = _white(likelihood, ratio) if tau_s <= 0 else Ridge(likelihood, ratio, tau_s).best()
    if prior.tau_s is None and tau_s > 0:
        spacing = _usual_spacing(likelihood.data.seconds)
        guess = likelihood.point(best.noise)[0] * (max(spacing, 1.0) / best.noise.tau_s) ** RIDGE
        if likelihood.at(guess, 0.0).log_posterior > best.log_posterior - _HOPELESS:
            best, curvature = max((best, curvature), _white(likelihood, guess), key=lambda one: one[0].log_posterior)
    if likelihood.rank <= _MANY:
        best, curvature = _refined(likelihood, best, curvature)
    if none and none[0].log_posterior > best.log_posterior:
        best, curvature = none[0], np.zeros(2)
    return _with_uncertainty(likelihood, best, curvature)


def _start(likelihood: Likelihood, start: NoiseModel | None) -> tuple[float, float]:
    prior = likelihood.prior
    if start is not None and start.theta_rad > 0:
        return likelihood.point(start)
    ratio = _UNKNOWN_RATIO if prior.theta_rad is None else prior.theta_rad * likelihood.field_nT / prior.sigma_nT
    return ratio, _USUAL_TAU_S if prior.tau_s is None else prior.tau_s


def _white(likelihood: Likelihood, ratio: float) -> tuple[Choice, FloatArray]:
    best, second = likeliest_ratio(likelihood, ratio, 0.0)
    return best, np.array([second, 0.0])


def _refined(likelihood: Likelihood, best: Choice, curvature: FloatArray) -> tuple[Choice, FloatArray]:
    """Narrower parabolas along log ratio and log tau, in turn; also the second derivatives there."""
    curvature = curvature.copy()
    for _ in range(_REFINEMENTS):
        for axis in (0, 1):
            if axis == 1 and best.noise.tau_s <= 0:
                continue
            by = float(np.clip(_NARROW / np.sqrt(max(-curvature[axis], 1e-6)), _WIDTH / 8.0, 2.0 * _WIDTH))
            low, high = (_moved(likelihood, best, axis, way * by) for way in (-1.0, 1.0))
            bend = (low.log_posterior + high.log_posterior - 2.0 * best.log_posterior) / by**2
            slope = (high.log_posterior - low.log_posterior) / (2.0 * by)
            trials = [best, low, high]
            if bend < 0:
                curvature[axis] = bend
                trials.append(_moved(likelihood, best, axis, float(np.clip(-slope / bend, -3.0 * by, 3.0 * by))))
            best = max(trials, key=_posterior)
    return best, curvature


def _moved(likelihood: Likelihood, best: Choice, axis: int, by: float) -> Choice:
    ratio, tau_s = likelihood.point(best.noise)
    if axis:  # along the ridge
        by = min(by, float(np.log(_LONGEST_S / tau_s)))
        return likelihood.at(float(ratio * np.exp(RIDGE * by)), float(tau_s * np.exp(by)))
    return likelihood.at(float(ratio * np.exp(by)), tau_s)


def likeliest_ratio(likelihood: Likelihood, ratio: float, tau_s: float, second: float = 0.0) -> tuple[Choice, float]:
    """The best ratio at a time constant, from a guess, and the second derivative along its logarithm.

    second: that of a neighbour, if known (negative): two points then do for a parabola that is near its top.
    """
    middle, width = likelihood.at(ratio, tau_s), _WIDTH
    if second < 0:
        by = 0.5 * width
        other = likelihood.at(float(ratio * np.exp(by)), tau_s)
        move = 0.5 * by - (other.log_posterior - middle.log_posterior) / (second * by)
        if abs(move) < 2.0 * width:
            if -0.5 * second * min(move**2, (move - by) ** 2) > _FLAT:
                middle = max(middle, likelihood.at(float(ratio * np.exp(move)), tau_s), key=_posterior)
            return max(middle, other, key=_posterior), second
    for _ in range(_MOST_MOVES):
        ratio = likelihood.point(middle.noise)[0]
        low, high = (likelihood.at(float(ratio * np.exp(by)), tau_s) for by in (-width, width))
        top = max(low, middle, high, key=_posterior)
        if top is middle:
            break
        middle = _climbed(likelihood, top, width) if top is high else top
    slope = (high.log_posterior - low.log_posterior) / (2.0 * width)
    second = (low.log_posterior + high.log_posterior - 2.0 * middle.log_posterior) / width**2
    if second < 0 and -0.5 * slope**2 / second > _FLAT:
        by = float(np.clip(-slope / second, -width, width))
        middle = max(middle, likelihood.at(float(ratio * np.exp(by)), tau_s), key=_posterior)
    return middle, float(second)


def _climbed(likelihood: Likelihood, top: Choice, step: float) -> Choice:
    """Onward to larger ratios, in strides that double for as long as it pays: a start may be far off. Not to smaller
    ones, where there is less and less to see: nothing would lead back."""
    tau_s = top.noise.tau_s
    while True:
        step *= 2.0
        further = likelihood.at(float(likelihood.point(top.noise)[0] * np.exp(step)), tau_s)
        if further.log_posterior <= top.log_posterior + _FLAT:
            return top
        top = further


def _posterior(choice: Choice) -> float:
    return choice.log_posterior


class Ridge:
    """The likelihood along the time constant, each at its likeliest ratio."""

    def __init__(self, likelihood: Likelihood, ratio: float, tau_s: float) -> None:
        self.likelihood = likelihood
        self.shortest_s = 0.25 * _usual_spacing(likelihood.data.seconds)
        best, self.second = likeliest_ratio(likelihood, ratio, tau_s)
        self.known = {float(np.log(tau_s)): best}

    def at(self, log_tau: float) -> Choice:
        """The best at a time constant, from the nearest one that is known and the curvature at the first."""
        log_tau = float(np.clip(log_tau, np.log(self.shortest_s), np.log(_LONGEST_S)))
        if log_tau not in self.known:
            likelihood = self.likelihood
            near = min(self.known, key=lambda other: abs(other - log_tau))
            ratio = likelihood.point(self.known[near].noise)[0] * float(np.exp(RIDGE * (log_tau - near)))
            self.known[log_tau] = likeliest_ratio(likelihood, ratio, float(np.exp(log_tau)), self.second)[0]
        return self.known[log_tau]

    def best(self) -> tuple[Choice, FloatArray]:
        """The best of all, and the second derivatives along the logarithms of ratio and time constant there."""
        middle, width, second = next(iter(self.known)), float(np.log(_TAU_FACTOR)), 0.0
        low, high = np.log(self.shortest_s), np.log(_LONGEST_S)
        for _ in range(_MOST_MOVES):
            below, here, above = (self.at(middle + by).log_posterior for by in (-width, 0.0, width))
            second = (below + above - 2.0 * here) / width**2
            slope = (above - below) / (2.0 * width)
            if max(below, above) > here:
                middle += width if above > below else -width
                if not low < middle < high:
                    break
                continue
            gain = -0.5 * slope**2 / second if second < 0 else 0.0
            if gain < _FLAT and -second < _SHARP:
                break
            top = middle - slope / second
            if abs(self.at(top).log_posterior - here - gain) < _TRUSTED:
                break
            middle, width = max(self.known, key=lambda known: _posterior(self.known[known])), width / 3.0
        return max(self.known.values(), key=_posterior), np.array([self.second, second])


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
