"""The noise of a problem: budget, model, outliers, whitening. The front door of the modules around it.

The budget is what is known before the fit: declared, or estimated from the readings themselves.

The model is chosen by restricted maximum likelihood. With V = sigma**2 W(theta / sigma, tau) and one orthonormal basis Q of
the design, the restricted likelihood (Patterson & Thompson 1971, doi 10.1093/biomet/58.3.545) plus the log prior of the
budget is

    l = -1/2 [log det W + log det Q' W^-1 Q + nu log sigma**2 + RSS / sigma**2] + log prior(sigma, theta, tau).

Q is the same at every point of the search: a basis that moves with the point, or columns that repeat each other,
would tilt the choice.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import NamedTuple

import numpy as np
from scipy.linalg import solve_triangular
from scipy.special import softmax, wrightomega

from fluxtwin.calib.common.robust import MAD_TO_SIGMA
from fluxtwin.gap.linear.projection import SHARE_PICKED, share_of_errors, span_of
from fluxtwin.gap.noise.robust_rows import RobustRows as RobustRows
from fluxtwin.gap.noise.robust_rows import first_weights, spike_weights
from fluxtwin.gap.noise.whitening import NoiseModel as NoiseModel
from fluxtwin.gap.noise.whitening import Whitener as Whitener
from fluxtwin.gap.noise.whitening import make_whitener
from fluxtwin.gap.problem.problem import Budget, Problem, Roll
from fluxtwin.gap.problem.row_axes import RowAxes
from fluxtwin.sim.base.types import BoolArray, FloatArray
from fluxtwin.sim.effects.chain import Active

DECLARED = "declared"
FROM_SPACING = "estimated from the spacing of the readings"
FROM_DIFFERENCES = "estimated from short differences"
NOT_KNOWN = "not known"

NOISE_LOG_SD = 0.1
"""The declared noise is trusted to 10 %: data sheets give two digits."""
USUAL_TAU_S = 100.0
"""Undeclared: from a sensor's own noise, some seconds, to ten minutes of an attitude filter, at 1.3 standard deviations."""
_LEAST_NOISE_nT = 1e-3
"""What a noise-free, unrounded simulation is held to have: the last decimal of a written reading."""
_WIDE, _NARROW = float(np.log(4.0)), 0.1
"""In the logarithms of ratio and time constant: the longest step of the search, and that of differences."""
CLOSE = 1e-3
"""In log likelihood, which is 0.04 standard deviations: no step is taken for less."""
_EVEN = NoiseModel(1.0, 0.0, 0.0)


@dataclass(frozen=True)
class NoisePrior:
    """Normal priors of the logarithms; None where nothing is known."""

    sigma_nT: float
    """White noise of a reading with rounding, 1 sigma per axis."""
    sigma_log_sd: float
    theta_rad: float | None = None
    theta_log_sd: float = 0.4
    """The declared attitude error is trusted to a factor 1.5: requirements are round numbers, and met with margin."""
    tau_s: float | None = None
    """Declared time constant; None leaves it to the data, white included."""
    roll: Roll | None = None
    """Declared; None leaves it to the data."""

    def log_density(self, sigma_nT: float, theta_rad: float, tau_s: float) -> float:
        """Log of the prior at a point, without its constant; a theta or tau of zero has the peak's."""
        total = (np.log(sigma_nT / self.sigma_nT) / self.sigma_log_sd) ** 2
        if self.theta_rad and theta_rad > 0:
            total += (np.log(theta_rad / self.theta_rad) / self.theta_log_sd) ** 2
        # A declared time constant is one number for a spectrum.
        usual_s, log_sd = (USUAL_TAU_S, 1.5) if self.tau_s is None else (self.tau_s, 0.5)
        if tau_s > 0 and usual_s:
            total += (np.log(tau_s / usual_s) / log_sd) ** 2
        return -0.5 * float(total)

    def log_ratio(self, sigma_nT: float, theta_rad: float) -> float:
        """Log of the Bayes factor, at most 0, of noise so far beyond the budget against something unknown that looks like it
        beside noise of the budget: the prior's density there over its mean. Less noise speaks for neither."""
        above = [np.log(sigma_nT / self.sigma_nT) / self.sigma_log_sd]
        if self.theta_rad and theta_rad > 0:
            above.append(np.log(theta_rad / self.theta_rad) / self.theta_log_sd)
        return min(0.0, 0.5 * float(sum(np.log(2.0) - max(one, 0.0) ** 2 for one in above)))


