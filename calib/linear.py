"""Linear regression for S, b and T against a reference attitude (Lerner & Shuster 1979, 1981).

    A B0 = (I+S) B + b + T D                                                    journal eq. 1

`linear` is the papers': the reading stands on the right (eqs. 2-9), solved stably by `regression`. Its noise
attenuates S, E[S] = S - (I+S) Sigma_B <B|B>^-1, which the errors-in-variables correction takes out:
<B|B> becomes <B|B> - Sigma_B. `forward` regresses the other way, B = G A B0 + o + C D, and inverts: right when
the reading is noisier than the reference.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from fluxtwin.calib import observability as seen
from fluxtwin.calib.conventions import Forward, correction_from_forward, forward_jacobian
from fluxtwin.calib.covariance import (
    FEWEST_BLOCKS,
    Blocks,
    jackknife_covariance,
    make_blocks,
    segments,
    white_covariance,
)
from fluxtwin.calib.covariance import widening as widening_of
from fluxtwin.calib.design import Design, assemble
from fluxtwin.calib.linear_fit import LinearFit
from fluxtwin.calib.moments import covariance_of, second_moment
from fluxtwin.calib.noise import ReadingNoise, reading_noise
from fluxtwin.calib.records import Calibration
from fluxtwin.calib.regression import Regression, regress, residuals
from fluxtwin.calib.residuals import residual_statistics
from fluxtwin.calib.robust import RobustWeights, robust_weights
from fluxtwin.sim.errors import BadInput, NoAnswer
from fluxtwin.sim.field import FieldModel
from fluxtwin.sim.telemetry import Telemetry
from fluxtwin.sim.types import FloatArray

PARAMETERS = ("b", "b,S", "b,S,T")
DIRECTIONS = ("linear", "forward")
_SAMPLES = {"b": 3, "b,S": 12, "b,S,T": 21}


@dataclass(frozen=True)
class Options:
    """How the regression is done; see `calibrate_linear`."""

    parameters: str = "b,S"
    direction: str = "linear"
    errors_in_variables: bool | None = None
    noise_nT: float | FloatArray | None = None
    lsb_nT: float | FloatArray | None = None
    robust: str | None = None
    covariance: str = "white"
    block_s: float | None = None

    def __post_init__(self) -> None:
        _one_of(self.parameters, PARAMETERS, "parameters")
        _one_of(self.direction, DIRECTIONS, "direction")
        _one_of(self.covariance, ("white", "blocks"), "covariance")
        if self.errors_in_variables and self.direction == "forward":
            raise BadInput(
                "the correction for noise in the reading has no place in the forward direction",
                where="errors_in_variables",
                wanted="direction linear, or the correction off",
            )
        if self.block_s is not None and not self.block_s > 0:
            raise BadInput(f"{self.block_s!r}", where="block_s", wanted="seconds, positive")

    @property
    def corrects(self) -> bool:
        """Whether the errors-in-variables correction is made."""
        wanted = self.direction == "linear" if self.errors_in_variables is None else self.errors_in_variables
        return wanted and self.parameters != "b"


def calibrate_linear(
    records: Telemetry | Sequence[Telemetry],
    model: FieldModel,
    *,
    parameters: str = "b,S",
    direction: str = "linear",
    errors_in_variables: bool | None = None,
    noise_nT: float | FloatArray | None = None,
    lsb_nT: float | FloatArray | None = None,
    weights: FloatArray | None = None,
    robust: str | bool | None = None,
    covariance: str = "white",
    passes: np.ndarray | None = None,
    block_s: float | None = None,
) -> LinearFit:
    """Calibrate one or several records against `model` and their reference attitude.

    parameters: `b`, `b,S` or `b,S,T`. errors_in_variables: None is on for `linear`. noise_nT, lsb_nT: of the
    reading, scalar or per axis; found in the data when not given. weights: (N,) of the joined rows (journal
    eq. 4, any scale). robust: None, `huber`, `tukey`; True is `tukey`. covariance: `white` or `blocks`, with
    `passes` (N,) labels of the joined rows or `block_s` seconds (default: see `covariance.make_blocks`).

    Raises BadInput for unknown options and absent columns, OutOfRange for epochs outside the model, NoAnswer,
    naming the parameters, when the data do not determine them.
    """
    options = Options(
        parameters, direction, errors_in_variables, noise_nT, lsb_nT, "tukey" if robust is True else robust or None,
        covariance, block_s,
    )  # fmt: skip
    design = assemble(records, model, with_dipole="T" in parameters)
    return fit_design(
        design,
        options,
        model_name=model.name,
        weights=_of_rows(weights, design, "weights"),
        passes=_of_rows(passes, design, "passes"),
    )


def fit_design(
    design: Design,
    options: Options,
    *,
    model_name: str = "",
    weights: FloatArray | None = None,
    passes: np.ndarray | None = None,
) -> LinearFit:
    """The regression on rows that are already assembled; arguments and errors as `calibrate_linear`."""
    fired = np.zeros(0, dtype=int) if design.D_Am2 is None else seen.fired_axes(design.D_Am2)
    seen.require_samples(len(design), _SAMPLES[options.parameters])
    dipole = [] if design.D_Am2 is None or not fired.size else [np.ascontiguousarray(design.D_Am2[:, fired])]
    a = _check_weights(weights, len(design))
    if options.parameters != "b":
        for field_nT in (design.H_nT, design.B_nT):
            seen.require_excitation(seen.excitation(field_nT, dipole, fired, a), np.zeros(3), 0.0)
    refit = _forward_refit(design, dipole, a, options.parameters == "b")
    robust = None
    if options.robust is not None:
        robust = robust_weights(design.B_nT - design.H_nT, refit, options.robust)
        a = robust.weights if a is None else a * robust.weights
        a = a / a.sum()
    first = refit(None if robust is None else robust.weights)
    noise = reading_noise(design.B_nT, first, design.time, options.noise_nT, options.lsb_nT)
    job = _Job(design, options, fired, dipole, a, robust, noise)
    solution = _solve_b(job) if options.parameters == "b" else _solve(job)
    return _report(job, solution, model_name, passes)


def _forward_refit(
    design: Design, dipole: list[FloatArray], a: FloatArray | None, only_b: bool
) -> Callable[[FloatArray | None], FloatArray]:
    """Residuals (N, 3) of B = G A B0 + o + C D (or of B = A B0 + o) for given further weights."""

    def refit(more: FloatArray | None) -> FloatArray:
        weights = more if a is None else a if more is None else a * more
        if only_b:
            difference = design.B_nT - design.H_nT
            return np.asarray(difference - np.average(difference, axis=0, weights=weights))
        fit = regress(design.B_nT, [design.H_nT, *dipole], weights)
        return residuals(design.B_nT, [design.H_nT, *dipole], fit.M, fit.c)

    return refit


@dataclass(frozen=True)
class _Job:
    design: Design
    options: Options
    fired: np.ndarray
    dipole: list[FloatArray]
    a: FloatArray | None  # weights of sum 1, None for equal
    robust: RobustWeights | None
    noise: ReadingNoise

    @property
    def weights(self) -> FloatArray:
        """(N,) a_k of journal eq. 4."""
        return np.full(len(self.design), 1.0 / len(self.design)) if self.a is None else self.a

    @property
    def effective(self) -> float:
        """Effective number of rows, 1 / sum a_k^2."""
        return float(len(self.design)) if self.a is None else 1.0 / float((self.a**2).sum())

    def mean_square(self, r: FloatArray, power: int = 1) -> FloatArray:
        """(3, 3) mean of r r' with weights a_k^power, divided by sum a_k^power."""
        if self.a is None:
            return second_moment([r])[1]
        w = self.a**power
        return second_moment([r], w / w.sum())[1]

    @property
    def noise_xx(self) -> FloatArray | None:
        """Sigma_x of the regressors [B; D] when the correction is on."""
        if not self.options.corrects:
            return None
        return np.diag(np.concatenate([self.noise.variance_nT2, np.zeros(self.fired.size)]))


