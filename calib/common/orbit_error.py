"""Positions from two-line elements err along the track, the more the older they are: the part of it in the sigmas.

The error is the same for the whole record, so no residual shows how large it is; a body that keeps pointing at the Earth
takes it for a rotation of its magnetometer. Its size is that of `tle.along_track_sigma_km` (Vallado 2006).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from scipy.spatial.transform import Rotation

from fluxtwin.sim.base.errors import NoAnswer
from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.earth import frames
from fluxtwin.sim.earth.references import OF_POSITION, rotation_XN
from fluxtwin.sim.telemetry.companions import ALONG_TRACK_KM, ATTITUDE_OF_ORBIT
from fluxtwin.sim.telemetry.record import Telemetry

if TYPE_CHECKING:
    from fluxtwin.calib.common.fit import Fit

_EARTH_KM = 6378.0
"""An error as large as the Earth is none along a track."""


def with_orbit_error(fit: Fit, telemetry: Telemetry, again: Callable[[Telemetry], Fit]) -> Fit:
    """The fit with the error of its positions along the track in the covariance, where its record states one.

    again: the same fit of another record. The answer changes in proportion to a shift of less than a degree, so one refit
    with the positions one sigma ahead gives the whole part.
    """
    sigma_km = stated_km(telemetry)
    if not sigma_km or telemetry.r_N_km is None or telemetry.v_N_km_s is None:
        return fit
    said = f"the positions are those of two-line elements, by their age {sigma_km:.3g} km off along the track (1 sigma)"
    try:
        moved = again(ahead(telemetry, sigma_km)).calibration
    except NoAnswer:
        return replace(fit, messages=(*fit.messages, f"{said}, which is not in the sigmas"))
    known = fit.calibration
    step = np.where(known.sigmas > 0.0, moved.values - known.values, 0.0)
    calibration = replace(known, covariance=known.covariance + np.outer(step, step))
    share = np.abs(step) / np.where(known.sigmas > 0.0, known.sigmas, np.inf)
    most = int(np.argmax(share))
    times = f"{np.hypot(1.0, share[most]):.2g} times as large"
    words = f"{said}: that is in the sigmas, and makes that of {known.names[most]} {times}"
    return replace(fit, calibration=calibration, messages=(*fit.messages, words))


def stated_km(telemetry: Telemetry) -> float:
    """The error along the track that the provenance states, 1 sigma; 0 where it states none, or no number, as a
    foreign file may."""
    try:
        size = float(telemetry.provenance.get(ALONG_TRACK_KM, "0"))
    except ValueError:
        return 0.0
    return size if 0.0 < size < _EARTH_KM else 0.0


def ahead(telemetry: Telemetry, distance_km: float | FloatArray) -> Telemetry:
    """The record with its positions that far, one number or (N,), ahead on a circle, and what the attitude takes of them."""
    assert telemetry.r_N_km is not None and telemetry.v_N_km_s is not None
    r, v = np.array(telemetry.r_N_km), np.array(telemetry.v_N_km_s)
    rows = np.flatnonzero(np.isfinite(np.hstack([r, v])).all(axis=1))
    normal = np.cross(r[rows], v[rows])
    angle = (
        np.broadcast_to(distance_km, len(r))[rows] / np.linalg.norm(r[rows], axis=1) / np.linalg.norm(normal, axis=1)
    )
    turn = Rotation.from_rotvec(normal * angle[:, None])
    new_r, new_v, q = r.copy(), v.copy(), telemetry.q_NB
    new_r[rows], new_v[rows] = turn.apply(r[rows]), turn.apply(v[rows])
    axes = telemetry.provenance.get(ATTITUDE_OF_ORBIT)
    if axes in OF_POSITION and q is not None:
        q = np.array(q)
        posed = rows[np.isfinite(q[rows]).all(axis=1)]
        old, new = (
            rotation_XN(axes, telemetry.time[posed], one[posed], two[posed]) for one, two in ((r, v), (new_r, new_v))
        )
        q[posed] = frames.q_from_rotation(frames.rotation_from_q(q[posed]) * old.inv() * new)
    return telemetry.replace(r_N_km=new_r, v_N_km_s=new_v, q_NB=q)
