"""Checks against a field model: unit, frame and axes of the position, attitude, mounting, clock; outliers.

One cause is named: what follows from it is not. All readings of the record that differ from it as it stands are weighed
against each other (`evidence`), so that the first name is the best one.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from scipy.spatial.transform import Rotation

from fluxtwin.calib.checks.clock import (
    BLOCKS,
    CLEAR,
    PLAIN_COST,
    STEP_S,
    check_clock,
    check_jump,
    cost,
    named_shift,
    of_elements,
    plain_shifts_s,
    predictions,
    readings_shift,
    shift_words,
    shifts_s,
    still_off,
)
from fluxtwin.calib.checks.evidence import Evidence, MODEL_nT, scalar_evidence, vector_evidence
from fluxtwin.calib.checks.matrix import check_matrix, eddies_would_do
from fluxtwin.calib.checks.orientation import FAR_BETTER, LOCAL, ORIENTATION, SINGLE_COST, Hypothesis, orientations
from fluxtwin.calib.checks.outliers import check_outliers, without_gross_outliers
from fluxtwin.calib.checks.report import Finding, named, note, trap
from fluxtwin.calib.checks.sample import FEWEST, MAX_ROWS, Sample, comparable, rms
from fluxtwin.calib.checks.stretch import check_stretch
from fluxtwin.calib.checks.unit import SMALLEST_MISFIT_nT, blind_magnitude, check_unit
from fluxtwin.sim.base.errors import OutOfRange
from fluxtwin.sim.base.types import BoolArray, FloatArray
from fluxtwin.sim.earth import frames, sun
from fluxtwin.sim.earth.field import FieldModel, field_N_nT
from fluxtwin.sim.telemetry.record import Origin, Telemetry

SUN_MISFIT_DEG = 20.0
"""Sun sensors err by less than a few degrees; a wrong attitude or axis by tens."""
ORIENTATION_MISFIT, SCALAR_MISFIT = 0.2, 0.1
"""Share of |B| left after the fit, by vectors and by |B|: above, nothing fits. Misaligned, miscaled sensors leave up
to 0.17 (S of 10 % in every element)."""
LARGE_BIAS_nT = 7_500.0
"""Misfits without bias fit below this are a usual bias and errors of 10 %; above, the bias is large or the axes wrong."""
MENDED_MISFIT = 0.17
"""Share of |B| that a name may leave: what S of 10 % in every element does."""
SCALAR_MENDED = 0.04
"""By |B| alone a name must leave less: noise and coarse steps do, scale errors are fitted."""
POSITION_COST = 10.0
"""Log prior odds against swapped or reversed axes of the position."""
AMBIGUOUS = 2.0
"""Log odds below which two names are not distinguished."""


def check_of_date(telemetry: Telemetry) -> list[Finding]:
    """Attitude relative to axes of date under the name GCRS, tested with the measured sun."""
    if telemetry.sun_B is None or telemetry.q_NB is None:
        return [note("of_date_not_tested.no_sun")]
    rows = np.flatnonzero(telemetry.has_attitude & np.isfinite(telemetry.sun_B).all(axis=1))
    rows = rows[np.linspace(0, rows.size - 1, min(rows.size, MAX_ROWS)).astype(int)] if rows.size else rows
    if rows.size < FEWEST:
        return [note("of_date_not_tested.few")]
    time, measured = telemetry.time[rows], np.array(telemetry.sun_B[rows])
    measured /= np.linalg.norm(measured, axis=1)[:, None]
    R_BN = frames.rotation_from_q(telemetry.q_NB[rows])
    towards = sun.sun_direction_N(time)
    turn, _ = Rotation.align_vectors(measured, R_BN.apply(towards))
    plain = turn.apply(R_BN.apply(towards))
    off = float(np.degrees(np.sqrt(np.mean(np.sum((measured - plain) ** 2, axis=1)))))
    if off > SUN_MISFIT_DEG:
        return [trap("sun_vector", off=off)]
    dated = turn.apply(R_BN.apply(frames.rotation_TN(time).apply(towards)))
    return _share_of_date(measured - plain, dated - plain, plain)


def _share_of_date(residual: FloatArray, shift: FloatArray, towards_B: FloatArray) -> list[Finding]:
    """How much of the shift from GCRS to axes of date the sun residuals contain: 0 or 1, or it cannot be said.

    A constant small turn of the sensor is free. The uncertainty is that of ten blocks in time, left out in turn
    (jackknife), so that attitude errors which last for minutes count.
    """
    turns = [np.cross(axis, towards_B) for axis in np.eye(3)]
    design = np.stack([shift, *turns], axis=-1)
    free = np.stack(turns, axis=-1).reshape(-1, 3)
    flat = shift.reshape(-1)
    alone = (flat - free @ np.linalg.lstsq(free, flat, rcond=None)[0]).reshape(shift.shape)
    seen = float(np.degrees(np.sqrt(np.mean(np.sum(alone**2, axis=1)))))
    blocks = np.array_split(np.arange(len(residual)), 10)
    shares = []
    for block in blocks:
        rest = np.setdiff1d(np.arange(len(residual)), block)
        fit = np.linalg.lstsq(design[rest].reshape(-1, 4), residual[rest].reshape(-1), rcond=None)[0]
        shares.append(float(fit[0]))
    share, sigma = float(np.mean(shares)), float(np.std(shares) * np.sqrt(len(blocks) - 1))
    if seen < 0.01 or sigma > 0.15:
        return [note("of_date_not_tested.alike", seen=seen)]
    if abs(share - 1.0) > 0.3 or share < 6.0 * sigma:
        return []
    return [trap("attitude_of_date", share=100 * share, sigma=100 * sigma, seen=seen)]


def check_field(telemetry: Telemetry, model: FieldModel, usable: BoolArray) -> list[Finding]:
    """All checks of this module on the rows `usable` (N,); at most one trap."""
    origin = telemetry.origin
    try:
        sample = comparable(telemetry, model, usable, with_attitude=False)
        posed = comparable(telemetry, model, usable, with_attitude=True)
    except OutOfRange as error:
        unit = [finding for finding in blind_magnitude(telemetry) if finding.severity == "trap"]
        return [*unit, trap("outside_field_model", error=error)]
    if sample is None:
        return [*blind_magnitude(telemetry), *check_outliers(telemetry, None, model, usable)[0]]
    unit = check_unit(sample)
    if any(found.severity == "trap" for found in unit):  # a wrong unit must not look like a wrong attitude
        if posed is not None and len(posed) >= FEWEST and (found := check_matrix(without_gross_outliers(posed))):
            return found
        return [*unit, note("orientation_not_tested.unit")]
    findings, with_attitude = list(unit), posed is not None and len(posed) >= FEWEST
    if not with_attitude:
        findings.append(note("orientation_not_tested.few"))
    chosen = posed if posed is not None and with_attitude else sample
    if len(chosen) < FEWEST:
        return findings
    if with_attitude and (turned := check_stretch(chosen)):
        return [*findings, *turned]
    outliers, faulty = check_outliers(telemetry, chosen, model, usable)
    chosen = without_gross_outliers(chosen.take(~faulty[chosen.rows]))
    compared = _by_vectors(chosen, telemetry, model, origin) if with_attitude else _by_size(chosen, model, origin)
    if not any(found.severity == "trap" for found in compared):
        compared += check_clock(chosen, model, origin)
    if any(found.code in ("clock", "epoch_off") for found in compared):
        compared = check_jump(chosen, model, origin) or compared
    if not any(found.severity == "trap" for found in compared):
        compared += [*outliers, *check_of_date(telemetry)]
    return [*findings, *compared]


def _by_vectors(sample: Sample, telemetry: Telemetry, model: FieldModel, origin: Origin) -> list[Finding]:
    """The best name for what is wrong, from readings with attitude; notes where nothing is."""
    small = sample.thinned(BLOCKS)
    tried = [*orientations(small, origin), *_positions(small, model, origin), *_stamps(small, model, origin)]
    if impossible := check_matrix(sample, tried):
        return impossible
    misfit = _after_bias_fit(small, tried)
    far_better = np.flatnonzero(misfit <= FAR_BETTER * misfit[0])
    found, left = None, np.inf
    if far_better.size:
        kept = [0, *far_better.tolist()]
        tried = [tried[k] for k in kept]
        evidence = vector_evidence(small.seconds, small.mag_nT, np.stack([one.predicted_nT for one in tried]))
        found, left = _best(tried, evidence, misfit[kept])
    poor = left > max(MENDED_MISFIT * sample.typical_nT, SMALLEST_MISFIT_nT)
    if found is not None and not poor:
        return [found]
    if misfit[0] <= max(ORIENTATION_MISFIT * sample.typical_nT, SMALLEST_MISFIT_nT) or eddies_would_do(sample):
        findings = []
        expected = sample.R_BN.apply(sample.field_N_nT)
        missed = rms(sample.mag_nT - expected)
        if missed > LARGE_BIAS_nT:
            findings.append(note("large_bias.by_vectors", missed=missed))
        if rms(expected - expected.mean(axis=0)) < 0.15 * sample.typical_nT:
            findings.append(note("orientation_not_tested.steady"))
        return findings
    shift = readings_shift(sample, telemetry, model)
    if shift is not None:
        shift_s, as_is, mended = shift
        late, side = ("late", "before") if shift_s > 0 else ("early", "after")
        said = {"hours": abs(shift_s) / 3600.0, "late": late, "side": side, "offset": -shift_s}
        return [trap("clock.readings", as_is=as_is, mended=mended, **said)]
    by_size = _by_size(dataclasses.replace(sample, q_NB=None), model, origin)
    if any(one.severity == "trap" for one in by_size):
        return by_size
    return [trap("vector_mismatch", misfit=misfit[0], share=100 * misfit[0] / sample.typical_nT)]


def _after_bias_fit(sample: Sample, tried: list[Hypothesis]) -> FloatArray:
    """(K,) rms [nT] of what a constant bias leaves."""
    left = np.stack([one.predicted_nT for one in tried]) - sample.mag_nT
    return np.asarray(np.sqrt(np.sum(np.var(left, axis=1), axis=1)))


def _by_size(sample: Sample, model: FieldModel, origin: Origin) -> list[Finding]:
    """The best name for wrong positions or stamps, from |B| alone."""
    if len(sample) < 3 * FEWEST:
        return []
    small = sample.thinned(2 * BLOCKS)
    plain = Hypothesis("", "", "", 0.0, small.field_N_nT)
    tried = [plain, *_positions(small, model, origin), *_stamps(small, model, origin)]
    size = np.stack([np.linalg.norm(one.predicted_nT, axis=1) for one in tried])
    evidence = scalar_evidence(small.seconds, small.mag_nT, size)
    found, left = _best(tried, evidence, evidence.misfit_nT)
    if found is not None and left < max(SCALAR_MENDED * sample.typical_nT, SMALLEST_MISFIT_nT):
        return [found]
    missed = float(evidence.misfit_nT[0])
    if missed <= max(SCALAR_MISFIT * sample.typical_nT, SMALLEST_MISFIT_nT):
        return []
    return [trap("field_mismatch", misfit=missed, share=100 * missed / sample.typical_nT)]


def _best(tried: list[Hypothesis], evidence: Evidence, misfit_nT: FloatArray) -> tuple[Finding | None, float]:
    """The hypothesis that stands out, as a trap, and the misfit it leaves; None where none is far better."""
    odds = evidence.log - evidence.log[0] - np.array([one.cost for one in tried])
    odds[1:][misfit_nT[1:] > FAR_BETTER * misfit_nT[0]] = -np.inf
    best = _likeliest(tried, odds, evidence.misfit_nT)
    if best == 0 or odds[best] < CLEAR:
        return None, np.inf
    one, as_is, mended = tried[best], float(misfit_nT[0]), float(misfit_nT[best])
    rivals = [
        f"{shift_words(other.shift_s)} ({other.words})" if other.shift_s else other.words
        for value, other in sorted(zip(odds, tried, strict=True), key=lambda pair: -pair[0])
        if value > odds[best] - AMBIGUOUS
        and other is not one
        and other.words
        and not (one.cost == other.cost == PLAIN_COST and abs(one.shift_s - other.shift_s) <= 3.0 * STEP_S)
    ]
    others = "; or ".join(rivals[:2])
    if one.shift_s:
        doubt = f". Nearly as likely: {others}" if rivals else ""
        doubt = still_off(float(evidence.misfit_nT[best])) + doubt
        return named("clock", named_shift(one.shift_s, one.words, as_is, mended) + doubt), mended
    text = (
        f"as it stands the reading misses the model by {as_is:.0f} nT rms after a bias fit, but only by {mended:.0f} nT"
    )
    if not rivals:
        return named(one.code, f"{text} if {one.words}: {one.advice}"), mended
    local = all(any(word in said for word in LOCAL) for said in (one.words, rivals[0]))
    settles = (
        "the documentation of the attitude (its vertical is geocentric in NEC, geodetic in NED, up to 0.19 deg apart), or a "
        "longer record"
        if local
        else "the documentation of the file, or a record in which the body turns about another axis"
    )
    text += f" if {one.words}, or if {others}: both are possible. What settles it: {settles}; {one.advice}"
    return named(one.code, text), mended


def _likeliest(tried: list[Hypothesis], odds: FloatArray, misfit_nT: FloatArray) -> int:
    """The likeliest hypothesis, or where that is an orientation one with less wrong, that would be likelier if both fitted
    alike, as they may.

    Where the attitude is held, the errors of the recorded attitude are all that moves, and another convention is to the
    record what another draw of these errors is: the rms of n rows is known to 1 / sqrt(2 n), those of two draws differ by
    sqrt(2) times that. So three sigma of it tell nothing, and what they add to the evidence of 3 n values is taken off.
    Stamps that are off turn the field about the pole, which is a turn of the axes to a body that is held.
    """
    best, rows = int(np.argmax(odds)), len(tried[0].predicted_nT)
    if tried[best].code not in ORIENTATION:
        return best
    misfit_nT = np.maximum(misfit_nT, MODEL_nT)
    worse = np.log(misfit_nT / misfit_nT[best])
    simpler = np.array([one.cost < tried[best].cost for one in tried])
    simpler &= worse <= np.log1p(3.0 / rows**0.5)
    simpler[best] = True
    return int(np.argmax(np.where(simpler, odds + 3.0 * rows * worse, -np.inf)))


def _positions(sample: Sample, model: FieldModel, origin: Origin) -> list[Hypothesis]:
    """Positions in the other frame, Earth-fixed or inertial; with attitude also those with axes swapped, which |B| alone
    takes for a phase."""
    if origin.position == "ITRS":  # they were turned to GCRS on reading
        words, advice = (
            "the positions are inertial (GCRS), not Earth-fixed",
            'name them r_x_km r_y_km r_z_km, or frame = "GCRS" for `position` in a column map',
        )
    else:
        words, advice = (
            "the positions are Earth-fixed",
            'name them ecef_x_km ecef_y_km ecef_z_km, or frame = "ITRS" for `position` in a column map',
        )
    r = sample.R_EN.apply(sample.r_N_km, inverse=origin.position != "ITRS")
    readings = [("position_frame", words, advice, SINGLE_COST, r)]
    for order in () if sample.q_NB is None else ((0, 2, 1), (1, 0, 2), (2, 1, 0), (1, 2, 0), (2, 0, 1)):
        r = sample.r_N_km[:, order]
        said = ", ".join(f"r_{one} is {'xyz'[other]}" for one, other in zip("xyz", order, strict=True))
        words = f"the axes of the position are swapped ({said})"
        readings.append(("position_axes", words, "rename the columns", POSITION_COST, r))
    out = []
    for code, words, advice, price, r in readings:
        field = field_N_nT(model, sample.time, r)
        predicted = field if sample.q_NB is None else sample.R_BN.apply(field)
        out.append(Hypothesis(code, words, advice, price, predicted))
    return out


def _stamps(sample: Sample, model: FieldModel, origin: Origin) -> list[Hypothesis]:
    """Stamps that are off by so much that the reading fits far better without."""
    known = shifts_s(sample)
    names = plain_shifts_s(origin) | known
    fields = predictions(sample, model, origin, (one for one in names if not of_elements(one, known, sample, origin)))
    return [
        Hypothesis("clock", names[shift], "", cost(shift, known), predicted, shift)
        for shift, predicted in fields.items()
    ]
