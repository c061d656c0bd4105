"""One sensor for all zones whose matrix follows sun and shadow: boom, scale and bias, each behind lags of the sunlight.

    reading = (1 + diag(k x)) G R(-sum_j a_j x_j) Rz(phase) H + o + sum_j b_j x_j

x_j are thermal states (sunlight of the day behind first-order lags), R(-a x) is the effect boom_bending's turn of the
sensor by a x; k and b are what thermal_scale_drift and thermal_bias_drift do, written as a gain. Each zone has its own
spin phase (angle, rate, drift of the rate): no file gives one. Each zone is predicted by a sensor that was fitted to the
other eight: only its spin phase is its own.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.polynomial.polynomial import polyval
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from fluxtwin.scenarios.elfin.record import Flight, Lags
from fluxtwin.scenarios.elfin.zone_fit import rms, turning
from fluxtwin.scenarios.flights import Numbers
from fluxtwin.scenarios.recorded_files import Settings
from fluxtwin.sim.base.progress import Progress, silent
from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.earth import frames
from fluxtwin.sim.effects.drivers import STANDARD_SWING_K
from fluxtwin.sim.telemetry.record import Telemetry, concatenate

_RECORD_EVERY = 11
_BIAS_UNIT_NT = 1e3
_PHASE_STEP = 1e-5
_STEPS = {"matrix": 1e-4, "offset": 1.0, "turn": 1e-4, "scale": 1e-4, "bias": 1e-3}
_AXIS_RESPONSE = (1.0, -0.6, 0.0)
"""Where the third column of the matrix starts: the field is near the spin plane, one zone hardly shows it."""


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

    def moved(self, step: FloatArray) -> Sensor:
        """After a step (12 + 9 J,)."""
        parts = (self.matrix, self.offset_nT, self.turn_rad, self.scale, self.bias_knT)
        steps = np.split(step, np.cumsum([part.size for part in parts])[:-1])
        return Sensor(*(part + one.reshape(part.shape) for part, one in zip(parts, steps, strict=True)))

    def reading_nT(self, rows: Numbers, phase: FloatArray) -> FloatArray:
        """(N, 3)."""
        turned = self.in_body_nT(rows, phase) @ self.matrix.T
        bias_nT = rows.states @ (_BIAS_UNIT_NT * self.bias_knT)
        return np.asarray(turned * (1.0 + rows.states @ self.scale) + self.offset_nT + bias_nT)

    def in_body_nT(self, rows: Numbers, phase: FloatArray) -> FloatArray:
        """(N, 3) field as the turned sensor sees it, body axes."""
        u = turning(rows.field_S_nT, rows.base_rad + polyval(rows.share, phase))
        seen = np.stack([u.real, u.imag, rows.field_S_nT[:, 2]], axis=1)
        if not self.turn_rad.any():
            return seen
        return np.asarray(Rotation.from_rotvec(-rows.states @ self.turn_rad).apply(seen))


def rows_of(flight: Flight, own: Sequence[Numbers], lags_s: Lags, every: int) -> list[Numbers]:
    """Thinned rows of each zone with one state for each entry of lags_s, itself lags in series."""
    found = []
    for zone, fit in zip(flight.zones, own, strict=True):
        picked = np.flatnonzero(zone.used)[::every]
        rows = Numbers(
            # (N,) time from the middle over half the length; phase at the constant rate that the zone's own fit found.
            share=zone.share[picked],
            base_rad=fit.rate_rad_s * zone.late_s[picked],
            field_S_nT=zone.field_S_nT[picked],
            reading_nT=zone.reading_nT[picked],
            # (N, J).
            states=flight.day.states(zone.seconds[picked], lags_s),
        )
        found.append(rows)
    return found


def start(fits: Sequence[Numbers], states: int, degree: int) -> tuple[Sensor, list[FloatArray]]:
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
    rows: Sequence[Numbers], begin: tuple[Sensor, Sequence[FloatArray]], free: Sequence[str], *, hold: bool = False
) -> Numbers:
    """Least squares over all zones given.

    free: of "turn", "scale", "bias", what follows the states besides the twelve. hold: only the phases are free.
    """
    states = begin[0].turn_rad.size
    names = ["matrix"] * 9 + ["offset"] * 3 + ["turn"] * states + ["scale"] * states + ["bias"] * states
    sizes = np.array([_STEPS[name] * (not hold and name in ("matrix", "offset", *free)) for name in names])

    def residual(step: FloatArray) -> FloatArray:
        sensor, phases = _stepped(*begin, sizes, step)
        parts = [one.reading_nT - sensor.reading_nT(one, p) for one, p in zip(rows, phases, strict=True)]
        return np.concatenate([part.ravel() for part in parts])

    def slopes(step: FloatArray) -> FloatArray:
        return -_slopes(rows, *_stepped(*begin, sizes, step), sizes)

    none = np.zeros(np.count_nonzero(sizes) + sum(phase.size for phase in begin[1]))
    found = least_squares(residual, none, slopes, method="lm", x_scale="jac", ftol=1e-5)
    sensor, phases = _stepped(*begin, sizes, found.x)
    rms_nT = [rms(one.reading_nT - sensor.reading_nT(one, p)) for one, p in zip(rows, phases, strict=True)]
    return Numbers(
        sensor=sensor,
        phases=tuple(phases),
        # Length of the residual vector, of each zone, and rms over the zones.
        rms_nT=tuple(rms_nT),
        whole_nT=np.sqrt(np.mean(np.square(rms_nT))),
    )


def seen_by(sensor: Sensor, rows: Numbers, phase: FloatArray) -> Numbers:
    """A sensor that is known on a zone it was not fitted to: only the zone's spin phase is estimated."""
    return fit_joint([rows], (sensor, [phase]), (), hold=True)


