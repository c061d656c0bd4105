"""Linear regression for S, b and T against a reference attitude (Lerner & Shuster 1979, 1981).

    A B0 = (I+S) B + b + T D                                                    journal eq. 1

`linear` is the papers': the reading stands on the right (eqs. 2-9), solved stably by `regression`. Its noise
attenuates S, E[S] = S - (I+S) Sigma_B <B|B>^-1, which the errors-in-variables correction takes out:
<B|B> becomes <B|B> - Sigma_B. `forward` regresses the other way, B = G A B0 + o + C D, and inverts: right when
the reading is noisier than the reference.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from fluxtwin.calib.common import observability as seen
from fluxtwin.calib.common.conventions import Forward, correction_from_forward
from fluxtwin.calib.common.design import Design, assemble, joined
from fluxtwin.calib.common.digits import plain
from fluxtwin.calib.common.fit_warnings import suspicions
from fluxtwin.calib.common.moments import covariance_of
from fluxtwin.calib.common.noise import reading_noise
from fluxtwin.calib.common.records import Calibration
from fluxtwin.calib.common.regression import regress, residuals
from fluxtwin.calib.common.residuals import residual_statistics
from fluxtwin.calib.common.robust import robust_weights
from fluxtwin.calib.linear.covariance_report import stated_covariance
from fluxtwin.calib.linear.fit import LinearFit
from fluxtwin.calib.linear.method import LinearOptions
from fluxtwin.calib.linear.problem import Job, Solution, corrected
from fluxtwin.sim.base.errors import BadInput
from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.earth.field import FieldModel
from fluxtwin.sim.telemetry.record import Telemetry

_SAMPLES = {"b": 3, "b,S": 12, "b,S,T": 21}


def calibrate_linear(
    records: Telemetry | Sequence[Telemetry], model: FieldModel, options: LinearOptions | None = None, **given: Any
) -> LinearFit:
    """Calibrate one or several records against `model` and their reference attitude.

    given: fields of `LinearOptions`, where no options are. Raises BadInput for unknown options and absent columns,
    OutOfRange for epochs outside the model, NoAnswer, naming the parameters, when the data do not determine them.
    """
    options = LinearOptions(**given) if options is None else options
    telemetry = joined(records)
    design = assemble(telemetry, model, with_dipole="T" in options.parameters)
    weights, passes = (_of_rows(getattr(options, name), design, name) for name in ("weights", "passes"))
    fit = fit_design(design, options, model_name=model.name, weights=weights, passes=passes)
    doubts = suspicions(telemetry, fit.calibration, fit.residuals_nT, robust=options.robust != "none")
    return dataclasses.replace(fit, messages=(*fit.messages, *doubts))


def fit_design(
    design: Design,
    options: LinearOptions,
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
    if options.robust != "none":
        robust = robust_weights(design.B_nT - design.H_nT, refit, options.robust)
        a = robust.weights if a is None else a * robust.weights
        a = a / a.sum()
    first = refit(None if robust is None else robust.weights)
    noise = reading_noise(design, first, options.noise_nT, options.lsb_nT)
    job = Job(design, options, fired, dipole, a, robust, noise)
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


def _solve_b(job: Job) -> Solution:
    h = job.design.H_nT - job.design.B_nT
    b = job.weights @ h
    calibration = Calibration(np.zeros((3, 3)), b)
    return Solution(None, np.zeros((3, 0)), b, calibration, h - b, h - b, np.zeros((3, 3)))


def _solve(job: Job) -> Solution:
    solution = _regressed(job, np.zeros(3))
    if job.options.errors_in_variables is False:
        return solution
    short = _shortening(job, solution.residual_nT)
    return solution if short is None else _regressed(job, short)


def _regressed(job: Job, longer_nT: FloatArray) -> Solution:
    """longer_nT: (N, 3) or (3,) by how much errors of the attitude shorten the mean of the reference field."""
    design, linear = job.design, job.options.method == "linear"
    # On the right side it is the true field given the reference that falls short.
    y, x = (design.H_nT + longer_nT, design.B_nT) if linear else (design.B_nT, design.H_nT - longer_nT)
    fit = regress(y, [x, *job.dipole], job.a)
    variance = job.noise.variance_nT2
    sigma_nT = float(np.sqrt(np.trace(fit.rr) / 3.0))
    moved = seen.excitation(x, job.dipole, job.fired, job.a)
    # The reference on the right side carries none of the noise of the reading.
    seen.require_excitation(moved, variance if linear else np.zeros(3), sigma_nT)
    M, c = fit.M, fit.c
    shift = np.zeros((3, 3))
    if job.noise_xx is not None:
        # <y|x> (<x|x> - Sigma)^-1 = M + (M Sigma) (<x|x> - Sigma)^-1: keeps the digits of the regression
        step, offset = corrected(fit.xx, fit.M @ job.noise_xx, fit.mean_x, np.zeros(3), job.noise_xx)
        M, c, shift = fit.M + step, fit.c + offset, step[:, :3]
    y, x = (design.H_nT, design.B_nT) if linear else (design.B_nT, design.H_nT)
    own = residuals(y, [x, *job.dipole], M, c)
    calibration = _calibration(job, M, c)
    true_side = own if linear else design.H_nT - calibration.apply(design.B_nT, design.D_Am2)
    return Solution(fit, M, c, calibration, true_side, own, shift)


def _shortening(job: Job, residual_nT: FloatArray) -> FloatArray | None:
    """(N, 3) by how much an error of the attitude shortens what it turns: |r across|^2 / (2 |B0|) along the field.

    A turn keeps the length, so that the mean of the turned field falls short: S11 + S22 + S33 of half a degree by
    1e-4, many of its sigmas. What white noise adds to the square is off it; None where no more than that is there.
    """
    H = job.design.H_nT
    size2 = np.maximum((H**2).sum(axis=1), 1e-6)
    along = np.einsum("ij,ij->i", residual_nT, H)
    variance = job.noise.variance_nT2
    noise = variance.sum() - (H**2 @ variance) / size2
    across = (residual_nT**2).sum(axis=1) - along**2 / size2
    share = (across - noise) / (2.0 * size2)
    mean = float(job.weights @ share)
    if mean < 3.0 * float(np.sqrt(job.weights @ (share - mean) ** 2 / job.effective)):
        return None
    return np.asarray(H * share[:, None])


def _calibration(job: Job, M: FloatArray, c: FloatArray) -> Calibration:
    """S, b, T from slopes in the fitted direction."""
    T = np.zeros((3, 3))
    T[:, job.fired] = M[:, 3:]
    with_T = "T" in job.options.parameters
    if job.options.method == "linear":
        return Calibration(M[:, :3] - np.eye(3), c, T if with_T else None)
    back = correction_from_forward(Forward(M[:, :3], c, T))
    return Calibration(back.S, back.b_nT, back.T_nT_per_Am2 if with_T else None)


def _report(job: Job, solution: Solution, model_name: str, passes: np.ndarray | None) -> LinearFit:
    design, options = job.design, job.options
    stated = stated_covariance(job, solution, passes)
    covariance = stated.covariance
    per_axis = 1 if solution.fit is None else solution.fit.xx.shape[0] + 1
    free = job.effective / max(job.effective - per_axis, 1e-9)
    kept = slice(None) if job.robust is None else job.robust.weights >= 0.01
    square = float(np.trace(job.mean_square(solution.residual_nT))) / 3.0
    if job.robust is not None:  # the weights shrink the tails of sound rows, too
        square = float((solution.residual_nT[kept] ** 2).mean())
    sigma_nT = float(np.sqrt(square * free))
    variation = seen.field_variation(covariance_of(design.B_nT, job.a))
    words = seen.never_fired_words(job.fired) if design.D_Am2 is not None else []
    if options.parameters != "b":
        field_rms = float(np.sqrt(np.trace(job.mean_square(design.B_nT))))
        words += seen.weak_direction_words(variation, covariance, sigma_nT)
        words += seen.pair_words(covariance, "T" in options.parameters, field_rms, sigma_nT)
    words += stated.unobservable
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
    return LinearFit(
        calibration=calibration,
        method=options.method,
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
        messages=(*_messages(job, solution, variation), *stated.messages),
        error_model=stated.errors,
    )


def _messages(job: Job, solution: Solution, variation: seen.FieldVariation) -> tuple[str, ...]:
    out = [f"{count} rows left out: {reason}" for reason, count in job.design.left_out.items()]
    out.append(f"noise of the reading: {job.noise.source}")
    if job.options.corrects:
        out.append(
            "S corrected for the noise of the reading (errors in variables): largest change "
            f"{plain(float(np.abs(solution.eiv_shift).max()), 2)}"
        )
    if job.robust is not None and job.robust.rejected:
        out.append(f"robust weights ({job.options.robust}): {job.robust.rejected} rows set aside")
    if job.options.parameters != "b":
        out.append(f"{variation.words()}; condition number {plain(variation.condition_number)}")
    return tuple(out)


def _method_words(options: LinearOptions) -> str:
    parts = [f"{options.method} regression for {options.parameters}"]
    if options.corrects:
        parts.append("corrected for errors in variables")
    if options.robust != "none":
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