@dataclass(frozen=True)
class _Solution:
    fit: Regression | None
    M: FloatArray  # (3, m) slopes in the fitted direction
    c: FloatArray
    calibration: Calibration
    residual_nT: FloatArray  # true-field side
    own_residual_nT: FloatArray  # side of the fitted direction
    eiv_shift: FloatArray


def _solve_b(job: _Job) -> _Solution:
    h = job.design.H_nT - job.design.B_nT
    b = job.weights @ h
    calibration = Calibration(np.zeros((3, 3)), b)
    return _Solution(None, np.zeros((3, 0)), b, calibration, h - b, h - b, np.zeros((3, 3)))


def _solve(job: _Job) -> _Solution:
    design, linear = job.design, job.options.direction == "linear"
    y, x = (design.H_nT, design.B_nT) if linear else (design.B_nT, design.H_nT)
    fit = regress(y, [x, *job.dipole], job.a)
    variance = job.noise.variance_nT2
    sigma_nT = float(np.sqrt(np.trace(fit.rr) / 3.0))
    moved = seen.excitation(design.B_nT, job.dipole, job.fired, job.a)
    seen.require_excitation(moved, variance, sigma_nT)
    M, c = fit.M, fit.c
    shift = np.zeros((3, 3))
    if job.noise_xx is not None:
        # <y|x> (<x|x> - Sigma)^-1 = M + (M Sigma) (<x|x> - Sigma)^-1: keeps the digits of the regression
        step, offset = _corrected(fit.xx, fit.M @ job.noise_xx, fit.mean_x, np.zeros(3), job.noise_xx)
        M, c, shift = fit.M + step, fit.c + offset, step[:, :3]
    own = residuals(y, [x, *job.dipole], M, c)
    calibration = _calibration(job, M, c)
    true_side = own if linear else design.H_nT - calibration.apply(design.B_nT, design.D_Am2)
    return _Solution(fit, M, c, calibration, true_side, own, shift)


