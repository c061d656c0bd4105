"""Attitude relative to axes of date under the name of GCRS, tested with the measured sun."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from fluxtwin.calib.checks.report import Finding, note, trap
from fluxtwin.calib.checks.sample import FEWEST, MAX_ROWS
from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.earth import frames, sun
from fluxtwin.sim.telemetry.record import Telemetry

SUN_MISFIT_DEG = 20.0
"""Sun sensors err by less than a few degrees; a wrong attitude or axis by tens."""


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
