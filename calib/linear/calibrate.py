"""Linear regression for S, b and T against a reference attitude (Lerner & Shuster 1979, 1981).

    A B0 = (I+S) B + b + T D                                                    journal eq. 1

`linear` is the papers': the reading stands on the right (eqs. 2-9), solved stably by `regression`. Its noise
attenuates S, E[S] = S - (I+S) Sigma_B <B|B>^-1, which the errors-in-variables correction takes out:
<B|B> becomes <B|B> - Sigma_B. `forward` regresses the other way, B = G A B0 + o + C D, and inverts: right when
the reading is noisier than the reference.

Fields that follow columns are weighted by what the errors were found to be. An error of the attitude, of half a degree for
minutes, moves the reading by hundreds of nT, across the field and not along it. Least squares, which is right for S and b
whatever the errors are (`covariance_report`), hears a column through all of that; the weighted fit of

    B = G (1 + [theta x]) H + o + C D + sum_j s_j d_j + h + white

with theta, h and white noise of the sizes that `error_model` has found hears it where it is quiet (Aitken 1935). It serves
the fields of columns alone: what switches is not in step with an error of the field model, which lies along the field.
S, b and T are then least squares of the reading without these fields.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from fluxtwin.calib.common import drivers, observability
from fluxtwin.calib.common.conventions import Correction, Forward, correction_from_forward
from fluxtwin.calib.common.covariance import stretches
from fluxtwin.calib.common.design import Design, assemble, joined, of_turns
from fluxtwin.calib.common.digits import plain
from fluxtwin.calib.common.fit import Fit, with_warnings
from fluxtwin.calib.common.noise import ReadingNoise, reading_noise
from fluxtwin.calib.common.options import LinearOptions
from fluxtwin.calib.common.records import Calibration, TelemetryBias, seconds_of
from fluxtwin.calib.common.regression import Regression, regress, residuals
from fluxtwin.calib.common.robust import outlier_words, rows_to_keep, within_attitude_errors
from fluxtwin.calib.linear.covariance_report import report_covariance
from fluxtwin.calib.linear.estimating_equations import LinearProblem, Solution, turned_rad2
from fluxtwin.sim.base.errors import BadInput, NoAnswer, amount
from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.earth.field import FieldModel
from fluxtwin.sim.telemetry.record import Telemetry

_SAMPLES = {"b": 3, "b,S": 12, "b,S,T": 21}
_SEARCHED = 20_000
"""Rows in which delays and lags are looked for."""


@dataclass(frozen=True, kw_only=True)
class LinearFit(Fit):
    """What the regression adds to the record of every method."""

    eiv_shift: FloatArray
    """(3, 3) change of S by the errors-in-variables correction; zero when off."""

    def to_dict(self) -> dict[str, Any]:
        """Plain numbers and text for JSON; no NaN."""
        return {
            **super().to_dict(),
            "direction": self.method,
            "errors_in_variables_shift": self.eiv_shift.tolist(),
            "telemetry_bias": self.calibration.to_dict().get("telemetry_bias", {}),
        }


def calibrate_linear(records: Telemetry | Sequence[Telemetry], model: FieldModel, **given: Any) -> LinearFit:
    """Calibrate one or several records against `model` and their reference attitude.

    given: fields of `LinearOptions`. Raises BadInput for unknown options and absent columns,
    OutOfRange for epochs outside the model, NoAnswer, naming the parameters, when the data do not determine them.
    """
    options = LinearOptions(**given)
    telemetry = joined(records)
    asked = drivers.asked_for(telemetry, options.driver)
    design = assemble(telemetry, model, with_dipole="T" in options.parameters, columns=asked.columns)
    weights, passes = (_of_rows(getattr(options, name), design, name) for name in ("weights", "passes"))

    again: dict[str, Any] = {"model_name": model.name, "weights": weights, "passes": passes}

    def by(columns: drivers.Columns, *, values_alone: bool = False) -> LinearFit:
        used = replace(design, columns=columns)
        fit = fit_design(used, options, **again)
        if not columns or fit.error_model is None:
            return fit
        value_nT, covariance = _weighted_fields(fit, used)
        if not values_alone:
            return _beside(used, options, value_nT, covariance, noise=fit.noise, **again)
        free = fit_design(_without(used, value_nT), replace(options, covariance="white"), noise=fit.noise, **again)
        biases = {name: TelemetryBias(one, np.zeros(3)) for name, one in zip(columns, value_nT, strict=True)}
        return replace(free, calibration=replace(free.calibration, telemetry_bias=biases))

    others = [design.H_nT] if options.parameters != "b" else []
    others += [] if design.D_Am2 is None else [design.D_Am2]
    beside = np.hstack([np.zeros((len(design), 0)), *others])
    drops, values_of = partial(_drops, design), partial(by, values_alone=True)
    fit: LinearFit = drivers.fitted(asked, design.rows, beside, by, drops, values_of)
    return with_warnings(fit, telemetry, robust=options.robust != "none")


def fit_design(
    design: Design,
    options: LinearOptions,
    *,
    model_name: str = "",
    weights: FloatArray | None = None,
    passes: np.ndarray | None = None,
    noise: ReadingNoise | None = None,
) -> LinearFit:
    """The regression on rows that are already assembled; arguments and errors as `calibrate_linear`.

    noise: of the reading, where it is known; readings less a field have lost the step in which they came.
    """
    # Torquer axes that fired at least once.
    fired = np.flatnonzero(np.zeros(0) if design.D_Am2 is None else np.abs(design.D_Am2).max(axis=0) > 0)
    wanted = _SAMPLES[options.parameters] + 3 * len(design.columns)
    observability.require_samples(len(design), wanted)
    dipole = [design.D_Am2[:, fired]] if design.D_Am2 is not None and fired.size else []
    a = _check_weights(weights, len(design))
    only_b = options.parameters == "b"
    for field_nT in () if only_b else (design.H_nT, design.B_nT):
        observability.require_excitation(field_nT, dipole, fired, a)
    y, x = (design.B_nT - design.H_nT, []) if only_b else (design.B_nT, [design.H_nT, *dipole])
    x += [np.stack(list(design.columns.values()), axis=1)] if design.columns else []

    def refit(more: FloatArray) -> FloatArray:
        """Residuals (N, 3) of B = G A B0 + o + C D (or of B = A B0 + o) for given further weights."""
        fit = regress(y, x, a * more)
        return residuals(y, x, fit.M, fit.c)

    kept = rows_to_keep(design.B_nT - design.H_nT, refit, options.robust)
    if not kept.all():
        kept |= within_attitude_errors(refit(kept.astype(np.float64)), design.H_nT)
    observability.require_samples(int(kept.sum()), wanted)
    if noise is None:
        noise = reading_noise(design, refit(kept.astype(np.float64)), options.noise_nT, options.lsb_nT)
    a = a * kept
    problem = LinearProblem(design, options, fired, a / a.sum(), kept, noise)
    return _report(problem, _solve(problem), model_name, passes)


def _beside(
    design: Design, options: LinearOptions, value_nT: FloatArray, covariance: FloatArray, **given: Any
) -> LinearFit:
    """The regression of the reading without the fields (J, 3) of the design's columns; its covariance has their errors."""
    names = list(design.columns)
    fit = fit_design(_without(design, value_nT), options, **given)
    alike = replace(options, covariance="white", robust="none")

    def values(fields_nT: FloatArray) -> FloatArray:
        free = _without(design, fields_nT)
        return fit_design(free, alike, weights=fit.weights, noise=fit.noise).calibration.values

    sigma_nT = np.sqrt(np.diag(covariance)).reshape(value_nT.shape)
    steps = np.diag(sigma_nT.ravel()).reshape(-1, *value_nT.shape)
    here = values(value_nT)
    J = np.array([values(value_nT + step) - here for step in steps]) / sigma_nT.reshape(-1, 1)
    biases = {name: TelemetryBias(value_nT[k], sigma_nT[k]) for k, name in enumerate(names)}
    calibration = replace(
        fit.calibration,
        telemetry_bias=biases,
        covariance=fit.calibration.covariance + J.T @ covariance @ J,
        method=_method_words(options, names),
    )
    return replace(fit, calibration=calibration, driver_covariance=covariance)


