"""Calibration without attitude: the size of the field is all that is compared.

| method | what it is |
|---|---|
| `center` | b from differences of |B|^2 - |H|^2 (`twostep.center`) |
| `twostep` | Alonso & Shuster's b, or b and symmetric D, with the noise term corrected (`twostep`) |
| `scalar` | maximum likelihood of |B| (`maximum_likelihood`), from TWOSTEP; takes torquers and columns of telemetry |

A rotation of the magnetometer leaves |B| as it is: S is found up to one and given symmetric.

The answer of a calibration without attitude: from D, b, s of the scalar form to S, b, T of journal eq. 1.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np

from fluxtwin.calib.common import drivers, observability
from fluxtwin.calib.common.conventions import PAIRS
from fluxtwin.calib.common.design import joined
from fluxtwin.calib.common.fit import Fit, with_warnings
from fluxtwin.calib.common.noise import ReadingNoise, scalar_noise
from fluxtwin.calib.common.options import ScalarOptions
from fluxtwin.calib.common.records import Calibration, TelemetryBias
from fluxtwin.calib.common.residuals import residual_statistics
from fluxtwin.calib.common.robust import outlier_words, rows_to_keep
from fluxtwin.calib.common.verdict import kept_rows
from fluxtwin.calib.scalar import words
from fluxtwin.calib.scalar.covariance import Scores, field_error_covariance, scalar_covariance, scores_of
from fluxtwin.calib.scalar.maximum_likelihood import Solved, Sums, add_up, solve
from fluxtwin.calib.scalar.model import ScalarData, pack, residual, unpack
from fluxtwin.calib.scalar.observability import (
    Geometry,
    choose,
    geometry,
    other_solution,
    parameter_words,
    refuse_thin,
    require_meaning,
    require_observed,
)
from fluxtwin.calib.scalar.rows import ScalarRows, assemble_scalar
from fluxtwin.calib.scalar.twostep import center, center_terms, twostep
from fluxtwin.sim.base.errors import NoAnswer
from fluxtwin.sim.base.types import BoolArray, FloatArray
from fluxtwin.sim.earth.field import FieldModel
from fluxtwin.sim.telemetry.record import Telemetry

NO_ROTATION = (
    "how the magnetometer is turned in the body: |B| does not show it. S is given symmetric, S12 = S21, S13 = S31, "
    "S23 = S32; its rotation is not in the sigmas"
)
_DIPOLES = ("dipole_x_Am2", "dipole_y_Am2", "dipole_z_Am2")
_SMALL = 1e-6
"""Noise in parts of the field, before it is known."""


@dataclass(frozen=True, kw_only=True)
class ScalarFit(Fit):
    """What the methods without attitude add to the record of every method."""

    quality: Mapping[str, float] = field(default_factory=dict)
    """`chi2_per_sample`: mean of r^2/q; `field_size_variation`: rms of |H| over its mean; `rounds` of the search."""

    def to_dict(self) -> dict[str, Any]:
        """Plain numbers and text for JSON; no NaN."""
        biases = self.calibration.to_dict().get("telemetry_bias", {})
        return {**super().to_dict(), "telemetry_bias": biases, "quality": dict(self.quality)}


def file_parameters(
    p: FloatArray,
    covariance: FloatArray,
    data: ScalarData,
    columns: tuple[str, ...],
    scale_nT: float,
    units: FloatArray,
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, dict[str, TelemetryBias]]:
    """S (3, 3), b_nT (3,), T (3, 3), their covariance (21, 21) in the order of the calibration file, and other fields.

    O = I: I + S = I + D, b = -b_A, T = -(I+D) s. units: (J,) rms of the columns that they were scaled by.
    """
    D, b, s = unpack(p, data)
    sigma_s = np.sqrt(np.diag(covariance))[(6 if data.with_D else 0) + 3 :].reshape(-1, 3)
    biases = {}
    P = np.eye(3) + D
    T = np.zeros((3, 3))
    jacobian = np.zeros((21, len(p)))
    at = 0
    if data.with_D:
        for k, (i, j) in enumerate(PAIRS):
            jacobian[3 * i + j, k] = jacobian[3 * j + i, k] = 1.0
        at = 6
    jacobian[9:12, at : at + 3] = -scale_nT * np.eye(3)
    for j, name in enumerate(columns):
        per = scale_nT / units[j]
        if name not in _DIPOLES:
            biases[name] = TelemetryBias(s[j] * per, sigma_s[j] * per)
            continue
        axis = _DIPOLES.index(name)
        T[:, axis] = -per * P @ s[j]
        rows = 12 + 3 * np.arange(3) + axis
        jacobian[rows, at + 3 + 3 * j : at + 6 + 3 * j] = -per * P
        if data.with_D:
            for k, (m, n) in enumerate(PAIRS):
                unit = np.zeros((3, 3))
                unit[m, n] = unit[n, m] = 1.0
                jacobian[rows, k] = -per * unit @ s[j]
    return D, -b * scale_nT, T, jacobian @ covariance @ jacobian.T, biases


def driver_covariance(
    covariance: FloatArray, data: ScalarData, columns: tuple[str, ...], scale_nT: float, units: FloatArray
) -> FloatArray:
    """(3J, 3J) of the fields that follow columns other than the dipole; arguments as `file_parameters`."""
    own = [j for j, name in enumerate(columns) if name not in _DIPOLES]
    start = (6 if data.with_D else 0) + 3
    place = np.array([start + 3 * j + axis for j in own for axis in range(3)], dtype=int)
    per = np.repeat(scale_nT / units[own], 3)
    return np.asarray(np.outer(per, per) * covariance[np.ix_(place, place)])


class ScalarProblem(NamedTuple):
    """The rows at work, without units."""

    rows: ScalarRows
    options: ScalarOptions
    data: ScalarData
    scale_nT: float
    """rms |H|, the unit."""
    columns: tuple[str, ...]
    rms_of: dict[str, float]
    """rms of each column that was used."""
    never_fired: tuple[str, ...]

    @property
    def names(self) -> tuple[str, ...]:
        """(p,) parameters."""
        return parameter_words(self.data, self.columns)

    def with_noise(self, noise: ReadingNoise) -> ScalarProblem:
        """The same with Sigma known."""
        least = (_SMALL * self.scale_nT) ** 2
        Sigma = np.diag(np.maximum(noise.variance_nT2, least)) / self.scale_nT**2
        return self._replace(data=self.data._replace(Sigma=Sigma))


def calibrate_scalar(
    records: Telemetry | Sequence[Telemetry], model: FieldModel, options: ScalarOptions | None = None, **given: Any
) -> ScalarFit:
    """Calibrate one or several records against |H| of `model`; no attitude is looked at.

    given: fields of `ScalarOptions`, where no options are. Raises BadInput for unknown options and absent columns,
    OutOfRange for epochs outside the model, NoAnswer, naming the parameters and the null direction, when the data do not
    determine them or two solutions fit alike.
    """
    options = ScalarOptions(**given) if options is None else options
    telemetry = joined(records)
    asked = drivers.asked_for(telemetry, [*options.driver, *options.telemetry_bias])
    rows = assemble_scalar(telemetry, model, with_dipole="T" in options.parameters, drivers=asked.columns)
    labels = None if options.passes is None else np.asarray(options.passes)[rows.rows]
    own = {name: values for name, values in rows.columns.items() if name not in asked.columns}

    def by(columns: drivers.Columns) -> ScalarFit:
        return fit_rows(replace(rows, columns={**own, **columns}), options, model_name=model.name, passes=labels)

    def drops(fit: ScalarFit, columns: drivers.Columns, name: str, tried: FloatArray) -> FloatArray:
        return _drops(fit, replace(rows, columns={**own, **columns}), name, tried)

    field = rows.B_nT if options.parameters != "b" else np.zeros((len(rows), 0))
    fit = drivers.fitted(asked, rows.rows, np.column_stack([field, *own.values()]), by, drops)
    return with_warnings(fit, telemetry, robust=options.robust != "none")


def _drops(fit: ScalarFit, rows: ScalarRows, name: str, tried: FloatArray) -> FloatArray:
    """(c,) by how much each of `tried` (n, c) lowers chi-square in the place of the column `name`; see `drivers.Drops`.

    |B| is taken as a linear function of the parameters about the fit: a turn of the field by a column does not show. Errors
    of the field model, which last, count as fewer rows.
    """
    known, kept = fit.calibration, kept_rows(fit.weights)
    true = known.apply(rows.B_nT, np.zeros_like(rows.B_nT), rows.columns)
    along = (true / np.linalg.norm(true, axis=1)[:, None]) @ (np.eye(3) + known.S)
    y = (fit.residuals_nT - drivers.drawn_in(fit.residuals_nT, kept))[:, 0]
    y += rows.columns[name] * (along @ known.telemetry_bias[name].value_nT)
    others = [np.ones(len(rows)), *(values for one, values in rows.columns.items() if one != name)]
    if known.S.any():
        others += list(rows.B_nT.T)
    parts = [along * part[:, None] for part in [*others, *tried.T]]
    seen = np.column_stack([*parts, y])
    step_s = float(np.median(np.diff(fit.time).astype("int64"))) * 1e-9
    memory = max(2.0 * fit.statistics.correlation_time_s / step_s, 1.0)
    left = float((fit.residuals_nT[kept] ** 2).mean())
    return drivers.drops_of(seen.T @ seen / (left * memory), 3 * len(others), 3)


def fit_rows(
    rows: ScalarRows, options: ScalarOptions, *, model_name: str = "", passes: np.ndarray | None = None
) -> ScalarFit:
    """The calibration of rows that are already assembled; arguments and errors as `calibrate_scalar`."""
    problem = make_problem(rows, options)
    how = geometry(problem.data, problem.scale_nT)
    start = pack(np.zeros((3, 3)), center(problem.data), problem.data)
    require_observed(add_up(start, problem.data, noise=True), problem.names, how)
    solved, kept = _first(problem, start)
    observability.require_samples(int(kept.sum()), problem.data.size + 1)
    a = kept.astype(np.float64)
    noise = scalar_noise(
        rows.B_nT, rows.time, residual(solved.p, problem.data) * problem.scale_nT, options.noise_nT, options.lsb_nT
    )
    problem = problem.with_noise(noise)
    how = geometry(problem.data, problem.scale_nT)
    first = solved
    try:
        solved, notes = _estimate(problem, first, a)
    except NoAnswer:
        for p in (start, first.p):  # says more where it applies
            require_observed(add_up(p, problem.data, noise=True), problem.names, how, over_noise=10.0)
        refuse_thin(add_up(start, problem.data), problem.names, how)
        raise
    inflation = solved.sums.cost / max(float(a.sum()) - problem.data.size, 1.0)
    scores = _scores(problem, solved, a)
    if options.method == "center":
        require_observed(_center_sums(problem, solved), problem.names, how, max(inflation, 1.0))
    else:
        sums = add_up(solved.p, problem.data, a, noise=True)
        require_observed(sums, problem.names, how, inflation if options.noise_nT is None else max(inflation, 1.0))
        polished = solve(solved.p, problem.data, a) if options.method == "twostep" else solved
        mirrored = other_solution(polished, problem.data, a)
        if mirrored is not None:
            better, sentence = choose(polished, mirrored, problem.data, problem.names, problem.scale_nT, inflation, how)
            solved = solved if better is polished else better
            scores = _scores(problem, solved, a)
            notes.append(sentence)
        settled = options.robust != "none" and solved.converged
        require_meaning(solved, problem.data, problem.names, how, problem.scale_nT, robust=settled)
    return _report(problem, solved, scores, noise, kept, how, inflation, notes, model_name, passes)


def make_problem(rows: ScalarRows, options: ScalarOptions) -> ScalarProblem:
    """Scale the rows; columns that are zero throughout are dropped."""
    scale = float(np.sqrt((rows.H_nT**2).mean()))
    rms = {name: float(np.sqrt((values**2).mean())) for name, values in rows.columns.items()}
    columns = tuple(name for name, size in rms.items() if size > 0)
    used = (
        np.stack([rows.columns[name] / rms[name] for name in columns], axis=1) if columns else np.zeros((len(rows), 0))
    )
    data = ScalarData(rows.B_nT / scale, rows.H_nT / scale, used, _SMALL**2 * np.eye(3), options.parameters != "b")
    observability.require_samples(len(rows), data.size + 1)
    if not (data.B**2).sum() > 0:
        raise NoAnswer("the magnetometer reads zero throughout: nothing can be calibrated", evidence={})
    dead = tuple(name for name in rms if rms[name] == 0)
    return ScalarProblem(rows, options, data, scale, columns, rms, dead)


def _first(problem: ScalarProblem, start: FloatArray) -> tuple[Solved, BoolArray]:
    """A solution before the noise is known, and the rows (N,) that are no outliers."""
    data, p = problem.data, start

    def refit(weights: FloatArray) -> FloatArray:
        nonlocal p
        p = solve(p, data, weights, adjusted=False).p
        return residual(p, data)[:, None]

    size = np.sqrt((data.B**2).sum(axis=1))
    kept = rows_to_keep((size - data.H)[:, None], refit, problem.options.robust)
    return solve(p, data, kept.astype(np.float64), adjusted=False), kept


def _estimate(problem: ScalarProblem, first: Solved, a: FloatArray) -> tuple[Solved, list[str]]:
    """The method's own answer, with what is to be said about the way to it."""
    data, method = problem.data, problem.options.method
    if method == "center":
        p = center(data, a)
        return Solved(p, add_up(p, data, a), True, 1), []
    notes = []
    step = twostep(data._replace(columns=data.columns[:, :0]), a)
    if data.with_D and step.centred_eigenvalue < 0.5:
        notes.append(words.trivial(data))
    if method == "twostep":
        if not step.converged:
            raise NoAnswer(words.not_settled("TWOSTEP"), evidence={"b_nT": (-step.b * problem.scale_nT).tolist()})
        p = pack(step.D, step.b, data)
        return Solved(p, add_up(p, data, a), True, 1), notes
    found = [solve(first.p, data, a)]
    if step.converged:
        found.append(solve(pack(step.D, step.b, data), data, a))
    settled = [one for one in found if one.converged]
    if not settled:
        raise NoAnswer(words.not_settled("the search"), evidence={"parameters": found[0].p.tolist()})
    return min(settled, key=lambda one: one.sums.cost), notes


