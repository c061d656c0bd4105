"""The iteration of Sedlak's "Iterative Magnetometer Calibration": scalar, filter, alignment, and again.

1. TWOSTEP gives b and D; the readings are adjusted.
2. The filter for spinning spacecraft gives the attitude history from the adjusted readings and the sun.
3. The alignment of magnetometer and sun sensor on it gives a turn of the magnetometer; the readings are adjusted again.

2 and 3 are repeated until the turn is below 2e-4 deg or a tenth of its sigma. A pass after the first begins where the
last one ended, carried back by the free motion; with process noise the end is no better known than the start, and every
pass begins at the start.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fluxtwin.calib.spin.aliquest import align, align_with_prior, relative
from fluxtwin.calib.spin.filter import Filtered, FilterSettings, spin_filter
from fluxtwin.calib.spin.motion import SpinMotion, turn_vector
from fluxtwin.calib.spin.rows import SpinRows
from fluxtwin.sim.base.errors import NoAnswer
from fluxtwin.sim.base.types import FloatArray

_PASSES = 30
_SMALLEST_RAD = np.radians(2e-4)
OF_SIGMA = 0.1
"""An iteration ends where it moves an answer by less of its sigma."""
_GROWING = 4


class Iterated(NamedTuple):
    """The end of the iteration."""

    turn: FloatArray
    """(3, 3) R: R' is still to be applied to the scalar calibration's readings."""
    first: Filtered
    """The filter before any alignment."""
    last: Filtered
    motion: SpinMotion
    """Free motion through the filter's end, zero of time at the rows' start."""
    steps_rad: tuple[float, ...]
    """Size of the turn found in each pass."""
    sun_weakest_rad: float
    """1 sigma of the sun sensor's own turn about the line that it hardly determines."""


def iterate(
    rows: SpinRows,
    field_B_nT: FloatArray,
    start: SpinMotion,
    ratio: float,
    settings: FilterSettings,
    sun_prior_rad: float,
) -> Iterated:
    """Passes of filter and alignment from the motion `start`.

    field_B_nT: (N, 3) readings after TWOSTEP. ratio: Js / Jt. sun_prior_rad: 1 sigma an axis of the sun sensor's
    alignment before launch. Raises NoAnswer where the turns grow or do not become small.
    """
    begin = min(float(rows.t_s[0]), float(rows.pulse_s[0]))
    whole, B, motion = np.eye(3), field_B_nT, start
    steps: list[float] = []
    first: Filtered | None = None
    weakest = 0.0
    for _ in range(_PASSES):
        filtered = spin_filter(rows, B, *at(motion, begin), ratio, settings)
        first = filtered if first is None else first
        end = free_motion(filtered, ratio)
        motion = start if settings.torque_walk_rad_s else end
        H_B = np.einsum("kij,kj->ki", filtered.A, rows.H_N_nT)
        of_field = align(B, H_B, (H_B**2).sum(axis=1) / settings.field_nT**2)
        s_B = np.einsum("kij,kj->ki", filtered.pulse_A, rows.sun_N)
        weight = np.full(len(s_B), settings.sun_rad**-2.0)
        weakest = align(rows.sun_B, s_B, weight).weakest()[0]
        R, covariance = relative(of_field, align_with_prior(rows.sun_B, s_B, weight, sun_prior_rad))
        step = turn_vector(R)
        steps.append(float(np.linalg.norm(step)))
        whole, B = whole @ R, B @ R
        if steps[-1] < _SMALLEST_RAD or bool((np.abs(step) < OF_SIGMA * np.sqrt(np.diag(covariance))).all()):
            return Iterated(whole, first, filtered, end, tuple(steps), weakest)
        if len(steps) > _GROWING and all(
            b > a for a, b in zip(steps[-_GROWING - 1 :], steps[-_GROWING:], strict=False)
        ):
            break
    sizes = ", ".join(f"{np.degrees(step):.3g}" for step in steps[-5:])
    raise NoAnswer(
        f"the iteration does not settle: after {len(steps)} passes the turns of the magnetometer are {sizes} deg. The "
        "inertia ratio, the noise of the sensors or the sun sensor's alignment may be wrong; compare with --method batch",
        evidence={"steps_deg": np.degrees(steps).tolist()},
    )


def free_motion(filtered: Filtered, ratio: float) -> SpinMotion:
    """The motion that passes through the filter's last state, zero of time at the rows' start."""
    lam = float(filtered.A_last[2] @ filtered.L) * (1.0 / ratio - 1.0)
    return SpinMotion(filtered.A_last, filtered.L, lam).shifted(-filtered.last_s)


def at(motion: SpinMotion, seconds: float) -> tuple[FloatArray, FloatArray]:
    """Attitude (3, 3) and rate in B (3,)."""
    A = motion.attitude(np.array([seconds]))[0]
    return A, A @ motion.Om_N_rad_s + np.array([0.0, 0.0, motion.lam_rad_s])
