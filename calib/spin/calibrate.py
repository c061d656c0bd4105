"""Calibration of a spinning spacecraft's magnetometer from the field, the orbit and sun pulses; no attitude is given.

| method | what it is |
|---|---|
| `batch` | motion and magnetometer at once, without inertia (`batch`), from a blind start (`start`) |
| `iterative` | Sedlak's: TWOSTEP, filter, alignment, repeated (`sedlak`); then linear regression and filter in turn |

Both need body z to be the axis of symmetry, and a record without thrust. The azimuth of the body is a convention of
such a body: the sun sensor defines it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from fluxtwin.calib.common.conventions import Forward, correction_from_forward, forward_jacobian
from fluxtwin.calib.common.covariance import batch_widening, segments
from fluxtwin.calib.common.design import Design, joined
from fluxtwin.calib.common.error_model import white_errors
from fluxtwin.calib.common.fit import Fit, with_warnings
from fluxtwin.calib.common.noise import ReadingNoise, scalar_noise
from fluxtwin.calib.common.observability import field_variation
from fluxtwin.calib.common.options import LinearOptions, SpinOptions
from fluxtwin.calib.common.records import LARGE_S, Calibration
from fluxtwin.calib.common.residuals import residual_statistics
from fluxtwin.calib.common.robust import TUKEY_AT, find_outliers, robust_distance
from fluxtwin.calib.linear.calibrate import fit_design
from fluxtwin.calib.scalar.model import ScalarData, pack, residual, without_outliers
from fluxtwin.calib.scalar.twostep import twostep
from fluxtwin.calib.spin.batch import (
    Noise,
    State,
    covariance_of_normal,
    normal_equations,
    residuals,
    solve_batch,
)
from fluxtwin.calib.spin.filter import Filtered, FilterSettings, spin_filter
from fluxtwin.calib.spin.motion import SpinMotion
from fluxtwin.calib.spin.rows import SpinRows, assemble_spin
from fluxtwin.calib.spin.sedlak import OF_SIGMA, Iterated, at, free_motion, iterate
from fluxtwin.calib.spin.start import SpinStart, blind_start
from fluxtwin.sim.base.errors import NoAnswer, amount
from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.earth import epoch, frames
from fluxtwin.sim.earth.field import FieldModel
from fluxtwin.sim.telemetry.record import Telemetry

LOOSE_NOISE = 0.005
"""In parts of the field: the least that is taken before any is found; as a weight it has no effect here."""
GAUGE = (
    "the azimuth of the body's x axis: an axisymmetric body has none of its own. The sun sensor defines it (the gauge); a "
    "misalignment of the sun sensor about body Z goes into S as one of the magnetometer"
)
_SUN_SIGMA_DEG = 0.2
_FINISHED = 1.15
_MISFIT = 10.0
_LEAST_NOISE = 1e-6
_FEWEST_FINISHED = 0.87
_REGRESSIONS = 60
_LEAP = 4
"""Every so many passes a step goes to where the geometric series of the steps would end."""
_CUTS = 5


def outlying_readings(rows: SpinRows) -> np.ndarray:
    """(N,) readings whose |B| is an outlier after a robust fit of b and S to |H|.

    Bit errors mislead a blind start, and no attitude is needed to see them.
    """
    data, _ = _sizes(rows, LOOSE_NOISE)
    none = np.zeros(data.size)
    p, _ = without_outliers(none, data, residual(none, data)[:, None], "tukey")
    return find_outliers(residual(p, data)[:, None])


def _sizes(rows: SpinRows, noise: float) -> tuple[ScalarData, float]:
    """The rows for a fit of |B|, with noise of that part of the field, and the scale [nT]."""
    size = np.linalg.norm(rows.H_N_nT, axis=1)
    scale = float(np.sqrt((size**2).mean()))
    return ScalarData(rows.B_nT / scale, size / scale, np.zeros((len(size), 0)), noise**2 * np.eye(3), True), scale


def beyond(residuals_nT: FloatArray) -> np.ndarray:
    """(N,) residuals (N, 3) of more than six robust sigma, where Tukey's weight is zero."""
    r = residuals_nT - np.median(residuals_nT, axis=0)
    return robust_distance(r) > TUKEY_AT


