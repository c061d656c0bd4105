"""One hour of ST5: the scenario, the magnetometer's telemetry without attitude, and the sun pulses between its rows."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from fluxtwin.scenarios.printed import Printed
from fluxtwin.sim import epoch, frames
from fluxtwin.sim.random_streams import stream
from fluxtwin.sim.rigid_body import torque_free
from fluxtwin.sim.scenario import Scenario, parse_scenario
from fluxtwin.sim.sensors.slit_sun_sensor import SlitSunSensor
from fluxtwin.sim.simulate import simulate
from fluxtwin.sim.telemetry import Telemetry
from fluxtwin.sim.truth import Truth
from fluxtwin.sim.types import FloatArray
from fluxtwin.sim.world import World, build_world, ephemeris

PRINTED = Printed("fluxtwin.scenarios.st5")
"""The abstract's numbers and claims, as packaged."""
SUN_NOISE_DEG = 0.18
"""White, of the slit sun sensor: abstract."""
SLIT_AZIMUTH_DEG = 0.0
"""Assumed: the slit looks along body x."""
_FINE_S = 0.25


@dataclass(frozen=True)
class Flight:
    """One run: what the ground gets, and the truth apart."""

    scenario: Scenario
    telemetry: Telemetry
    """Rows of the magnetometer, and rows that hold a sun pulse alone; no attitude."""
    truth: Truth
    """Rows of the magnetometer."""


def scenario() -> Scenario:
    """The packaged scenario."""
    return parse_scenario(scenario_text(), where="st5.toml")


def scenario_text() -> str:
    """The packaged scenario as it is written, with the source of each number."""
    return PRINTED.text("st5.toml")


def published() -> Mapping[str, Any]:
    """What the abstract prints, as packaged."""
    content: Mapping[str, Any] = json.loads(PRINTED.text("data/published.json"))
    return content


def world_of(config: Scenario) -> World:
    """Orbit, sun and field; the same for any seed and attitude."""
    return build_world(config)


def fly(config: Scenario, world: World | None = None) -> Flight:
    """Run a scenario in mode spin; `world` if it is known already."""
    world = build_world(config) if world is None else world
    whole, truth = simulate(config, world=world)
    return Flight(config, with_pulses(whole, pulses(config, world, truth)), truth)


def pulses(config: Scenario, world: World, truth: Truth) -> Telemetry:
    """Rows with the measured sun alone, at the times of the crossings."""
    start = truth.time[0]
    inertia = np.array(config.spacecraft.inertia_kg_m2)
    stamps_s = epoch.seconds_since(truth.time, start)
    length_s = float(stamps_s[-1])
    R_BN0 = frames.rotation_from_q(truth.q_NB[:1])[0]

    def sun_B(seconds: FloatArray) -> FloatArray:
        R_BN, _ = torque_free(seconds, inertia, R_BN0, truth.rate_B_rad_s[0])
        sun_N = np.stack([np.interp(seconds, stamps_s, world.sun_N[:, i]) for i in range(3)], axis=1)
        return np.asarray(R_BN.apply(sun_N))

    slit = SlitSunSensor(np.radians(SLIT_AZIMUTH_DEG), np.radians(SUN_NOISE_DEG))
    grid = np.arange(0.0, length_s, _FINE_S)
    seconds, seen_B = slit.crossings(grid, sun_B, stream(config.seed, "sun_sensor.slit"))
    inside = (seconds > 0.0) & (seconds < length_s)
    stamps = epoch.add_seconds(start, seconds[inside])
    r_N_km, v_N_km_s = ephemeris(config, stamps)
    nothing = np.full((stamps.size, 3), np.nan)
    return Telemetry(time=stamps, mag_B_nT=nothing, r_N_km=r_N_km, v_N_km_s=v_N_km_s, sun_B=seen_B[inside])


def with_pulses(magnetometer: Telemetry, sun_rows: Telemetry) -> Telemetry:
    """Both in one record, in order of time; a pulse on the very stamp of a reading goes a nanosecond later."""
    late = np.isin(sun_rows.time, magnetometer.time)
    time = np.concatenate([magnetometer.time, sun_rows.time + late.astype("timedelta64[ns]")])
    order = np.argsort(time, kind="stable")
    assert magnetometer.r_N_km is not None and magnetometer.v_N_km_s is not None
    assert sun_rows.r_N_km is not None and sun_rows.v_N_km_s is not None and sun_rows.sun_B is not None
    seen = np.concatenate([np.full((len(magnetometer), 3), np.nan), sun_rows.sun_B])
    return Telemetry(
        time=time[order],
        mag_B_nT=np.concatenate([magnetometer.mag_B_nT, sun_rows.mag_B_nT])[order],
        r_N_km=np.concatenate([magnetometer.r_N_km, sun_rows.r_N_km])[order],
        v_N_km_s=np.concatenate([magnetometer.v_N_km_s, sun_rows.v_N_km_s])[order],
        sun_B=seen[order],
        provenance=dict(magnetometer.provenance),
    )
