"""The iteration of Sedlak's "Iterative Magnetometer Calibration": scalar, filter, alignment, and again.

1. TWOSTEP gives b and D; the readings are adjusted.
2. The filter for spinning spacecraft gives the attitude history from the adjusted readings and the sun.
3. The alignment of magnetometer and sun sensor on it gives a turn of the magnetometer; the readings are adjusted again.

2 and 3 are repeated until the turn is below 2e-4 deg or a tenth of its sigma. A pass after the first begins where the
last one ended, carried back by the free motion; with process noise the end is no better known than the start, and every
pass begins at the start.

Alignment of each sensor on an attitude history, and of the magnetometer relative to the sun sensor.

For a sensor with unit vectors m_k, references v_k and weights w_k: the R that maximises tr(R sum w m (A v)') (Wahba's
problem, by the singular-value decomposition), so that m = R A v; information F = sum w (1 - r r'), r = R A v.

The trap: a slit sees the sun at nearly one direction of the body, and its own turn about that line is unknown.
R_sun' R_TAM would carry it into the magnetometer. A prior on the sun sensor's alignment (what was measured before
launch) keeps it out; dropping R_sun instead would let the azimuth of the body drift from pass to pass, for an
axisymmetric body has none of its own: the sun sensor defines it (the gauge).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fluxtwin.calib.common.conventions import best_turn
from fluxtwin.calib.spin.filter import Filtered, FilterSettings, spin_filter
from fluxtwin.calib.spin.motion import SpinMotion, turn, turn_vector
from fluxtwin.calib.spin.rows import SpinRows
from fluxtwin.sim.base.errors import NoAnswer
from fluxtwin.sim.base.types import FloatArray

_STEPS = 30
_SMALL_RAD = 1e-12
_PASSES = 30
_SMALLEST_RAD = np.radians(2e-4)
OF_SIGMA = 0.1
"""An iteration ends where it moves an answer by less of its sigma."""
_GROWING = 4


class Alignment(NamedTuple):
    """One sensor: m = R A v."""

    R: FloatArray
    """(3, 3) body to sensor axes, both nominally the same."""
    information: FloatArray
    """(3, 3) of the rotation vector [rad^-2]; a weak eigenvalue is a direction that the sensor hardly determines."""

    @property
    def weakest_rad(self) -> float:
        """1 sigma about the direction known least."""
        return float(1.0 / np.sqrt(max(np.linalg.eigvalsh(self.information)[0], 1e-300)))


def align(seen: FloatArray, reference_B: FloatArray, weight: FloatArray) -> Alignment:
    """One sensor. seen (n, 3), any length; reference_B (n, 3) = A v, any length; weight (n,) 1/rad^2."""
    m = seen / np.linalg.norm(seen, axis=1)[:, None]
    v = reference_B / np.linalg.norm(reference_B, axis=1)[:, None]
    R = best_turn((m * weight[:, None]).T @ v)
    r = v @ R.T
    return Alignment(R, float(weight.sum()) * np.eye(3) - (r * weight[:, None]).T @ r)


def align_with_prior(seen: FloatArray, reference_B: FloatArray, weight: FloatArray, sigma_rad: float) -> Alignment:
    """As `align`, with no turn at all known beforehand to sigma_rad an axis; the information holds the prior.

    Sought from no turn onward: Wahba's own answer may lie half a turn off about a line that the sensor hardly determines.
    """
    m = seen / np.linalg.norm(seen, axis=1)[:, None]
    v = reference_B / np.linalg.norm(reference_B, axis=1)[:, None]
    prior = np.eye(3) / sigma_rad**2
    total = float(weight.sum()) * np.eye(3)
    R, whole = np.eye(3), total
    for _ in range(_STEPS):
        r = v @ R.T
        whole = total - (r * weight[:, None]).T @ r + prior
        step = np.linalg.solve(whole, weight @ np.cross(r, m) - prior @ turn_vector(R))
        R = turn(np.asarray(step, dtype=np.float64)) @ R
        if float(np.linalg.norm(step)) < _SMALL_RAD:
            break
    return Alignment(R, whole)


def relative(magnetometer: Alignment, sun: Alignment) -> tuple[FloatArray, FloatArray]:
    """R_rel = R_sun' R_TAM (3, 3) and the covariance (3, 3) of its rotation vector [rad^2]; sun: with its prior."""
    R = sun.R.T @ magnetometer.R
    turned = sun.R.T @ (np.linalg.inv(magnetometer.information) + np.linalg.inv(sun.information)) @ sun.R
    return np.asarray(R), np.asarray(turned)


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
        weakest = align(rows.sun_B, s_B, weight).weakest_rad
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
