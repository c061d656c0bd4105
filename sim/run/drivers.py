"""What [drivers.NAME] of a scenario records: columns `driver_NAME`, which effects may follow."""

from __future__ import annotations

import numpy as np

from fluxtwin.sim.base.errors import BadInput
from fluxtwin.sim.base.random_streams import stream
from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.earth import epoch
from fluxtwin.sim.run.world import World
from fluxtwin.sim.scenario.scenario import Scenario
from fluxtwin.sim.scenario.sections import DriverSection
from fluxtwin.sim.spacecraft.torquers import draw_random_duty
from fluxtwin.sim.telemetry.csv_files import open_csv
from fluxtwin.sim.telemetry.quantities import DRIVERS
from fluxtwin.sim.telemetry.time_stamps import parse_iso


def run_drivers(scenario: Scenario, world: World) -> dict[str, FloatArray]:
    """(N,) columns `driver_NAME` at the world's stamps. Raises BadInput for a file that cannot be read or is too short."""
    return {DRIVERS.prefix + name: _values(scenario, world, name) for name in scenario.drivers}


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
        drawn = draw_random_duty(1.0, section.duty, section.dwell_s, stream(scenario.seed, name), both_signs=False)
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