def _without(design: Design, fields_nT: FloatArray) -> Design:
    """The reading without the fields (J, 3) of the design's columns."""
    stray = np.stack(list(design.columns.values()), axis=1) @ fields_nT
    return replace(design, B_nT=design.B_nT - stray, columns={})


def _weighted_fields(fit: LinearFit, design: Design) -> tuple[FloatArray, FloatArray]:
    """(J, 3) fields of the design's columns [nT a unit] and their covariance (3J, 3J), by the errors that the fit has found.

    The covariance is scaled up, never down, by the mean square of what is left over what was expected.
    """
    rows = np.flatnonzero(fit.kept)
    columns = np.stack(list(design.columns.values()), axis=1)
    unit = np.sqrt((columns**2).mean(axis=0))
    others = _others(fit, design)
    B_nT = (design.B_nT if fit.calibration.S.any() else design.B_nT - design.H_nT)[rows]
    gram = _products(fit, design, rows, [*others, *(columns / unit).T], B_nT[:, :, None])
    fixed = 3 * len(others)
    scale = np.sqrt(np.diag(gram)[:-1])
    inverse = np.linalg.inv(gram[:-1, :-1] / np.outer(scale, scale)) / np.outer(scale, scale)
    found = inverse @ gram[:-1, -1]
    misfit = (gram[-1, -1] - found @ gram[:-1, -1]) / max(3 * len(rows) - len(found), 1)
    per = np.repeat(1.0 / unit, 3)
    covariance = inverse[fixed:, fixed:] * np.outer(per, per) * max(misfit, 1.0)
    return (found[fixed:] * per).reshape(-1, 3), covariance


