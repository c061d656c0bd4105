"""Telemetry without the effects that a scenario has: what they do to readings, and the error of positions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from fluxtwin.calib.common.orbit_error import ahead
from fluxtwin.gap.problem.problem import pose
from fluxtwin.sim.earth.field import FieldModel
from fluxtwin.sim.effects.base import SignalEffect
from fluxtwin.sim.effects.chain import Active
from fluxtwin.sim.effects.clock_and_orbit import AlongTrackError
from fluxtwin.sim.spacecraft.sensors.magnetometer import Magnetometer
from fluxtwin.sim.telemetry.companions import ALONG_TRACK_KM
from fluxtwin.sim.telemetry.record import Telemetry

_OF_READINGS = ("spacecraft", "sensor")


@dataclass(frozen=True)
class TakenOut:
    """The record, the names of what was taken out of it, and of what it still has."""

    telemetry: Telemetry
    taken: tuple[str, ...]
    left: tuple[str, ...]
    """What is no error of readings or positions (clock, attitude, field), or cannot be known row by row (noise, bits)."""


def without_effects(
    telemetry: Telemetry, model: FieldModel, instrument: Magnetometer, active: Sequence[Active]
) -> TakenOut:
    """The record as it would be without these effects; instrument: S, b and T of equation 1, through which they act.

    Positions go where they truly were. What effects of spacecraft and sensor do is computed from field, attitude and
    housekeeping, and taken from the readings (N, 3) [nT]; rows of which that is not known are left without reading.
    Raises BadInput and NoAnswer as `pose`.
    """
    of_orbit = [one for one in active if isinstance(one[0], AlongTrackError)]
    of_readings = [
        one
        for one in active
        if isinstance(one[0], SignalEffect) and one[0].stage in _OF_READINGS and not one[0].after_noise
    ]
    setting = pose(telemetry, model, modelled=(), instrument=instrument).setting
    for effect, theta in of_orbit:
        assert isinstance(effect, AlongTrackError)
        error_km = np.broadcast_to(effect.size(replace(setting, time=telemetry.time), theta), len(telemetry))
        known = {key: text for key, text in telemetry.provenance.items() if key != ALONG_TRACK_KM}
        telemetry = ahead(telemetry, -error_km).replace(provenance=known)
    if of_readings:
        problem = pose(telemetry, model, modelled=(), instrument=instrument)
        change = problem.chain.reading_nT(of_readings) - problem.chain.reading_nT()
        rows = np.isin(telemetry.time, problem.telemetry.time)
        mag = np.full((len(telemetry), 3), np.nan)
        mag[rows] = telemetry.mag_B_nT[rows] - change
        telemetry = telemetry.replace(mag_B_nT=mag)
    taken = tuple(effect.name for effect, _ in (*of_orbit, *of_readings))
    return TakenOut(telemetry, taken, tuple(effect.name for effect, _ in active if effect.name not in taken))
