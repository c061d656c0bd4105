"""The record that the gap diagnosis is given: all zones through the static sensor, with the attitude that was estimated."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from fluxtwin.scenarios.elfin.bending import fit_joint, rows_of, start
from fluxtwin.scenarios.elfin.record import Flight
from fluxtwin.scenarios.elfin.zone_fit import ZoneFit, powers
from fluxtwin.scenarios.recorded_files import Settings
from fluxtwin.sim.earth import frames
from fluxtwin.sim.effects.drivers import STANDARD_SWING_K
from fluxtwin.sim.telemetry.record import Telemetry

_EVERY = 11


def record_of(flight: Flight, own: Sequence[ZoneFit], lags_s: Sequence[float], settings: Settings) -> Telemetry:
    """All zones, thinned, in body axes: readings through the static sensor that fits them best, attitude from spin axis
    and phase.

    The file has no temperature. The column holds what stands in for it: the day's sunlight behind `lags_s` in series,
    a swing of 20, the same that the thermal effects use where nothing was recorded; those start again in each record
    and do not know the sunlight between two zones.
    """
    static = fit_joint(rows_of(flight, own, (), settings.every), start(own, 0, settings.phase_degree), ())
    inverse = np.linalg.inv(static.sensor.matrix)
    parts: dict[str, list[Any]] = {}
    for zone, fit, phase in zip(flight.zones, own, static.phases, strict=True):
        rows = np.flatnonzero(zone.used)[::_EVERY]
        assert zone.telemetry.r_N_km is not None
        position = np.asarray(zone.telemetry.r_N_km)
        angle = fit.rate_rad_s * zone.late_s + powers(zone.share, phase.size) @ phase
        R_BN = Rotation.from_rotvec(np.outer(-angle, [0.0, 0.0, 1.0])) * Rotation.from_matrix(zone.spin_N)
        recorded: dict[str, Any] = {
            "time": zone.telemetry.time[rows],
            "mag_B_nT": (zone.reading_nT[rows] - static.sensor.offset_nT) @ inverse.T,
            "r_N_km": position[rows],
            "v_N_km_s": np.gradient(position, zone.seconds, axis=0)[rows],
            "q_NB": frames.q_from_rotation(R_BN[rows]),
            "temperature_degC": STANDARD_SWING_K * flight.day.lagged(zone.seconds[rows], *lags_s),
            "sunlit": (zone.lit[rows] > 0.5).astype(np.float64),
        }
        for name, value in recorded.items():
            parts.setdefault(name, []).append(value)
    whole: dict[str, Any] = {name: np.concatenate(values) for name, values in parts.items()}
    return Telemetry(**whole)
