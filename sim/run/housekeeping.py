"""Currents, temperature, heater and wheel speeds along a run.

These have memory, so each stretch of the schedule is preceded by a warm-up of three orbits on a fine grid. It
starts from a full battery and the mean temperature: a battery that loses more in an orbit than it gains, or a
thermal constant of several orbits, is still on its way when the stretch begins.
"""

from __future__ import annotations

import numpy as np

from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.earth import epoch, orbit
from fluxtwin.sim.run.drivers import run_drivers
from fluxtwin.sim.run.flights import flights
from fluxtwin.sim.run.true_attitude import true_attitude
from fluxtwin.sim.run.world import World, ephemeris, world_along
from fluxtwin.sim.scenario.scenario import Scenario
from fluxtwin.sim.spacecraft import power, thermal, wheels

_GRID_S = 30.0
_WARM_UP_ORBITS = 3


def run_housekeeping(scenario: Scenario, world: World) -> dict[str, FloatArray]:
    """Columns of the telemetry at the world's stamps, by name, for the parts that the scenario has."""
    columns = {"sunlit": (world.illumination > 0.5).astype(np.float64), **run_drivers(scenario, world)}
    speeds = _wheel_speeds(scenario, world)
    if speeds is not None:
        columns["wheel_speed_rpm"] = speeds
    if scenario.power is None and scenario.thermal is None:
        return columns
    rows: dict[str, list[FloatArray]] = {}
    for number in np.unique(world.segment):
        inside = world.segment == number
        for name, column in _segment(scenario, world, inside).items():
            rows.setdefault(name, []).append(column)
    return columns | {name: np.concatenate(parts) for name, parts in rows.items()}


def _segment(scenario: Scenario, world: World, inside: np.ndarray) -> dict[str, FloatArray]:
    """One stretch, warm-up included; every sample is a node of the grid, so nothing is interpolated."""
    first = world.time[inside][0]
    wanted = epoch.seconds_since(world.time[inside], first)
    before = np.arange(-_WARM_UP_ORBITS * orbit.kepler_period_s(world.r_N_km[0], world.v_N_km_s[0]), 0.0, _GRID_S)
    between = np.arange(0.0, wanted[-1], _GRID_S)
    seconds = np.unique(np.concatenate([before, between, wanted]))
    picked = np.searchsorted(seconds, wanted)
    time = epoch.add_seconds(first, seconds)
    fine = world_along(scenario, time, np.zeros(time.size), *ephemeris(scenario, time), with_field=False)
    columns: dict[str, FloatArray] = {}
    if scenario.power is not None:
        columns |= _power(scenario, fine)
    if scenario.thermal is not None:
        columns |= _thermal(scenario, fine)
    return {name: column[picked] for name, column in columns.items()}


def _power(scenario: Scenario, world: World) -> dict[str, FloatArray]:
    section = scenario.power
    assert section is not None
    panel = power.Panel(section.axis_B or section.normal_B, section.full_sun_current_A, section.axis_B is not None)
    sun_B = true_attitude(scenario, world).R_BN.apply(world.sun_N)
    array = power.array_current_A(sun_B, world.illumination, panel)
    battery = power.Battery(section.battery_capacity_Ah, section.charge_efficiency, section.taper_above)
    slot = np.floor(epoch.seconds_since(world.time, epoch.MJD2000) / section.switched_every_s)
    load = section.load_A + section.switched_load_A * (slot % 2.0)
    current, _ = power.battery_history(world.time, array, load, battery)
    return {"array_current_A": array, "battery_current_A": current}


def _thermal(scenario: Scenario, world: World) -> dict[str, FloatArray]:
    section = scenario.thermal
    assert section is not None
    thermostat = None
    if section.heater_on_below_degC is not None and section.heater_off_above_degC is not None:
        thermostat = thermal.Thermostat(
            section.heater_on_below_degC, section.heater_off_above_degC, section.heater_rise_degC
        )
    goal = thermal.equilibrium_degC(world.illumination, section.sunlit_degC, section.eclipse_degC)
    temperature, heater = thermal.temperature_history(
        world.time, goal, 60.0 * section.time_constant_min, thermostat=thermostat
    )
    columns = {"temperature_degC": temperature}
    return columns if thermostat is None else columns | {"heater_on": heater}


def _wheel_speeds(scenario: Scenario, world: World) -> FloatArray | None:
    section = scenario.wheels
    if section is None:
        return None
    if scenario.attitude.mode == "dynamics":
        return flights(scenario).wheel_speed_rpm(world.time)
    phase = orbit.argument_of_latitude(world.time, world.r_N_km, world.v_N_km_s)
    momentum = wheels.periodic_momentum_B_Nms(phase, section.momentum_amplitude_Nms)
    return wheels.wheel_speed_rpm(momentum, np.array(section.axes_B), section.inertia_kg_m2, np.array(section.bias_rpm))