def _slopes(rows: Sequence[Numbers], sensor: Sensor, phases: Sequence[FloatArray], sizes: FloatArray) -> FloatArray:
    """(M, P) derivative of all readings by the sensor's parameters of non-zero step, then by the zones' phases."""
    places, width, blocks = np.flatnonzero(sizes), phases[0].size, []
    moved = [(sensor.moved(sizes * (np.arange(sizes.size) == place)), sizes[place]) for place in places]
    for number, (one, phase) in enumerate(zip(rows, phases, strict=True)):
        now = sensor.reading_nT(one, phase)
        block = np.zeros((now.size, places.size + len(rows) * width))
        for column, (other, size) in enumerate(moved):
            block[:, column] = ((other.reading_nT(one, phase) - now) / size).ravel()
        for power, step in enumerate(_PHASE_STEP * np.eye(width)):
            change = (sensor.reading_nT(one, phase + step) - now) / _PHASE_STEP
            block[:, places.size + number * width + power] = change.ravel()
        blocks.append(block)
    return np.concatenate(blocks)


def _stepped(
    sensor: Sensor, phases: Sequence[FloatArray], sizes: FloatArray, step: FloatArray
) -> tuple[Sensor, list[FloatArray]]:
    places, whole = np.flatnonzero(sizes), np.zeros(sizes.size)
    whole[places] = step[: places.size]
    turned = step[places.size :].reshape(len(phases), -1)
    return sensor.moved(whole), [phase + more for phase, more in zip(phases, turned, strict=True)]


def compare(
    flight: Flight, own: Sequence[Numbers], settings: Settings, progress: Progress = silent
) -> tuple[Numbers, ...]:
    """Every model, from nothing to all that the catalogue has for temperature, within and on unseen zones."""
    once: list[Lags] = [((lag,),) for lag in settings.settle_s]
    twice: list[Lags] = [((lag, lag),) for lag in settings.settle_s]
    pairs: list[Lags] = [((first,), (second,)) for first, second in settings.pairs_s]
    asked: list[tuple[str, str, tuple[str, ...], list[Lags]]] = [
        ("static", "twelve parameters", (), [()]),
        ("boom", "boom behind one lag", ("turn",), once),
        ("boom, two lags", "boom behind two equal lags in series", ("turn",), twice),
        ("boom and scale", "boom and scale behind two lags side by side", ("turn", "scale"), pairs),
    ]
    ways: list[Numbers] = []
    for number, (name, about, free, choices) in enumerate(asked):
        progress(about, number / len(asked))
        fitted = []
        for lags_s in choices:
            rows = rows_of(flight, own, lags_s, settings.every)
            begin = start(own, len(lags_s), settings.phase_degree)
            fitted.append((lags_s, rows, fit_joint(rows, begin, free)))
        best = min(fitted, key=lambda one: one[2].whole_nT)
        unseen_nT, unseen = zip(*(_fold(flight, fitted, free, left_out) for left_out in range(len(own))), strict=True)
        whole_nT = np.sqrt(np.mean(np.square(unseen_nT)))
        first = ways[0] if ways else Numbers(unseen_nT=unseen_nT, unseen_whole_nT=whole_nT)
        way = Numbers(
            # A model of what follows sun and shadow, with the lags it may choose from.
            name=name,
            about=about,
            free=free,
            # Fitted to all zones, and the lags chosen with them.
            within=best[2],
            lags_s=best[0],
            # Each zone by a sensor and lags found without it: rms length of the residual; minutes, and the residual (N, 3);
            # rms over the zones.
            unseen_nT=unseen_nT,
            unseen=unseen,
            unseen_whole_nT=whole_nT,
            # The same over the first model's, and the number of zones in which it is below half of that model's.
            of_static=round(float(whole_nT / first.unseen_whole_nT), 3),
            below=np.sum(np.array(unseen_nT) < 0.5 * np.array(first.unseen_nT)),
            tilted_deg=_tilted_deg(flight, best[2].sensor, best[0]),
        )
        ways.append(way)
    return tuple(ways)