def complete_budget(problem: Problem) -> Budget:
    """The budget of a problem with what was not declared filled in from the readings; `sources` says which.

    The LSB comes from the spacing of the readings, the noise from short differences of the residual along the
    field, where the attitude error does not reach. The attitude error stays None if it was not declared.
    """
    given = problem.budget
    sources = dict(given.sources or {})
    lsb = given.lsb_nT
    if lsb is None:
        lsb = reading_spacing(np.asarray(problem.telemetry.mag_B_nT))
        sources["lsb_nT"] = FROM_SPACING if lsb is not None else NOT_KNOWN
    else:
        sources.setdefault("lsb_nT", DECLARED)
    noise = given.noise_nT
    if noise is None:
        total = short_difference_sigma(problem.residual_nT, problem.field_B_nT, problem.segment)
        noise = float(np.sqrt(max(total**2 - (lsb or 0.0) ** 2 / 12.0, 0.0)))
        sources["noise_nT"] = FROM_DIFFERENCES
    else:
        sources.setdefault("noise_nT", DECLARED)
    for name in ("attitude_sigma_rad", "attitude_tau_s"):
        sources.setdefault(name, NOT_KNOWN if getattr(given, name) is None else DECLARED)
    return replace(given, noise_nT=noise, lsb_nT=lsb, sources=sources)


def prior_of(budget: Budget) -> NoisePrior:
    """The prior that a complete budget stands for."""
    sources = budget.sources or {}
    white = float(np.hypot(budget.noise_nT or 0.0, (budget.lsb_nT or 0.0) / np.sqrt(12.0)))
    guessed = budget.noise_nT is None or sources.get("noise_nT") == FROM_DIFFERENCES
    return NoisePrior(
        sigma_nT=max(white, _LEAST_NOISE_nT),
        sigma_log_sd=0.7 if guessed else NOISE_LOG_SD,  # differences take all fast errors for noise
        theta_rad=budget.attitude_sigma_rad,
        tau_s=budget.attitude_tau_s,
        roll=budget.attitude_roll,
    )


def reading_spacing(mag_B_nT: FloatArray) -> float | None:
    """LSB of readings (N, 3): the step whose multiples they are; None where they are on no grid.

    Readings written with few decimals are on a grid too, but one so fine that it does not matter. A few bit errors
    stay on the grid.
    """
    spacings = [s for axis in np.asarray(mag_B_nT).T if (s := _axis_spacing(axis)) is not None]
    return float(np.median(spacings)) if len(spacings) >= 2 else None


def _axis_spacing(values: FloatArray) -> float | None:
    distinct = np.unique(values[np.isfinite(values)])
    if distinct.size < 4:
        return None
    gaps = np.diff(distinct)
    span = float(distinct[-1] - distinct[0])
    gaps = np.sort(gaps[gaps > 1e-9 * span])
    if gaps.size < 3:
        return None
    step = float(np.median(gaps[gaps < 1.5 * gaps[0]]))
    # Longer and longer lever arms: each refines the step enough to count over the next.
    for reach in (4.5, 20.5, 100.5):
        near = gaps[gaps < reach * step]
        counts = np.rint(near / step)
        step = float((near @ counts) / (counts @ counts))
    off = np.abs(gaps / step - np.rint(gaps / step))
    # On a random axis the fraction is spread over 0 to 0.5; on a grid it is the rounding of the file.
    return step if float(np.mean(off < 0.05)) > 0.97 and float(np.mean(np.rint(gaps / step) > 0)) == 1.0 else None


def short_difference_sigma(residual_nT: FloatArray, field_B_nT: FloatArray, segment: FloatArray) -> float:
    """White noise per axis [nT] from second differences of neighbouring rows, robust against spikes.

    The component along the field is used: an attitude error turns the field and cannot lengthen it.
    """
    along = np.einsum("ti,ti->t", residual_nT, field_B_nT) / np.maximum(np.linalg.norm(field_B_nT, axis=1), 1e-9)
    if along.size < 3:
        return float(np.std(residual_nT)) if residual_nT.size else _LEAST_NOISE_nT
    same = (segment[2:] == segment[:-2]) & np.isfinite(along[2:] + along[:-2])
    second = (along[2:] - 2.0 * along[1:-1] + along[:-2])[same if same.any() else slice(None)] / np.sqrt(6.0)
    middle = MAD_TO_SIGMA * float(np.median(np.abs(second)))
    if middle > 0:
        return middle
    return float(np.sqrt(np.mean(np.square(second)))) or _LEAST_NOISE_nT


