"""Each zone predicted by a sensor that was fitted to the other eight: only its spin phase is its own."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fluxtwin.scenarios.elfin.bending import Joint, Lags, Rows, fit_joint, rows_of, seen_by, start
from fluxtwin.scenarios.elfin.record import Flight
from fluxtwin.scenarios.elfin.zone_fit import ZoneFit
from fluxtwin.scenarios.recorded_files import Settings
from fluxtwin.sim.base.progress import Progress, silent
from fluxtwin.sim.base.types import FloatArray


@dataclass(frozen=True)
class Way:
    """One model of what follows sun and shadow, with the lags it may choose from, and how it predicts."""

    name: str
    about: str
    free: tuple[str, ...]
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


def compare(flight: Flight, own: Sequence[ZoneFit], settings: Settings, progress: Progress = silent) -> tuple[Way, ...]:
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
    ways = []
    for number, (name, about, free, choices) in enumerate(asked):
        progress(about, number / len(asked))
        fitted = []
        for lags_s in choices:
            rows = rows_of(flight, own, lags_s, settings.every)
            begin = start(own, len(lags_s), settings.phase_degree)
            fitted.append((lags_s, rows, fit_joint(rows, begin, free)))
        best = min(fitted, key=lambda one: one[2].whole_nT)
        folds = [_fold(fitted, free, left_out) for left_out in range(len(own))]
        unseen_nT, fold_lags_s = zip(*folds, strict=True)
        ways.append(Way(name, about, free, best[2], best[0], unseen_nT, fold_lags_s))
    return tuple(ways)


def _fold(fitted: Sequence[tuple[Lags, list[Rows], Joint]], free: tuple[str, ...], left_out: int) -> tuple[float, Lags]:
    """The lags are chosen without the zone too; the other zones' phases start where they are with it."""
    trained = []
    for lags_s, rows, whole in fitted:
        rest = [number for number in range(len(rows)) if number != left_out]
        begin = (whole.sensor, [whole.phases[number] for number in rest])
        joint = fit_joint([rows[number] for number in rest], begin, free)
        trained.append((joint, lags_s, rows[left_out], whole.phases[left_out]))
    joint, lags_s, unseen, phase = min(trained, key=lambda one: one[0].whole_nT)
    return seen_by(joint.sensor, unseen, phase).rms_nT[0], lags_s


def residuals_nT(
    flight: Flight, own: Sequence[ZoneFit], way: Way, left_out: int, settings: Settings
) -> tuple[FloatArray, FloatArray]:
    """Minutes and residual (N, 3) of a zone by the sensor fitted to the others, for a figure."""
    lags_s = way.fold_lags_s[left_out]
    rows = rows_of(flight, own, lags_s, settings.every)
    sensor, phases = start(own, len(lags_s), settings.phase_degree)
    one, phase = rows.pop(left_out), phases.pop(left_out)
    seen = seen_by(fit_joint(rows, (sensor, phases), way.free).sensor, one, phase)
    half_s = 0.5 * float(np.ptp(flight.zones[left_out].seconds))
    return half_s * (1.0 + one.share) / 60.0, one.reading_nT - seen.sensor.reading_nT(one, seen.phases[0])
