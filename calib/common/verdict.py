"""Is a calibration good, what does it mean in degrees, what do the data not determine, what comes next: one verdict.

The residual is compared with what noise, LSB and attitude error give. Where the attitude error was found in the same
residual that comparison proves nothing, so the part along the field is compared by itself: an error of the attitude,
slow or not, shortens it by its square and no more.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from scipy.stats import chi2

from fluxtwin.calib.common.digits import measured
from fluxtwin.calib.common.direction import (
    CONFIDENCE,
    DirectionKnowledge,
    direction_knowledge,
    of_parameters,
    rotation_deg,
)
from fluxtwin.calib.common.error_model import ErrorModel
from fluxtwin.calib.common.noise import white_nT
from fluxtwin.calib.common.observability import correlated_pairs, direction_words
from fluxtwin.calib.common.orbit_error import stated_km
from fluxtwin.calib.common.records import Calibration
from fluxtwin.calib.common.words import say
from fluxtwin.sim.base.types import BoolArray, FloatArray, TimeArray
from fluxtwin.sim.earth import epoch
from fluxtwin.sim.telemetry.record import Telemetry

if TYPE_CHECKING:
    from fluxtwin.calib.common.fit import Fit

IMPOSSIBLE_S = 0.2
"""An element of S that no magnetometer has: scale and axes are made and measured on ground to a few percent."""
IMPOSSIBLE_RESIDUAL = 0.1
"""Residual over field, rms: a tenth is an attitude wrong by six degrees."""
SEVERAL = 3.0
"""A residual so many times what is expected is not that of a calibrated magnetometer."""
FIELD_MODEL_NT = 150.0
"""Error of |B| that a main-field model may have, 1 sigma (error model of the World Magnetic Model, technical reports of
2020 and 2025, at the surface; less in orbit): allowed before a residual is called impossible."""
_FALSE_ALARM = 1e-3  # of a comparison of variances
_TRUSTED = 1.5  # a declared attitude error is trusted to that factor, as in `error_model`
_WEAK_S = 0.01  # 1 sigma: half a degree, or a percent of the field
_MANY_OUTLIERS = 0.01  # of the rows: the share up to which the sigmas were measured (docs/calibration.md)
_TOO_MANY_OUTLIERS = 0.25
"""Of the rows: half of what breaks a robust fit. With more, one half of the record may consist mostly of outliers, and that
half alone would have given another calibration: the rows that are set aside are then no errors of single readings."""
_NEARLY_ALL = 0.9  # of the outliers: a tenth may be errors of single readings besides
_SHOWN = 5
_SHOWN_SQUARE = 0.1  # of what is expected along the field: with less it is half a percent


class Pair(NamedTuple):
    """Two parameters and their correlation."""

    one: str
    other: str
    correlation: float


_WITH_TORQUERS = "fluxtwin calibrate TELEMETRY --parameters b,S,T"
_DIAGNOSE = "fluxtwin diagnose TELEMETRY --html diagnosis.html"
_CHECK = f"fluxtwin check TELEMETRY; if it finds nothing, {_DIAGNOSE}"


class Along(NamedTuple):
    """The residual along the field [nT], rms."""

    found_nT: float
    noise_nT: float
    """From white noise, LSB and the square of the attitude error."""
    allowed_nT: float
    """rms that chance and the errors of the calibration alone pass once in a thousand times."""
    chance_nT: float
    """rms that chance alone passes so often."""
    turned: bool = False
    """Whether the square of the attitude error is more than a tenth of `noise_nT`."""

    @property
    def too_much(self) -> bool:
        """Whether it is not let pass."""
        return self.found_nT > self.allowed_nT

    @property
    def beyond_model(self) -> bool:
        """Whether it is more than noise and a field model give."""
        return self.too_much and bool(self.found_nT > np.hypot(self.chance_nT, FIELD_MODEL_NT))


@dataclass(frozen=True)
class Verdict:
    """What the fit is worth."""

    level: str
    """`good`; `usable`, with the limits in `reasons`; `bad`: no file should be made of it."""
    reasons: tuple[str, ...]
    """Why it is not good, in sentences; none for a good one."""
    residual: str
    """The residual and what is expected, in words."""
    residual_nT: float
    along_field_nT: float
    """rms along the field, where no attitude error has a part."""
    along_field_expected_nT: float
    """Of that, what white noise, LSB and the square of the attitude error give."""
    direction: DirectionKnowledge
    set_aside: int
    """Rows that count for nothing, as outliers."""
    correlated: tuple[Pair, ...]
    """The most correlated pairs of parameters, worst first, at most five."""
    not_observable: tuple[str, ...]
    passes: float | None
    """As in the error model: so few that the sigmas do not include errors that last an orbit."""
    next_step: str
    """A command with TELEMETRY and CALIBRATION.toml for the files, or a manoeuvre."""

    @property
    def impossible(self) -> bool:
        """Whether this is no calibration of a magnetometer."""
        return self.level == "bad"

    @property
    def lines(self) -> tuple[str, ...]:
        """The first lines of an answer: good or not, degrees, what is not observable, what next."""
        d, seen = self.direction, self.not_observable
        head = {"good": "Good", "usable": "Usable, with limits", "bad": "Bad: not a calibration"}[self.level]
        what = say("verdict.absolute" if d.rotation_counted else "verdict.without_rotation")
        degrees = say("verdict.degrees", what=what, confidence=100 * CONFIDENCE, d=d)
        if d.rotation_deg is not None:
            degrees += say("verdict.rotation", deg=d.rotation_deg)
        if d.against_reference_deg is not None:
            degrees += say("verdict.against_reference", deg=d.against_reference_deg)
        unseen = say("verdict.unseen_one", words=seen[0]) if seen else say("verdict.unseen_none")
        unseen = say("verdict.unseen_many", count=len(seen)) if len(seen) > 1 else unseen
        sigmas = []
        if self.passes is not None:
            are = "orbit or pass is" if f"{self.passes:.2g}" == "1" else "orbits or passes are"
            sigmas = [say("verdict.passes", passes=self.passes, are=are)]
        words = [f"{head}. {self.residual}", *self.reasons, *([] if self.impossible else [degrees, *sigmas])]
        return (*words, unseen, f"Next: {self.next_step}")

    def to_dict(self) -> dict[str, Any]:
        """Plain numbers and text for JSON."""
        plain_lists = {name: list(getattr(self, name)) for name in ("reasons", "not_observable", "lines")}
        pairs = [list(pair) for pair in self.correlated]
        return {**asdict(self), **plain_lists, "correlated": pairs, "confidence": CONFIDENCE}


def assess(
    fit: Fit,
    telemetry: Telemetry,
    *,
    attitude_sigma_deg: float | None = None,
    against_attitude: bool = True,
    reference_nT: FloatArray | None = None,
) -> Verdict:
    """The verdict on a fit of a record (joined, as it was fitted). Pure: the same fit, the same verdict.

    attitude_sigma_deg: error of the reference attitude as it was declared. against_attitude: whether the method took the
    telemetry's attitude for its reference. reference_nT: (N, 3) model field in the body of the record's rows, NaN where
    unknown, for a method that compares |B| alone: it shows how the sensor is turned.
    """
    known, kept = fit.calibration, fit.kept
    B = telemetry.mag_B_nT[fit.rows]
    D = None if telemetry.dipole_B_Am2 is None else telemetry.dipole_B_Am2[fit.rows]
    field_nT = known.apply(B, D, known.columns_of(telemetry, fit.rows, fitted=True))
    with_attitude = fit.residuals_nT.shape[1] == 3
    true_nT = field_nT + fit.residuals_nT if with_attitude else field_nT
    direction = direction_knowledge(
        known, B[kept], None if D is None else D[kept], field_nT[kept], true_nT[kept], fit.noise.variance_nT2
    )
    along = _along(fit, telemetry, field_nT, kept)
    residual_nT = known.sigma_nT
    declared = _against_declared(fit, attitude_sigma_deg)
    strength_nT = float(np.sqrt((true_nT[kept] ** 2).sum(axis=1).mean()))
    impossible = _impossible(fit, declared, along, residual_nT, strength_nT)
    if not (with_attitude and against_attitude):
        direction = replace(direction, against_reference_deg=None)
    if not with_attitude:
        turned = None if reference_nT is None else rotation_deg(field_nT[kept], reference_nT[fit.rows][kept])
        direction = replace(direction, rotation_counted=False, rotation_deg=turned)
    suspect_km = _orbit_suspect_km(fit, telemetry, along, strength_nT)
    outliers = " and the outliers" if fit.rejected else ""
    of_orbit = [say("verdict.elements", km=suspect_km, outliers=outliers)] if suspect_km else []
    limits = [] if impossible else _limits(fit, declared, along, direction, strength_nT, of_orbit)
    coupling = _coupling(fit, D) if impossible or along.too_much else ""
    return Verdict(
        level="bad" if impossible else "usable" if limits else "good",
        reasons=(
            *([coupling] if coupling else []),
            *([*fit.warnings, *impossible, *of_orbit] if impossible else limits),
        ),
        residual=_residual_words(fit, along, residual_nT, impossible=bool(impossible))
        + (say("verdict.aside", count=fit.rejected, rows=_rows(fit)) if fit.rejected else ""),
        residual_nT=residual_nT,
        along_field_nT=along.found_nT,
        along_field_expected_nT=along.noise_nT,
        direction=direction,
        set_aside=fit.rejected,
        correlated=worst_pairs(fit),
        not_observable=fit.observability,
        passes=None if fit.error_model is None else fit.error_model.passes,
        next_step=_WITH_TORQUERS if coupling else _next_step(fit, impossible, along, direction, suspect_km > 0.0),
    )


def worst_pairs(fit: Fit) -> tuple[Pair, ...]:
    """Pairs of parameters with a correlation of 0.95 or more, worst first; S12 and S21 of a symmetric S are one."""
    C, names = fit.correlation, fit.calibration.names
    found = [
        Pair(names[i], names[j], correlation)
        for correlation, i, j in correlated_pairs(fit.calibration.covariance)
        if names[j] != f"S{names[i][:0:-1]}" or not np.allclose(C[i], C[j], atol=1e-9)
    ]
    return tuple(sorted(found, key=lambda pair: -abs(pair.correlation))[:_SHOWN])


def _along(fit: Fit, telemetry: Telemetry, field_nT: FloatArray, kept: BoolArray) -> Along:
    u = field_nT / np.linalg.norm(field_nT, axis=1)[:, None]
    r = (u * fit.residuals_nT).sum(axis=1) if fit.residuals_nT.shape[1] == 3 else fit.residuals_nT[:, 0]
    r, u, B = r[kept], u[kept], telemetry.mag_B_nT[fit.rows][kept]
    turned = u @ (np.eye(3) + fit.calibration.S)
    noise = float(np.sqrt(((turned**2) @ fit.noise.variance_nT2).mean()))
    if fit.noise.covariance.any():  # that of each axis was found beside the attitude error, which is across the field
        noise = max(noise, white_nT(r, telemetry.time[fit.rows][kept]))
    square = _square_of_attitude_nT(fit, field_nT[kept])
    expected = float(np.hypot(noise, square))
    # Noise is new in every row: what lasts in the residual is no noise, but for the errors of the calibration itself.
    images = np.einsum("ni,nik->nk", u, of_parameters(B))
    of_own = fit.calibration.covariance[:12, :12] @ (images.T @ images / len(images))
    own = float(np.trace(of_own))
    if own > 0.0:  # one draw of a few parameters: of as many degrees of freedom as have the same mean and variance
        own *= _most_by_chance(own**2 / float(np.trace(of_own @ of_own)))
    if fit.error_model is not None and fit.error_model.slow_nT > 0.0:
        own *= _not_of_slow_errors(fit.error_model, noise, telemetry.time[fit.rows][kept])
    chance = float(np.sqrt(_most_by_chance(len(r))))
    allowed = float(np.hypot(chance * expected, np.sqrt(own)))
    return Along(float(np.sqrt((r**2).mean())), expected, allowed, chance * expected, square > _SHOWN_SQUARE * expected)


def _most_by_chance(freedom: float) -> float:
    """Variance over its expectation that chance passes once in a thousand times."""
    return float(chi2.ppf(1.0 - _FALSE_ALARM, freedom) / freedom)


def _square_of_attitude_nT(fit: Fit, field_nT: FloatArray) -> float:
    """rms along the field of what an error of the reference attitude takes from it; its mean goes into S.

    An angle theta leaves cos(theta). Its two components across the field have the variance sigma^2 each, so B theta^2 / 2
    has the mean B sigma^2 and, of a normal distribution, as large a standard deviation.
    """
    model = fit.error_model
    if fit.residuals_nT.shape[1] == 1 or model is None or not model.attitude_sigma_deg:
        return 0.0
    return float(np.sqrt((field_nT**2).sum(axis=1).mean()) * np.radians(model.attitude_sigma_deg) ** 2)


def _not_of_slow_errors(model: ErrorModel, noise_nT: float, time: TimeArray) -> float:
    """Share of the variance of a calibration that is due to noise and attitude: what an error of so many nT, which lasts so
    long, does to a mean grows with the square of the one and with the other.

    The remaining slow errors were found in the residual that is looked at, so they are no excuse for it.
    """
    step_s = float(np.median(np.diff(time) / np.timedelta64(1, "s")))
    of_attitude = max(model.expected_rms_nT**2 - noise_nT**2, 0.0) * max(model.attitude_tau_s or 0.0, step_s)
    known = noise_nT**2 * step_s + of_attitude
    return known / (known + model.slow_nT**2 * max(model.slow_tau_s, step_s))


class DeclaredNoise(NamedTuple):
    """The attitude error that the residual asks for, against the declared one."""

    ratio: float
    """The lower end of its 90 % interval over what was declared; 0 where nothing was declared."""
    words: str


def _against_declared(fit: Fit, declared_deg: float | None) -> DeclaredNoise:
    model = fit.error_model
    if not declared_deg or model is None or model.attitude_sigma_deg is None or model.attitude_range_deg is None:
        return DeclaredNoise(0.0, "")
    low, high = model.attitude_range_deg
    words = say("verdict.declared", sigma=model.attitude_sigma_deg, low=low, high=high, declared=declared_deg)
    return DeclaredNoise(low / declared_deg, words)


def _impossible(fit: Fit, declared: DeclaredNoise, along: Along, residual_nT: float, field_rms_nT: float) -> list[str]:
    """Sentences that say why this is no calibration of a magnetometer; none where it may be one."""
    found = []
    known = fit.calibration
    at = int(np.abs(known.S).argmax())
    value, sigma = float(known.S.ravel()[at]), float(known.sigmas[at])
    if abs(value) > IMPOSSIBLE_S:
        unsure = ", or data that hardly determine it" if abs(value) - IMPOSSIBLE_S < 2.0 * sigma else ""
        said = {"name": known.names[at], "value": measured(value, sigma or None), "most": 100 * IMPOSSIBLE_S}
        found.append(say("verdict.impossible_S", unsure=unsure, **said))
    allowed_nT = SEVERAL * float(np.hypot(along.noise_nT, FIELD_MODEL_NT))
    if along.found_nT > allowed_nT:
        S = "" if known.sigmas[:9].any() else "S (which was not estimated), "
        found.append(say("verdict.impossible_along", along=along, model_nT=FIELD_MODEL_NT, S=S))
    if declared.ratio > SEVERAL:
        found.append(declared.words)
    if residual_nT > IMPOSSIBLE_RESIDUAL * field_rms_nT / np.sqrt(fit.residuals_nT.shape[1]):
        share = 100 * residual_nT * np.sqrt(fit.residuals_nT.shape[1]) / field_rms_nT
        found.append(say("verdict.impossible_residual", share=share))
    if fit.rejected > _TOO_MANY_OUTLIERS * _rows(fit):
        found.append(say("verdict.impossible_outliers", share=100 * fit.rejected / _rows(fit), where=_stretch(fit)))
    return found or _undetermined(known)


def _undetermined(known: Calibration) -> list[str]:
    """A sentence on the element of S that the data know worst, where that is less than is known of any magnetometer."""
    at = int(known.sigmas[:9].argmax())
    said = {"name": known.names[at], "sigma": known.sigmas[at], "most": 100 * IMPOSSIBLE_S}
    return [say("verdict.undetermined_S", **said)] if known.sigmas[at] > IMPOSSIBLE_S else []


def _limits(
    fit: Fit,
    declared: DeclaredNoise,
    along: Along,
    direction: DirectionKnowledge,
    strength_nT: float,
    of_orbit: list[str],
) -> list[str]:
    """Sentences that say what a usable calibration lacks."""
    known = fit.calibration
    found = [*of_orbit, *fit.warnings, *([declared.words] if declared.ratio > _TRUSTED else [])]
    only_b = not known.sigmas[:9].any()
    if along.too_much and not of_orbit:  # which says why
        rest = float(np.sqrt(along.found_nT**2 - along.noise_nT**2))
        beyond = say("verdict.beyond_model", model_nT=FIELD_MODEL_NT) if along.beyond_model else say("verdict.of_model")
        beyond += say("verdict.of_turns") if along.turned else ""
        found.append(say("verdict.along", rest=rest, why=beyond, S=", S (which was not estimated)" if only_b else ""))
    if along.found_nT > _WEAK_S * strength_nT:
        found.append(say("verdict.misses", share=100 * along.found_nT / strength_nT))
    if _many_outliers(fit):
        found.append(say("verdict.many_outliers", share=100 * _MANY_OUTLIERS, where=_stretch(fit)))
    at = int(known.sigmas[:9].argmax())
    if known.sigmas[at] > _WEAK_S:
        weak = {"name": known.names[at], "sigma": known.sigmas[at], "deg": direction.calibration_anywhere_deg}
        found.append(say("verdict.weak", **weak))
    stated_deg = max(
        direction.after_deg, direction.calibration_anywhere_deg
    )  # errors of S and b may look like a rotation
    if direction.rotation_deg is not None and direction.rotation_deg > stated_deg:
        found.append(say("verdict.turned", deg=direction.rotation_deg))
    if direction.after_deg >= direction.before_deg:
        found.append(say("verdict.no_better"))
    return found


def _residual_words(fit: Fit, along: Along, residual_nT: float, *, impossible: bool) -> str:
    one = fit.residuals_nT.shape[1] == 1
    if impossible:  # of a fit that is none the noise is not known
        return say("verdict.residual_bad", residual=residual_nT, what="in |B|" if one else "per component")
    reading = float(np.sqrt(fit.noise.variance_nT2.mean()))
    if one:
        return say("verdict.residual_size", residual=residual_nT, reading=reading, given=along.noise_nT)
    model, because = fit.error_model, say("verdict.because_noise", reading=reading)
    if model is not None and model.attitude_sigma_deg is not None:
        because = say("verdict.because_both", reading=reading, model=model)
    if along.turned:
        words = say("verdict.residual_turned", residual=residual_nT, because=because, along=along)
    else:
        words = say("verdict.residual", residual=residual_nT, because=because, along=along)
    if along.chance_nT < along.found_nT and not along.too_much:
        words += say("verdict.along_allowed", most=along.allowed_nT)
    return words


def _rows(fit: Fit) -> int:
    """Rows that there were before outliers were set aside: some methods keep those with weight 0, some drop them."""
    return int(fit.kept.sum()) + fit.rejected


def _many_outliers(fit: Fit) -> bool:
    return fit.rejected > _MANY_OUTLIERS * _rows(fit)


def _stretch(fit: Fit) -> str:
    """A sentence on the one stretch in which nearly all outliers lie and most rows are outliers; empty where none is such.

    Errors of single readings would share a stretch by chance once in a thousand records.
    """
    out = ~fit.kept
    total = np.concatenate([[0], np.cumsum(np.where(out, 1, -1))])
    lowest = np.minimum.accumulate(total)
    end = int((total - lowest).argmax())  # where outliers most outnumber the other rows since the start of a stretch
    start = int(total[: end + 1].argmin())
    rows, inside, outliers = end - start, int(out[start:end].sum()), int(out.sum())
    by_chance = len(out) * (rows / len(out)) ** inside  # at most: so many stretches of this length begin somewhere
    if inside <= _NEARLY_ALL * outliers or by_chance > _FALSE_ALARM:
        return ""
    from_, to = epoch.iso(fit.time[start], "s"), epoch.iso(fit.time[end - 1], "s")
    where = f"from {from_} on" if end == len(out) else f"until {to}" if start == 0 else f"from {from_} to {to}"
    return say("verdict.stretch", inside=inside, rows=rows, outliers=outliers, where=where)


def _coupling(fit: Fit, dipole_B_Am2: FloatArray | None) -> str:
    """A sentence where torquers were on and nobody asked what couples from them; else empty."""
    if dipole_B_Am2 is None or fit.calibration.T_nT_per_Am2 is not None:
        return ""
    on = np.nanmean(np.nanmax(np.abs(dipole_B_Am2), axis=1) > 0.0) if np.isfinite(dipole_B_Am2).any() else 0.0
    return say("verdict.coupling", share=100 * on) if on else ""


def _orbit_suspect_km(fit: Fit, telemetry: Telemetry, along: Along, strength_nT: float) -> float:
    """How far two-line elements may be off (1 sigma), where that may be what noise does not explain; else 0.

    The field of a dipole changes by no more than 3 B / r per unit of length. `along.allowed_nT` allows for what such an
    error does, so twice the variance of noise alone is enough.
    """
    km = stated_km(telemetry)
    suspect = along.too_much or along.found_nT > np.sqrt(2.0) * along.noise_nT or _many_outliers(fit)
    if not km or telemetry.r_N_km is None or not suspect:
        return 0.0
    steepest = 3.0 * strength_nT / float(np.nanmin(np.linalg.norm(telemetry.r_N_km, axis=1)))
    return km if along.found_nT < float(np.hypot(along.noise_nT, SEVERAL * km * steepest)) else 0.0


def _next_step(
    fit: Fit, impossible: list[str], along: Along, direction: DirectionKnowledge, orbit_suspect: bool
) -> str:
    weak = direction_words(fit.variation.directions_B[0])
    if impossible and impossible == _undetermined(fit.calibration):
        return say("verdict.more_field", weak=weak)
    if orbit_suspect and not impossible:
        return _DIAGNOSE
    only_b = not fit.calibration.sigmas[:9].any()
    if only_b and along.too_much and len(impossible) < 2 and not _many_outliers(fit):  # it may be no more than S
        return "fluxtwin calibrate TELEMETRY --parameters b,S"
    if impossible or _many_outliers(fit) or along.beyond_model:
        return _CHECK
    if along.too_much:
        return _DIAGNOSE
    if direction.calibration_deg > direction.noise_deg:
        return say("verdict.more_field", weak=weak)
    return "fluxtwin apply TELEMETRY --calibration CALIBRATION.toml --out CORRECTED"