@dataclass(frozen=True, eq=False)
class Data:
    """What the likelihood is taken of; N rows."""

    residual_nT: FloatArray
    """(N, 3)."""
    design: FloatArray
    """(N, 3, P), any rank, any units."""
    image_nT: FloatArray
    """(N, 3, 3) of a turn, as from `row_axes.turn_images`."""
    seconds: FloatArray
    segment: FloatArray
    weights: FloatArray
    """(N, 3), 0 not measured."""
    axes: RowAxes | None = None
    """In which the rows are compared, if those are not the body axes; all of the above is in them already."""


@dataclass(frozen=True, eq=False)
class Choice:
    """The best point, and the fit there."""

    noise: NoiseModel
    log_posterior: float
    along: FloatArray
    """(r,) generalised least-squares coordinates in the basis of the design."""


class Likely(NamedTuple):
    """A noise model that data and budget allow; sigma is the best beside its other two numbers."""

    noise: NoiseModel
    probability: float
    cost: float
    """Twice the log of the posterior density that it lacks to the best."""


class Likelihood:
    """The restricted likelihood of one set of data, as a function of the noise model."""

    def __init__(self, data: Data, prior: NoisePrior, like: NoiseModel = _EVEN, walk: float = 0.0) -> None:
        """like: how the axes differ, in noise and in attitude error; walk: rate of a bias that walks, over sigma
        [1/sqrt(s)]."""
        self.data, self.prior, self.like, self.walk = data, prior, like, walk
        there = data.weights > 0
        flat = np.where(there[:, :, None], data.design, 0.0).reshape(there.size, -1)
        # A column must have more of its energy beside others than the attitude error that it was made with.
        self.span = span_of(flat, share_left=share_of_errors(prior.theta_rad, SHARE_PICKED))
        basis = self.span.basis(flat)
        y = np.where(there, data.residual_nT, 0.0).reshape(-1)
        # What the design explains by plain least squares changes nothing but the coordinates.
        self.plain = basis.T @ y
        self.stacked = np.column_stack([basis, y - basis @ self.plain]).reshape(*there.shape, -1)
        self.dof = int(there.sum()) - self.span.rank
        size = np.sum(data.image_nT**2, axis=(1, 2))
        self.field_nT = max(float(np.sqrt(0.5 * np.mean(size))) if size.size else 0.0, 1.0)

    def point(self, noise: NoiseModel) -> tuple[float, float]:
        """Ratio and time constant of a noise model, as for `at`."""
        return noise.theta_rad * self.field_nT / noise.sigma_nT, noise.tau_s

    def whitener(self, noise: NoiseModel, weights: FloatArray, *, covariance: bool = False) -> Whitener:
        """The whitening of a noise model with other weights (N, 3), the walk in it."""
        rows, walk = self.data, self.walk * noise.sigma_nT
        geometry = (rows.image_nT, rows.seconds, rows.segment)
        return make_whitener(*geometry, noise, weights, rows.axes, walk=walk, covariance=covariance)

    def left_nT(self, choice: Choice) -> FloatArray:
        """(N, 3) the residual less its generalised least-squares fit at a choice, also where nothing was measured."""
        design = self.data.design
        fit = design @ self.span.coefficients(self.plain + choice.along, design.shape[2])
        return np.asarray(self.data.residual_nT - fit)

    def at(self, ratio: float, tau_s: float) -> Choice:
        """The best sigma at a ratio (theta times field over sigma) and a time constant."""
        data, rank = self.data, self.span.rank
        unit = replace(self.like, sigma_nT=1.0, theta_rad=ratio / self.field_nT, tau_s=tau_s)
        whitener = self.whitener(unit, data.weights)
        white = whitener.apply_in_row_axes(self.stacked, turned=False).reshape(-1, rank + 1)
        gram = white.T @ white
        try:
            L = np.linalg.cholesky(gram[:rank, :rank])
        except np.linalg.LinAlgError:  # an attitude error so large that nothing is left of some column
            return Choice(unit, -1e12, np.zeros(rank))
        half = solve_triangular(L, gram[:rank, rank], lower=True, check_finite=False)
        along = solve_triangular(L, half, lower=True, trans=1, check_finite=False)
        rss = max(float(gram[rank, rank] - half @ half), 1e-12 * float(gram[rank, rank]), 1e-30)
        log_sigma = self._best_sigma(rss, ratio)
        sigma = float(np.exp(log_sigma))
        log_det = whitener.log_det + 2.0 * float(np.log(np.diag(L)).sum())
        fit = -0.5 * (log_det + 2.0 * self.dof * log_sigma + rss / sigma**2)
        noise = replace(unit, sigma_nT=sigma, theta_rad=ratio * sigma / self.field_nT)
        return Choice(noise, fit + self.prior.log_density(sigma, noise.theta_rad, tau_s), along)

    def _best_sigma(self, rss: float, ratio: float) -> float:
        """log sigma s that maximises the posterior at fixed ratio: the root of rss exp(-2 s) = dof + sum of p (s - s0)
        over the priors, of weight p about s0."""
        prior = self.prior
        weight, pull = prior.sigma_log_sd**-2, prior.sigma_log_sd**-2 * np.log(prior.sigma_nT)
        if ratio > 0 and prior.theta_rad:
            weight += prior.theta_log_sd**-2
            pull += prior.theta_log_sd**-2 * np.log(prior.theta_rad * self.field_nT / ratio)
        shift = (self.dof - pull) / weight
        return float(0.5 * wrightomega(np.log(2.0 * rss / weight) + 2.0 * shift) - shift)