def _drops(
    design: Design, fit: LinearFit, of_fit: drivers.Columns, now: drivers.Columns, name: str, tried: FloatArray
) -> FloatArray:
    """(c,) by how much each of `tried` (n, c) lowers chi-square in the place of the column `name`; see `drivers.Drops`."""
    if fit.error_model is None:
        return np.zeros(tried.shape[1])
    rows = stretches(len(design), _SEARCHED)
    error = -fit.residuals_nT[rows] @ np.linalg.inv(np.eye(3) + fit.calibration.S).T
    fields = {one: bias.value_nT for one, bias in fit.calibration.telemetry_bias.items()}
    here, there = ({one: values[rows] for one, values in columns.items()} for columns in (of_fit, now))
    left_nT, far_nT, beyond = drivers.drawn_in(error, fit.kept[rows], fields, here, there, name, tried[rows])
    others = [*_others(fit, design), *(values for one, values in now.items() if one != name)]
    gram = _products(fit, design, rows, [*others, *tried.T], left_nT - far_nT)
    return drivers.drops_of(gram, 3 * len(others), beyond)


def _others(fit: LinearFit, design: Design) -> list[FloatArray]:
    """What is fitted beside the columns, each (N,)."""
    held = [np.ones(len(design))]
    if fit.calibration.S.any():
        held += list(design.H_nT.T)
    if design.D_Am2 is not None:
        held += [one for one in design.D_Am2.T if one.any()]
    return held


def _products(
    fit: LinearFit, design: Design, rows: np.ndarray, parts: list[FloatArray], y_nT: FloatArray
) -> FloatArray:
    """(q, q) whitened products in some rows: of three columns, one an axis, for each part (N,), and of what is fitted,
    y_nT (n, 3, t) in these rows."""
    from fluxtwin.calib.common.error_kernels import whitened_gram

    errors = fit.error_model
    assert errors is not None
    H, seconds = design.H_nT[rows], seconds_of(design.time[rows])
    columns = np.zeros((len(rows), 3, 3 * len(parts) + y_nT.shape[2]))
    for axis in range(3):
        columns[:, axis, axis : 3 * len(parts) : 3] = np.stack([part[rows] for part in parts], axis=1)
    columns[:, :, 3 * len(parts) :] = y_nT
    U = np.ascontiguousarray(np.linalg.inv(np.eye(3) + fit.calibration.S) @ of_turns(H))
    gap = np.diff(seconds, prepend=seconds[0])
    theta, tau = np.radians(errors.attitude_sigma_deg or 0.0), errors.attitude_tau_s
    sizes = (theta, tau, 0.0) if tau else (0.0, 1.0, theta)
    noise = np.broadcast_to(np.diag(errors.white_nT**2), (len(rows), 3, 3))
    gram = np.empty((columns.shape[2],) * 2)
    turned = np.einsum("kij,klj->kil", U, U)
    slow = (errors.slow_nT, max(errors.slow_tau_s, 1.0))
    whitened_gram(columns, U, np.ascontiguousarray(noise), turned, gap, np.zeros(len(rows)), (*sizes, *slow), gram)
    return gram


