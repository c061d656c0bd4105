"""Seasat's runs: the scenario, its data sets, and one flight of it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from fluxtwin.scenarios.motion import ATTITUDES, with_attitude
from fluxtwin.scenarios.printed import Printed
from fluxtwin.scenarios.seasat import geometry
from fluxtwin.sim.base.random_streams import stream
from fluxtwin.sim.base.types import BoolArray
from fluxtwin.sim.run.simulate import simulate
from fluxtwin.sim.run.truth import Truth
from fluxtwin.sim.run.world import World, build_world
from fluxtwin.sim.scenario.scenario import Scenario, parse_scenario
from fluxtwin.sim.telemetry.record import Telemetry

PRINTED = Printed("fluxtwin.scenarios.seasat")
read_table, read_claims, printed_value = PRINTED.table, PRINTED.claims, PRINTED.value


def quantity(name: str) -> float:
    """A single number that the papers print, by its name in `quantities.csv`; LookupError for another name."""
    return printed_value("quantities", "value", quantity=name)


DATA_SETS: Mapping[str, tuple[int, ...]] = {
    "205": (0,),
    "219": (1,),
    "225": (2,),
    "227": (3,),
    "193": (0, 2),
    "all": (0, 1, 2, 3),
}
"""Segments of the schedule in each data set. 193 samples are days 205 and 225; the published base of 210
samples is no sum of these days and is left out."""

PAPER_COLUMN = {"205": "205", "219": "219", "225": "225", "227": "227", "193": "combo193", "all": "final325"}
"""Columns of `calibration.csv`."""


@dataclass(frozen=True)
class Flight:
    """One run of a scenario."""

    scenario: Scenario
    world: World
    telemetry: Telemetry
    truth: Truth

    def rows(self, data_set: str) -> BoolArray:
        """(N,) rows of one of DATA_SETS."""
        return np.isin(self.world.segment, DATA_SETS[data_set])


def scenario(attitude: str = ATTITUDES[0]) -> Scenario:
    """The packaged scenario: its vehicle moved by torques, or as `prescribed`."""
    return with_attitude(parse_scenario(PRINTED.text("seasat.toml"), where="seasat.toml"), attitude)


def scenario_text(attitude: str = ATTITUDES[0]) -> str:
    """The packaged scenario: as it is written, with the source of each number, or every key of the prescribed one."""
    return PRINTED.text("seasat.toml") if attitude == ATTITUDES[0] else scenario(attitude).to_toml()


def fly(config: Scenario, world: World | None = None) -> Flight:
    """Run a scenario; `world` if it is known already."""
    world = build_world(config) if world is None else world
    return Flight(config, world, *simulate(config, world=world))


def with_random_hours(config: Scenario, seed: int) -> Scenario:
    """The same days with another seed and start hours drawn at random, so that longitudes differ as well."""
    hours = stream(seed, "seasat.start_hours").uniform(0.0, 24.0, size=len(geometry.DATA_DAYS))
    segments = [
        {"start_utc": str(geometry.day(number, float(hour))) + "Z", "samples": samples, "step_s": 60.0}
        for number, samples, hour in zip(geometry.DATA_DAYS, geometry.DATA_MINUTES, hours, strict=True)
    ]
    return config.updated({"seed": seed, "schedule.segments": segments})


def with_schedule(config: Scenario, start: np.datetime64, samples: int, step_s: float) -> Scenario:
    """The same spacecraft over another stretch of time."""
    segment = {"start_utc": f"{start}Z", "samples": samples, "step_s": step_s}
    return config.updated({"schedule.segments": [segment]})


SOURCES = ("lsb", "attitude", "torquer", "field", "unknown")
_OFF: Mapping[str, Mapping[str, Any]] = {
    "lsb": {"magnetometer.lsb_mG": 0.0},
    "attitude": {"attitude.reference.source": "error_model"},
    "torquer": {"torquers.compensation": 1.0},
    "field": {"field.truth": "igrf1975"},
    "unknown": {"magnetometer.unknown": None},
}


def only(config: Scenario, *sources: str) -> Scenario:
    """The scenario with all sources of error off but these (names of SOURCES)."""
    changes: dict[str, Any] = {}
    for source in SOURCES:
        if source not in sources:
            changes |= _OFF[source]
    return config.updated(changes)