def best_noise(likelihood: Likelihood, start: NoiseModel | None = None) -> Choice:
    """The best point: with a memory, white, or without attitude error, as the budget allows; from `start`, if given."""
    prior = likelihood.prior
    if prior.theta_rad == 0.0:
        return _with_uncertainty(likelihood, likelihood.at(0.0, 0.0), np.zeros((0, 0)))
    ratio, tau_s = 1.0, prior.tau_s or 0.0
    if prior.theta_rad is not None:
        ratio = prior.theta_rad * likelihood.field_nT / prior.sigma_nT
    if start is not None and start.theta_rad > 0:
        ratio, tau_s = likelihood.point(start)
    if not tau_s and prior.tau_s is None:  # an error that was white beside other noise may have a memory all the same
        tries = [likelihood.at(ratio, by * USUAL_TAU_S) for by in (0.25, 1.0, 4.0)]
        tau_s = max(tries, key=lambda one: one.log_posterior).noise.tau_s
    best, hessian = _climbed(likelihood, ratio, tau_s)
    if prior.tau_s is None and tau_s > 0:
        guess = likelihood.point(best.noise)[0]
        if likelihood.at(guess, 0.0).log_posterior > best.log_posterior - 6.0:  # further behind it is left alone
            white = _climbed(likelihood, guess, 0.0)
            best, hessian = max((best, hessian), white, key=lambda one: one[0].log_posterior)
    if prior.theta_rad is None:
        best = max(best, likelihood.at(0.0, 0.0), key=lambda one: one.log_posterior)
    return _with_uncertainty(likelihood, best, hessian)


def noises_about(likelihood: Likelihood, chosen: NoiseModel) -> list[Likely]:
    """Noise models all over what data and budget allow: a lattice about each mode (with a memory, white, without attitude
    error, as the budget allows). Near `chosen` the search for the modes begins."""
    prior = likelihood.prior
    if chosen.theta_rad <= 0:
        return [Likely(chosen, 1.0, 0.0)]
    ratio, tau_s = likelihood.point(chosen)
    memories = [tau_s] if prior.tau_s is not None else [tau_s or USUAL_TAU_S, 0.0]
    modes = [_about(likelihood, *_climbed(likelihood, ratio, memory)) for memory in memories]
    if prior.theta_rad is None:
        modes.append([likelihood.at(0.0, 0.0)])
    heights = [np.array([one.log_posterior for one in mode]) for mode in modes]
    peaks = np.array([each.max() for each in heights])
    found = []
    for mode, height, share in zip(modes, heights, softmax(peaks), strict=True):
        for one, within in zip(mode, softmax(height), strict=True):
            cost = 2.0 * float(peaks.max() - one.log_posterior)
            found.append(Likely(one.noise, float(share * within), cost))
    return found


