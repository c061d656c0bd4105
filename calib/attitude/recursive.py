"""S and b row by row, with the attitude estimated too: the filter of `attitude.filter` with twelve more states.

The recursive counterpart of the batch methods (for b and D alone, without attitude: Crassidis, Lai & Harman 2005, Journal
of Guidance, Control, and Dynamics 28, 115). Attitude comes from scanner and sun, or from a reference that is wrong by
a slow error; outliers count less, and readings far from a robust batch fit not at all, because while little is known no
innovation is large. Passes are repeated about the last answer until it stays, as in an iterated filter, because an extended
filter freezes what it got wrong while it knew little.

One record says little about how long the slow errors last, and the sigmas depend on it: S, b and the covariance are averages
over the times that the innovations allow.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from fluxtwin.calib.attitude.filter import (
    SENSORS,
    FilterRows,
    Learned,
    Noises,
    Run,
    assemble_rows,
    fixes,
    learned,
    run,
    starts,
)
from fluxtwin.calib.attitude.three_axis import consistency, declared_noises, limits
from fluxtwin.calib.common.design import joined
from fluxtwin.calib.common.digits import plain
from fluxtwin.calib.common.error_model import white_errors
from fluxtwin.calib.common.fit import Fit, with_warnings
from fluxtwin.calib.common.noise import ReadingNoise, lsb_from_spacing_nT, per_axis
from fluxtwin.calib.common.observability import field_variation, pair_words, require_samples, weak_direction_words
from fluxtwin.calib.common.options import RecursiveOptions
from fluxtwin.calib.common.records import Calibration, parameter_names
from fluxtwin.calib.common.residuals import residual_statistics
from fluxtwin.calib.common.robust import MAD_TO_SIGMA
from fluxtwin.calib.common.words import say
from fluxtwin.calib.linear.calibrate import calibrate_linear
from fluxtwin.sim.base.errors import NoAnswer, amount
from fluxtwin.sim.base.types import BoolArray, FloatArray
from fluxtwin.sim.earth import frames
from fluxtwin.sim.earth.field import FieldModel
from fluxtwin.sim.telemetry.record import Telemetry

_FIRST_SIGMA = np.repeat([0.3, 1e5], [9, 3])  # far wider than any magnetometer: 1, nT
_UNKNOWN = 0.3  # of that sigma: a parameter no better known than that is not determined
_FAR = 10.0  # such residuals of the batch fit, over their median size, belong to no reading
_PASSES, _OF_SIGMA = 6, 0.05
_LONGER = np.arange(-1.0, 2.6, 0.5)
"""Logarithms by which slow errors may last longer, and be larger with the same steps from row to row."""


@dataclass(frozen=True, kw_only=True)
class RecursiveFit(Fit):
    """What this method adds to the record of every method."""

    q_NB: FloatArray
    """(N, 4) attitude at the readings, textbook quaternion, from the rows up to each."""
    attitude_sigma_rad: FloatArray
    """(N, 3) its 1 sigma about body axes."""
    noises: Noises
    """What the errors were taken to be, declared or found."""

    def to_dict(self) -> dict[str, Any]:
        """Plain numbers and text for JSON; no NaN."""
        return {**super().to_dict(), "noises": self.noises._asdict()}


def calibrate_recursive(records: Telemetry | Sequence[Telemetry], model: FieldModel, **given: Any) -> RecursiveFit:
    """S and b (or b alone) by a Kalman filter over readings, nadir and sun, or the reference attitude.

    given: fields of `RecursiveOptions`; the error of the attitude is that of the scanner, or of the
    reference attitude where there is no scanner. What is None is found in the innovations.

    Raises BadInput for options that this method does not take, NoAnswer where the attitude cannot be started from nadir and
    sun or from a reference, and, with the names of the parameters, where the data do not determine them.
    """
    options = RecursiveOptions(**given)
    parameters, noise_nT = options.parameters, options.noise_nT
    telemetry = joined(records)
    rows = assemble_rows(telemetry, model)
    reading = rows.reading_nT[np.isfinite(rows.reading_nT).all(axis=1)]
    require_samples(len(reading), 4 if parameters == "b,S" else 1)
    white_nT = None
    if noise_nT is not None:
        lsb = lsb_from_spacing_nT(reading) if options.lsb_nT is None else per_axis(options.lsb_nT, "--lsb-nT")
        white_nT = float(np.sqrt((per_axis(noise_nT, "--noise-nT") ** 2 + lsb**2 / 12.0).mean()))
    declared = declared_noises(white_nT, options.attitude_sigma_deg, options.attitude_tau_s, options.sun_sigma_deg)
    begun = starts(rows, None)
    first = np.diag(_FIRST_SIGMA**2)
    if parameters == "b":
        first[:9, :9] = 0.0
    rows, p, far = _without_outliers(telemetry, rows, model, parameters)
    taken = learned(rows, begun, declared, p, first, by_field=False)

    def passed(noises: Noises, p: FloatArray) -> Run:
        """Linearised about p, of which no more is known than at first."""
        return run(rows, begun, noises, p, first)

    done, passes = _settled(passed, taken.noises, p, first)
    mean, C = _averaged(passed, taken.noises, done.p, declared)
    done = done._replace(p=mean, p_covariance=C)
    _require_known(done, first)
    return with_warnings(_report(rows, done, taken, options, model, passes, far), telemetry, robust=True)


def _without_outliers(
    telemetry: Telemetry, rows: FilterRows, model: FieldModel, parameters: str
) -> tuple[FilterRows, FloatArray, BoolArray]:
    """Rows without the readings that lie far from a robust batch fit to the rows with a fix; its S and b; which they are.

    Raises NoAnswer where the fit is not determined.
    """
    R, covariance = fixes(rows, None)
    sure = np.isfinite(covariance[:, 0, 0])
    q = np.full((len(telemetry), 4), np.nan)
    q[rows.rows[sure]] = frames.q_from_rotation(R[sure])
    known = calibrate_linear(telemetry.replace(q_NB=q), model, parameters=parameters).calibration
    off = np.full_like(rows.reading_nT, np.nan)
    B = rows.reading_nT[sure]
    off[sure] = R[sure].apply(rows.field_N_nT[sure]) - (B + B @ known.S.T + known.b_nT)
    size = MAD_TO_SIGMA * np.nanmedian(np.abs(off), axis=0)
    far = (np.abs(off) > _FAR * size).any(axis=1)
    reading = rows.reading_nT.copy()
    reading[far] = np.nan
    return replace(rows, reading_nT=reading), np.concatenate([known.S.ravel(), known.b_nT]), np.asarray(far)


def _settled(
    passed: Callable[[Noises, FloatArray], Run], noises: Noises, p: FloatArray, first: FloatArray
) -> tuple[Run, int]:
    """The pass that moves the answer by less than a twentieth of a sigma, and how many it took."""
    moved = np.inf
    for count in range(1, _PASSES + 1):
        done = passed(noises, p)
        sigma = np.sqrt(np.diag(done.p_covariance))
        moved = float(np.abs((done.p - p) / np.where(sigma > 0, sigma, 1.0)).max())
        p = done.p
        if moved < _OF_SIGMA:
            return done, count
    _require_known(done, first)
    raise NoAnswer(say("attitude.still_moves", moved=moved, passes=_PASSES), evidence={"moved_sigma": moved})


def _averaged(
    passed: Callable[[Noises, FloatArray], Run], noises: Noises, p: FloatArray, declared: dict[str, float]
) -> tuple[FloatArray, FloatArray]:
    """p and its covariance, over durations of the slow errors weighted by their likelihood."""
    drift = (0.0,) if "drift_s" in declared else _LONGER
    slow = _LONGER[::2] if noises.slow_nT > 0.1 * noises.field_nT else (0.0,)
    answers = []
    for of_drift, of_slow in itertools.product(drift, slow):
        sized = {} if "drift_rad" in declared else {"drift_rad": noises.drift_rad * np.exp(0.5 * of_drift)}
        longer = noises._replace(
            drift_s=noises.drift_s * np.exp(of_drift),
            slow_nT=noises.slow_nT * np.exp(0.5 * of_slow),
            slow_s=noises.slow_s * np.exp(of_slow),
            **sized,
        )
        answers.append(passed(longer, p))
    cost, values, C = (np.array([getattr(one, name) for one in answers]) for name in ("cost", "p", "p_covariance"))
    weight = np.exp(-0.5 * (cost - cost.min()))
    weight /= weight.sum()
    mean = weight @ values
    off = values - mean
    return mean, np.asarray(np.einsum("k,kij->ij", weight, C + off[:, :, None] * off[:, None, :]))


def _require_known(done: Run, first: FloatArray) -> None:
    left = np.sqrt(np.diag(done.p_covariance)) > _UNKNOWN * np.sqrt(np.diag(first))
    unknown = [name for name, weak in zip(parameter_names(False), left & (np.diag(first) > 0), strict=True) if weak]
    if unknown:
        raise NoAnswer(say("attitude.not_determined", names=", ".join(unknown)), evidence={"parameters": unknown})


def _report(
    rows: FilterRows,
    done: Run,
    taken: Learned,
    options: RecursiveOptions,
    model: FieldModel,
    passes: int,
    far: BoolArray,
) -> RecursiveFit:
    noises, declared = taken.noises, options.noise_nT is not None
    S, b_nT = done.p[:9].reshape(3, 3), done.p[9:]
    kept = np.flatnonzero(np.isfinite(rows.reading_nT).all(axis=1) & np.isfinite(done.A[:, 0, 0]))
    B, A = rows.reading_nT[kept], done.A[kept]
    r = np.einsum("kij,kj->ki", A, rows.field_N_nT[kept]) - (B + B @ S.T + b_nT)
    outlying = done.inflated[kept, 0] == 1.0
    sigma_nT = residual_statistics(rows.time[kept[~outlying]], r[~outlying]).component_rms_nT
    variation = field_variation(B[~outlying])
    words = [
        *pair_words(done.p_covariance, False, float(np.sqrt((B**2).mean())), sigma_nT),
        *(weak_direction_words(variation, done.p_covariance) if options.parameters == "b,S" else []),
    ]
    calibration = Calibration(
        S=S,
        b_nT=b_nT,
        covariance=done.p_covariance,
        covariance_kind="blocks",
        sigma_nT=sigma_nT,
        samples=len(kept),
        span=(rows.time[kept[0]], rows.time[kept[-1]]),
        field_model=model.name,
        method=f"recursive filter for {options.parameters}, attitude estimated too",
        unobservable=tuple(words),
    )
    noise = ReadingNoise(
        np.full(3, noises.field_nT**2),
        f"{plain(noises.field_nT)} nT white, {'declared' if declared else 'found in the innovations'}",
    )
    nis, lag_correlation, reasons = consistency(done)
    left_out = dict(rows.left_out)
    if far.any():
        left_out["the reading lies far from all others"] = int(far.sum())
    if len(kept) + far.sum() < len(rows.t_s):
        left_out["no reading, or before a first fix"] = len(rows.t_s) - len(kept) - int(far.sum())
    # The residual has the slow error of the field in it, and can not explain it.
    against = limits(rows, replace(calibration, sigma_nT=0.0), taken)
    white_deg, drift_deg = np.degrees(noises.white_rad), np.degrees(noises.drift_rad)
    innovations = ", ".join(f"{sensor} {plain(nis[sensor])}" for sensor in SENSORS if sensor in nis)
    messages = [
        *(f"{amount(count, 'row|rows')} left out: {reason}" for reason, count in left_out.items()),
        say("attitude.of_field", source=noise.source, n=noises),
        say("attitude.of_reference", white_deg=white_deg, drift_deg=drift_deg, n=noises),
        say("attitude.fit_innovations", nis=innovations, correlation=lag_correlation, passes=passes),
    ]
    return RecursiveFit(
        calibration=calibration,
        method="recursive",
        time=rows.time[kept],
        residuals_nT=r,
        weights=np.where(outlying, 0.0, 1.0 / max(int((~outlying).sum()), 1)),
        rows=rows.rows[kept],
        left_out=left_out,
        warnings=(*reasons, *(f"{text[0].upper()}{text[1:]}." for text in against)),
        rejected=int(outlying.sum() + far.sum()),
        variation=variation,
        noise=noise,
        messages=tuple(messages),
        error_model=white_errors(noise.variance_nT2, declared=declared),
        q_NB=frames.q_from_rotation(Rotation.from_matrix(A)),
        attitude_sigma_rad=np.sqrt(np.einsum("kii->ki", done.covariance[kept])),
        noises=noises,
    )
