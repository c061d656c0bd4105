"""The covariance that a linear calibration states, in the order of the calibration file, and the words beside it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fluxtwin.calib.conventions import forward_jacobian
from fluxtwin.calib.covariance import (
    FEWEST_BLOCKS,
    Blocks,
    batch_widening,
    bread_of,
    jackknife_covariance,
    make_blocks,
    observed_s,
    plain_covariance,
    sandwich_covariance,
    segments,
    uncentred,
)
from fluxtwin.calib.job import Job, Solution, corrected
from fluxtwin.calib.slow_errors import Cells, cells, kernel_moments, slow_errors
from fluxtwin.sim.errors import NoAnswer
from fluxtwin.sim.types import FloatArray

_SANDWICH_ROWS = 10  # a parameter of one axis
_TOO_SMALL = 1.2  # by so much may white sigmas be too small before it is said
_LONG_MEMORY = 0.05  # of a pass


@dataclass(frozen=True)
class Stated:
    """What the calibration says of its own errors."""

    covariance: FloatArray
    """(P, P) in the order of the calibration file."""
    messages: tuple[str, ...]
    """How it was found."""
    unobservable: tuple[str, ...]
    """What it does not cover."""


def stated_covariance(job: Job, solution: Solution, passes: np.ndarray | None) -> Stated:
    """White or allowing for correlation, plus what the noise of the reading and a declared field error add."""
    stacked = _white(job, solution)
    messages, unobservable = [], []
    segment = segments(job.design.time)
    if job.options.covariance == "blocks":
        stacked, words, memory_s = _correlated(job, solution, stacked, passes, segment)
        messages.append(f"covariance: {words}")
        unobservable += _orbit_long_words(job, segment, memory_s, passes)
    else:
        factor = float(np.sqrt(batch_widening(solution.residual_nT, segment)))
        if factor > _TOO_SMALL:
            messages.append(
                f"the residuals hang together in time: white sigmas are too small, by up to {factor:.1f}; "
                "covariance blocks (--covariance blocks) allows for it"
            )
    stacked = stacked + _from_noise_uncertainty(job, solution) + _from_field_error(job, solution, segment)
    if job.options.field_error_nT:
        messages.append(
            f"field model taken as wrong by {job.options.field_error_nT:.4g} nT rms an axis with a memory of "
            f"{job.design.radian_s:.0f} s, a radian of the orbit"
        )
    return Stated(_in_file_order(job, solution, stacked), tuple(messages), tuple(unobservable))


def _correlated(
    job: Job, solution: Solution, white: FloatArray, passes: np.ndarray | None, segment: np.ndarray
) -> tuple[FloatArray, str, float]:
    """Stacked covariance, how it was found, and the memory of the residual [s]."""
    seen, longest_s = _cells_of(job, solution, segment)
    m = solution.M.shape[1]
    covered_s = observed_s(job.design.time, segment)
    slow = slow_errors(seen, m, job.mean_square(solution.own_residual_nT), longest_s, covered_s)
    memory_s = 0.0 if slow is None else slow.memory_s
    grouped = make_blocks(job.design.time, memory_s, passes, job.options.block_s)
    try:
        stacked = _jackknife(job, solution, grouped)
        return stacked, f"jackknife over {grouped.count} blocks ({grouped.words})", memory_s
    except NoAnswer as reason:
        if slow is None:
            return white, f"{reason}, and too few rows to see correlation: white", memory_s
        stacked = slow.white_part * white + _through(job, solution, slow.slow)
        words = (
            f"{reason}; instead a slow part of the residual, {slow.share:.0%} of its variance with a memory of "
            f"{memory_s:.0f} s, by restricted likelihood"
        )
        return stacked, words, memory_s


def _cells_of(job: Job, solution: Solution, segment: np.ndarray) -> tuple[Cells, float]:
    """Cells of [x - <x>, 1, residual, y - <y> where there are slopes], and the longest unbroken stretch [s]."""
    time, rows, m = job.design.time, len(job.design), solution.M.shape[1]
    y = [] if solution.fit is None else [job.design.H_nT if job.options.direction == "linear" else job.design.B_nT]
    seen = cells(time, segment, [*job.parts, solution.own_residual_nT, *y], job.weights)
    x, r_y = np.split(seen.columns, [m], axis=1)
    if solution.fit is not None:
        x = x - solution.fit.mean_x
        r_y[:, 3:] -= seen.weight @ r_y[:, 3:]
    seen = seen._replace(columns=np.hstack([x, np.ones((len(x), 1)), r_y]))
    first = np.concatenate([[0], np.flatnonzero(np.diff(segment)) + 1])
    last = np.concatenate([first[1:], [rows]]) - 1
    longest = float((time[last] - time[first]).max().astype("int64")) * 1e-9
    return seen, longest


def _through(job: Job, solution: Solution, moments: FloatArray) -> FloatArray:
    """Stacked covariance from (3, m+1, 3, m+1) moments of [x - <x>, 1] with the errors of the fitted direction."""
    m = solution.M.shape[1]
    bread = np.eye(1) if solution.fit is None else bread_of(solution.fit, job.noise_xx)
    whole = np.kron(np.eye(3), bread)
    stacked = whole @ moments.reshape(3 * (m + 1), 3 * (m + 1)) @ whole.T
    if job.robust is not None:
        stacked = stacked / job.robust.sharpness**2
    return uncentred(stacked, np.zeros(0) if solution.fit is None else solution.fit.mean_x)


def _orbit_long_words(job: Job, segment: np.ndarray, memory_s: float, passes: np.ndarray | None) -> list[str]:
    """A sentence where errors that last an orbit cannot have been seen."""
    orbit_s = 2.0 * np.pi * job.design.radian_s
    covered_s = observed_s(job.design.time, segment)
    count = int(segment[-1]) + 1
    pass_s = min(covered_s / count, orbit_s)
    seen = max(count, covered_s / orbit_s, 0 if passes is None else np.unique(passes).size)
    # One pass is too little to find a long memory, so that a short one proves nothing.
    hidden = seen < 2 or memory_s >= _LONG_MEMORY * pass_s
    if job.options.field_error_nT or seen >= FEWEST_BLOCKS or not hidden:
        return []
    return [
        f"errors that last an orbit, as those of the field model do, are not in these sigmas: the data hold {seen:.2g} "
        "passes, too few to see them. Declare them (field_error_nT, --field-error-nT) or add passes"
    ]


def _jackknife(job: Job, solution: Solution, blocks: Blocks) -> FloatArray:
    """Raises NoAnswer where the blocks are too few, or one of them alone determines a parameter."""
    if blocks.count < FEWEST_BLOCKS:
        raise NoAnswer(f"only {blocks.count} blocks ({blocks.words})")
    design = job.design
    y = design.H_nT if job.options.direction == "linear" else design.B_nT
    if solution.fit is None:
        y = design.H_nT - design.B_nT
    x = np.hstack([*job.parts, np.zeros((len(design), 0))])

    def solve(xx: FloatArray, yx: FloatArray, mean_x: FloatArray, mean_y: FloatArray) -> tuple[FloatArray, FloatArray]:
        try:
            return corrected(xx, yx, mean_x, mean_y, job.noise_xx)
        except NoAnswer:
            raise NoAnswer("one block alone determines a parameter") from None

    return jackknife_covariance(y, x, job.weights, blocks, solve)


def _from_noise_uncertainty(job: Job, solution: Solution) -> FloatArray:
    """What an uncertain Sigma_B adds: dM = M[:, i] (row i of the inverse of <x|x> - Sigma_x) for each variance i."""
    size = 3 * (solution.M.shape[1] + 1)
    if solution.fit is None or job.noise_xx is None or not job.noise.covariance.any():
        return np.zeros((size, size))
    inverse = np.linalg.inv(solution.fit.xx - job.noise_xx)
    moved = []
    for i in range(3):
        step = np.outer(solution.M[:, i], inverse[i])
        moved.append(np.hstack([step, -(step @ solution.fit.mean_x)[:, None]]).ravel())
    return np.asarray(np.array(moved).T @ job.noise.covariance @ np.array(moved))


def _from_field_error(job: Job, solution: Solution, segment: np.ndarray) -> FloatArray:
    """A declared error of the field model: Gauss-Markov with a memory of one radian of the orbit."""
    size = solution.M.shape[1] + 1
    if not job.options.field_error_nT:
        return np.zeros((3 * size, 3 * size))
    seen, _ = _cells_of(job, solution, segment)
    K = kernel_moments(seen._replace(columns=seen.columns[:, :size]), np.array([job.design.radian_s]))[0]
    turn = solution.M[:, :3] if job.options.direction == "forward" and solution.fit is not None else np.eye(3)
    C = job.options.field_error_nT**2 * turn @ turn.T
    return _through(job, solution, np.einsum("ij,fg->ifjg", C, K))


def _white(job: Job, solution: Solution) -> FloatArray:
    effective, m = job.effective, solution.M.shape[1]
    sharpness = 1.0 if job.robust is None else job.robust.sharpness
    own = solution.own_residual_nT
    if solution.fit is not None and effective >= _SANDWICH_ROWS * (m + 1):
        stacked = sandwich_covariance(own, job.parts, solution.fit, solution.M, job.a, job.noise_xx)
        return np.asarray(stacked / sharpness**2)
    # With equal weights this is N/(N-p) times the mean of r r'.
    rr = job.mean_square(own, 2) * effective / max(effective - m - 1, 1e-9) / sharpness**2
    if solution.fit is None:
        return np.asarray(rr / effective)
    return plain_covariance(solution.fit, solution.M, rr, effective, job.noise_xx)


def _in_file_order(job: Job, solution: Solution, stacked: FloatArray) -> FloatArray:
    with_S = solution.fit is not None
    m = solution.M.shape[1]
    place = np.zeros(3 * (m + 1), dtype=int)
    for i in range(3):
        columns = [3 * i + k for k in range(3)] if with_S else []
        columns += [12 + 3 * i + int(j) for j in job.fired] if with_S else []
        place[i * (m + 1) : (i + 1) * (m + 1)] = [*columns, 9 + i]
    full = np.zeros((21, 21))
    full[np.ix_(place, place)] = stacked
    if with_S and job.options.direction == "forward":
        jacobian = forward_jacobian(solution.calibration.correction)
        full = jacobian @ full @ jacobian.T
    size = 21 if "T" in job.options.parameters else 12
    return np.asarray(full[:size, :size])
