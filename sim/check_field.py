"""Checks against a field model: the frame of the position, axes of date; unit and orientation by their own modules."""

from __future__ import annotations

import dataclasses
import itertools

import numpy as np
from scipy.spatial.transform import Rotation

from fluxtwin.sim import frames, sun
from fluxtwin.sim.check_orientation import FAR_BETTER, Sample, SMALLEST_MISFIT_nT, check_orientation
from fluxtwin.sim.check_report import Finding, note, trap
from fluxtwin.sim.check_unit import blind_magnitude, check_unit
from fluxtwin.sim.errors import OutOfRange
from fluxtwin.sim.field import FieldModel, field_N_nT
from fluxtwin.sim.telemetry import Telemetry
from fluxtwin.sim.telemetry_build import velocity_from_positions
from fluxtwin.sim.types import FloatArray

SCALAR_MISFIT = 0.1
"""Share of |B| left after a ten-parameter ellipsoid: above, the reading does not belong to the position."""
SUN_MISFIT_DEG = 20.0
"""Sun sensors err by less than a few degrees; a wrong attitude or axis by tens."""
_FEWEST = 20
_MAX_ROWS = 3000


def check_field(telemetry: Telemetry, model: FieldModel) -> list[Finding]:
    """All checks of this module."""
    try:
        sample = _comparable(telemetry, model, with_attitude=False)
    except OutOfRange as error:
        unit = [finding for finding in blind_magnitude(telemetry) if finding.severity == "trap"]
        return [*unit, trap("outside_field_model", f"{error}; or the time stamps are wrong")]
    if sample is None:
        return blind_magnitude(telemetry)
    unit = check_unit(sample)
    scalar = [] if any(found.severity == "trap" for found in unit) else _scalar(sample, model)
    posed = _comparable(telemetry, model, with_attitude=True)
    if posed is None or len(posed.time) < _FEWEST:
        reason = note("orientation_not_tested", "fewer than 20 rows have reading, position and attitude")
        return [*unit, *scalar, reason]
    if any(found.severity == "trap" for found in unit):  # a wrong unit must not look like a wrong attitude
        size, wanted = (np.median(np.linalg.norm(x, axis=1)) for x in (posed.mag_nT, posed.field_N_nT))
        posed = dataclasses.replace(posed, mag_nT=posed.mag_nT * (wanted / size))
    return [*unit, *scalar, *check_orientation(posed), *_of_date(telemetry)]


def _comparable(telemetry: Telemetry, model: FieldModel, *, with_attitude: bool) -> Sample | None:
    good = telemetry.has_reading & telemetry.has_position
    if with_attitude:
        good &= telemetry.has_attitude
    rows = np.flatnonzero(good)
    if rows.size == 0 or telemetry.r_N_km is None:
        return None
    rows = rows[np.linspace(0, rows.size - 1, min(rows.size, _MAX_ROWS)).astype(int)]
    r = np.array(telemetry.r_N_km[rows])
    rows, r = rows[np.linalg.norm(r, axis=1) > 6300.0], r[np.linalg.norm(r, axis=1) > 6300.0]
    if rows.size == 0:
        return None
    mag = np.array(telemetry.mag_B_nT[rows])
    size = np.linalg.norm(mag, axis=1)
    sane = size < 3.0 * np.median(size)  # single bit errors must not decide
    rows, r, mag = rows[sane], r[sane], mag[sane]
    v = telemetry.v_N_km_s
    return Sample(
        telemetry.time[rows],
        r,
        mag,
        field_N_nT(model, telemetry.time[rows], r),
        None if telemetry.q_NB is None else np.array(telemetry.q_NB[rows]),
        velocity_from_positions(telemetry.time[rows], r) if v is None else np.array(v[rows]),
    )