def _corrected(
    xx: FloatArray, yx: FloatArray, mean_x: FloatArray, mean_y: FloatArray, noise_xx: FloatArray | None
) -> tuple[FloatArray, FloatArray]:
    """M = <y|x> (<x|x> - Sigma_x)^-1, c = <y> - M <x> (journal eqs. 5, 8; Fuller 1987)."""
    clean = xx if noise_xx is None else xx - noise_xx
    scale = np.sqrt(np.maximum(np.diag(clean), 1e-300))
    try:
        factor = np.linalg.cholesky(clean / np.outer(scale, scale))
    except np.linalg.LinAlgError:
        raise NoAnswer(
            "the field varies by less than the noise of the reading in some body direction: S is not determined",
            evidence={"field_covariance_nT2": xx[:3, :3].tolist()},
        ) from None
    half = np.linalg.solve(factor, (yx / scale).T)
    M = np.linalg.solve(factor.T, half).T / scale
    return M, mean_y - M @ mean_x


def _calibration(job: _Job, M: FloatArray, c: FloatArray) -> Calibration:
    """S, b, T from slopes in the fitted direction."""
    T = np.zeros((3, 3))
    T[:, job.fired] = M[:, 3:]
    with_T = "T" in job.options.parameters
    if job.options.direction == "linear":
        return Calibration(M[:, :3] - np.eye(3), c, T if with_T else None)
    back = correction_from_forward(Forward(M[:, :3], c, T))
    return Calibration(back.S, back.b_nT, back.T_nT_per_Am2 if with_T else None)


def _report(job: _Job, solution: _Solution, model_name: str, passes: np.ndarray | None) -> LinearFit:
    design, options = job.design, job.options
    covariance, block_words = _covariance(job, solution, passes)
    per_axis = 1 if solution.fit is None else solution.fit.xx.shape[0] + 1
    free = job.effective / max(job.effective - per_axis, 1e-9)
    sigma_nT = float(np.sqrt(np.trace(job.mean_square(solution.residual_nT)) / 3.0 * free))
    variation = seen.field_variation(covariance_of(design.B_nT, job.a))
    words = seen.never_fired_words(job.fired) if design.D_Am2 is not None else []
    if options.parameters != "b":
        field_rms = float(np.sqrt(np.trace(job.mean_square(design.B_nT))))
        words += seen.weak_direction_words(variation, covariance, sigma_nT)
        words += seen.pair_words(covariance, "T" in options.parameters, field_rms, sigma_nT)
    calibration = Calibration(
        S=solution.calibration.S,
        b_nT=solution.calibration.b_nT,
        T_nT_per_Am2=solution.calibration.T_nT_per_Am2,
        covariance=covariance,
        covariance_kind=options.covariance,
        sigma_nT=sigma_nT,
        samples=len(design) - (0 if job.robust is None else job.robust.rejected),
        span=(design.time[0], design.time[-1]),
        field_model=model_name,
        method=_method_words(options),
        unobservable=tuple(words),
    )
    kept = slice(None) if job.robust is None else job.robust.weights >= 0.01
    return LinearFit(
        calibration=calibration,
        direction=options.direction,
        time=design.time,
        residuals_nT=solution.residual_nT,
        weights=job.weights,
        rows=design.rows,
        left_out=dict(design.left_out),
        rejected=0 if job.robust is None else job.robust.rejected,
        variation=variation,
        noise=job.noise,
        eiv_shift=solution.eiv_shift,
        statistics=residual_statistics(design.time[kept], solution.residual_nT[kept]),
        messages=_messages(job, solution, variation, block_words),
    )


def _covariance(job: _Job, solution: _Solution, passes: np.ndarray | None) -> tuple[FloatArray, str]:
    """(P, P) in the order of the calibration file, and how correlation was treated, in words."""
    stacked, words = _white(job, solution), ""
    if job.options.covariance == "blocks":
        blocks = make_blocks(job.design.time, solution.residual_nT, passes, job.options.block_s)
        try:
            stacked, words = _jackknife(job, solution, blocks), f"jackknife over {blocks.count} blocks ({blocks.words})"
        except NoAnswer as reason:
            factor = widening_of(solution.residual_nT, segments(job.design.time))
            stacked = stacked * factor
            words = (
                f"{reason}, so the white covariance is widened by N/N_eff = {factor:.2f}, from the correlation of "
                "neighbouring residuals"
            )
    stacked = stacked + _from_noise_uncertainty(job, solution)
    return _in_file_order(job, solution, stacked), words and f"covariance: {words}"