def _about(likelihood: Likelihood, best: Choice, hessian: FloatArray) -> list[Choice]:
    """A mode and a lattice about it, in standard deviations along the principal axes: as far as a noise model goes that
    takes a barely visible cause up (20 of chi-square), in steps that miss the best of them by half a unit of chi-square."""
    ratio, tau_s = likelihood.point(best.noise)
    free = len(hessian)
    place, (low, high) = np.log([ratio, tau_s or 1.0])[:free], _range(likelihood, free)
    value, vector = np.linalg.eigh(-hessian)
    axes = vector / np.sqrt(np.maximum(value, _WIDE**-2))
    lattice = 1.5 * np.arange(-3, 4)
    steps = np.stack(np.meshgrid(*[lattice] * free), axis=-1).reshape(-1, free)
    reach = np.linalg.norm(steps, axis=1)
    inside = steps[(reach > 0.0) & (reach <= lattice[-1])]
    points = np.exp(np.unique(np.clip(place + inside @ axes.T, low, high), axis=0))
    return [best, *(likelihood.at(float(at[0]), float(at[1]) if free == 2 else 0.0) for at in points)]


def _range(likelihood: Likelihood, free: int) -> tuple[FloatArray, FloatArray]:
    """Lowest and highest logarithm of the ratio, or of ratio and time constant.

    Below the lowest ratio the attitude error does nothing, above the highest there is nothing but it; one with a memory of
    more than half an orbit is a constant turn, which calibrations take up.
    """
    seconds = likelihood.data.seconds
    spacing = float(np.median(np.diff(seconds))) if seconds.size > 1 else 1.0
    return np.log([1e-3, 0.25 * spacing])[:free], np.log([1e6, 3000.0])[:free]


def _climbed(likelihood: Likelihood, ratio: float, tau_s: float) -> tuple[Choice, FloatArray]:
    """The highest point near a start, by Newton's method on differences in the logarithms of ratio and time constant (one
    of 0 stays), and the second derivatives by them (1 or 2 of each)."""
    free = 2 if tau_s else 1
    low, high = _range(likelihood, free)

    def at(place: FloatArray) -> Choice:
        return likelihood.at(float(np.exp(place[0])), float(np.exp(place[1])) if tau_s else 0.0)

    def heights(places: FloatArray) -> FloatArray:
        return np.array([at(place).log_posterior for place in places])

    place = np.clip(np.log([ratio, tau_s][:free]), low, high)
    best, by = at(place), _NARROW * np.eye(free)
    while True:
        here, up, down = best.log_posterior, heights(place + by), heights(place - by)
        slope, bends = (up - down) / (2.0 * _NARROW), (up + down - 2.0 * here) / _NARROW**2
        hessian = np.diag(bends)
        if free == 2:
            twist = at(place + _NARROW).log_posterior - up.sum() + here
            hessian = hessian + twist / _NARROW**2 * (1.0 - np.eye(2))
        value, vector = np.linalg.eigh(-hessian)
        along = vector.T @ slope
        # Newton's step, no longer than wide, and uphill where the surface is hollow.
        move = vector @ (along / np.maximum(value, np.maximum(np.abs(along) / _WIDE, 1e-12)))
        while slope @ move > 2.0 * CLOSE:
            further = np.clip(np.round(place + move, 6), low, high)  # the rest differs between processors
            found = at(further)
            if found.log_posterior > here + CLOSE:
                break
            move = 0.5 * move
        else:
            return best, hessian
        best, place = found, further


def _with_uncertainty(likelihood: Likelihood, best: Choice, hessian: FloatArray) -> Choice:
    """hessian: by the logarithms of ratio and time constant, as many as are free."""
    prior = likelihood.prior
    sigma_sd = float(1.0 / np.sqrt(2.0 * max(likelihood.dof, 0) + prior.sigma_log_sd**-2))
    bends = np.append(np.diag(hessian), [0.0, 0.0])[:2]
    theta_sd, tau_sd = (float(1.0 / np.sqrt(-bend)) if bend < 0 else np.inf for bend in bends)
    noise = replace(
        best.noise,
        sigma_log_sd=sigma_sd,
        theta_log_sd=float(np.hypot(theta_sd, sigma_sd)),
        tau_log_sd=tau_sd,
        sigma_prior_nT=prior.sigma_nT,
    )
    return replace(best, noise=noise)


class NoiseChoice(NamedTuple):
    """The noise model of a problem, and the readings that no model explains."""

    noise: NoiseModel
    robust: RobustRows


