"""Each zone predicted by a sensor that was fitted to the other eight: only its spin phase is its own."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fluxtwin.scenarios.elfin.bending import Joint, Rows, fit_joint, rows_of, seen_by, start
from fluxtwin.scenarios.elfin.record import Flight
from fluxtwin.scenarios.elfin.settings import Settings
from fluxtwin.scenarios.elfin.zone_fit import ZoneFit
from fluxtwin.sim.base.progress import Progress, silent
from fluxtwin.sim.base.types import FloatArray

Lags = tuple[tuple[float, ...], ...]


@dataclass(frozen=True)
class Way:
    """One model of what follows sun and shadow, with the lags it may choose from."""

    name: str
    about: str
    free: tuple[str, ...]
    choices: tuple[Lags, ...]


@dataclass(frozen=True)
class Told:
    """A way and what came of it."""

    way: Way
    within: Joint
    """Fitted to all zones."""
    lags_s: Lags
    """Chosen with all zones."""
    unseen_nT: tuple[float, ...]
    """Each zone, rms length of the residual vector, fitted without it."""
    fold_lags_s: tuple[Lags, ...]
    """Chosen without it."""

    @property
    def unseen_whole_nT(self) -> float:
        """rms over the zones."""
        return float(np.sqrt(np.mean(np.square(self.unseen_nT))))


def ways(settings: Settings) -> tuple[Way, ...]:
    """From nothing to all that the catalogue has for temperature."""
    once: tuple[Lags, ...] = tuple(((lag,),) for lag in settings.settle_s)
    twice: tuple[Lags, ...] = tuple(((lag, lag),) for lag in settings.settle_s)
    pairs: tuple[Lags, ...] = tuple(((first,), (second,)) for first, second in settings.pairs_s)
    return (
        Way("static", "twelve parameters", (), ((),)),
        Way("boom", "boom behind one lag", ("turn",), once),
        Way("boom, two lags", "boom behind two equal lags in series", ("turn",), twice),
        Way("boom and scale", "boom and scale behind two lags side by side", ("turn", "scale"), pairs),
    )


def compare(
    flight: Flight, own: Sequence[ZoneFit], settings: Settings, progress: Progress = silent
) -> tuple[Told, ...]:
    """Every way, within and on unseen zones."""
    told = []
    for number, way in enumerate(ways(settings)):
        progress(way.about, number / len(ways(settings)))
        told.append(_told(flight, own, way, settings))
    return tuple(told)


def _told(flight: Flight, own: Sequence[ZoneFit], way: Way, settings: Settings) -> Told:
    every: list[tuple[Lags, list[Rows], Joint]] = []
    for lags_s in way.choices:
        rows = _rows(flight, own, lags_s, settings)
        every.append((lags_s, rows, fit_joint(rows, start(own, len(lags_s), settings.phase_degree), way.free)))
    best = min(every, key=lambda one: one[2].whole_nT)
    unseen, chosen = [], []
    for left_out in range(len(own)):
        found, lags_s = _fold(every, way, left_out)
        unseen.append(found)
        chosen.append(lags_s)
    return Told(way, best[2], best[0], tuple(unseen), tuple(chosen))


def _fold(every: Sequence[tuple[Lags, list[Rows], Joint]], way: Way, left_out: int) -> tuple[float, Lags]:
    """The lags are chosen without the zone too; the other zones' phases start where they are with it."""
    trained = []
    for lags_s, rows, whole in every:
        rest = [number for number in range(len(rows)) if number != left_out]
        begin = (whole.sensor, [whole.phases[number] for number in rest])
        trained.append((lags_s, rows, fit_joint([rows[number] for number in rest], begin, way.free), whole))
    lags_s, rows, joint, whole = min(trained, key=lambda one: one[2].whole_nT)
    return seen_by(joint.sensor, rows[left_out], whole.phases[left_out]).rms_nT[0], lags_s


def residuals_nT(
    flight: Flight, own: Sequence[ZoneFit], told: Told, left_out: int, settings: Settings
) -> tuple[FloatArray, FloatArray]:
    """Minutes and residual (N, 3) of a zone by the sensor fitted to the others, for a figure."""
    rows = _rows(flight, own, told.fold_lags_s[left_out], settings)
    rest = [number for number in range(len(rows)) if number != left_out]
    begin = start(own, len(told.fold_lags_s[left_out]), settings.phase_degree)
    joint = fit_joint([rows[n] for n in rest], (begin[0], [begin[1][n] for n in rest]), told.way.free)
    seen = seen_by(joint.sensor, rows[left_out], begin[1][left_out])
    one = rows[left_out]
    half_s = 0.5 * float(np.ptp(flight.zones[left_out].seconds))
    return half_s * (1.0 + one.share) / 60.0, one.reading_nT - seen.sensor.reading_nT(one, seen.phases[0])


def _rows(flight: Flight, own: Sequence[ZoneFit], lags_s: Lags, settings: Settings) -> list[Rows]:
    return [rows_of(zone, fit, flight.day, lags_s, settings.every) for zone, fit in zip(flight.zones, own, strict=True)]
