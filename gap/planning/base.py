"""The spacecraft of a record as a scenario that can be flown again: its orbit, noise, calibration and housekeeping.

What a record does not say is filled in with something usual, and `assumed` names it. A user's own scenario is better.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from fluxtwin.gap.problem.problem import Problem, corrected
from fluxtwin.gap.records.diagnosis import Closure
from fluxtwin.sim.base.types import FloatArray, TimeArray
from fluxtwin.sim.earth import epoch, frames
from fluxtwin.sim.earth.constants import EARTH_RADIUS_KM, GM_EARTH_KM3_S2
from fluxtwin.sim.earth.orbit import argument_of_latitude, orbital_rates

_FAR_M = ((0.0, 0.0, 2.0), (0.0, 2.0, 0.0), (2.0, 0.0, 0.0))
"""Places of torquers of which only the coupling matters, which is given."""
_ROUND = 0.01
"""Eccentricity below which an orbit is taken as a circle; the Earth's oblateness alone makes a tenth of that of one."""
_ARC_RAD = 1.0
"""From so much of an orbit on its mean motion is that of the record; of less that of its energy, good to half a percent."""
_TIME_CONSTANT_MIN = 20.0
_LEAST_SWING_K = 1.0


def base_tree(closure: Closure, lsb_nT: float | None, field: str) -> dict[str, Any]:
    """The tables of a scenario, as TOML has them; [schedule] is the record's own span."""
    problem, noise = closure.problem, closure.whitener.noise
    time, r, v = problem.time, *problem.setting.given[:2]
    instrument = corrected(problem.setting.instrument, closure.modelled)
    step = lsb_nT or 0.0
    white = float(np.sqrt(max(float(np.mean(noise.white_nT**2)) - step**2 / 12.0, 0.0)))
    magnetometer: dict[str, Any] = {
        "S": np.asarray(instrument.S).tolist(),
        "b_nT": np.asarray(instrument.b_nT).tolist(),
    }
    magnetometer |= {"noise_nT": white, "lsb_nT": step}
    tree: dict[str, Any] = {
        "name": "plan",
        "seed": 1,
        "spacecraft": {"name": problem.telemetry.spacecraft or "the spacecraft of the record"},
        "field": {"truth": field, "model": field},
        "orbit": _orbit(time, r, v),
        "attitude": {"reference": {"sigma_deg": float(np.degrees(noise.theta_rad)), "tau_s": float(noise.tau_s)}},
        "magnetometer": magnetometer,
    }
    span_min = float((time[-1] - time[0]) / np.timedelta64(1, "s")) / 60.0
    step_s = float(np.median(np.diff(problem.setting.seconds)))
    start = epoch.iso(time[0], "ms")
    tree["schedule"] = {"segments": [{"start_utc": start, "duration_min": span_min, "step_s": step_s}]}
    columns = problem.setting.columns
    dipole = columns.get("dipole_B_Am2")
    if dipole is not None and np.nanmax(np.abs(dipole)) > 0:
        tree["torquers"] = {"dipole_Am2": float(np.nanmax(np.abs(dipole))), "positions_m": [list(p) for p in _FAR_M]}
        coupling = np.zeros((3, 3)) if instrument.T_nT_per_Am2 is None else np.asarray(instrument.T_nT_per_Am2)
        magnetometer["T_nT_per_Am2"] = coupling.tolist()
    return tree | _housekeeping(problem) | _drivers(problem)


def _orbit(time: TimeArray, r_N_km: FloatArray, v_N_km_s: FloatArray) -> dict[str, Any]:
    """Through the last row, with the mean motion of the record: good to some tens of km, which is nothing to a plan."""
    last = slice(-1, None)
    T = frames.rotation_TN(time[last])
    r, v = T.apply(r_N_km[last])[0], T.apply(v_N_km_s[last])[0]
    normal = np.cross(r, v)
    node = float(np.arctan2(normal[0], -normal[1]))
    tilt = float(np.arccos(np.clip(normal[2] / np.linalg.norm(normal), -1.0, 1.0)))
    shape = np.cross(v, normal) / GM_EARTH_KM3_S2 - r / np.linalg.norm(r)
    e = float(np.linalg.norm(shape))
    axis_km = float(np.median(1.0 / (2.0 / np.linalg.norm(r_N_km, axis=1) - (v_N_km_s**2).sum(1) / GM_EARTH_KM3_S2)))
    found = {"epoch_utc": epoch.iso(time[-1], "ms"), "inclination_deg": float(np.degrees(tilt))}
    latitude = argument_of_latitude(time, r_N_km, v_N_km_s)
    if e > _ROUND:
        along = np.array([np.cos(node), np.sin(node), 0.0])
        across = np.cross(normal / np.linalg.norm(normal), along)
        perigee = float(np.arctan2(shape @ across, shape @ along))
        E = 2.0 * np.arctan(np.tan(0.5 * (latitude - perigee)) * np.sqrt((1.0 - e) / (1.0 + e)))
        latitude = perigee + E - e * np.sin(E)
        found |= {"eccentricity": e, "argument_of_perigee_deg": float(np.degrees(perigee))}
    latitude = np.unwrap(latitude)
    if np.ptp(latitude) > _ARC_RAD and np.diff(latitude).max() < np.pi / 2:
        seconds = epoch.seconds_since(time, time[0])
        for _ in range(3):  # the rates change little with the axis: a digit or two more each time
            rates = orbital_rates(axis_km, e, tilt)
            known = rates.mean_anomaly_rad_s + rates.argument_of_perigee_rad_s
            seen = float(np.polyfit(seconds, latitude, 1)[0])
            if not 0.5 < seen / known < 2.0:  # arcs far apart, between which nobody counted the orbits
                break
            axis_km *= (known / seen) ** (2.0 / 3.0)
    u = float(latitude[-1])
    angles = {"raan_deg": float(np.degrees(node)) % 360.0, "argument_of_latitude_deg": float(np.degrees(u)) % 360.0}
    return found | angles | {"altitude_km": axis_km - EARTH_RADIUS_KM}


def _housekeeping(problem: Problem) -> dict[str, Any]:
    columns, found = problem.setting.columns, {}
    array, battery = columns.get("array_current_A"), columns.get("battery_current_A")
    if array is not None and np.nanmax(array) > 0:
        load = 0.0 if battery is None else float(np.clip(np.nanmedian(array - battery), 0.0, None))
        found["power"] = {"full_sun_current_A": float(np.nanmax(array)), "load_A": load}
    temperature = columns.get("temperature_degC")
    if temperature is not None and np.isfinite(temperature).any():
        low, high = (float(value) for value in np.nanpercentile(temperature, (2.0, 98.0)))
        found["thermal"] = {"sunlit_degC": max(high, low + _LEAST_SWING_K), "eclipse_degC": low}
        found["thermal"]["time_constant_min"] = _TIME_CONSTANT_MIN
    return found


def _drivers(problem: Problem) -> dict[str, Any]:
    found = {}
    for name, column in problem.telemetry.drivers.items():
        low, high = float(np.nanmin(column)), float(np.nanmax(column))
        if high > low:
            found[name] = {"pattern": "random", "high": high, "low": low, "duty": 0.5, "dwell_s": 600.0}
    return {"drivers": found} if found else {}