def outlier_words(rows: SpinRows, *, left_out: bool) -> str:
    """How many outliers there are, and what to do; empty where there are none."""
    outlying = np.flatnonzero(outlying_readings(rows))
    if not outlying.size:
        return ""
    first = ", ".join(epoch.iso(rows.time[k], "ms") for k in outlying[:3])
    return f"{outlying.size} of {len(rows)} readings are outliers in |B| (bit errors?), the first at {first}. " + (
        "They were left out, and others that |B| does not show may remain: leave those readings empty"
        if left_out
        else "--robust tukey leaves them out"
    )


@dataclass(frozen=True, kw_only=True)
class SpinFit(Fit):
    """What the methods for spinners add to the record of every method."""

    q_NB: FloatArray
    """(N, 4) attitude at the readings, textbook quaternion."""
    motion: Mapping[str, float] = field(default_factory=dict)
    """`spin_rad_s`, `precession_rad_s`, `nutation_deg`, `inertia_ratio`."""
    quality: Mapping[str, float] = field(default_factory=dict)
    """`field_chi2`, `sun_chi2` a component, `rounds`; of the filter `nis_first`, `nis_last`."""
    steps_deg: tuple[float, ...] = ()
    """Turns found in the passes of the iteration."""

    def to_dict(self) -> dict[str, Any]:
        """Plain numbers and text for JSON; no NaN."""
        return {
            **super().to_dict(),
            "motion": dict(self.motion),
            "quality": dict(self.quality),
            "steps_deg": list(self.steps_deg),
        }


class _Found(NamedTuple):
    """What either way ends with."""

    calibration: Calibration
    motion: SpinMotion
    quality: dict[str, float]
    messages: list[str]
    steps_rad: tuple[float, ...]


def calibrate_spin(records: Telemetry | Sequence[Telemetry], model: FieldModel, **given: Any) -> SpinFit:
    """S (9) and b (3) of one record of a spinner with sun pulses; given: fields of `SpinOptions`.

    Raises BadInput for unknown options or no sun column, NoAnswer, in words, where no free motion fits, the iteration
    does not settle, or readings and pulses are too few.
    """
    fit = fit_spin(assemble_spin(records, model), SpinOptions(**given), model_name=model.name)
    return with_warnings(fit, joined(records), robust=fit.rejected > 0)


def fit_spin(rows: SpinRows, options: SpinOptions, *, model_name: str = "") -> SpinFit:
    """The calibration of rows that are already assembled; errors as `calibrate_spin`."""
    kept, fit = rows, None
    if options.robust != "none":
        kept = rows.select(~outlying_readings(rows))
    try:
        for _ in range(_CUTS):
            fit = _fit(kept, options, model_name)
            if options.robust == "none" or not beyond(fit.residuals_nT).any():
                break
            kept = kept.select(~beyond(fit.residuals_nT))
        assert fit is not None
        cut = len(rows) - len(kept)
        if not cut:
            return fit
        said = (
            f"{cut} of {len(rows)} readings are outliers beyond six sigma and are left out (--robust none keeps them)"
        )
        return replace(fit, rejected=cut, left_out={**fit.left_out, "outliers": cut}, messages=(said, *fit.messages))
    except NoAnswer as refusal:
        outlying = outlier_words(rows, left_out=options.robust != "none")
        if not outlying:
            raise
        raise NoAnswer(f"{outlying}. As it is, {refusal}", evidence=refusal.evidence) from refusal