def _scalar(sample: Sample, model: FieldModel) -> list[Finding]:
    """|B| against the model under three readings of the position, each after a ten-parameter ellipsoid fit."""
    if len(sample.time) < 3 * _FEWEST:
        return []
    typical = float(np.median(np.linalg.norm(sample.field_N_nT, axis=1)))
    as_is = _ellipsoid_misfit(sample.mag_nT, sample.field_N_nT)
    if as_is <= max(SCALAR_MISFIT * typical, SMALLEST_MISFIT_nT):
        return []
    r_from_E = frames.rotation_EN(sample.time).apply(sample.r_N_km, inverse=True)
    earth_fixed = _ellipsoid_misfit(sample.mag_nT, field_N_nT(model, sample.time, r_from_E))
    evidence = f"|B| leaves {as_is:.0f} nT rms against the model after an ellipsoid fit"
    if earth_fixed < FAR_BETTER * as_is:
        return [
            trap(
                "position_frame",
                f"{evidence}, but {earth_fixed:.0f} nT if the positions are Earth-fixed. Name them ecef_x_km ...",
            )
        ]
    return [
        trap(
            "field_mismatch",
            f"{evidence}, {100 * as_is / typical:.0f} % of |B|: wrong positions or times, swapped columns, or "
            "interference as large as the field",
        )
    ]


def _ellipsoid_misfit(mag_nT: FloatArray, field_nT: FloatArray) -> float:
    """Rms [nT] of |B| left by the best quadratic form of the reading (bias, scale, misalignment all free)."""
    scale = 1e4
    m = mag_nT / scale
    size = np.linalg.norm(field_nT, axis=1) / scale
    pairs = [m[:, i] * m[:, j] for i, j in itertools.combinations_with_replacement(range(3), 2)]
    design = np.column_stack([*pairs, m, np.ones(len(m))])
    target = size**2
    fit, *_ = np.linalg.lstsq(design, target, rcond=1e-10)
    left = (design @ fit - target) / (2.0 * size)
    core = np.abs(left) <= 5.0 * np.median(np.abs(left)) + 1e-12
    return float(np.sqrt(np.mean(left[core] ** 2)) * scale)


def _of_date(telemetry: Telemetry) -> list[Finding]:
    """Attitude relative to axes of date under the name GCRS, judged by the measured sun."""
    if telemetry.sun_B is None or telemetry.q_NB is None:
        return [note("of_date_not_tested", "no measured sun vector: J2000 and axes of date cannot be told apart")]
    rows = np.flatnonzero(telemetry.has_attitude & np.isfinite(telemetry.sun_B).all(axis=1))
    rows = rows[np.linspace(0, rows.size - 1, min(rows.size, _MAX_ROWS)).astype(int)] if rows.size else rows
    if rows.size < _FEWEST:
        return [note("of_date_not_tested", "fewer than 20 rows have attitude and sun vector")]
    time, measured = telemetry.time[rows], np.array(telemetry.sun_B[rows])
    measured /= np.linalg.norm(measured, axis=1)[:, None]
    R_BN = frames.rotation_from_q(telemetry.q_NB[rows])
    towards = sun.sun_direction_N(time)
    turn, _ = Rotation.align_vectors(measured, R_BN.apply(towards))
    plain = turn.apply(R_BN.apply(towards))
    off = float(np.degrees(np.sqrt(np.mean(np.sum((measured - plain) ** 2, axis=1)))))
    if off > SUN_MISFIT_DEG:
        return [
            trap("sun_vector", f"the measured sun misses the computed one by {off:.0f} deg rms under this attitude")
        ]
    dated = turn.apply(R_BN.apply(frames.rotation_TN(time).apply(towards)))
    return _share_of_date(measured - plain, dated - plain, plain)


def _share_of_date(residual: FloatArray, shift: FloatArray, towards_B: FloatArray) -> list[Finding]:
    """How much of the shift from GCRS to axes of date the sun residuals contain: 0 or 1, or it cannot be told.

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
        return [
            note(
                "of_date_not_tested",
                f"GCRS and axes of date differ here by {seen:.3f} deg in a way the sun vector could show: too little",
            )
        ]
    if abs(share - 1.0) > 0.3 or share < 6.0 * sigma:
        return []
    return [
        trap(
            "attitude_of_date",
            f"the measured sun shows {100 * share:.0f} +- {100 * sigma:.0f} % of the {seen:.3f} deg between GCRS and "
            "axes of date: the attitude is relative to the equator and equinox of date. Map it with relative_to = "
            "'true_of_date'",
        )
    ]
