"""Rows that hold a sun pulse alone: when the sun crosses the slit of a spinning spacecraft, between the readings."""

from __future__ import annotations

import numpy as np

from fluxtwin.sim.attitude.rigid_body import torque_free
from fluxtwin.sim.base.random_streams import stream
from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.earth import epoch, frames
from fluxtwin.sim.run.truth import Truth
from fluxtwin.sim.run.world import World, ephemeris
from fluxtwin.sim.scenario.scenario import Scenario
from fluxtwin.sim.telemetry.record import Telemetry, concatenate, named_columns

_FINE_S, _PART_OF_TURN = 0.25, 0.125


def with_pulses(magnetometer: Telemetry, scenario: Scenario, world: World, truth: Truth) -> Telemetry:
    """The record with a row for each pulse of [slit_sun_sensor], in order of time; itself where there is no such section.

    A pulse on the very stamp of a reading goes a nanosecond later.
    """
    if scenario.slit_sun_sensor is None:
        return magnetometer
    return _merged(magnetometer, pulses(scenario, world, truth))


def pulses(scenario: Scenario, world: World, truth: Truth) -> Telemetry:
    """Rows with the measured sun alone, at the times of the crossings; the motion between the rows is the free one."""
    slit = scenario.slit_sun_sensor
    assert slit is not None and scenario.spacecraft.inertia_kg_m2 is not None
    start = truth.time[0]
    inertia = np.array(scenario.spacecraft.inertia_kg_m2)
    stamps_s = epoch.seconds_since(truth.time, start)
    length_s = float(stamps_s[-1])
    R_BN0 = frames.rotation_from_q(truth.q_NB[:1])[0]

    def sun_B(seconds: FloatArray) -> FloatArray:
        R_BN, _ = torque_free(seconds, inertia, R_BN0, truth.rate_B_rad_s[0])
        sun_N = np.stack([np.interp(seconds, stamps_s, world.sun_N[:, i]) for i in range(3)], axis=1)
        return np.asarray(R_BN.apply(sun_N))

    turn_s = 2.0 * np.pi / max(float(np.linalg.norm(truth.rate_B_rad_s[0])), 1e-9)
    grid = np.arange(0.0, length_s, min(_FINE_S, _PART_OF_TURN * turn_s))
    seconds, seen_B = slit.crossings(grid, sun_B, stream(scenario.seed, "sun_sensor.slit"))
    inside = (seconds > 0.0) & (seconds < length_s)
    stamps = epoch.add_seconds(start, seconds[inside])
    r_N_km, v_N_km_s = ephemeris(scenario, stamps)
    nothing = np.full((stamps.size, 3), np.nan)
    return Telemetry(time=stamps, mag_B_nT=nothing, r_N_km=r_N_km, v_N_km_s=v_N_km_s, sun_B=seen_B[inside])


def _merged(magnetometer: Telemetry, sun_rows: Telemetry) -> Telemetry:
    """Both in order of time; a column that one of them lacks is missing in its rows."""
    if not len(sun_rows):
        return magnetometer
    late = np.isin(sun_rows.time, magnetometer.time)
    time = np.concatenate([magnetometer.time, sun_rows.time + late.astype("timedelta64[ns]")])
    order = np.argsort(time, kind="stable")
    # Joined one after the other first, which fills what is absent; then put in order.
    after = sun_rows.replace(time=sun_rows.time - sun_rows.time[0] + magnetometer.time[-1] + np.timedelta64(1, "s"))
    joined = concatenate([magnetometer, after])
    changes: dict[str, object] = {
        name: value[order] for name, value in vars(joined).items() if isinstance(value, np.ndarray)
    }
    changes["time"] = time[order]
    changes |= named_columns(joined, lambda value: value[order])
    return joined.replace(**changes, provenance=dict(magnetometer.provenance))
