"""One sensor for all zones whose matrix follows sun and shadow: boom, scale and bias, each behind lags of the sunlight.

    reading = (1 + diag(k x)) G R(-sum_j a_j x_j) Rz(phase) H + o + sum_j b_j x_j

x_j are thermal states (sunlight of the day behind first-order lags), R(-a x) is the effect boom_bending's turn of the
sensor by a x; k and b are what thermal_scale_drift and thermal_bias_drift do, written as a gain. Each zone has its own
spin phase (angle, rate, drift of the rate): no file gives one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from fluxtwin.scenarios.elfin.record import Day, Zone
from fluxtwin.scenarios.elfin.zone_fit import ZoneFit, rms, turning
from fluxtwin.sim.base.types import FloatArray

_ROUNDS = 40
_BIAS_UNIT_NT = 1e3
_SIZE = {"matrix": 1e-4, "offset": 1.0, "turn": 1e-4, "scale": 1e-4, "bias": 1e-3, "phase": 1e-5}
_AXIS_RESPONSE = (1.0, -0.6, 0.0)
"""Where the third column of the matrix starts: the field is near the spin plane, one zone hardly shows it."""


@dataclass(frozen=True)
class Rows:
    """Used rows of one zone, thinned; N rows."""

    number: int
    share: FloatArray
    """(N,) time from the middle over half the length."""
    base_rad: FloatArray
    """(N,) phase at the constant rate that the zone's own fit found."""
    field_S_nT: FloatArray
    reading_nT: FloatArray
    states: FloatArray
    """(N, J)."""


@dataclass(frozen=True)
class Sensor:
    """Parameters that all zones share; J states."""

    matrix: FloatArray
    """(3, 3) G."""
    offset_nT: FloatArray
    turn_rad: FloatArray
    """(J, 3) a."""
    scale: FloatArray
    """(J, 3) k."""
    bias_knT: FloatArray
    """(J, 3) b, thousands of nT."""

    @property
    def vector(self) -> FloatArray:
        """All numbers in a row."""
        parts = (self.matrix, self.offset_nT, self.turn_rad, self.scale, self.bias_knT)
        return np.concatenate([np.ravel(part) for part in parts])

    def moved(self, step: FloatArray) -> Sensor:
        """After a step (12 + 9 J,)."""
        cut = np.cumsum([9, 3, self.turn_rad.size, self.turn_rad.size])
        m, o, a, k, b = np.split(step, cut)
        shape = self.turn_rad.shape
        return Sensor(
            self.matrix + m.reshape(3, 3), self.offset_nT + o, self.turn_rad + a.reshape(shape),
            self.scale + k.reshape(shape), self.bias_knT + b.reshape(shape),
        )  # fmt: skip

    def reading_nT(self, rows: Rows, phase: FloatArray) -> FloatArray:
        """(N, 3)."""
        seen = self.in_body_nT(rows, phase)
        return (
            (seen @ self.matrix.T) * (1.0 + rows.states @ self.scale)
            + self.offset_nT
            + rows.states @ (_BIAS_UNIT_NT * self.bias_knT)
        )

    def in_body_nT(self, rows: Rows, phase: FloatArray) -> FloatArray:
        """(N, 3) field as the turned sensor sees it, body axes."""
        u = turning(rows.field_S_nT, rows.base_rad + powers(rows.share, phase.size) @ phase)
        seen = np.stack([u.real, u.imag, rows.field_S_nT[:, 2]], axis=1)
        if not self.turn_rad.any():
            return seen
        return np.asarray(Rotation.from_rotvec(-rows.states @ self.turn_rad).apply(seen))


@dataclass(frozen=True)
class Joint:
    """A sensor and the phases of the zones it was fitted to."""

    sensor: Sensor
    phases: tuple[FloatArray, ...]
    rms_nT: tuple[float, ...]
    """Length of the residual vector, each zone."""

    @property
    def whole_nT(self) -> float:
        """rms over the zones."""
        return float(np.sqrt(np.mean(np.square(self.rms_nT))))


def rows_of(zone: Zone, own: ZoneFit, day: Day, lags_s: Sequence[Sequence[float]], every: int) -> Rows:
    """Thinned rows with one state for each entry of lags_s, itself lags in series."""
    picked = np.flatnonzero(zone.used)[::every]
    t = zone.seconds - zone.seconds.mean()
    states = [day.lagged(zone.seconds[picked], *series) for series in lags_s]
    return Rows(
        zone.number, (t / t[-1])[picked], own.rate_rad_s * t[picked], zone.field_S_nT[picked], zone.reading_nT[picked],
        np.stack(states, axis=1) if states else np.zeros((picked.size, 0)),
    )  # fmt: skip


def powers(share: FloatArray, count: int) -> FloatArray:
    """(N, count) 1, share, share^2, ..."""
    return np.stack([share**power for power in range(count)], axis=1)