def _fit(rows: SpinRows, options: SpinOptions, model_name: str) -> SpinFit:
    G, o_nT, noise, messages = scalar_start(rows, options)
    field_nT = float(np.sqrt((rows.H_N_nT**2).sum(axis=1).mean()))
    white_nT = max(float(np.sqrt(noise.variance_nT2.mean())), _LEAST_NOISE * field_nT)
    sensors = Noise(white_nT, np.radians(options.sun_sigma_deg or _SUN_SIGMA_DEG))
    # Noise found from row to row is the least there is; what lasts longer must not pass for a wrong motion.
    loose_nT = white_nT if options.noise_nT is not None else max(white_nT, LOOSE_NOISE * field_nT)
    start = blind_start(rows, sensors._replace(field_nT=loose_nT), G, o_nT)
    messages.append(
        f"blind start: {start.tried} candidate{'s' if start.tried > 1 else ''} followed from an arc of "
        f"{start.first_arc_s:.0f} s; spin {start.state.motion.spin_rad_s * 30.0 / np.pi:.4g} rpm"
    )
    if options.method == "batch":
        found = _batch(rows, options, start, sensors)
    else:
        found = _iterative(rows, options, start, sensors, (G, o_nT), noise)
    return _report(rows, options, found, noise, messages, model_name)


def scalar_start(rows: SpinRows, options: SpinOptions) -> tuple[FloatArray, FloatArray, ReadingNoise, list[str]]:
    """G (symmetric) and o by TWOSTEP, the noise, and what is to be said."""
    data, scale = _sizes(rows, _LEAST_NOISE)
    if options.noise_nT is not None:
        data = data._replace(Sigma=max(float(np.max(options.noise_nT)) / scale, 1e-7) ** 2 * np.eye(3))
    D, b, sound = _of_size(data)
    r_nT = residual(pack(D, b, data), data) * scale
    noise = scalar_noise(rows.B_nT, rows.time, r_nT, options.noise_nT, options.lsb_nT)
    if options.noise_nT is None:  # TWOSTEP takes off what the noise does: no more than there is
        found = _of_size(data._replace(Sigma=np.diag(np.maximum(noise.variance_nT2 / scale**2, _LEAST_NOISE**2))))
        D, b, sound = found if found[2] else (D, b, sound)
    messages = [f"{amount(count, 'row|rows')} left out: {reason}" for reason, count in rows.left_out.items()]
    messages.append(f"noise of the reading: {noise.source}")
    if not sound:
        messages.append("the size of the field alone does not give S and b (TWOSTEP): the start takes both for zero")
    G = np.linalg.inv(np.eye(3) + D)
    return np.asarray(G), G @ b * scale, noise, messages


def _of_size(data: ScalarData) -> tuple[FloatArray, FloatArray, bool]:
    """D and b by TWOSTEP and whether they are sound; zeros where not."""
    found = twostep(data)
    sound = found.converged and bool(np.abs(found.D).max() < LARGE_S)
    return (found.D, found.b, True) if sound else (np.zeros((3, 3)), np.zeros(3), False)


def _batch(rows: SpinRows, options: SpinOptions, start: SpinStart, sensors: Noise) -> _Found:
    solved = solve_batch(start.state, rows, sensors)
    words = []
    ratio = solved.normal.field_chi2
    if options.noise_nT is None or options.sun_sigma_deg is None:
        now = solved.normal
        field_nT = sensors.field_nT * (1.0 if options.noise_nT is not None else float(np.sqrt(now.field_chi2)))
        sun_rad = sensors.sun_rad * (1.0 if options.sun_sigma_deg is not None else float(np.sqrt(now.sun_chi2)))
        sensors = Noise(field_nT, sun_rad)
        words.append(f"noise found in the residuals: {field_nT:.4g} nT a component, sun {np.degrees(sun_rad):.3g} deg")
        solved = solve_batch(solved.state, rows, sensors)
    now = solved.normal
    misfit = float(np.sqrt(max(ratio, now.sun_chi2)))
    if not solved.converged or misfit > _MISFIT:
        raise NoAnswer(
            f"the batch leaves residuals {misfit:.3g} times the noise: torques or thrust, or the magnetometer changed. "
            "Cut the record to a quiet stretch, or state the noise",
            evidence={"field_chi2": now.field_chi2, "sun_chi2": now.sun_chi2},
        )
    words += _finished(ratio, "residuals")
    calibration = _from_forward(solved.state, solved.covariance, rows, options, max(now.field_chi2, 1.0))
    quality = {"field_chi2": ratio, "sun_chi2": now.sun_chi2, "rounds": float(solved.rounds)}
    return _Found(calibration, solved.state.motion, quality, words, ())


