"""Calibration of a tumbler after launch, from its gyro and magnetometer: `calibrate_gyro`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.stats import chi2

from fluxtwin.calib.common import drivers, observability
from fluxtwin.calib.common.design import complete_rows, joined
from fluxtwin.calib.common.digits import measured, plain
from fluxtwin.calib.common.fit import Fit, with_warnings
from fluxtwin.calib.common.noise import ReadingNoise, per_axis
from fluxtwin.calib.common.options import GyroOptions
from fluxtwin.calib.common.records import Calibration, TelemetryBias
from fluxtwin.calib.common.robust import rows_to_keep
from fluxtwin.calib.common.words import say
from fluxtwin.calib.gyro.solve import LARGEST_TURN_RAD, GyroRows, Solved, cut, drops, fields_without_errors, solve
from fluxtwin.sim.base.errors import BadInput, NoAnswer
from fluxtwin.sim.base.random_streams import stream
from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.earth.field import FieldModel
from fluxtwin.sim.telemetry.record import Telemetry

_LENGTHS_S = (600.0, 300.0, 150.0, 75.0, 40.0, 20.0, 10.0, 5.0, 2.0)
_FEWEST = 3
"""Stretches that are needed."""
_MOST_ROWS = 120
_WORST_S = 0.02
"""Sigma of an element of S: magnetometers are made to a few percent, and a weaker combination is moved by noise as much."""
_COLLAPSED = 0.3
"""Share of the reading that must be left: a body that does not turn reads a field like a bias, and b = -B fits it."""
_SLOW = 30.0
"""Rates in noises of a rate: below, answers were seen that are wrong by many of their sigmas."""
_PERTURBED = 2.0  # noises of the gyro, in the trial with a magnetometer without errors
_REPEATED = float(chi2.ppf(0.999, 3))


@dataclass(frozen=True, kw_only=True)
class GyroFit(Fit):
    """What this method adds to the record of every method."""

    seen: GyroRows
    solved: Solved


def calibrate_gyro(records: Telemetry | Sequence[Telemetry], model: FieldModel, **given: Any) -> GyroFit:
    """S (of trace zero) and b from readings and body rates; the field model, positions and attitude are not looked at.

    Raises BadInput where the telemetry has no rates, NoAnswer where too few rows follow each other closely enough, or the
    body turned so little that b is not determined, with the direction.
    """
    options = GyroOptions(**given)
    telemetry = joined(records)
    rates = telemetry.rate_B_rad_s
    if rates is None:
        raise BadInput(
            "the telemetry has no body rates",
            where="rate_x_rad_s rate_y_rad_s rate_z_rad_s",
            wanted="the gyro's columns",
        )
    asked = drivers.asked_for(telemetry, options.driver)
    needs = {"no reading": telemetry.has_reading, "no rate": np.asarray(np.isfinite(rates).all(axis=1))}
    needs |= {f"no {name}": np.asarray(np.isfinite(column)) for name, column in asked.columns.items()}
    rows, left_out = complete_rows(needs, "by gyro needs readings, body rates and drivers in the same rows")
    used = telemetry.select(rows)

    def by(columns: drivers.Columns) -> GyroFit:
        return _fit(telemetry, used, rows, columns, options, left_out)

    def late(fit: GyroFit, of_fit: drivers.Columns, now: drivers.Columns, name: str, tried: FloatArray) -> FloatArray:
        others = _stacked({one: values for one, values in now.items() if one != name}, len(used))
        rows = fit.seen.in_stretches
        here, there = ({one: values[rows] for one, values in columns.items()} for columns in (of_fit, now))
        error = -fit.residuals_nT @ np.linalg.inv(np.eye(3) + fit.solved.S).T
        fields = {one: bias.value_nT for one, bias in fit.calibration.telemetry_bias.items()}
        _, far_nT, beyond = drivers.drawn_in(error, fit.kept, fields, here, there, name, tried[rows])
        return drops(fit.seen, fit.solved, others, tried, far_nT, beyond)

    others = used.mag_B_nT if options.parameters != "b" else np.zeros((len(used), 0))
    return drivers.fitted(asked, rows, others, by, late)


def _stacked(columns: drivers.Columns, rows: int) -> FloatArray:
    """(rows, J) the columns side by side."""
    return np.array([*columns.values()]).reshape(len(columns), rows).T


def _fit(
    telemetry: Telemetry,
    used: Telemetry,
    rows: np.ndarray,
    columns: drivers.Columns,
    options: GyroOptions,
    left_out: Mapping[str, int],
) -> GyroFit:
    """The fit to these rows of the telemetry, with the fields of columns (n,)."""
    seen, solved, weights = _best(used, _stacked(columns, len(used)), options)
    _require_turns(seen, solved)
    in_stretch, residual_nT = seen.in_stretches, solved.residual_nT
    w = weights[in_stretch]
    kept = w > 0.0
    noise = _noise(options, solved.variance_nT2)
    beside = f", field of {' and '.join(columns)} estimated" if columns else ""
    fields_sigma_nT = np.sqrt(np.diag(solved.fields_covariance)).reshape(-1, 3)
    calibration = Calibration(
        S=solved.S,
        b_nT=solved.b_nT,
        covariance=solved.covariance,
        covariance_kind="blocks",
        sigma_nT=float(np.sqrt((residual_nT[kept] ** 2).mean())),
        samples=int(kept.sum()),
        span=(used.time[in_stretch[0]], used.time[in_stretch[-1]]),
        field_model="none",
        method=f"gyro and magnetometer alone, for {options.parameters}{beside}",
        unobservable=(say("gyro.S_not_estimated") if options.parameters == "b" else say("gyro.no_scale"),),
        telemetry_bias={name: TelemetryBias(solved.fields_nT[k], fields_sigma_nT[k]) for k, name in enumerate(columns)},
    )
    outside = len(used) - len(in_stretch)
    fit = GyroFit(
        calibration=calibration,
        method="gyro",
        time=used.time[in_stretch],
        residuals_nT=residual_nT,
        weights=w / w.sum(),
        rows=rows[in_stretch],
        left_out={**left_out, **({"no unbroken stretch around it": outside} if outside else {})},
        rejected=int((~kept).sum()),
        variation=observability.field_variation(used.mag_B_nT),
        noise=noise,
        messages=_messages(seen, solved, noise, options),
        driver_covariance=solved.fields_covariance,
        seen=seen,
        solved=solved,
    )
    return with_warnings(fit, telemetry, robust=options.robust != "none")


def _best(used: Telemetry, columns: FloatArray, options: GyroOptions) -> tuple[GyroRows, Solved, FloatArray]:
    """The rows in stretches, the answer and the weights (N,). A stretch is as long as may be while there are three, as more
    of a turn is seen in it; but of no more rows than a covariance is cheap for."""
    rates = used.rate_B_rad_s
    assert rates is not None
    usual_s = float(np.median(np.diff(used.time).astype(np.float64))) * 1e-9 if len(used) > 1 else 1.0
    lengths = (
        [one for one in _LENGTHS_S if one <= _MOST_ROWS * usual_s] if options.stretch_s is None else [options.stretch_s]
    )
    for length in lengths:
        cuts = cut(used.time, rates, length)
        if len(cuts) >= _FEWEST:
            seen = GyroRows(used.time, used.mag_B_nT, rates, cuts, length, columns, options.parameters != "b")
            solved, weights = _robust(seen, options.robust)
            _require_no_false_turns(seen, solved, weights)
            return seen, solved, weights
    fast = np.degrees(np.median(np.linalg.norm(rates, axis=1)))
    words = say("gyro.no_stretches", fewest=_FEWEST, fast=fast, most=np.degrees(LARGEST_TURN_RAD))
    raise NoAnswer(words, evidence={"rows": len(used)})


def _robust(seen: GyroRows, kind: str) -> tuple[Solved, FloatArray]:
    """The answer without outliers, and the weights (N,): none of an outlier."""
    rows, whole = seen.in_stretches, np.ones(len(seen.time))
    if kind == "none":
        return solve(seen, whole), whole
    found = solve(seen, whole, corrected=False)

    def refit(weights: FloatArray) -> FloatArray:
        nonlocal found
        whole[rows] = weights
        found = solve(seen, whole, start=found, corrected=False)
        return found.deleted

    whole[rows] = rows_to_keep(found.deleted, refit, kind)
    return solve(seen, whole), whole


def _require_no_false_turns(seen: GyroRows, solved: Solved, weights: FloatArray) -> None:
    """Raises NoAnswer where a magnetometer without errors, with the noises that were found, would not be found to have none.

    Noise of the gyro is false turns: where they are as large as the true ones a field passes for a bias, and no sigma knows
    of it.
    """
    rates, noise = seen.rate_B_rad_s, solved.gyro_noise_rad_s
    speed = float(np.median(np.linalg.norm(rates, axis=1)))
    if speed < _SLOW * noise:
        words = say("gyro.too_slow", speed=np.degrees(speed), noise=np.degrees(noise), wanted=_SLOW)
        raise NoAnswer(words, evidence={"rate_rad_s": speed, "noise_rad_s": noise})
    rng = stream(0, "calib.gyro.repeat")
    again = seen.reading_nT - seen.columns @ solved.fields_nT
    field = fields_without_errors(seen._replace(reading_nT=again), weights)
    again[seen.in_stretches] = field + np.sqrt(solved.variance_nT2) * rng.standard_normal(field.shape)
    perturbed = rates + _PERTURBED * noise * rng.standard_normal(rates.shape)
    found = solve(seen._replace(reading_nT=again, rate_B_rad_s=perturbed), weights)
    if float(found.b_nT @ np.linalg.solve(found.covariance[9:, 9:], found.b_nT)) > _REPEATED:
        raise NoAnswer(
            say("gyro.false_turns", size=np.linalg.norm(found.b_nT)),
            evidence={"b_nT": solved.b_nT.tolist(), "without_errors_nT": found.b_nT.tolist()},
        )


def _require_turns(seen: GyroRows, solved: Solved) -> None:
    """Raises NoAnswer where b, or S, is not determined."""
    reading_nT = seen.reading_nT - seen.columns @ solved.fields_nT
    strength = float(np.sqrt((reading_nT**2).sum(axis=1).mean()))
    left = float(np.sqrt(((reading_nT @ (np.eye(3) + solved.S).T + solved.b_nT) ** 2).sum(axis=1).mean()))
    if left < _COLLAPSED * strength:
        words = say("gyro.collapsed", left=left, strength=strength)
        raise NoAnswer(words, evidence={"field_nT": left, "b_nT": solved.b_nT.tolist()})
    values, vectors = np.linalg.eigh(solved.covariance[9:, 9:])
    sigma = float(np.sqrt(values[-1]))
    S_sigma = float(np.sqrt(np.diag(solved.covariance)[:9].max()))
    if seen.with_S and not S_sigma < _WORST_S:
        raise NoAnswer(say("gyro.no_S", sigma=S_sigma), evidence={"sigma": S_sigma})
    if not sigma < observability.WORST_SIGMA * strength:
        words = say("gyro.no_b", direction=observability.direction_words(vectors[:, -1]), sigma=sigma)
        raise NoAnswer(words, evidence={"sigma_nT": sigma, "direction": vectors[:, -1].tolist()})


def _noise(options: GyroOptions, variance: float) -> ReadingNoise:
    if options.noise_nT is not None:
        declared = per_axis(options.noise_nT, "--noise-nT")
        return ReadingNoise(declared**2, f"{plain(float(declared.mean()))} nT as declared")
    return ReadingNoise(np.full(3, variance), f"{plain(float(np.sqrt(variance)))} nT per axis, found in the data")


def _messages(seen: GyroRows, solved: Solved, noise: ReadingNoise, options: GyroOptions) -> tuple[str, ...]:
    per_h = 3600.0 * np.degrees(1.0)
    bias = ", ".join(
        f"{measured(float(x) * per_h, float(s) * per_h)}"
        for x, s in zip(solved.bias_rad_s, solved.bias_sigma_rad_s, strict=True)
    )
    chosen = "as asked" if options.stretch_s is not None else "the longest that fits three times"
    return (
        say("gyro.stretches", count=len(seen.cuts), length_s=seen.length_s, chosen=chosen),
        say("gyro.gyro_noise", deg_s=np.degrees(solved.gyro_noise_rad_s)),
        f"bias of the gyro about x, y, z: {bias} deg/h",
        f"noise of the reading: {noise.source}",
    )
