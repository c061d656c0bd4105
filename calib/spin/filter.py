"""A Kalman filter for a spinning spacecraft whose rate comes from its momentum.

State: the attitude A (N to B) and the angular momentum L in N, which is constant without torque; rate w = J^-1 A L.
Errors: dtheta in B and dL in N (the form that Markley & Sedlak 2008 recommend). An axisymmetric body moves in closed
form. A slit's pulse is two scalars: the azimuth of the sun when it crosses, and its elevation. Only the ratio of the
moments matters; L is in units of Jt.

An extended filter freezes what it got wrong while it knew little: a sigma in an hour. Where a near motion is known, all
is linearised about that one instead (`extended` off), which makes a pass a step of Gauss and Newton.

Innovations over their predicted covariance average 1 a component when readings, alignment and motion are right: they
say when the calibration is finished.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from fluxtwin.calib.spin.rows import SpinRows
from fluxtwin.sim.base.types import FloatArray


@dataclass(frozen=True)
class FilterSettings:
    """Noise of the sensors and of the motion."""

    field_nT: float
    """1 sigma of a component."""
    sun_rad: float
    """1 sigma of either angle."""
    torque_walk_rad_s: float = 0.0
    """Process noise: random walk of L / Jt in a second, per axis, 1 sigma."""
    first_attitude_rad: float = 0.1
    """1 sigma of the start."""
    first_rate_rad_s: float = 0.05
    """1 sigma of the start in L / Jt."""
    extended: bool = True
    """Linearise about the latest estimate; False: about the motion given, where that is near already."""


class Filtered(NamedTuple):
    """What the filter gives."""

    A: FloatArray
    """(N, 3, 3) attitude at the readings, after each."""
    pulse_A: FloatArray
    """(M, 3, 3) at the pulses."""
    L: FloatArray
    """(3,) momentum at the end, in units of Jt."""
    A_last: FloatArray
    """(3, 3) at the last event."""
    last_s: float
    P: FloatArray
    """(6, 6) at the end."""
    field_nis: float
    """Mean squared innovation a component of the field: 1 when finished."""
    sun_nis: float
    """The same of the sun's angles."""


def spin_filter(
    rows: SpinRows,
    field_B_nT: FloatArray,
    A0: FloatArray,
    rate_B_rad_s: FloatArray,
    ratio: float,
    settings: FilterSettings,
) -> Filtered:
    """Run through the rows from attitude A0 (3, 3) and rate (3,) at their first event.

    field_B_nT: (N, 3) readings as calibrated so far. ratio: Js / Jt, of the moments about body z and across it.
    """
    from fluxtwin.calib.spin.filter_kernels import run_filter

    t = np.concatenate([rows.t_s, rows.pulse_s])
    order = np.argsort(t, kind="stable")
    kind = np.concatenate([np.zeros(len(rows)), np.ones(len(rows.pulse_s))])[order]
    seen = np.concatenate([field_B_nT, rows.sun_B])[order]
    ref = np.concatenate([rows.H_N_nT, rows.sun_N])[order]
    P = np.diag(np.repeat([settings.first_attitude_rad**2, settings.first_rate_rad_s**2], 3))
    noise = np.array([settings.field_nT, settings.sun_rad, settings.torque_walk_rad_s**2])
    n = t.size
    history, nis = np.empty((n, 3, 3)), np.empty(n)
    A0 = np.ascontiguousarray(A0, dtype=np.float64)
    L0 = np.ascontiguousarray(A0.T @ (np.array([1.0, 1.0, ratio]) * rate_B_rad_s))
    A, L, P = run_filter(t[order], kind, seen, ref, A0, L0, P, ratio, noise, settings.extended, history, nis)
    field = kind == 0.0
    settled = np.arange(n) >= n // 10  # the start is not the filter's merit
    return Filtered(
        A=history[field],
        pulse_A=history[~field],
        L=L,
        A_last=A,
        last_s=float(t[order][-1]),
        P=P,
        field_nis=float(nis[field & settled].mean() / 3.0),
        sun_nis=float(nis[~field & settled].mean() / 2.0),
    )