def _from_forward(
    state: State, covariance: FloatArray, rows: SpinRows, options: SpinOptions, inflation: float = 1.0
) -> Calibration:
    """G, o and their covariance (19, 19) as S, b."""
    known = correction_from_forward(Forward(state.G, state.o_nT))
    order = [*range(10, 19), *range(7, 10)]
    jacobian = forward_jacobian(known)[:12, :12]
    covariance = jacobian @ covariance[np.ix_(order, order)] @ jacobian.T * inflation
    if options.covariance == "blocks":
        covariance = covariance * batch_widening(residuals(state, rows)[0], segments(rows.time))
    return Calibration(known.S, known.b_nT, None, covariance, options.covariance)


def _iterative(
    rows: SpinRows,
    options: SpinOptions,
    start: SpinStart,
    sensors: Noise,
    scalar: tuple[FloatArray, FloatArray],
    noise: ReadingNoise,
) -> _Found:
    G, o_nT = scalar
    ratio = start.state.motion.inertia_ratio if options.inertia_ratio is None else options.inertia_ratio
    words = [
        f"Js/Jt {ratio:.6g} {'as given' if options.inertia_ratio else 'from the blind start'}; the sun sensor's mounting "
        f"known to {options.sun_alignment_deg:g} deg an axis"
    ]
    settings = FilterSettings(sensors.field_nT, sensors.sun_rad)
    B = (rows.B_nT - o_nT) @ np.linalg.inv(G).T
    done = iterate(rows, B, start.state.motion, ratio, settings, np.radians(options.sun_alignment_deg))
    words.append(
        f"{len(done.steps_rad)} passes; turns " + ", ".join(f"{np.degrees(s):.2g}" for s in done.steps_rad) + " deg"
    )
    words.append(
        f"the sun sensor's own turn about the sun's line is known to {np.degrees(done.sun_weakest_rad):.2g} deg from these "
        "data alone"
    )
    known, last, passes = _regress(rows, done, noise, settings, ratio)
    words.append(
        f"linear regression on that attitude and filter in turn, {passes} more passes: b and D were TWOSTEP's until then"
    )
    words += _finished(last.field_nis, "innovations")
    motion = free_motion(last, ratio)
    # The same values with the covariance that leaves the motion free too: of the batch's equations there.
    state = State(motion, known.forward.G, known.forward.o_nT)
    known = _from_forward(state, covariance_of_normal(normal_equations(state, rows, sensors)), rows, options)
    quality = {
        "nis_first": done.first.field_nis,
        "nis_last": last.field_nis,
        "sun_nis_last": last.sun_nis,
        "rounds": float(len(done.steps_rad) + passes),
    }
    return _Found(known, motion, quality, words, done.steps_rad)