def _scores(problem: ScalarProblem, solved: Solved, a: FloatArray) -> Scores:
    if problem.options.method == "center":
        rows, slope, half = center_terms(solved.p, problem.data, a)
        far = -2.0 * half * (a * problem.data.H)[:, None]
        return Scores(rows, slope, far, np.sqrt(a)[:, None] * half)
    return scores_of(solved, problem.data, a)


def _center_sums(problem: ScalarProblem, solved: Solved) -> Sums:
    """CENTER's information: that of differences alone."""
    data = problem.data
    weight = 1.0 / float((4.0 * data.H**2).mean() * np.trace(data.Sigma) / 3.0)
    _, slope, _ = center_terms(solved.p, data)
    return solved.sums._replace(information=slope * weight, from_noise=4.0 * len(data.H) * weight * data.Sigma)


def _report(
    problem: ScalarProblem,
    solved: Solved,
    scores: Scores,
    noise: ReadingNoise,
    kept: BoolArray,
    how: Geometry,
    inflation: float,
    notes: list[str],
    model_name: str,
    passes: np.ndarray | None,
) -> ScalarFit:
    rows, options, data = problem.rows, problem.options, problem.data
    r = residual(solved.p, data)
    covariance, how_found = scalar_covariance(
        scores, r, rows.time, options.covariance, passes=passes, block_s=options.block_s
    )
    covariance = covariance + _from_noise(problem, scores, solved, noise)
    messages = words.messages(rows, noise, options, inflation, problem.columns)
    messages += [*notes, how_found]
    if options.field_error_nT:
        covariance = covariance + field_error_covariance(
            scores, rows.time, options.field_error_nT / problem.scale_nT, rows.radian_s
        )
        messages.append(words.field_error(options.field_error_nT, rows.radian_s))
    if not data.with_D:
        messages += words.missing_S(solved, data, inflation)
    if not kept.all():
        messages.append(outlier_words(kept))
    units = np.array([problem.rms_of[name] for name in problem.columns])
    S, b_nT, T, whole, biases = file_parameters(solved.p, covariance, data, problem.columns, problem.scale_nT, units)
    with_T = "T" in options.parameters
    residuals_nT = (r * problem.scale_nT)[:, None]
    sigma_nT = float(np.sqrt((residuals_nT[kept] ** 2).sum() / max(int(kept.sum()) - data.size, 1)))
    unobservable = [
        NO_ROTATION,
        *words.never_fired(problem.never_fired),
        *observability.relative_pair_words(covariance, problem.names, 1e-3),
    ]
    calibration = Calibration(
        S=S,
        b_nT=b_nT,
        T_nT_per_Am2=T if with_T else None,
        covariance=whole if with_T else whole[:12, :12],
        covariance_kind=options.covariance,
        sigma_nT=sigma_nT,
        samples=int(kept.sum()),
        span=(rows.time[0], rows.time[-1]),
        field_model=model_name,
        method=words.method(options, problem.columns),
        unobservable=tuple(unobservable),
        telemetry_bias=biases,
    )
    return ScalarFit(
        calibration=calibration,
        method=options.method,
        time=rows.time,
        residuals_nT=residuals_nT,
        weights=kept / kept.sum(),
        rows=rows.rows,
        left_out=dict(rows.left_out),
        rejected=int((~kept).sum()),
        variation=observability.field_variation(rows.B_nT),
        noise=noise,
        statistics=residual_statistics(rows.time[kept], residuals_nT[kept]),
        messages=tuple(messages),
        error_model=words.errors(noise, options.noise_nT is not None),
        driver_covariance=driver_covariance(covariance, data, problem.columns, problem.scale_nT, units),
        quality={"chi2_per_sample": inflation, "field_size_variation": how.constant_share, "rounds": solved.rounds},
    )


def _from_noise(problem: ScalarProblem, scores: Scores, solved: Solved, noise: ReadingNoise) -> FloatArray:
    """What an uncertain Sigma adds: the adjustment is in proportion to it."""
    if not noise.covariance.any() or problem.options.method == "center":
        return np.zeros_like(scores.slope)
    relative = float(np.sqrt(np.trace(noise.covariance) / 3.0) / max(noise.variance_nT2.mean(), 1e-300))
    mean_r = problem.data._replace(Sigma=2.0 * problem.data.Sigma)
    # The residual's own mean moves by tr_perp / 2|H|, the score by its share of noise.
    shift = add_up(solved.p, mean_r).score * 2.0 - solved.sums.score - solved.sums.shared
    moved = np.linalg.solve(scores.slope, shift) * relative
    return np.asarray(np.outer(moved, moved))
