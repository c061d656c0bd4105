"""The gap diagnosis asked what the static sensor leaves: one record of all zones with the attitude that was estimated."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.spatial.transform import Rotation

from fluxtwin.gap.diagnose import diagnose
from fluxtwin.gap.problem import Budget
from fluxtwin.gap.records import Diagnosis
from fluxtwin.scenarios.elfin.bending import Joint, fit_joint, powers, rows_of, start
from fluxtwin.scenarios.elfin.record import Flight, Zone
from fluxtwin.scenarios.elfin.settings import Settings
from fluxtwin.scenarios.elfin.zone_fit import ZoneFit
from fluxtwin.sim.base.progress import Progress, silent
from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.earth import frames
from fluxtwin.sim.earth.field import load_field
from fluxtwin.sim.effects.drivers import STANDARD_SWING_K
from fluxtwin.sim.telemetry.record import Telemetry

_EVERY = 11
_LSB_NT = 0.01


def ask(
    flight: Flight,
    own: Sequence[ZoneFit],
    lags_s: Sequence[float],
    noise_nT: float,
    settings: Settings,
    progress: Progress = silent,
) -> Diagnosis:
    """The verdict on the record of `record_of`, through the static sensor that fits these zones best.

    noise_nT: of one component. The attitude is as uncertain as the spin axis is said to be.
    """
    rows = [rows_of(zone, fit, flight.day, (), settings.every) for zone, fit in zip(flight.zones, own, strict=True)]
    static = fit_joint(rows, start(own, 0, settings.phase_degree), ())
    budget = Budget(noise_nT, _LSB_NT, flight.axis_sigma_rad, None)
    record = record_of(flight, own, static, lags_s)
    return diagnose(record, load_field(settings.field_model), budget=budget, progress=progress)


def record_of(flight: Flight, own: Sequence[ZoneFit], static: Joint, lags_s: Sequence[float]) -> Telemetry:
    """All zones, thinned, in body axes: readings through the static sensor, attitude from spin axis and phase.

    The file has no temperature. The column holds what stands in for it: the day's sunlight behind `lags_s` in series,
    a swing of 20, the same that the thermal effects use where nothing was recorded; those begin anew in each record
    and know nothing of the light between two zones.
    """
    inverse = np.linalg.inv(static.sensor.matrix)
    parts: dict[str, list[FloatArray]] = {name: [] for name in ("mag", "r", "v", "q", "warm", "lit")}
    times = []
    for zone, fit, phase in zip(flight.zones, own, static.phases, strict=True):
        rows = np.flatnonzero(zone.used)[::_EVERY]
        times.append(zone.telemetry.time[rows])
        parts["mag"].append((zone.reading_nT[rows] - static.sensor.offset_nT) @ inverse.T)
        assert zone.telemetry.r_N_km is not None
        position = np.asarray(zone.telemetry.r_N_km)
        parts["r"].append(position[rows])
        parts["v"].append(np.gradient(position, zone.seconds, axis=0)[rows])
        parts["q"].append(frames.q_from_rotation(attitude(zone, fit, phase)[rows]))
        parts["warm"].append(STANDARD_SWING_K * flight.day.lagged(zone.seconds[rows], *lags_s))
        parts["lit"].append((zone.lit[rows] > 0.5).astype(np.float64))
    whole = {name: np.concatenate(values) for name, values in parts.items()}
    return Telemetry(
        np.concatenate(times), whole["mag"], r_N_km=whole["r"], v_N_km_s=whole["v"], q_NB=whole["q"],
        temperature_degC=whole["warm"], sunlit=whole["lit"],
    )  # fmt: skip


def attitude(zone: Zone, fit: ZoneFit, phase: FloatArray) -> Rotation:
    """R_BN at every row of the zone: spin axes, turned about the axis by the phase."""
    t = zone.seconds - zone.seconds.mean()
    angle = fit.rate_rad_s * t + powers(t / t[-1], phase.size) @ phase
    about = Rotation.from_rotvec(np.outer(-angle, [0.0, 0.0, 1.0]))
    return about * Rotation.from_matrix(zone.spin_N)