def _solve(problem: LinearProblem) -> Solution:
    solution = _regressed(problem, np.zeros(3))
    if problem.options.parameters == "b" or problem.options.errors_in_variables is False:
        return solution
    short = _shortening(problem, solution.residual_nT)
    return solution if short is None else _regressed(problem, short)


def _regressed(problem: LinearProblem, longer_nT: FloatArray) -> Solution:
    """longer_nT: (N, 3) or (3,) by how much errors of the attitude shorten the mean of the reference field."""
    design, (y, x) = problem.design, problem.sides
    # On the right side it is the true field given the reference that falls short.
    if problem.forward:
        fit = regress(y, [x[0] - longer_nT, *x[1:]], problem.weights)
    else:
        fit = regress(y + longer_nT, x, problem.weights)
    M, c, shift = fit.M, fit.c, np.zeros((3, 3))
    if problem.fits_S:
        # The reference on the right side carries none of the noise of the reading.
        sigma_nT, variance = float(np.sqrt(np.trace(fit.rr) / 3.0)), problem.noise.variance_nT2 * problem.linear
        observability.require_excitation(x[0], problem.dipole, problem.fired, problem.weights, variance, sigma_nT)
    if problem.noise_xx.any():
        step = _corrected(fit, problem.noise_xx)
        M, c, shift = fit.M + step, fit.c - step @ fit.mean_x, step[:, :3]
    own = residuals(y, x, M, c)
    calibration = _calibration(problem, M, c)
    true_side = own
    if problem.forward:
        true_side = design.H_nT - calibration.apply(design.B_nT, design.D_Am2, design.columns)
    return Solution(fit, M, c, calibration, true_side, own, shift)


def _corrected(fit: Regression, noise_xx: FloatArray) -> FloatArray:
    """What the correction for noise adds to the slopes (journal eqs. 5, 8; Fuller 1987).

    <y|x> (<x|x> - Sigma)^-1 = M + (M Sigma) (<x|x> - Sigma)^-1: so the digits of the regression are kept.
    """
    clean = fit.xx - noise_xx
    scale = np.sqrt(np.maximum(np.diag(clean), 1e-300))
    try:
        factor = cho_factor(clean / np.outer(scale, scale))
    except np.linalg.LinAlgError:
        raise NoAnswer(
            "the field varies by less than the noise of the reading in some body direction: S is not determined",
            evidence={"field_covariance_nT2": fit.xx[:3, :3].tolist()},
        ) from None
    return np.asarray(cho_solve(factor, (fit.M @ noise_xx / scale).T).T / scale)


def _shortening(problem: LinearProblem, residual_nT: FloatArray) -> FloatArray | None:
    """(N, 3) by how much an error of the attitude shortens what it turns: |r across|^2 / (2 |B0|) along the field.

    A turn keeps the length, so that the mean of the turned field falls short: S11 + S22 + S33 of half a degree by
    1e-4, many of its sigmas. What white noise adds to the square is off it; None where no more than that is there.
    """
    share = turned_rad2(problem, residual_nT)
    mean = float(problem.weights @ share)
    if mean < 3.0 * float(np.sqrt(problem.weights @ (share - mean) ** 2 / problem.effective)):
        return None
    return np.asarray(problem.design.H_nT * share[:, None])


def _calibration(problem: LinearProblem, M: FloatArray, c: FloatArray) -> Calibration:
    """S, b, T and the fields of drivers from slopes in the fitted direction."""
    columns = list(problem.design.columns)
    of_fields, of_drivers = np.hsplit(M, [M.shape[1] - len(columns)])
    T = np.zeros((3, 3))
    with_T = "T" in problem.options.parameters
    if problem.fits_S:
        T[:, problem.fired] = of_fields[:, 3:]
    if problem.forward:
        back = correction_from_forward(Forward(of_fields[:, :3], c, T))
        values = of_drivers / problem.driver_rms
    else:
        S = of_fields[:, :3] - np.eye(3) if problem.fits_S else np.zeros((3, 3))
        back = Correction(S, c, T)
        values = -np.linalg.inv(np.eye(3) + S) @ of_drivers / problem.driver_rms
    biases = {name: TelemetryBias(values[:, k], np.zeros(3)) for k, name in enumerate(columns)}
    return Calibration(back.S, back.b_nT, back.T_nT_per_Am2 if with_T else None, telemetry_bias=biases)


