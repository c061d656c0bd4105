"""Fields that follow columns, weighted by what the errors were found to be.

An error of the attitude, of half a degree for minutes, moves the reading by hundreds of nT, across the field and not along
it. Least squares, which is right for S and b whatever the errors are (`covariance_report`), hears a column through all
of that; the weighted fit of

    B = G (1 + [theta x]) H + o + C D + sum_j s_j d_j + h + white

with theta, h and white noise of the sizes that `error_model` has found hears it where it is quiet (Aitken 1935). It serves
the fields of columns alone: what switches is not in step with an error of the field model, which lies along the field.
S, b and T are then least squares of the reading without these fields.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from fluxtwin.calib.common.covariance import stretches
from fluxtwin.calib.common.design import Design, of_turns
from fluxtwin.calib.common.drivers import drawn_in, drops_of
from fluxtwin.calib.common.records import seconds_of
from fluxtwin.sim.base.types import FloatArray

if TYPE_CHECKING:
    from fluxtwin.calib.linear.calibrate import LinearFit

_SEARCHED = 20_000
"""Rows in which delays and lags are looked for."""


def weighted_fields(fit: LinearFit, design: Design) -> tuple[FloatArray, FloatArray]:
    """(J, 3) fields of the design's columns [nT a unit] and their covariance (3J, 3J), by the errors that the fit has found.

    The covariance is scaled up, never down, by the mean square of what is left over what was expected.
    """
    rows = np.flatnonzero(fit.kept)
    columns = np.stack(list(design.columns.values()), axis=1)
    unit = np.sqrt((columns**2).mean(axis=0))
    others = _others(fit, design)
    gram = _products(fit, design, rows, [*others, *(columns / unit).T])
    fixed = 3 * len(others)
    scale = np.sqrt(np.diag(gram)[:-1])
    inverse = np.linalg.inv(gram[:-1, :-1] / np.outer(scale, scale)) / np.outer(scale, scale)
    found = inverse @ gram[:-1, -1]
    misfit = (gram[-1, -1] - found @ gram[:-1, -1]) / max(3 * len(rows) - len(found), 1)
    per = np.repeat(1.0 / unit, 3)
    covariance = inverse[fixed:, fixed:] * np.outer(per, per) * max(misfit, 1.0)
    return (found[fixed:] * per).reshape(-1, 3), covariance


def drops(
    fit: LinearFit, design: Design, columns: Mapping[str, FloatArray], name: str, tried: FloatArray
) -> FloatArray:
    """(c,) by how much each of `tried` (n, c) lowers chi-square in the place of the column `name`; see `drivers.Drops`."""
    rows = stretches(len(design), _SEARCHED)
    back = np.linalg.inv(np.eye(3) + fit.calibration.S)
    B = design.B_nT + drawn_in(fit.residuals_nT, fit.kept) @ back.T
    design = replace(design, B_nT=B)
    others = [*_others(fit, design), *(values for one, values in columns.items() if one != name)]
    return drops_of(_products(fit, design, rows, [*others, *tried.T]), 3 * len(others), 3)


def _others(fit: LinearFit, design: Design) -> list[FloatArray]:
    """What is fitted beside the columns, each (N,)."""
    held = [np.ones(len(design))]
    if fit.calibration.S.any():
        held += list(design.H_nT.T)
    if design.D_Am2 is not None:
        held += [one for one in design.D_Am2.T if one.any()]
    return held


def _products(fit: LinearFit, design: Design, rows: np.ndarray, parts: list[FloatArray]) -> FloatArray:
    """(q, q) whitened products in some rows: of three columns, one an axis, for each part (N,), and of what is fitted."""
    from fluxtwin.calib.common.error_kernels import whitened_gram

    errors = fit.error_model
    assert errors is not None
    H, seconds = design.H_nT[rows], seconds_of(design.time[rows])
    columns = np.zeros((len(rows), 3, 3 * len(parts) + 1))
    for axis in range(3):
        columns[:, axis, axis:-1:3] = np.stack([part[rows] for part in parts], axis=1)
    columns[:, :, -1] = design.B_nT[rows] if fit.calibration.S.any() else design.B_nT[rows] - H
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
