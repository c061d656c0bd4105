"""The errors of a fit against a reference attitude: white noise, an error of the attitude, slow errors of the field.

    r(t) = U(t) theta(t) + h(t) + white,     U theta = theta x B0 seen from the side that is fitted

theta (3 axes of the body) and h (3 components) are first-order Gauss-Markov processes, sigma and tau each; theta may
have a white part besides. What an attitude error puts into a component is in step with the field in the others, and so
with the regressors: S13 - S31 and its like see the mean of theta, which a homogeneous error of the reading has not.

None of the sizes is known. They are weighed by the restricted likelihood (Patterson & Thompson 1971, Biometrika 58,
545), which allows for what was fitted, on cells of a few hundred. Priors are flat in the logarithms of the sizes:
sigma_theta from 1e-7 rad to 6 deg, h likewise; or about what was declared. What the attitude's error does in the mean of
the record, which is a misalignment to these data, goes with its time constant, and a record of few time constants hardly
determines that. Its prior is therefore the reference prior, the root of the information that such a record has of sigma,
tau and white noise beside what is fitted (Berger, De Oliveira & Sanso 2001, J. Am. Stat. Assoc. 96, 1361), with which
intervals cover about as often as they say whatever is true. It is taken at the sigma that would explain the whole
residual, and so does not depend on how much of the error the fit calls slow. That of h is flat up to the longest
unbroken stretch.

The posterior is sampled by an adaptive Metropolis chain (Haario, Saksman & Tamminen 2001, Bernoulli 7, 223) with a fixed
seed; covariances are means over it, so that they widen where the record does not separate sigma and tau.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from scipy.linalg import block_diag, null_space

from fluxtwin.sim.base.types import FloatArray

FOUND, DECLARED = "found in the data", "declared"
_SIZES_RAD = (1e-7, 0.1)
_LOG_SD = 0.4  # a declared attitude error is trusted to a factor 1.5
_TAU_LOG_SD = 0.5
_SPARE = 8  # degrees of freedom that must remain
_QUIETER = np.log(1000.0)  # white noise may be so much less than the residual
_TRIED, _SEARCH = 4, 8  # rounds of the coordinate search from each start, and from the best of what they reach
_BETTER = 1e-6  # in the log: less is rounding, which a coordinate that changes nothing must not follow
_APART = 4.0  # cells that slow errors last at least: shorter ones are white noise to these data
_BEYOND = 10.0  # longest time constant of the attitude over the longest stretch; 50 changes pulls by 2 %
_INFORMED = 48  # cells and
_INFORMED_TAUS = 10  # time constants that the reference prior is worked out on
_STATES, _NEAR_TAUS, _FAR_TAUS, _EACH = 40, 9, 5, 20  # of the chain, and of the time constants at each
_BURN, _KEPT = 160, 480  # steps in which the chain finds the width of its proposals, and those that count
_LOCAL, _NUDGED, _NUDGE = (
    0.55,
    0.25,
    0.7,
)  # shares of the proposals, the rest draw one coordinate anew; width of a nudge
_ACCEPTED = 0.35  # aimed at (Gelman, Roberts & Gilks 1996: 0.35 in two dimensions)
_SIZES, _TAUS = [0, 2, 3], [1, 4]  # places in the five
_NODES = 14  # time constants of the table


@dataclass(frozen=True)
class ErrorModel:
    """What a fit was taken to err by; the sizes are medians of the posterior."""

    white_nT: FloatArray
    """(3,) white noise of a reading as the covariance takes it, 1 sigma, rounding included."""
    white_source: str
    """`declared` or `found in the data`."""
    expected_rms_nT: float
    """rms of a component of the residuals (of |B| without attitude) from white noise and attitude error alone."""
    attitude_sigma_deg: float | None = None
    """Error of the reference attitude, 1 sigma per body axis; None where none is looked at."""
    attitude_tau_s: float | None = None
    """Its time constant; 0: white."""
    attitude_source: str = ""
    attitude_range_deg: tuple[float, float] | None = None
    """90 % interval of the sigma."""
    slow_nT: float = 0.0
    """rms of a component of slow errors that are neither (field model, drift); 0: none seen."""
    slow_tau_s: float = 0.0
    passes: float | None = None
    """Passes of the record, where they are too few to show errors that last an orbit, which then no sigma includes."""
    misfit: float = 1.0
    """Scatter of the estimating equations from block to block over what the model gives, a ratio of variances."""

    def to_dict(self) -> dict[str, Any]:
        """Plain numbers and text for JSON."""
        plain = {name: getattr(self, name) for name in self.__dataclass_fields__}
        return plain | {"white_nT": self.white_nT.tolist()}


def white_errors(variance_nT2: FloatArray, *, declared: bool) -> ErrorModel:
    """Where only noise of the reading is looked at; its variance (3,)."""
    white_nT = np.sqrt(variance_nT2)
    return ErrorModel(white_nT, DECLARED if declared else FOUND, float(np.sqrt((white_nT**2).mean())))


class LikelihoodCells(NamedTuple):
    """What the likelihood is taken of: K cells."""

    seconds: FloatArray
    residual_nT: FloatArray
    """(K, 3)."""
    design: FloatArray
    """(K, m+1) regressors and a one, free of errors as far as may be: see `estimating_equations.evidence`."""
    image_nT: FloatArray
    """(K, 3, 3) U."""
    white: FloatArray
    """(3, 3) covariance of the white noise of a row up to a factor."""
    effective: FloatArray
    """(K,) rows in a cell."""
    length_s: FloatArray
    """(K,) how long each cell is; 0 where it is one row."""
    longest_s: float
    """Longest unbroken stretch."""


class Posterior(NamedTuple):
    """Samples of the sizes."""

    sigma_nT: FloatArray
    """(n,) factor on the root of `LikelihoodCells.white`."""
    theta_rad: FloatArray
    tau_s: FloatArray
    white_theta_rad: FloatArray
    """White from row to row."""
    slow_nT: FloatArray
    slow_tau_s: FloatArray

    @property
    def nodes_s(self) -> FloatArray:
        """Time constants at which covariances are worked out."""
        every = np.concatenate([self.tau_s, self.slow_tau_s])
        return np.geomspace(every.min(), max(float(every.max()), 1.001 * float(every.min())), _NODES)

    def memory_s(self, field_nT: float) -> float:
        """Mean time constant of what is correlated, by power; field_nT: what a rad of attitude error gives."""
        theta, slow = (self.theta_rad * field_nT) ** 2, self.slow_nT**2
        return float(theta @ self.tau_s + slow @ self.slow_tau_s) / max(float((theta + slow).sum()), 1e-300)

    def constant_rad2(self, covered_s: float) -> float:
        """Mean square, an axis, of the attitude error's mean over a time."""
        x = np.maximum(covered_s / self.tau_s, 1e-6)
        return float((self.theta_rad**2 * np.where(x < 1e-3, 1.0, 2.0 * (x - 1.0 + np.exp(-x)) / x**2)).mean())

    def on_nodes(self, power: FloatArray, tau_s: FloatArray) -> FloatArray:
        """(_NODES,) mean power at each node: linear in the logarithm of tau between them."""
        at = np.log(self.nodes_s)
        place = np.clip((np.log(tau_s) - at[0]) / (at[1] - at[0]), 0.0, _NODES - 1.0)
        low = np.minimum(place.astype(int), _NODES - 2)
        share = place - low
        total = np.bincount(low, power * (1.0 - share), _NODES) + np.bincount(low + 1, power * share, _NODES)
        return np.asarray(total / power.size)