def choose_noise(
    problem: Problem, *columns: FloatArray, residual_nT: FloatArray | None = None, walk: float = 0.0
) -> NoiseChoice:
    """The noise model of a problem.

    columns: of the signal beside the problem's nuisance, (N, 3, P) each; residual_nT: (N, 3) about which they are linear, by
    default that of the problem; walk: rate of a bias that walks, over the white noise [1/sqrt(s)]. Restricted maximum
    likelihood with the budget as prior, in turn with the search for spikes.
    """
    residual_nT = problem.residual_nT if residual_nT is None else residual_nT
    return noise_of(problem, residual_nT, [problem.nuisance, *columns], walk)


def noise_of(
    problem: Problem, residual_nT: FloatArray, designs: Sequence[FloatArray], walk: float = 0.0
) -> NoiseChoice:
    """The noise model of a residual (N, 3) with these designs (N, 3, P) fitted, as in `select_noise`; in body axes."""
    where = (problem.noise_image_nT, problem.setting.seconds, problem.segment)
    prior, columns = prior_of(complete_budget(problem)), [problem.in_row_axes(design) for design in designs]
    reading_nT = problem.telemetry.mag_B_nT if problem.axes is None else None
    return select_noise(problem.in_row_axes(residual_nT), columns, *where, prior, problem.axes, walk, reading_nT)


def noise_beside(problem: Problem, active: Sequence[Active]) -> NoiseChoice:
    """The noise model with these effects on, linear about them; the modelled ones, as refitted, are among them."""
    return choose_noise(problem, problem.derivatives(active), residual_nT=problem.residual_of(active))


def likely_noises(
    problem: Problem, whitener: Whitener, residual_nT: FloatArray, columns: FloatArray, walk: float = 0.0
) -> list[Likely]:
    """Noise models all over what a residual (N, 3) with these columns (N, 3, C) fitted and the budget allow.

    whitener: with the noise model that was chosen; walk: as for `choose_noise`.
    """
    noise, prior = whitener.noise, prior_of(complete_budget(problem))
    where = (problem.noise_image_nT, problem.setting.seconds, problem.segment)
    weights = whitener.weights * noise.axis_variance(whitener.axes)
    design = _affordable([problem.in_row_axes(columns)], int((weights > 0).sum()))
    data = Data(problem.in_row_axes(residual_nT), design, *where, weights, problem.axes)
    like = replace(_EVEN, axis_factor=noise.axis_factor, roll=noise.roll)
    return noises_about(Likelihood(data, prior, like, walk), noise)


def whitener_of(problem: Problem, noise: NoiseModel, weights: FloatArray | None) -> Whitener:
    """The whitening of a noise model on a problem's rows; takes columns in body axes."""
    seconds, segment = problem.setting.seconds, problem.segment
    return make_whitener(problem.noise_image_nT, seconds, segment, noise, weights, problem.axes)


def select_noise(
    residual_nT: FloatArray,
    designs: Sequence[FloatArray],
    image_nT: FloatArray,
    seconds: FloatArray,
    segment: FloatArray,
    prior: NoisePrior,
    axes: RowAxes | None = None,
    walk: float = 0.0,
    reading_nT: FloatArray | None = None,
) -> NoiseChoice:
    """`choose_noise` on arrays: residual (N, 3), images of a turn (N, 3, 3), designs (N, 3, P) each (the first is the least
    that is fitted where there are too few rows for all), seconds, segment (N,); axes: those that all this is in,
    if not the body axes; reading_nT: as for `with_clipped`."""
    there = np.ones(residual_nT.shape, dtype=np.bool_) if axes is None else axes.measured
    design = _affordable(designs, int(there.sum()))
    if not image_nT.any():
        prior = replace(prior, theta_rad=0.0)  # nothing that an attitude error could act on
    weights = first_weights(residual_nT, design, there, reading_nT)
    most_nT = prior.sigma_nT * float(np.exp(2.0 * prior.sigma_log_sd))
    like = _EVEN if prior.roll is None else replace(_EVEN, roll=prior.roll)
    whole = np.asarray(there.all(axis=1), dtype=np.bool_)
    choice: Choice | None = None
    difference = residual_nT
    for _ in range(4):  # two settle all but records with many bit errors
        data = Data(residual_nT, design, image_nT, seconds, segment, weights, axes)
        likelihood = Likelihood(data, prior, like, walk)
        choice = best_noise(likelihood, None if choice is None else choice.noise)
        left = likelihood.left_nT(choice)
        filtered = likelihood.whitener(choice.noise, weights, covariance=True)
        again, difference = spike_weights(left, filtered, there, most_nT, reading_nT)
        whitener = likelihood.whitener(choice.noise, again)
        uneven = replace(like, axis_factor=_axis_factor(whitener, left, like.axis_factor, whole))
        if uneven != like and like == _EVEN and prior.roll is None and prior.theta_rad != 0.0:
            uneven = _likelier(likelihood, choice.noise, uneven, _rolls(left[whole], image_nT[whole]))
        settled = np.array_equal(again <= 0, weights <= 0) and uneven == like
        weights, like = again, uneven
        if settled:
            break
    assert choice is not None
    return NoiseChoice(choice.noise, RobustRows(weights, difference, None if axes is None else there))


