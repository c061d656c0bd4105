"""Calibration without attitude: the size of the field is all that is compared.

| method | what it is |
|---|---|
| `center` | b from differences of |B|^2 - |H|^2 (`twostep.center`) |
| `twostep` | Alonso & Shuster's b, or b and symmetric D, with the noise term corrected (`twostep`) |
| `scalar` | maximum likelihood of |B| (`maximum_likelihood`), from TWOSTEP; takes torquers and columns of telemetry |

A rotation of the magnetometer leaves |B| as it is: S is found up to one and given symmetric.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from fluxtwin.calib.common import drivers, observability
from fluxtwin.calib.common.conventions import PAIRS
from fluxtwin.calib.common.design import Design, joined
from fluxtwin.calib.common.error_model import white_errors
from fluxtwin.calib.common.fit import Fit, with_warnings
from fluxtwin.calib.common.noise import ReadingNoise, scalar_noise
from fluxtwin.calib.common.options import ScalarOptions
from fluxtwin.calib.common.records import Calibration, TelemetryBias
from fluxtwin.calib.common.robust import outlier_words
from fluxtwin.calib.scalar.covariance import Scores, field_error_covariance, scalar_covariance, scores_of
from fluxtwin.calib.scalar.model import (
    ScalarData,
    Solved,
    Sums,
    add_up,
    pack,
    residual,
    solve,
    unpack,
    without_outliers,
)
from fluxtwin.calib.scalar.observability import choose, other_solution, refuse_thin, require_meaning, require_observed
from fluxtwin.calib.scalar.rows import DIPOLES, ScalarProblem, assemble_scalar, make_problem
from fluxtwin.calib.scalar.twostep import center, center_terms, twostep
from fluxtwin.sim.base.errors import NoAnswer, amount
from fluxtwin.sim.base.types import BoolArray, FloatArray
from fluxtwin.sim.earth.field import FieldModel
from fluxtwin.sim.telemetry.record import Telemetry

NO_ROTATION = (
    "how the magnetometer is turned in the body: |B| does not show it. S is given symmetric, S12 = S21, S13 = S31, "
    "S23 = S32; its rotation is not in the sigmas"
)
_NAMES = {"center": "CENTER", "twostep": "TWOSTEP with the noise term corrected", "scalar": "scalar maximum likelihood"}
_MISSTATED = 1.25
_WORTH = 0.1
_CONSTANT = 0.05


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
    p: FloatArray, covariance: FloatArray, problem: ScalarProblem
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, dict[str, TelemetryBias]]:
    """From D, b, s of the scalar form: S (3, 3), b_nT (3,), T (3, 3) of journal eq. 1, their covariance, and other fields.

    The covariance is (21 + 3J, 21 + 3J), in the order of the calibration file, that of the other fields behind it.
    O = I: I + S = I + D, b = -b_A, T = -(I+D) s.
    """
    data, scale_nT, columns = problem.data, problem.scale_nT, problem.columns
    D, b, s = unpack(p, data)
    at = 6 if data.with_D else 0
    P, T = np.eye(3) + D, np.zeros((3, 3))
    jacobian = np.zeros((21 + 3 * len(problem.drivers), len(p)))
    for k, (i, j) in enumerate(PAIRS if data.with_D else ()):
        jacobian[3 * i + j, k] = jacobian[3 * j + i, k] = 1.0
    jacobian[9:12, at : at + 3] = -scale_nT * np.eye(3)
    row = 21
    for j, name in enumerate(columns):
        per, own = scale_nT / problem.units[j], slice(at + 3 + 3 * j, at + 6 + 3 * j)
        if name not in DIPOLES:
            jacobian[row : row + 3, own] = per * np.eye(3)
            row += 3
            continue
        axis = DIPOLES.index(name)
        T[:, axis] = -per * P @ s[j]
        rows = 12 + 3 * np.arange(3) + axis
        jacobian[rows, own] = -per * P
        for k, (m, n) in enumerate(PAIRS if data.with_D else ()):
            unit = np.zeros((3, 3))
            unit[m, n] = unit[n, m] = 1.0
            jacobian[rows, k] = -per * unit @ s[j]
    whole = jacobian @ covariance @ jacobian.T
    fields_nT = scale_nT / problem.units[:, None] * s
    sigmas_nT = np.sqrt(np.diag(whole)[21:]).reshape(-1, 3)
    biases = {
        name: TelemetryBias(fields_nT[columns.index(name)], sigma_nT)
        for name, sigma_nT in zip(problem.drivers, sigmas_nT, strict=True)
    }
    return D, -b * scale_nT, T, whole, biases


def calibrate_scalar(records: Telemetry | Sequence[Telemetry], model: FieldModel, **given: Any) -> ScalarFit:
    """Calibrate one or several records against |H| of `model`; no attitude is looked at.

    given: fields of `ScalarOptions`. Raises BadInput for unknown options and absent columns,
    OutOfRange for epochs outside the model, NoAnswer, naming the parameters and the null direction, when the data do not
    determine them or two solutions fit alike.
    """
    options = ScalarOptions(**given)
    telemetry = joined(records)
    asked = drivers.asked_for(telemetry, options.driver)
    rows = assemble_scalar(telemetry, model, with_dipole="T" in options.parameters, drivers=asked.columns)
    labels = None if options.passes is None else np.asarray(options.passes)[rows.rows]
    own = {name: values for name, values in rows.columns.items() if name not in asked.columns}

    def by(columns: drivers.Columns) -> ScalarFit:
        return fit_rows(replace(rows, columns={**own, **columns}), options, model_name=model.name, passes=labels)

    def drops(
        fit: ScalarFit, of_fit: drivers.Columns, now: drivers.Columns, name: str, tried: FloatArray
    ) -> FloatArray:
        return _drops(fit, replace(rows, columns={**own, **of_fit}), {**own, **now}, name, tried)

    field = rows.B_nT if options.parameters != "b" else np.zeros((len(rows), 0))
    fit = drivers.fitted(asked, rows.rows, np.column_stack([field, *own.values()]), by, drops)
    return with_warnings(fit, telemetry, robust=options.robust != "none")


def _drops(fit: ScalarFit, rows: Design, now: drivers.Columns, name: str, tried: FloatArray) -> FloatArray:
    """(c,) by how much each of `tried` (n, c) lowers chi-square in the place of the column `name`; see `drivers.Drops`.

    |B| is taken as a linear function of the parameters about the fit: a turn of the field by a column does not show. Errors
    of the field model, which last, count as fewer rows.
    """
    known, kept = fit.calibration, fit.kept
    true = known.apply(rows.B_nT, np.zeros_like(rows.B_nT), rows.columns)
    along = (true / np.linalg.norm(true, axis=1)[:, None]) @ (np.eye(3) + known.S)
    fields = {one: along @ bias.value_nT[:, None] for one, bias in known.telemetry_bias.items()}
    y, far, beyond = drivers.drawn_in(fit.residuals_nT, kept, fields, rows.columns, now, name, tried)
    others = [np.ones(len(rows)), *(values for one, values in now.items() if one != name)]
    if known.S.any():
        others += list(rows.B_nT.T)
    parts = [along * part[:, None] for part in [*others, *tried.T]]
    seen = np.column_stack([*parts, (y - far)[:, 0]])
    step_s = float(np.median(np.diff(fit.time).astype("int64"))) * 1e-9
    memory = max(2.0 * fit.statistics.correlation_time_s / step_s, 1.0)
    left = float((fit.residuals_nT[kept] ** 2).mean())
    return drivers.drops_of(seen.T @ seen / (left * memory), 3 * len(others), beyond / memory)


def fit_rows(
    rows: Design, options: ScalarOptions, *, model_name: str = "", passes: np.ndarray | None = None
) -> ScalarFit:
    """The calibration of rows that are already assembled; arguments and errors as `calibrate_scalar`."""
    problem = make_problem(rows, options)
    start = pack(np.zeros((3, 3)), center(problem.data), problem.data)
    require_observed(add_up(start, problem.data, noise=True), problem)
    solved, kept = _first(problem, start)
    observability.require_samples(int(kept.sum()), problem.data.size + 1)
    a = kept.astype(np.float64)
    noise = scalar_noise(
        rows.B_nT, rows.time, residual(solved.p, problem.data) * problem.scale_nT, options.noise_nT, options.lsb_nT
    )
    problem, first = problem.with_noise(noise), solved
    try:
        solved, notes = _estimate(problem, first, a)
    except NoAnswer:
        for p in (start, first.p):  # says more where it applies
            require_observed(add_up(p, problem.data, noise=True), problem, over_noise=10.0)
        refuse_thin(add_up(start, problem.data), problem)
        raise
    inflation = solved.sums.cost / max(float(a.sum()) - problem.data.size, 1.0)
    scores = _scores(problem, solved, a)
    if options.method == "center":
        require_observed(_center_sums(problem, solved), problem, max(inflation, 1.0))
    else:
        sums = add_up(solved.p, problem.data, a, noise=True)
        require_observed(sums, problem, inflation if options.noise_nT is None else max(inflation, 1.0))
        polished = solve(solved.p, problem.data, a) if options.method == "twostep" else solved
        mirrored = other_solution(polished, problem.data, a)
        if mirrored is not None:
            better, sentence = choose(polished, mirrored, problem, inflation)
            solved = solved if better is polished else better
            scores = _scores(problem, solved, a)
            notes.append(sentence)
        settled = options.robust != "none" and solved.converged
        require_meaning(solved, problem, robust=settled)
    return _report(problem, solved, scores, noise, kept, inflation, notes, model_name, passes)


def _first(problem: ScalarProblem, start: FloatArray) -> tuple[Solved, BoolArray]:
    """A solution before the noise is known, and the rows (N,) that are no outliers."""
    data = problem.data
    size = np.sqrt((data.B**2).sum(axis=1))
    p, kept = without_outliers(start, data, (size - data.H)[:, None], problem.options.robust)
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
        notes.append(_trivial(data))
    if method == "twostep":
        if not step.converged:
            raise NoAnswer(_not_settled("TWOSTEP"), evidence={"b_nT": (-step.b * problem.scale_nT).tolist()})
        p = pack(step.D, step.b, data)
        return Solved(p, add_up(p, data, a), True, 1), notes
    found = [solve(first.p, data, a)]
    if step.converged:
        found.append(solve(pack(step.D, step.b, data), data, a))
    settled = [one for one in found if one.converged]
    if not settled:
        raise NoAnswer(_not_settled("the search"), evidence={"parameters": found[0].p.tolist()})
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
    messages = [*_messages(problem, noise, inflation), *notes, how_found]
    if options.field_error_nT:
        covariance = covariance + field_error_covariance(
            scores, rows.time, options.field_error_nT / problem.scale_nT, rows.radian_s
        )
        messages.append(
            f"field model taken as wrong by {options.field_error_nT:.4g} nT rms in |H| with a memory of "
            f"{rows.radian_s:.0f} s, a radian of the orbit"
        )
    if not data.with_D:
        messages += _missing_S(solved, data, inflation)
    if not kept.all():
        messages.append(outlier_words(kept))
    S, b_nT, T, whole, biases = file_parameters(solved.p, covariance, problem)
    with_T = "T" in options.parameters
    residuals_nT = (r * problem.scale_nT)[:, None]
    sigma_nT = float(np.sqrt((residuals_nT[kept] ** 2).sum() / max(int(kept.sum()) - data.size, 1)))
    unobservable = [
        NO_ROTATION,
        *_never_fired(problem),
        *observability.relative_pair_words(covariance, problem.names, 1e-3),
    ]
    calibration = Calibration(
        S=S,
        b_nT=b_nT,
        T_nT_per_Am2=T if with_T else None,
        covariance=whole[:21, :21] if with_T else whole[:12, :12],
        covariance_kind=options.covariance,
        sigma_nT=sigma_nT,
        samples=int(kept.sum()),
        span=(rows.time[0], rows.time[-1]),
        field_model=model_name,
        method=_method_words(problem),
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
        messages=tuple(messages),
        error_model=white_errors(noise.variance_nT2, declared=options.noise_nT is not None),
        driver_covariance=whole[21:, 21:],
        quality={
            "chi2_per_sample": inflation,
            "field_size_variation": problem.geometry.constant_share,
            "rounds": solved.rounds,
        },
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


def _method_words(problem: ScalarProblem) -> str:
    """One line for the calibration file."""
    parts = [f"{_NAMES[problem.options.method]} for {problem.options.parameters}, without attitude"]
    if problem.drivers:
        parts.append("field of " + " and ".join(problem.drivers) + " estimated")
    if problem.options.robust != "none":
        parts.append("without outliers")
    return ", ".join(parts)


def _messages(problem: ScalarProblem, noise: ReadingNoise, inflation: float) -> list[str]:
    """Rows left out, the noise, and what the residual says of it."""
    rows = problem.rows
    out = [f"{amount(count, 'row|rows')} left out: {reason}" for reason, count in rows.left_out.items()]
    out.append(f"noise of the reading: {noise.source}")
    ratio = float(np.sqrt(inflation))
    sure = 4.0 / np.sqrt(2.0 * max(len(rows), 1))
    if not 1.0 / _MISSTATED < ratio < _MISSTATED and abs(ratio - 1.0) > sure:
        reason = "the declared noise is wrong, or something is not modelled"
        if problem.options.noise_nT is None:
            reason = "the rest lasts longer than a sample: the field model, currents, temperature or S may be wrong"
        shift = 3.0 * abs(ratio**2 - 1.0) * noise.variance_nT2.mean() / float((rows.H_nT**2).mean())
        out.append(
            f"the residual of |B| is {ratio:.3g} times what the noise gives: {reason}. The sigmas follow the residual; "
            f"were all of it noise of the reading, S would be off by {shift:.1g}"
        )
    if problem.drivers:
        out.append(f"b is for {' and '.join(problem.drivers)} at zero")
    return out


def _missing_S(solved: Solved, data: ScalarData, inflation: float) -> list[str]:
    """A sentence where scale and non-orthogonality, not estimated, are in the residual."""
    full = data._replace(with_D=True, columns=data.columns[:, :0])
    sums = add_up(pack(np.zeros((3, 3)), solved.p[:3], full), full)
    gain = float(sums.score @ np.linalg.lstsq(sums.information, sums.score, rcond=1e-12)[0])
    share = gain / max(sums.cost, 1e-300)
    if share < _WORTH or gain / max(inflation, 1.0) < 50.0:
        return []
    return [
        f"S is not estimated, and would take {share:.0%} of the variance of the residual: b then holds about S times the "
        "mean reading and moves from pass to pass. Compare with --parameters b,S"
    ]


def _trivial(data: ScalarData) -> str:
    """Where the centred equations are of no use."""
    share = float(np.std(data.H) / np.mean(data.H))
    reason = "|H| is nearly constant" if share < _CONSTANT else "the directions of the field are few"
    return (
        f"{reason} (|H| varies by {max(100.0 * share, 1e-6):.2g} % rms): the centred equations tend to the solution "
        "S = -I that means nothing; the start was CENTER's bias instead"
    )


def _not_settled(what: str) -> str:
    """A search without an end."""
    return (
        f"{what} does not settle: |B| and |H| disagree by more than a magnetometer can. Unit, position or time may be "
        "wrong (run `fluxtwin check`), or the readings keep too close to a plane"
    )


def _never_fired(problem: ScalarProblem) -> list[str]:
    """Columns that are zero throughout."""
    out = []
    for name in problem.rows.columns:
        if name not in problem.columns:
            axis = DIPOLES.index(name) + 1 if name in DIPOLES else 0
            what = f"T1{axis}, T2{axis} and T3{axis}" if axis else f"the field of {name}"
            out.append(f"{what} not estimated: {name} is zero throughout these data")
    return out
