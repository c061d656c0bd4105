"""The covariance that a linear calibration states, in the order of the calibration file, and how it was found.

`white`: see `covariance`. `blocks`: errors are correlated in time. What errors can be is fitted to the residual
(`error_model`: white noise, an error theta x B0 of the reference attitude, slow errors of the field), and carried through
the estimator that was used, (X'X)^-1 X' V X (X'X)^-1, averaged over what the residual leaves possible. The estimator
stays least squares: it is right whatever V is, where one weighted by V would lean on the component along the field,
which an attitude error spares and an error of the field model does not. Blocks then test the model: scores of blocks are
compared with what it gives them, blocks growing from a 192nd to an eighth of the record until their scatter grows no
more, and the covariance follows them as far as they are many (`shrinkage`). It is never singular.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from fluxtwin.calib.common.conventions import forward_jacobian
from fluxtwin.calib.common.covariance import (
    FEWEST_BLOCKS,
    batch_widening,
    bread_of,
    cells,
    groupings,
    kernel_moments,
    observed_s,
    plain_covariance,
    sandwich_covariance,
    segments,
    uncentred,
)
from fluxtwin.calib.common.digits import plain
from fluxtwin.calib.common.error_model import DECLARED, FOUND, ErrorModel, Posterior, find_errors
from fluxtwin.calib.common.records import seconds_of
from fluxtwin.calib.common.shrinkage import grown, half_of, in_units_of
from fluxtwin.calib.linear.estimating_equations import (
    LinearProblem,
    Solution,
    Spread,
    evidence,
    of_blocks,
    spread_of,
    sums,
    turned_rad2,
    white_of,
)
from fluxtwin.sim.base.types import FloatArray

_SANDWICH_ROWS = 10  # a parameter of one axis
_TOO_SMALL = 1.2  # by so much may white sigmas be too small before it is said
_LONG_MEMORY = 0.05  # of a pass


@dataclass(frozen=True)
class CovarianceReport:
    """What the calibration says of its own errors."""

    covariance: FloatArray
    """(P, P) in the order of the calibration file."""
    driver_covariance: FloatArray
    """(3J, 3J) of the fields that follow columns, x, y, z of each."""
    messages: tuple[str, ...]
    """How it was found."""
    errors: ErrorModel | None = None
    """What the errors were taken for; None for white ones."""


def report_covariance(problem: LinearProblem, solution: Solution, passes: np.ndarray | None) -> CovarianceReport:
    """White or allowing for correlation, plus what the noise of the reading and a declared field error add."""
    messages = []
    segment = segments(problem.design.time)
    errors = None
    if problem.options.covariance == "blocks":
        stacked, words, memory_s, errors = _correlated(problem, solution, passes)
        few = _too_few_passes(problem, segment, memory_s, passes)
        errors = None if errors is None else replace(errors, passes=few)
        messages.append(f"covariance: {words}")
    else:
        stacked = _white(problem, solution)
        factor = float(np.sqrt(batch_widening(solution.residual_nT, segment)))
        if factor > _TOO_SMALL:
            messages.append(
                f"the residuals are correlated in time: white sigmas are too small, by up to {factor:.1f}; "
                "covariance blocks (--covariance blocks) allows for it"
            )
    stacked = stacked + _from_noise_uncertainty(problem, solution) + _from_field_error(problem, solution)
    if problem.options.field_error_nT:
        messages.append(
            f"field model taken as wrong by {problem.options.field_error_nT:.4g} nT rms per axis, correlated over "
            f"{problem.design.radian_s:.0f} s, a radian of the orbit"
        )
    whole = _in_file_order(problem, solution, stacked)
    size = 21 if "T" in problem.options.parameters else 12
    return CovarianceReport(whole[:size, :size], whole[21:, 21:], tuple(messages), errors)


def _correlated(
    problem: LinearProblem, solution: Solution, passes: np.ndarray | None
) -> tuple[FloatArray, str, float, ErrorModel | None]:
    """Stacked covariance by the model of the errors, as far as blocks confirm it, and in words; how long errors last [s]."""
    options = problem.options
    posterior = find_errors(
        evidence(problem, solution, problem.weights > 0), options.attitude_sigma_deg, options.attitude_tau_s
    )
    if posterior is None:
        return _white(problem, solution), "too few rows to see correlation: white", 0.0, None
    label = segments(problem.design.time)
    if passes is not None or options.block_s is not None:
        label = next(groupings(problem.design.time, label, passes, options.block_s))[0]
    added = sums(problem, solution, label)
    shared = np.pad(solution.M @ problem.noise_xx, ((0, 0), (0, 1)))
    spread = spread_of(added, posterior, white_of(problem, solution), shared)
    memory_s = posterior.memory_s(_field_nT(problem))
    total, misfit, words = _checked(problem, spread, label, memory_s, passes)
    whole = np.kron(np.eye(3), bread_of(solution.fit, problem.noise_xx))
    stacked = uncentred(whole @ total @ whole.T, solution.fit.mean_x)
    covered_s = observed_s(problem.design.time, segments(problem.design.time))
    if problem.fits_S:
        stacked = stacked + _from_turning(solution, posterior.constant_rad2(covered_s))
    errors = _error_model(problem, solution, posterior, misfit)
    return stacked, f"{_error_words(errors)}; {words}", memory_s, errors


def _checked(
    problem: LinearProblem, spread: Spread, label: np.ndarray, memory_s: float, passes: np.ndarray | None
) -> tuple[FloatArray, float, str]:
    """The covariance of the scores as blocks confirm it, `ErrorModel.misfit`, and how it was found: the blocks are grown
    until their scatter grows no more."""
    first = spread.sums.first
    asked = problem.options.block_s
    up = half_of(spread.total)
    # one a parameter of an axis: fewer are hardly free of the fit
    fewest = max(FEWEST_BLOCKS, len(problem.noise_xx) + 1)

    def scatter() -> Iterator[tuple[FloatArray, str]]:
        covered_s = observed_s(problem.design.time, segments(problem.design.time))
        for of_row, words in groupings(problem.design.time, label, passes, asked):
            block, count = of_row[first], int(of_row.max()) + 1
            cut = passes is None and asked is None and not np.array_equal(of_row, label)
            if count >= fewest and not (cut and covered_s / count < 2.0 * memory_s):
                yield in_units_of(up, *of_blocks(spread, block, count)), f"{count} blocks ({words})"

    found = grown(scatter())
    if found is None:
        words = f"too few blocks of the record (fewer than {fewest}) to compare it with their scatter"
        return spread.total, 1.0, words
    W, misfit, words = found
    if 0.8 < misfit < 1.25:
        words += ", whose scatter agrees with it"
    else:
        words = f"variances multiplied by {misfit:.2g} on average, to agree with the scatter of {words}"
    return up @ W @ up.T, misfit, words


def _field_nT(problem: LinearProblem) -> float:
    return float(np.sqrt((problem.design.H_nT**2).sum(axis=1).mean() * 2.0 / 3.0))


def _error_model(problem: LinearProblem, solution: Solution, posterior: Posterior, misfit: float) -> ErrorModel:
    """In the words of a reader."""
    options = problem.options
    sigma = float(np.median(posterior.sigma_nT))
    white, brief_s = _of_rows(problem, solution, posterior)
    attitude = np.hypot(posterior.theta_rad, white)
    lasts = float(np.mean(posterior.theta_rad**2 / np.maximum(attitude**2, 1e-300)))
    tau_s = float(np.median(posterior.tau_s))
    if brief_s > 0.0:  # of one error the cells may see the longer part and the shorter one
        tau_s = lasts * tau_s + (1.0 - lasts) * brief_s
    declared = options.attitude_sigma_deg is not None
    low, high = np.degrees(np.quantile(attitude, [0.05, 0.95]))
    variance = np.diag(white_of(problem, solution))  # of the readings alone: sigma also takes what is not modelled
    middle = float(np.median(attitude))
    across = middle * _field_nT(problem)
    reading = problem.noise.variance_nT2 * sigma**2
    return ErrorModel(
        white_nT=np.sqrt(reading),
        white_source=DECLARED if options.noise_nT is not None else FOUND,
        expected_rms_nT=float(np.sqrt(variance.mean() + across**2)),
        attitude_sigma_deg=float(np.degrees(middle)),
        attitude_tau_s=tau_s if brief_s > 0.0 or lasts > 0.5 else 0.0,
        attitude_source=DECLARED if declared else FOUND,
        attitude_range_deg=(float(low), float(high)),
        slow_nT=float(np.median(posterior.slow_nT)),
        slow_tau_s=float(np.median(posterior.slow_tau_s)),
        misfit=misfit,
    )


def _of_rows(problem: LinearProblem, solution: Solution, posterior: Posterior) -> tuple[FloatArray, float]:
    """(n,) the attitude error that is white to the cells of the likelihood as it is in a row [rad], and its time constant
    [s]; 0: white to the rows, too.

    To cells that last longer than an error it is as strong as its integral over time. In a row it is no larger than the
    residual shows.
    """
    share = turned_rad2(problem, solution.residual_nT, measured=True)
    mean = float(problem.weights @ share)
    integral2 = float(np.median(posterior.white_theta_rad)) ** 2
    longer = max(integral2 / mean, 1.0) if mean > 0.0 else 1.0
    # The squares of a first-order process are correlated, too.
    sd = float(np.sqrt(problem.weights @ (share - mean) ** 2 / problem.effective * 0.5 * (longer + 1.0 / longer)))
    seen2 = mean + sd * np.random.default_rng(0).normal(size=posterior.theta_rad.size)
    white2 = np.clip(seen2 - posterior.theta_rad**2, 0.0, posterior.white_theta_rad**2)
    white = float(np.median(white2))
    half_step_s = 0.5 * float(np.median(np.diff(seconds_of(problem.design.time))))
    # Of rows with a common error the ratio is coth(step / 2 tau). One of less than half a step is white to them.
    if problem.options.attitude_tau_s == 0.0 or not white > 0.0 or integral2 < white / np.tanh(1.0):
        return np.sqrt(white2), 0.0
    return np.sqrt(white2), half_step_s / float(np.arctanh(white / integral2))


def _error_words(errors: ErrorModel) -> str:
    assert errors.attitude_range_deg is not None
    low, high = errors.attitude_range_deg
    assert errors.attitude_sigma_deg is not None
    sigma = plain(errors.attitude_sigma_deg, 2)
    tau_s = errors.attitude_tau_s
    memory = f"with a time constant of {plain(tau_s, 2)} s" if tau_s else "white from row to row"
    words = f"from noise and an attitude error of {sigma} deg (90 %: {plain(low, 2)} to {plain(high, 2)}), {memory}"
    expected_nT = errors.expected_rms_nT
    if plain(float(np.hypot(expected_nT, errors.slow_nT))) == plain(expected_nT):
        return words
    slow = f"slow errors of {plain(errors.slow_nT, 2)} nT over {plain(errors.slow_tau_s, 2)} s"
    return f"{words}, and {slow} (of the field model, or an effect that is not modelled)"


def _too_few_passes(
    problem: LinearProblem, segment: np.ndarray, memory_s: float, passes: np.ndarray | None
) -> float | None:
    """How many there are, where errors that last an orbit cannot have been seen."""
    orbit_s = 2.0 * np.pi * problem.design.radian_s
    covered_s = observed_s(problem.design.time, segment)
    count = int(segment[-1]) + 1
    pass_s = min(covered_s / count, orbit_s)
    seen = max(count, covered_s / orbit_s, 0 if passes is None else np.unique(passes).size)
    # One pass is too little to find a long memory, so that a short one proves nothing.
    hidden = seen < 2 or memory_s >= _LONG_MEMORY * pass_s
    return None if problem.options.field_error_nT or seen >= FEWEST_BLOCKS or not hidden else float(seen)


def _from_noise_uncertainty(problem: LinearProblem, solution: Solution) -> FloatArray:
    """What an uncertain Sigma_B adds: dM = M[:, i] (row i of the inverse of <x|x> - Sigma_x) for each variance i."""
    size = 3 * (solution.M.shape[1] + 1)
    if not (problem.noise_xx.any() and problem.noise.covariance.any()):
        return np.zeros((size, size))
    inverse = np.linalg.inv(solution.fit.xx - problem.noise_xx)
    moved = []
    for i in range(3):
        step = np.outer(solution.M[:, i], inverse[i])
        moved.append(np.hstack([step, -(step @ solution.fit.mean_x)[:, None]]).ravel())
    return np.asarray(np.array(moved).T @ problem.noise.covariance @ np.array(moved))


def _from_turning(solution: Solution, power_rad2: float) -> FloatArray:
    """What a turn w of the whole adds in second order: M goes over into (1 + [w x]^2/2) M.

    A mean attitude error of half a degree shortens M by 4e-5, which is many sigmas of its trace. Mean square of
    (w_i w_j - d_ij |w|^2)/2 for normal w of that power an axis.
    """
    one, m = np.eye(3), solution.M.shape[1]
    # E of the products of four normals; the traces of w w' add 2 and 2 to 3
    both = np.einsum("ik,jl->ijkl", one, one) + np.einsum("il,jk->ijkl", one, one)
    square = 0.25 * power_rad2**2 * (both + 6.0 * np.einsum("ij,kl->ijkl", one, one))
    moved = np.hstack([solution.M, solution.c[:, None]])
    return np.asarray(np.einsum("ijkl,jf,lg->ifkg", square, moved, moved).reshape(3 * (m + 1), 3 * (m + 1)))


def _from_field_error(problem: LinearProblem, solution: Solution) -> FloatArray:
    """A declared error of the field model: Gauss-Markov with a memory of one radian of the orbit."""
    size = solution.M.shape[1] + 1
    if not problem.options.field_error_nT:
        return np.zeros((3 * size, 3 * size))
    x = np.hstack([np.zeros((len(problem.design), 0)), *problem.sides[1]])
    seen = cells(problem.design.time, segments(problem.design.time), [x, np.ones((len(x), 1))], problem.weights)
    seen.columns[:, :-1] -= solution.fit.mean_x
    K = kernel_moments(seen, np.array([problem.design.radian_s]))[0]
    turn = solution.M[:, :3] if problem.forward else np.eye(3)
    C = problem.options.field_error_nT**2 * turn @ turn.T
    whole = np.kron(np.eye(3), bread_of(solution.fit, problem.noise_xx))
    moments = np.einsum("ij,fg->ifjg", C, K).reshape(3 * size, 3 * size)
    return uncentred(whole @ moments @ whole.T, solution.fit.mean_x)


def _white(problem: LinearProblem, solution: Solution) -> FloatArray:
    effective, m, x = problem.effective, solution.M.shape[1], problem.sides[1]
    own = solution.own_residual_nT
    if x and effective >= _SANDWICH_ROWS * (m + 1):
        return sandwich_covariance(own, x, solution.fit, solution.M, problem.weights, problem.noise_xx)
    # With equal weights this is N/(N-p) times the mean of r r'.
    rr = problem.mean_square(own, 2) * effective / max(effective - m - 1, 1e-9)
    return plain_covariance(solution.fit, solution.M, rr, effective, problem.noise_xx)


def _in_file_order(problem: LinearProblem, solution: Solution, stacked: FloatArray) -> FloatArray:
    """(21 + 3J, 21 + 3J): S, b and T as in the file, then the field in the reading that follows each column."""
    columns = len(problem.design.columns)
    of_field = [
        [*range(3 * i, 3 * i + 3), *(12 + 3 * i + int(j) for j in problem.fired)] if problem.fits_S else []
        for i in range(3)
    ]
    of_drivers = 21 + 3 * np.arange(columns)
    place = np.concatenate([[*of_field[i], *(of_drivers + i), 9 + i] for i in range(3)]).astype(int)
    full = np.zeros((21 + 3 * columns,) * 2)
    full[np.ix_(place, place)] = stacked
    jacobian = np.eye(len(full))
    known = solution.calibration
    if problem.forward:
        jacobian[:21, :21] = forward_jacobian(known.correction)
    else:
        # the field in the reading is s = -(I+S)^-1 k: ds = -(I+S)^-1 (dk + dS s)
        inverse = np.linalg.inv(np.eye(3) + known.S)
        for at, bias, rms in zip(of_drivers, known.telemetry_bias.values(), problem.driver_rms, strict=True):
            jacobian[at : at + 3, at : at + 3] = -inverse
            jacobian[at : at + 3, :9] = -np.kron(inverse, bias.value_nT * rms)
    per = np.concatenate([np.ones(21), np.repeat(1.0 / problem.driver_rms, 3)])
    jacobian = per[:, None] * jacobian
    return np.asarray(jacobian @ full @ jacobian.T)
