"""A blind start for a spinner: attitude, precession and turn of the body from field sizes, sun pulses and nothing else.

1. The scalar calibration gives G (symmetric) and o.
2. The spacing of the pulses gives the size of the spin, the sense in which the field turns its sign.
3. The reading along z, free of spin, is H(t).l + constant for the momentum's direction l, and the sun stands at a
   constant elevation: least squares on the sphere, which may have two minima.
4. At a pulse, l and the azimuth of the sun give the attitude, but for nutation.
5. The rate lam at which nutation goes round in the body, w3 (1 - Js/Jt), lies within +-w3: all of a grid are tried on
   a few turns, each with the batch, and the best are followed as the arc grows fourfold, so that no turn slips.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from fluxtwin.calib.spin.batch import Batch, Noise, Prior, State, solve_batch
from fluxtwin.calib.spin.motion import SpinMotion
from fluxtwin.calib.spin.rows import SpinRows
from fluxtwin.sim.base.errors import NoAnswer
from fluxtwin.sim.base.types import FloatArray

_TURNS = 7.0
"""Of the first arc."""
_SHORTEST_S = 12.0
_GROWTH = 4.0
_RATIOS = np.arange(0.06, 1.99, 0.06)
"""Js / Jt that a body can have: 0 to 2."""
_SIGMA_G = 0.08
_SIGMA_O_SHARE = 0.05
_GOOD = 2.5
"""Mean squared residual over noise up to which an arc counts as fitted."""
_FOLLOWED = 6
_ONE_AZIMUTH = 0.9
"""Length of the mean of unit azimuths above which the sensor is a slit."""
_OFF_AXIS = 0.08
"""The sun must stand at least so far from the spin axis [rad] for its azimuth to mean anything."""
_NUTATION = 0.04


class SpinStart(NamedTuple):
    """Where the final search may begin."""

    state: State
    tried: int
    """Candidates that were followed."""
    first_arc_s: float


def blind_start(rows: SpinRows, noise: Noise, G: FloatArray, o_nT: FloatArray) -> SpinStart:
    """A state within a few degrees all along the record.

    G (3, 3), o_nT (3,): from a calibration without attitude, up to a rotation of the sensor by some degrees. Raises
    NoAnswer, in words, where no free motion of an axisymmetric body about z fits.
    """
    true_side = (rows.B_nT - o_nT) @ np.linalg.inv(G).T
    centre = _first_pulse(rows)
    spin = _spin_rate(rows, true_side, centre)
    arc_s = max(_SHORTEST_S, _TURNS * 2.0 * np.pi / abs(spin))
    field_nT = float(np.sqrt((rows.H_N_nT**2).sum(axis=1).mean()))
    prior = Prior(G, o_nT, _SIGMA_G, _SIGMA_O_SHARE * field_nT)
    tried, worst = 0, "none of the candidates settles"
    for candidate in _candidates(rows, noise, prior, centre, spin, arc_s, true_side):
        tried += 1
        grown, said = _grow(candidate, rows, noise, prior, rows.pulse_s[centre], arc_s)
        if grown is not None:
            return SpinStart(grown, tried, arc_s)
        worst = said
    raise NoAnswer(
        f"no free motion of an axisymmetric body about z fits these readings and sun pulses ({worst}). Torques or "
        "thrust, a symmetry axis that is not body z, wrong time, orbit or field model, or wrong sun vectors may be the "
        "reason; cut the record to a quiet stretch",
        evidence={"candidates": tried, "spin_rad_s": spin},
    )


def _first_pulse(rows: SpinRows) -> int:
    """The first of five views of the sun in a row, with readings about it."""
    step = np.diff(rows.pulse_s)
    usual = float(np.median(step))
    for k in range(len(step) - 3):
        if (step[k : k + 4] < 1.3 * usual).all() and (np.abs(rows.t_s - rows.pulse_s[k]) < _SHORTEST_S).sum() >= 8:
            return k
    raise NoAnswer("there are no five sun pulses in a row with readings about them", evidence={"spacing_s": usual})


def _spin_rate(rows: SpinRows, true_side: FloatArray, centre: int) -> float:
    """w3 with its sign.

    Of a slit, which sees the sun at one azimuth, the spacing of the pulses is the size, and the field's turn in the
    body, which is backward, the sense. A sensor that sees the sun all along gives both by the turn of its azimuth.
    """
    phase = np.exp(1j * np.arctan2(rows.sun_B[:, 1], rows.sun_B[:, 0]))
    if abs(phase.mean()) < _ONE_AZIMUTH:
        step_s = np.diff(rows.pulse_s)
        near = step_s < 1.3 * np.median(step_s)
        return -float(np.median(np.angle(phase[1:] / phase[:-1])[near] / step_s[near]))
    size = 2.0 * np.pi / float(np.median(np.diff(rows.pulse_s)))
    t = rows.t_s - rows.pulse_s[centre]
    close = np.abs(t) < 10.0 * 2.0 * np.pi / size
    transverse = true_side[close, 0] + 1j * true_side[close, 1]
    forward, backward = (abs(np.sum(transverse * np.exp(1j * sign * size * t[close]))) for sign in (1.0, -1.0))
    return size if forward > backward else -size


def _candidates(
    rows: SpinRows, noise: Noise, prior: Prior, centre: int, spin: float, arc_s: float, true_side: FloatArray
) -> Iterator[Batch]:
    """States fitted to the first arc, best first."""
    at_s = float(rows.pulse_s[centre])
    arc = rows.within(at_s - 0.5 * arc_s, at_s + 0.5 * arc_s)
    found = []
    for axis_N in _axes(rows, true_side):
        A = _attitude_at(axis_N, rows.sun_N[centre], rows.sun_B[centre])
        if A is None:
            continue
        for ratio in _RATIOS:
            lam = spin * (1.0 - ratio)
            motion = SpinMotion(A, (spin - lam) * axis_N, lam).shifted(-at_s)
            found.append(solve_batch(State(motion, prior.G, prior.o_nT), arc, noise, prior, rounds=6))
    if not found:
        raise NoAnswer(
            "the sun stands along the spin axis: its pulses do not show the phase",
            evidence={"pulses": len(rows.pulse_s)},
        )
    found.sort(key=lambda one: one.normal.cost)
    yield from found[:_FOLLOWED]


def _axes(rows: SpinRows, true_side: FloatArray) -> list[FloatArray]:
    """Directions of body z in N, best first: minima on the sphere of (z reading - H.l - c)^2 and (sun_z - s.l)^2."""
    H = rows.H_N_nT
    sigma = _NUTATION * float(np.sqrt((H**2).sum(axis=1).mean()))
    centred = (H - H.mean(axis=0)) / sigma
    z = (true_side[:, 2] - true_side[:, 2].mean()) / sigma
    mean = np.append(H.mean(axis=0), true_side[:, 2].mean()) / sigma  # the constant is small compared with the field
    share = 30.0 / len(z)
    Q = share * centred.T @ centred + 4.0 * np.outer(mean[:3], mean[:3])
    q = share * centred.T @ z + 4.0 * mean[:3] * mean[3]
    weight = 30.0 / len(rows.pulse_s) / _NUTATION**2
    Q = Q + weight * rows.sun_N.T @ rows.sun_N
    q = q + weight * rows.sun_N.T @ rows.sun_B[:, 2]
    minima: list[tuple[float, FloatArray]] = []
    grid = np.array([[i, j, k] for i in (-1, 0, 1) for j in (-1, 0, 1) for k in (-1, 0, 1) if i or j or k], dtype=float)
    steepest = np.trace(Q)
    for start in grid:
        v = start / np.sqrt(start @ start)
        for _ in range(200):
            new = v - (Q @ v - q) / steepest
            new = new / np.sqrt(new @ new)
            moved = new - v
            if moved @ moved < 1e-18:
                break
            v = new
        cost = float(v @ Q @ v - 2.0 * q @ v)
        if all(float(v @ other) < 0.999 for _, other in minima):
            minima.append((cost, v))
    return [v for _, v in sorted(minima, key=lambda one: one[0])[:2]]


def _attitude_at(axis_N: FloatArray, sun_N: FloatArray, sun_B: FloatArray) -> FloatArray | None:
    """(3, 3) A with A l = z and the sun at its measured azimuth; None where the sun is along l."""
    across = sun_N - float(sun_N @ axis_N) * axis_N
    size = float(np.linalg.norm(across))
    if size < _OFF_AXIS:
        return None
    e1 = across / size
    e2 = np.cross(axis_N, e1)
    azimuth = float(np.arctan2(sun_B[1], sun_B[0]))
    c, s = np.cos(azimuth), np.sin(azimuth)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]) @ np.stack([e1, e2, axis_N])


def _grow(
    first: Batch, rows: SpinRows, noise: Noise, prior: Prior, at_s: float, arc_s: float
) -> tuple[State | None, str]:
    """Fit arcs that grow about `at_s`; None and why where one is not fitted."""
    state = first.state
    end_s = max(float(rows.t_s[-1]), float(rows.pulse_s[-1]))
    while True:
        arc_s *= _GROWTH
        solved = solve_batch(state, rows.within(at_s - 0.5 * arc_s, at_s + 0.5 * arc_s), noise, prior)
        now = solved.normal
        if max(now.field_chi2, now.sun_chi2) > _GOOD**2:
            size = np.sqrt(max(now.field_chi2, now.sun_chi2))
            return None, f"over {min(arc_s, end_s):.0f} s the residual is {size:.3g} times the noise"
        state = solved.state
        if at_s - 0.5 * arc_s <= 0.0 and at_s + 0.5 * arc_s >= end_s:
            return state, ""