def start(fits: Sequence[ZoneFit], states: int, degree: int) -> tuple[Sensor, list[FloatArray]]:
    """From the zones' own fits: channel Z's azimuth is +y in all of them, the median of the matrices."""
    matrices, phases = [], []
    for fit in fits:
        C = fit.coefficients
        azimuth = float(np.angle(C[0, 2] + 1j * C[1, 2])) - 0.5 * np.pi
        c, s = np.cos(azimuth), np.sin(azimuth)
        matrices.append(C[:3].T @ np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]))
        phases.append(np.concatenate([[azimuth], np.zeros(degree)]))
    matrix = np.median(matrices, axis=0)
    matrix[:, 2] = _AXIS_RESPONSE
    none = np.zeros((states, 3))
    offset = np.median([fit.coefficients[3] for fit in fits], axis=0)
    return Sensor(matrix, offset, none, none, none), phases


def fit_joint(
    rows: Sequence[Rows], begin: tuple[Sensor, Sequence[FloatArray]], free: Sequence[str], *, hold: bool = False
) -> Joint:
    """Levenberg-Marquardt over all zones given.

    free: of "turn", "scale", "bias", what follows the states beside the twelve. hold: only the phases are free.
    """
    sensor, phases = begin[0], [np.array(phase) for phase in begin[1]]
    names = _names(sensor)
    chosen = np.array([not hold and (name in ("matrix", "offset") or name in free) for name in names])
    damping = 1e-5
    for _ in range(_ROUNDS):
        A, r = _linear(rows, sensor, phases, names, chosen)
        cost, size = float(r @ r), np.linalg.norm(A, axis=0)
        size[size == 0.0] = 1.0
        A = A / size
        normal, slope = A.T @ A, A.T @ r
        better = None
        for _ in range(8):
            step = np.linalg.solve(normal + damping * np.eye(len(normal)), slope) / size
            better = _stepped(rows, sensor, phases, chosen, step)
            if better[2] < cost:
                damping = max(damping / 10.0, 1e-9)
                break
            damping *= 20.0
        if better is None or better[2] >= cost:
            break
        sensor, phases, now = better
        if cost - now < 1e-5 * cost:
            break
    left = tuple(rms(one.reading_nT - sensor.reading_nT(one, p)) for one, p in zip(rows, phases, strict=True))
    return Joint(sensor, tuple(phases), left)


def seen_by(sensor: Sensor, rows: Rows, phase: FloatArray) -> Joint:
    """A sensor that is known on a zone it was not fitted to: only the zone's spin phase is estimated."""
    return fit_joint([rows], (sensor, [phase]), (), hold=True)


def without_states(sensor: Sensor) -> Sensor:
    """The same sensor that follows nothing."""
    none = np.zeros_like(sensor.turn_rad)
    return replace(sensor, turn_rad=none, scale=none, bias_knT=none)


def _names(sensor: Sensor) -> list[str]:
    each = sensor.turn_rad.size
    return ["matrix"] * 9 + ["offset"] * 3 + ["turn"] * each + ["scale"] * each + ["bias"] * each


def _linear(
    rows: Sequence[Rows], sensor: Sensor, phases: Sequence[FloatArray], names: Sequence[str], chosen: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """(M, P) derivative of all readings by what is free, and what is left (M,)."""
    places = [int(place) for place in np.flatnonzero(chosen)]
    width = phases[0].size
    blocks, left = [], []
    for number, (one, phase) in enumerate(zip(rows, phases, strict=True)):
        now = sensor.reading_nT(one, phase)
        block = np.zeros((now.size, len(places) + len(rows) * width))
        for column, place in enumerate(places):
            step = np.zeros(len(names))
            step[place] = _SIZE[names[place]]
            block[:, column] = ((sensor.moved(step).reading_nT(one, phase) - now) / step[place]).ravel()
        for power in range(width):
            moved = phase.copy()
            moved[power] += _SIZE["phase"]
            column = len(places) + number * width + power
            block[:, column] = ((sensor.reading_nT(one, moved) - now) / _SIZE["phase"]).ravel()
        blocks.append(block)
        left.append((one.reading_nT - now).ravel())
    return np.concatenate(blocks), np.concatenate(left)


def _stepped(
    rows: Sequence[Rows], sensor: Sensor, phases: Sequence[FloatArray], chosen: FloatArray, step: FloatArray
) -> tuple[Sensor, list[FloatArray], float]:
    places = np.flatnonzero(chosen)
    whole = np.zeros(chosen.size)
    whole[places] = step[: places.size]
    moved = sensor.moved(whole)
    turned = step[places.size :].reshape(len(rows), -1)
    after = [phase + more for phase, more in zip(phases, turned, strict=True)]
    cost = sum(
        float(((one.reading_nT - moved.reading_nT(one, p)) ** 2).sum()) for one, p in zip(rows, after, strict=True)
    )
    return moved, after, cost
