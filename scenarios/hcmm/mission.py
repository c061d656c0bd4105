"""HCMM's runs: the scenario, its days, one flight of it, and the printed tables."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from fluxtwin.scenarios.motion import ATTITUDES, with_attitude
from fluxtwin.scenarios.printed import Printed
from fluxtwin.sim.run.simulate import simulate
from fluxtwin.sim.run.truth import Truth
from fluxtwin.sim.run.world import World, build_world
from fluxtwin.sim.scenario.scenario import Scenario, parse_scenario
from fluxtwin.sim.telemetry.record import Telemetry

PRINTED = Printed("fluxtwin.scenarios.hcmm")
read_table, read_claims, printed_value = PRINTED.table, PRINTED.claims, PRINTED.value


def quantity(name: str) -> float:
    """A single number that the papers print, by its name in `quantities.csv`; LookupError for another name."""
    return printed_value("quantities", "value", quantity=name)


DAYS: Mapping[str, tuple[int, ...]] = {"A": (284, 285, 287, 289), "B": (279, 290, 292, 298, 300, 302)}
"""Days of 1978 in each set of Table 3. The scan shows 285 before 284, so one digit of it may be wrong."""
SAMPLES: Mapping[str, int] = {"A": 135, "B": 308}
"""132 and 308 in the scan, 443 together; 135 makes the sum right."""


@dataclass(frozen=True)
class Flight:
    """One run of a scenario."""

    scenario: Scenario
    world: World
    telemetry: Telemetry
    truth: Truth


def scenario(attitude: str = ATTITUDES[0]) -> Scenario:
    """The packaged scenario: its vehicle moved by torques, or as `prescribed`."""
    return with_attitude(parse_scenario(PRINTED.text("hcmm.toml"), where="hcmm.toml"), attitude)


def scenario_text(attitude: str = ATTITUDES[0]) -> str:
    """The packaged scenario: as it is written, with the source of each number, or every key of the prescribed one."""
    return PRINTED.text("hcmm.toml") if attitude == ATTITUDES[0] else scenario(attitude).to_toml()


def fly(config: Scenario, world: World | None = None) -> Flight:
    """Run a scenario; `world` if it is known already."""
    world = build_world(config) if world is None else world
    return Flight(config, world, *simulate(config, world=world))


def day(number: int) -> np.datetime64:
    """0 h UTC of a day of 1978 (1 is 1 January)."""
    return np.datetime64("1978-01-01", "ns") + np.timedelta64(number - 1, "D")


def on_days(config: Scenario, step_s: float = 60.0) -> Scenario:
    """The same spacecraft over all days of Table 3, in view of the stations."""
    segments = [
        {"start_utc": f"{day(number)}Z", "duration_min": 1439.0, "step_s": step_s}
        for number in sorted(DAYS["A"] + DAYS["B"])
    ]
    return config.updated({"schedule.segments": segments, "sun_sensor.1.misalignment_deg": None})


SOURCES = ("lsb", "attitude", "torquer", "field")
_OFF: Mapping[str, Mapping[str, Any]] = {
    "lsb": {"magnetometer.lsb_mG": 0.0},
    "attitude": {
        "attitude.reference.source": "error_model", "attitude.reference.needs_sun": True,
        "horizon_scanner.noise_deg": 0.0,
    },
    "torquer": {"torquers.compensation": 1.0},
    "field": {"field.truth": "igrf1975"},
}  # fmt: skip


def only(config: Scenario, *sources: str) -> Scenario:
    """The scenario with all sources of error off but these (names of SOURCES)."""
    changes: dict[str, Any] = {}
    for source in SOURCES:
        if source not in sources:
            changes |= _OFF[source]
    return config.updated(changes)
