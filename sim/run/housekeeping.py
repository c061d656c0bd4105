"""Currents, temperature, heater and wheel speeds along a run.

These have memory, so each stretch of the schedule is preceded by a warm-up of three orbits on a fine grid. It
starts from a full battery and the mean temperature: a battery that loses more in an orbit than it gains, or a
thermal constant of several orbits, is still on its way when the stretch begins.

What [drivers.NAME] of a scenario records: columns `driver_NAME`, which effects may follow.
"""

from __future__ import annotations

import numpy as np

from fluxtwin.sim.base.errors import BadInput
from fluxtwin.sim.base.random_streams import stream
from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.earth import epoch, orbit
from fluxtwin.sim.run.flights import flights
from fluxtwin.sim.run.true_attitude import true_attitude
from fluxtwin.sim.run.world import World, ephemeris, world_along
from fluxtwin.sim.scenario.scenario import Scenario
from fluxtwin.sim.scenario.sections import DriverSection
from fluxtwin.sim.spacecraft import power, wheels
from fluxtwin.sim.spacecraft.torquers import draw_random_duty
from fluxtwin.sim.telemetry.csv_files import open_csv
from fluxtwin.sim.telemetry.quantities import DRIVERS
from fluxtwin.sim.telemetry.time_stamps import parse_iso

_GRID_S = 30.0
_WARM_UP_ORBITS = 3


def _values(scenario: Scenario, world: World, name: str) -> FloatArray:
    section = scenario.drivers[name]
    if section.pattern == "file":
        return _from_file(scenario, section, world, f"drivers.{name}")
    low, high = section.low or 0.0, section.high or 0.0
    return np.asarray(low + (high - low) * _share(scenario, section, world, f"drivers.{name}"))


def _share(scenario: Scenario, section: DriverSection, world: World, name: str) -> FloatArray:
    """(N,) 0 at `low`, 1 at `high`."""
    if section.pattern == "sunlit":
        return world.illumination
    if section.pattern == "random":
        assert section.duty is not None and section.dwell_s is not None
        rng = stream(scenario.seed, name)
        drawn = draw_random_duty((1.0, 0.0, 0.0), section.duty, section.dwell_s, rng, both_signs=False)
        return drawn.dipole_B_Am2(world.time)[:, 0]
    if section.period_s is None:
        return np.ones(world.time.size)
    seconds = np.round(epoch.seconds_since(world.time, world.time[0]), 6) - (section.offset_s or 0.0)
    since = np.mod(seconds, section.period_s)
    share = since / section.period_s if section.duty is None else since < section.duty * section.period_s
    return np.asarray(share, dtype=np.float64)


def _from_file(scenario: Scenario, section: DriverSection, world: World, name: str) -> FloatArray:
    """A column of a CSV, linear between its rows."""
    assert section.file is not None and section.column is not None
    opened = open_csv(scenario.path_of(section.file))
    missing = [column for column in ("time", section.column) if column not in opened.names]
    if missing:
        raise BadInput(
            f"column {missing[0]} is missing", where=f"{name}: {opened.where}", wanted=", ".join(opened.names)
        )
    values = opened.numbers([section.column])[section.column]
    stamps = parse_iso(opened.text("time"), opened.where)
    known = np.isfinite(values) & ~np.isnat(stamps)
    stamps, values = stamps[known], values[known]
    if (np.diff(stamps.astype("int64")) <= 0).any():
        raise BadInput("time does not increase", where=f"{name}: {opened.where}", wanted="increasing stamps")
    if not stamps.size or world.time[0] < stamps[0] or world.time[-1] > stamps[-1]:
        raise BadInput(
            f"its values of {section.column} do not cover the schedule, "
            f"{epoch.iso(world.time[0])} to {epoch.iso(world.time[-1])}",
            where=f"{name}: {opened.where}",
            wanted="rows from the first sample to the last",
        )
    return np.interp(epoch.seconds_since(world.time, stamps[0]), epoch.seconds_since(stamps, stamps[0]), values)


def run_housekeeping(scenario: Scenario, world: World) -> dict[str, FloatArray]:
    """Columns of the telemetry at the world's stamps, by name, for the parts that the scenario has."""
    columns = {
        "sunlit": (world.illumination > 0.5).astype(np.float64),
        **{DRIVERS.prefix + name: _values(scenario, world, name) for name in scenario.drivers},
    }
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
        columns["temperature_degC"], heater = scenario.thermal.history(fine.time, fine.illumination)
        columns |= {} if scenario.thermal.heater_on_below_degC is None else {"heater_on": heater}
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


def _wheel_speeds(scenario: Scenario, world: World) -> FloatArray | None:
    section = scenario.wheels
    if section is None:
        return None
    if scenario.attitude.mode == "dynamics":
        return flights(scenario).wheel_speed_rpm(world.time)
    phase = orbit.argument_of_latitude(world.time, world.r_N_km, world.v_N_km_s)
    momentum = wheels.periodic_momentum_B_Nms(phase, section.momentum_amplitude_Nms)
    return wheels.wheel_speed_rpm(momentum, np.array(section.axes_B), section.inertia_kg_m2, np.array(section.bias_rpm))