class _Likelihood:
    """Log posterior of (theta/sqrt(tau), tau, white theta, slow/sqrt(slow tau), slow tau): their logarithms p (5,), all but
    the taus over the factor of the white noise. What a process does in a short time, sigma^2/tau, is well known where
    sigma and tau are not."""

    def __init__(self, of: LikelihoodCells, sigma_deg: float | None, tau_s: float | None) -> None:
        self.of = of
        design = of.design
        K, width = design.shape
        scale = np.maximum(np.sqrt((design**2).mean(axis=0)), 1e-300)
        columns = np.zeros((K, 3, 3 * width + 1))
        for i in range(3):
            columns[:, i, i * width : (i + 1) * width] = design / scale
        columns[:, :, -1] = of.residual_nT
        step = np.diff(of.seconds)
        gap = np.concatenate([[0.0], np.maximum(step - 0.5 * (of.length_s[1:] + of.length_s[:-1]), 0.0)])
        self.field = float(np.sqrt((of.image_nT**2).sum() / (2.0 * K)))  # |U|^2 = 2 |B0|^2
        shortest = float(np.median(step))
        longest = max(of.longest_s, 2.0 * shortest)
        taus = np.log(
            [min(shortest, 0.1 * tau_s), max(longest, 10.0 * tau_s)] if tau_s else [shortest, _BEYOND * longest]
        )
        sizes = np.log(_SIZES_RAD)
        self.low = np.array(
            [sizes[0], taus[0], sizes[0], sizes[0] + np.log(self.field), np.log(min(_APART * shortest, 0.5 * longest))]
        )
        self.high = np.array([sizes[1], taus[1], sizes[1], sizes[1] + np.log(self.field), np.log(longest)])
        self.log_sigma = None if sigma_deg is None else np.log(np.radians(sigma_deg))
        self.log_tau = np.log(tau_s) if tau_s else None
        self.white = tau_s == 0.0
        self.prior: tuple[FloatArray, FloatArray] | None = None
        self.cells = (
            columns,
            np.ascontiguousarray(of.image_nT),
            of.white[None] / of.effective[:, None, None],
            np.einsum("kij,klj->kil", of.image_nT, of.image_nT) / of.effective[:, None, None],
            gap,
            np.ascontiguousarray(of.length_s),
        )
        self.freedom = 3 * (K - width)
        # The sizes are over the factor of the white noise, of which a residual that is all white is the most there is.
        self.rms_nT = float(np.sqrt((of.residual_nT**2).sum() / (3.0 * K)))
        most = np.sqrt(of.effective @ (of.residual_nT**2).sum(axis=1))
        most = np.log(most / np.sqrt(K * np.trace(of.white)))
        self.low[_SIZES] -= most
        self.high[_SIZES] += _QUIETER - most
        self.lowest, self.highest = self.low.tolist(), self.high.tolist()
        self.root_freedom = np.sqrt(self.freedom)
        self.gram = np.empty((columns.shape[2],) * 2)

    def __call__(self, p: FloatArray) -> tuple[float, float]:
        """Its value at p, and the factor of the white noise."""
        from fluxtwin.calib.common.error_kernels import whitened_gram

        size = _sizes(p)
        # A few numbers as numbers of Python: this is asked some thousand times a fit, and arrays of five take longer.
        if not all(low <= one <= high for low, one, high in zip(self.lowest, size.tolist(), self.highest, strict=True)):
            return -np.inf, 1.0
        theta, *others = np.exp(size).tolist()
        value = -0.5 * whitened_gram(*self.cells, (0.0 if self.white else theta, *others), self.gram)
        try:
            root = np.linalg.cholesky(self.gram).diagonal()  # the last: of the weighted sum of squares left
        except np.linalg.LinAlgError:
            return -np.inf, 1.0
        factor = float(root[-1] / self.root_freedom)
        log_factor = np.log(factor)
        value -= float(np.log(root[:-1]).sum()) + self.freedom * log_factor
        if self.log_sigma is not None:
            apart, white = size[0] + log_factor, size[2] + log_factor
            both = white if self.white else 0.5 * np.logaddexp(2.0 * apart, 2.0 * white)
            value -= 0.5 * ((both - self.log_sigma) / _LOG_SD) ** 2
        if self.log_tau is not None:
            value -= 0.5 * ((p[1] - self.log_tau) / _TAU_LOG_SD) ** 2
        if self.prior is not None:
            value += float(np.interp(p[1], *self.prior))
        return value, factor

    def chain(self, p: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(n, 5) samples and (n,) factors of the white noise, from p on, by an adaptive Metropolis chain.

        The attitude's sigma and tau are moved together, the others apart, or one size or time constant is drawn anew.
        """
        if self.log_tau is None and not self.white:
            self.prior = self._reference_prior(self(p)[1])
        n = _BURN + _KEPT
        rng = np.random.default_rng(0)  # the same record, the same answer
        kind, step, coordinate = rng.uniform(size=n), rng.normal(size=(n, 3)), rng.integers(5, size=n)
        place, accept = rng.uniform(size=n), rng.uniform(size=n)
        points, factors = np.empty((n + 1, 5)), np.empty(n + 1)
        value, factor = self(p)
        points[0], factors[0] = p, factor
        scale = 1.0
        root: FloatArray = 0.2 * np.eye(2)
        for k in range(n):
            tried, local = points[k].copy(), kind[k] < _LOCAL
            if local:
                tried[:2] += scale * root @ step[k, :2]
            elif kind[k] < _LOCAL + _NUDGED:
                tried[2:] += _NUDGE * step[k]
            else:
                size, at = _sizes(points[k]), coordinate[k]
                size[at] = self.low[at] + place[k] * (self.high[at] - self.low[at])
                if at in _TAUS:  # what the process does in a short time stays
                    tried[at] = size[at]
                else:
                    tried = _sizes(size, back=True)
            then, new = self(tried)
            taken = bool(np.log(accept[k]) < then - value)
            if taken:
                value, factor = then, new
            points[k + 1], factors[k + 1] = tried if taken else points[k], factor
            if k < _BURN and local:
                scale *= np.exp((taken - _ACCEPTED) / np.sqrt(1.0 + k / 10.0))
            if k < _BURN and k % 40 == 39:
                spread = np.cov(points[(k + 2) // 2 : k + 2, :2].T) + 1e-4 * np.eye(2)
                root = np.asarray(np.linalg.cholesky(spread), dtype=np.float64)
        return points[_BURN + 1 :], factors[_BURN + 1 :]

    def spread(self, points: FloatArray, chain: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(n, 5) samples and (n,) factors like those of a chain, the attitude's tau integrated over.

        A chain rarely visits the long time constants that the record hardly excludes, and misses their part of the
        covariance (Rao-Blackwell). At a state, what the error does in a short time is kept. chain: (n,) the factors of the
        points.
        """
        from scipy.interpolate import PchipInterpolator

        states = points[:: max(1, len(points) // _STATES)]
        middle, sd = float(points[:, 1].mean()), max(float(points[:, 1].std()), 0.05)
        first, edge, last = max(self.low[1], middle - 3.0 * sd), middle + 3.0 * sd, self.high[1]
        nodes = np.linspace(first, min(edge, last), _NEAR_TAUS)
        if edge < last:
            nodes = np.concatenate([nodes, np.linspace(edge, last, _FAR_TAUS + 1)[1:]])
        fine = np.linspace(first, last, 400)
        out, factors = [], []
        for state in states:
            tried = np.tile(state, (len(nodes), 1))
            tried[:, 1] = nodes
            found = np.array([self(one) for one in tried])
            inside = np.isfinite(found[:, 0])
            if inside.sum() < 2:
                continue
            log = PchipInterpolator(nodes[inside], found[inside, 0])(np.clip(fine, *nodes[inside][[0, -1]]))
            share = np.cumsum(np.exp(log - log.max()))
            tau = fine[np.searchsorted(share, (np.arange(_EACH) + 0.5) / _EACH * share[-1])]
            out.append(np.tile(state, (_EACH, 1)))
            out[-1][:, 1] = tau
            factors.append(np.interp(tau, nodes[inside], found[inside, 1]))
        return (np.concatenate(out), np.concatenate(factors)) if out else (points, chain)

    def _reference_prior(self, factor: float) -> tuple[FloatArray, FloatArray]:
        """(n,) logarithms of tau and of the root of the determinant of the information about sigma, tau and the white
        noise that is left when the fit and a constant attitude have taken their part.

        sigma is that of an attitude error that would explain the whole residual: the information about one that hardly
        shows is greatest for time constants near the length of the record, which is no reason to expect them. Few cells
        suffice: a long tau, which they are for, acts on all of them.
        """
        of = self.of
        every = -(-len(of.seconds) // _INFORMED)
        cells = slice(None, None, every)
        seconds, image, columns = of.seconds[cells], of.image_nT[cells], self.cells[0][cells, :, :-1]
        size = 3 * len(seconds)
        taken = np.hstack([columns.reshape(size, -1), image.reshape(size, 3)])
        left = null_space((taken / np.linalg.norm(taken, axis=0)).T, rcond=1e-4)
        apart = np.abs(seconds[:, None] - seconds)
        sigma2 = 1.5 * (self.rms_nT / self.field) ** 2  # of the three components, two are across the field
        both = sigma2 * np.einsum("kin,ljn->kilj", image, image)
        white = left.T @ block_diag(*(self.cells[2][cells] * factor**2 / every)) @ left
        logs, values = np.linspace(self.low[1], self.high[1], _INFORMED_TAUS), []
        for tau in np.exp(logs):
            x = apart / tau
            turned, slower = (  # less a constant, which is taken
                left.T @ (both * part[:, None, :, None]).reshape(size, size) @ left
                for part in (np.expm1(-x), x * np.exp(-x))
            )
            powers, vectors = np.linalg.eigh(white + turned)
            # Without noise it has full rank, and no value below zero, only to rounding.
            whitens = vectors / np.sqrt(np.maximum(powers, 1e-9 * powers.mean()))
            rates = [whitens.T @ one @ whitens for one in (turned, slower, white)]
            information = np.einsum("aij,bij->ab", rates, rates)
            values.append(0.5 * np.linalg.slogdet(information)[1])
        return logs, np.array(values)

    def starts(self) -> list[FloatArray]:
        """An error of the attitude, slow or white; a slow error of the field; none of them."""
        size = float(np.clip(np.log(self.rms_nT / self.field), self.low[0] + 0.5, self.high[0] - 1.0))
        tau, slow_tau = 0.5 * (self.low[1] + self.high[1]), 0.5 * (self.low[4] + self.high[4])
        least, slow = self.low[0] + 1.0, self.low[3] + 1.0
        points = [
            [size, tau, least, slow, slow_tau],
            [least, tau, size, slow, slow_tau],
            [least, tau, least, size + np.log(self.field), slow_tau],
            [least, tau, least, slow, slow_tau],
        ]
        return [np.array(point) - 0.5 * np.array([tau, 0.0, 0.0, slow_tau, 0.0]) for point in points]


def _sizes(p: FloatArray, *, back: bool = False) -> FloatArray:
    """Logarithms of (theta, tau, white theta, slow, slow tau) from p (..., 5), or back from there."""
    out, half = np.array(p), -0.5 if back else 0.5
    out[..., 0] += half * p[..., 1]
    out[..., 3] += half * p[..., 4]
    return out


def find_errors(of: LikelihoodCells, sigma_deg: float | None = None, tau_s: float | None = None) -> Posterior | None:
    """Sample the sizes; None where there are too few rows, or the residual is zero.

    sigma_deg, tau_s: error of the attitude as declared, tau 0 for white; None leaves it to the data.
    """
    width = of.design.shape[1]
    if len(of.seconds) - width < _SPARE or not (of.residual_nT**2).sum() > 0 or not (of.image_nT**2).sum() > 0:
        return None
    likelihood = _Likelihood(of, sigma_deg, tau_s)
    # A point near the maximum: the best that is reached from several starts, one coordinate after the other.
    found = [_climb_from(likelihood, p, _TRIED) for p in likelihood.starts()]
    best = max(one[0] for one in found)
    value, p = _climb_from(likelihood, next(p for value, p in found if value >= best - _BETTER), _SEARCH)
    if not np.isfinite(value):
        return None
    samples, factor = likelihood.chain(p)
    if likelihood.prior is not None:
        samples, factor = likelihood.spread(samples, factor)
    size = np.exp(_sizes(samples))
    theta = np.zeros_like(factor) if tau_s == 0.0 else factor * size[:, 0]
    return Posterior(factor, theta, size[:, 1], factor * size[:, 2], factor * size[:, 3], size[:, 4])


def _climb_from(likelihood: _Likelihood, p: FloatArray, rounds: int) -> tuple[float, FloatArray]:
    value = likelihood(p)[0]
    reach = np.full(5, 1.0)
    for _ in range(rounds):
        for k in range(5):
            for sign in (1.0, -1.0):
                tried = p.copy()
                tried[k] += sign * reach[k]
                then = likelihood(tried)[0]
                if then > value + _BETTER:
                    value, p = then, tried
                    reach[k] *= 1.5
                    break
            else:
                reach[k] *= 0.5
    return value, p