def _report(problem: LinearProblem, solution: Solution, model_name: str, passes: np.ndarray | None) -> LinearFit:
    design, options = problem.design, problem.options
    report = report_covariance(problem, solution, passes)
    covariance = report.covariance
    free = problem.effective / max(problem.effective - solution.M.shape[1] - 1, 1e-9)
    rejected = int((~problem.kept).sum())
    square = float(np.trace(problem.mean_square(solution.residual_nT))) / 3.0
    sigma_nT = float(np.sqrt(square * free))
    variation = observability.field_variation(design.B_nT, problem.weights)
    words = observability.never_fired_words(problem.fired) if design.D_Am2 is not None else []
    if options.parameters != "b":
        field_rms = float(np.sqrt(np.trace(problem.mean_square(design.B_nT))))
        words += observability.weak_direction_words(variation, covariance)
        words += observability.pair_words(covariance, "T" in options.parameters, field_rms, sigma_nT)
    sigmas = np.sqrt(np.diag(report.driver_covariance)).reshape(-1, 3)
    biases = solution.calibration.telemetry_bias.items()
    calibration = replace(
        solution.calibration,
        telemetry_bias={
            name: replace(bias, sigma_nT=sigma) for (name, bias), sigma in zip(biases, sigmas, strict=True)
        },
        covariance=covariance,
        covariance_kind=options.covariance,
        sigma_nT=sigma_nT,
        samples=len(design) - rejected,
        span=(design.time[0], design.time[-1]),
        field_model=model_name,
        method=_method_words(options, list(design.columns)),
        unobservable=tuple(words),
    )
    return LinearFit(
        calibration=calibration,
        method=options.method,
        time=design.time,
        residuals_nT=solution.residual_nT,
        weights=problem.weights,
        rows=design.rows,
        left_out=dict(design.left_out),
        rejected=rejected,
        variation=variation,
        noise=problem.noise,
        eiv_shift=solution.eiv_shift,
        messages=(*_messages(problem, solution, variation), *report.messages),
        error_model=report.errors,
        driver_covariance=report.driver_covariance,
    )


def _messages(problem: LinearProblem, solution: Solution, variation: observability.FieldVariation) -> tuple[str, ...]:
    out = [f"{amount(count, 'row|rows')} left out: {reason}" for reason, count in problem.design.left_out.items()]
    out.append(f"noise of the reading: {problem.noise.source}")
    if problem.options.corrects:
        out.append(
            "S corrected for the noise of the reading (errors in variables): largest change "
            f"{plain(float(np.abs(solution.eiv_shift).max()), 2)}"
        )
    if not problem.kept.all():
        out.append(outlier_words(problem.kept))
    if problem.options.parameters != "b":
        out.append(f"{variation.words()}; condition number {plain(variation.condition_number)}")
    return tuple(out)


def _method_words(options: LinearOptions, columns: Sequence[str]) -> str:
    parts = [f"{options.method} regression for {options.parameters}"]
    if columns:
        parts.append(f"field of {' and '.join(columns)} estimated")
    if options.corrects:
        parts.append("corrected for errors in variables")
    if options.robust != "none":
        parts.append("without outliers")
    return ", ".join(parts)


def _of_rows(values: np.ndarray | None, design: Design, name: str) -> np.ndarray | None:
    if values is None:
        return None
    array = np.asarray(values)
    total = len(design) + sum(design.left_out.values())
    if array.shape != (total,):
        raise BadInput(f"has shape {array.shape}", where=name, wanted=f"one entry for each of the {total} rows")
    return np.asarray(array[design.rows])


def _check_weights(weights: FloatArray | None, rows: int) -> FloatArray:
    """(N,) of sum 1, equal where none are given."""
    a = np.ones(rows) if weights is None else np.asarray(weights, dtype=np.float64)
    if a.shape != (rows,) or not np.isfinite(a).all() or (a < 0).any() or not a.sum() > 0:
        raise BadInput("a weight is negative, not finite, or all are zero", where="weights", wanted=f"{rows} weights")
    return np.asarray(a / a.sum())