def _jackknife(job: _Job, solution: _Solution, blocks: Blocks) -> FloatArray:
    """Raises NoAnswer where the blocks are too few, or one of them alone determines a parameter."""
    if blocks.count < FEWEST_BLOCKS:
        raise NoAnswer(f"only {blocks.count} blocks ({blocks.words})")
    design = job.design
    y, x = (design.H_nT, design.B_nT) if job.options.direction == "linear" else (design.B_nT, design.H_nT)
    if solution.fit is None:
        y, x = design.H_nT - design.B_nT, np.zeros((len(design), 0))

    def solve(xx: FloatArray, yx: FloatArray, mean_x: FloatArray, mean_y: FloatArray) -> tuple[FloatArray, FloatArray]:
        try:
            return _corrected(xx, yx, mean_x, mean_y, job.noise_xx)
        except NoAnswer:
            raise NoAnswer("one block alone determines a parameter") from None

    return jackknife_covariance(y, np.hstack([x, *job.dipole]), job.weights, blocks, solve)


def _from_noise_uncertainty(job: _Job, solution: _Solution) -> FloatArray:
    """What an uncertain Sigma_B adds: the correction scales with it as a whole."""
    if solution.fit is None or job.noise_xx is None:
        return np.zeros((3 * (solution.M.shape[1] + 1),) * 2)
    step = solution.M - solution.fit.M
    moved = np.hstack([step, -(step @ solution.fit.mean_x)[:, None]]).ravel()
    return np.outer(moved, moved) * job.noise.relative_uncertainty**2


def _white(job: _Job, solution: _Solution) -> FloatArray:
    effective, m = job.effective, solution.M.shape[1]
    # With equal weights this is N/(N-p) times the mean of r r'.
    rr = job.mean_square(solution.own_residual_nT, 2) * effective / max(effective - m - 1, 1e-9)
    if job.robust is not None:
        rr = rr / job.robust.sharpness**2
    if solution.fit is None:
        return np.asarray(rr / effective)
    return white_covariance(solution.fit, solution.M, rr, effective, job.noise_xx)


def _in_file_order(job: _Job, solution: _Solution, stacked: FloatArray) -> FloatArray:
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


def _messages(job: _Job, solution: _Solution, variation: seen.FieldVariation, block_words: str) -> tuple[str, ...]:
    out = [f"{count} rows left out: {reason}" for reason, count in job.design.left_out.items()]
    out.append(f"noise of the reading: {job.noise.source}")
    if job.options.corrects:
        out.append(
            "S corrected for the noise of the reading (errors in variables): largest change "
            f"{np.abs(solution.eiv_shift).max():.2g}"
        )
    if job.robust is not None:
        out.append(f"robust weights ({job.options.robust}): {job.robust.rejected} rows set aside")
    if job.options.parameters != "b":
        out.append(f"{variation.words()}; condition number {variation.condition_number:.3g}")
    if block_words:
        out.append(block_words)
    return tuple(out)


def _method_words(options: Options) -> str:
    parts = [f"{options.direction} regression for {options.parameters}"]
    if options.corrects:
        parts.append("corrected for errors in variables")
    if options.robust is not None:
        parts.append(f"{options.robust} weights")
    return ", ".join(parts)


def _of_rows(values: np.ndarray | None, design: Design, name: str) -> np.ndarray | None:
    if values is None:
        return None
    array = np.asarray(values)
    total = len(design) + sum(design.left_out.values())
    if array.shape != (total,):
        raise BadInput(f"has shape {array.shape}", where=name, wanted=f"one entry for each of the {total} rows")
    return np.asarray(array[design.rows])


def _check_weights(weights: FloatArray | None, rows: int) -> FloatArray | None:
    if weights is None:
        return None
    a = np.asarray(weights, dtype=np.float64)
    if a.shape != (rows,) or not np.isfinite(a).all() or (a < 0).any() or not a.sum() > 0:
        raise BadInput("a weight is negative, not finite, or all are zero", where="weights", wanted=f"{rows} weights")
    return np.asarray(a / a.sum())


def _one_of(value: str, allowed: tuple[str, ...], name: str) -> None:
    if value not in allowed:
        raise BadInput(f"{value!r}", where=name, wanted=" or ".join(repr(v) for v in allowed))


__all__ = ["DIRECTIONS", "PARAMETERS", "LinearFit", "Options", "calibrate_linear", "fit_design"]