def _affordable(designs: Sequence[FloatArray], components: int) -> FloatArray:
    """All designs, or the first alone, or none, so that degrees of freedom are left."""
    for used in (designs, designs[:1]):
        if components >= 1.5 * sum(d.shape[2] for d in used) + 6:
            return np.concatenate(list(used), axis=2)
    return designs[0][:, :, :0]


def _axis_factor(
    whitener: Whitener, left_nT: FloatArray, now: tuple[float, float, float], whole: BoolArray
) -> tuple[float, float, float]:
    """White noise of each axis over the mean, from differences of neighbouring innovations: slow structure is none
    of its business. whole: rows in body axes. Unchanged where the axes agree, within chance or within a quarter, which costs
    at most 5 % (Kantorovich's bound)."""
    white, weights = whitener.apply_in_row_axes(left_nT)[whole], whitener.weights[whole]
    step = np.where((weights[1:] > 0) & (weights[:-1] > 0), np.diff(white, axis=0), np.nan)
    count = np.isfinite(step).sum(axis=0)
    if count.min() < 20:
        return now
    size = np.sqrt(np.nanmean(np.square(step), axis=0))
    bar = max(1.25, 1.0 + 4.0 * np.sqrt(1.5 / count.min()))
    if size.max() <= bar * size.min():
        return now
    factor = np.asarray(now) * size
    factor = factor / np.exp(np.mean(np.log(factor)))
    return (float(factor[0]), float(factor[1]), float(factor[2]))


def _likelier(likelihood: Likelihood, start: NoiseModel, uneven: NoiseModel, rolls: Sequence[Roll]) -> NoiseModel:
    """Of axes that differ in noise and an attitude error that is larger about one axis, what the data have rather: both are
    known by their scatter alone, but the error leaves alone what lies along the field, and that axis."""
    trials = [uneven, *(replace(_EVEN, roll=roll) for roll in rolls)]
    chosen = [best_noise(Likelihood(likelihood.data, likelihood.prior, one, likelihood.walk), start) for one in trials]
    # An axis and a factor are one number more than two ratios of the noise.
    lead = [one.log_posterior - 0.5 * np.log(likelihood.dof) * (place > 0) for place, one in enumerate(chosen)]
    return trials[int(np.argmax(lead))]


def _rolls(left_nT: FloatArray, image_nT: FloatArray) -> list[Roll]:
    """The likeliest axis of white turns, beside white noise, in residuals (N, 3) with images (N, 3, 3) of a turn, with the
    factors that are tried: star trackers of fields of 8 to 20 deg know the roll 6 to 16 times worse (Liebe 2002)."""
    # Of each pair of opposite directions one, 18 deg or less from any other direction.
    axes = [np.array(one) / np.linalg.norm(one) for one in product(range(-2, 3), repeat=3) if one > (0, 0, 0)]
    energy, best = float(np.sum(left_nT**2)), (-np.inf, axes[0])
    size = float(np.mean(np.sum(image_nT**2, axis=(1, 2)))) / 2.0
    for axis in axes:
        turned = image_nT @ axis
        along, reach = np.sum(left_nT * turned, axis=1) ** 2, np.sum(turned**2, axis=1)
        for share in np.geomspace(0.1, 100.0, 13) / max(size, 1e-9):
            variance = (energy - np.sum(share * along / (1.0 + share * reach))) / left_nT.size
            log = -left_nT.size * np.log(variance) - np.sum(np.log1p(share * reach))
            best = max(best, (float(log), axis), key=lambda one: one[0])
    axis = (float(best[1][0]), float(best[1][1]), float(best[1][2]))
    return [Roll(axis, factor) for factor in (3.0, 10.0)]