def _tilted_deg(flight: Flight, sensor: Sensor, lags_s: Lags) -> float:
    """How far the sensor tilts from one moment of the zones to another, at most; its turn about the spin axis cannot be
    distinguished from the spin phase."""
    seconds = np.concatenate([zone.seconds[zone.used][::50] for zone in flight.zones])
    tilts = (flight.day.states(seconds, lags_s) @ sensor.turn_rad)[:, :2]
    return float(np.degrees(np.linalg.norm(tilts[:, None, :] - tilts[None, :, :], axis=2).max()))


def _fold(
    flight: Flight, fitted: Sequence[tuple[Lags, list[Numbers], Numbers]], free: tuple[str, ...], left_out: int
) -> tuple[float, tuple[FloatArray, FloatArray]]:
    """The lags are chosen without the zone too; the other zones' phases start where they are with it."""
    trained = []
    for _, rows, whole in fitted:
        rest = [number for number in range(len(rows)) if number != left_out]
        begin = (whole.sensor, [whole.phases[number] for number in rest])
        joint = fit_joint([rows[number] for number in rest], begin, free)
        trained.append((joint, rows[left_out], whole.phases[left_out]))
    joint, one, phase = min(trained, key=lambda one: one[0].whole_nT)
    seen = seen_by(joint.sensor, one, phase)
    minutes = np.ptp(flight.zones[left_out].seconds) * (1.0 + one.share) / 120.0
    return seen.rms_nT[0], (minutes, one.reading_nT - seen.sensor.reading_nT(one, seen.phases[0]))


def record_of(flight: Flight, own: Sequence[Numbers], lags_s: Sequence[float], settings: Settings) -> Telemetry:
    """What the gap diagnosis is given: all zones, thinned, in body axes, readings through the static sensor that fits them
    best, attitude from spin axis and phase.

    The file has no temperature. The column holds what replaces it: the day's sunlight behind `lags_s` in series,
    a swing of 20, the same that the thermal effects use where nothing was recorded; those start again in each record
    and do not know the sunlight between two zones.
    """
    static = fit_joint(rows_of(flight, own, (), settings.every), start(own, 0, settings.phase_degree), ())
    inverse = np.linalg.inv(static.sensor.matrix)
    parts = []
    for zone, fit, phase in zip(flight.zones, own, static.phases, strict=True):
        rows = np.flatnonzero(zone.used)[::_RECORD_EVERY]
        assert zone.telemetry.r_N_km is not None
        position = np.asarray(zone.telemetry.r_N_km)
        angle = fit.rate_rad_s * zone.late_s + polyval(zone.share, phase)
        R_BN = Rotation.from_rotvec(np.outer(-angle, [0.0, 0.0, 1.0])) * Rotation.from_matrix(zone.spin_N)
        record = Telemetry(
            time=zone.telemetry.time[rows],
            mag_B_nT=(zone.reading_nT[rows] - static.sensor.offset_nT) @ inverse.T,
            r_N_km=position[rows],
            v_N_km_s=np.gradient(position, zone.seconds, axis=0)[rows],
            q_NB=frames.q_from_rotation(R_BN[rows]),
            temperature_degC=STANDARD_SWING_K * flight.day.lagged(zone.seconds[rows], *lags_s),
            sunlit=(zone.lit[rows] > 0.5).astype(np.float64),
        )
        parts.append(record)
    return concatenate(parts)