def _regress(
    rows: SpinRows, done: Iterated, noise: ReadingNoise, settings: FilterSettings, ratio: float
) -> tuple[Calibration, Filtered, int]:
    """Linear regression on the attitude and filter with what it gives, in turn, until a tenth of a sigma is left."""
    sigma_nT = np.sqrt(noise.variance_nT2)
    how = LinearOptions(method="forward", noise_nT=sigma_nT, lsb_nT=0.0, covariance="white", robust="none")
    near, motion = replace(settings, extended=False), done.motion
    before, moved, left, share, count = np.zeros(12), np.inf, np.inf, 0.0, 0
    begin = min(float(rows.t_s[0]), float(rows.pulse_s[0]))
    while left >= OF_SIGMA:
        if count == _REGRESSIONS:
            raise NoAnswer(
                f"regression and filter in turn still change the answer by {moved:.2g} sigma after {count} passes: the "
                "record is too short to separate the magnetometer from the motion in this way; --method batch solves for "
                "both at once",
                evidence={"moved_sigma": moved},
            )
        count += 1
        H_B = np.einsum("kij,kj->ki", motion.attitude(rows.t_s), rows.H_N_nT)
        design = Design(rows.time, rows.B_nT, H_B, {}, rows.rows, {})
        known = fit_design(design, how).calibration
        used = known
        if count % _LEAP == 0 and 0.5 < share < 0.97:
            ahead = known.values + (known.values - before) * share / (1.0 - share)
            used = Calibration(ahead[:9].reshape(3, 3), ahead[9:])
        filtered = spin_filter(rows, used.apply(rows.B_nT), *at(motion, begin), ratio, near)
        if not filtered.field_nis < _MISFIT**2:
            raise NoAnswer(
                f"regression and filter, in turn, diverge: squared innovations {filtered.field_nis:.3g} times the noise; "
                "--method batch solves for both at once",
                evidence={"passes": count, "nis": min(filtered.field_nis, 1e300)},
            )
        motion = free_motion(filtered, ratio)
        last, moved = moved, float(np.abs((known.values - before) / known.sigmas).max())
        before = used.values
        # The steps shrink by a share of the one before: what is still to come is their geometric rest.
        share = min(moved / last, 0.98)
        left = moved * max(share / (1.0 - share), 1.0)
    return known, filtered, count


def _finished(ratio: float, what: str) -> list[str]:
    if _FEWEST_FINISHED < ratio < _FINISHED:
        return [f"squared {what} are {ratio:.3f} of what the noise gives: the calibration is finished"]
    return [
        f"squared {what} are {ratio:.3f} of what the noise gives, not 1: the noise is wrong, or something is not modelled"
    ]


def _report(
    rows: SpinRows, options: SpinOptions, found: _Found, noise: ReadingNoise, messages: list[str], model_name: str
) -> SpinFit:
    known, motion = found.calibration, found.motion
    A = motion.attitude(rows.t_s)
    r = np.einsum("kij,kj->ki", A, rows.H_N_nT) - known.apply(rows.B_nT)
    label = {"batch": "batch of motion and magnetometer", "iterative": "TWOSTEP, filter, alignment, linear regression"}
    calibration = replace(
        known,
        sigma_nT=residual_statistics(rows.time, r).component_rms_nT,
        samples=len(rows),
        span=(rows.time[0], rows.time[-1]),
        field_model=model_name,
        method=f"{label[options.method]} for b,S, spinning, without attitude",
        unobservable=(GAUGE,),
    )
    nutation_deg = float(np.degrees(motion.nutation_rad))
    said = [*messages, *found.messages, f"nutation {nutation_deg:.3g} deg, Js/Jt {motion.inertia_ratio:.6g}"]
    return SpinFit(
        calibration=calibration,
        method=options.method,
        time=rows.time,
        residuals_nT=r,
        weights=np.full(len(rows), 1.0 / len(rows)),
        rows=rows.rows,
        left_out=dict(rows.left_out),
        rejected=0,
        variation=field_variation(rows.B_nT),
        noise=noise,
        messages=tuple(said),
        q_NB=frames.q_from_rotation(Rotation.from_matrix(A)),
        motion={
            "spin_rad_s": motion.spin_rad_s,
            "nutation_deg": nutation_deg,
            "inertia_ratio": motion.inertia_ratio,
            "precession_rad_s": float(np.linalg.norm(motion.Om_N_rad_s)),
        },
        error_model=white_errors(noise.variance_nT2, declared=options.noise_nT is not None),
        quality=found.quality,
        steps_deg=tuple(float(np.degrees(step)) for step in found.steps_rad),
    )
