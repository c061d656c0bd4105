"""One flight of a study's scenario, and the scenario as a study flies it: by torques or as prescribed, with sources off."""

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


@dataclass(frozen=True)
class Flight:
    """One run of a scenario."""

    scenario: Scenario
    world: World
    telemetry: Telemetry
    truth: Truth


def fly(config: Scenario, world: World | None = None) -> Flight:
    """Run a scenario; `world` if it is known already."""
    world = build_world(config) if world is None else world
    return Flight(config, world, *simulate(config, world=world))


def day(number: int, hour: float = 0.0) -> np.datetime64:
    """UTC stamp of a day of the year 1978 (1 is 1 January)."""
    return np.datetime64("1978-01-01", "ns") + np.timedelta64(number - 1, "D") + np.timedelta64(round(hour * 3600), "s")


@dataclass(frozen=True)
class Mission(Printed):
    """The packaged scenario NAME.toml of a study beside what the papers print."""

    off: Mapping[str, Mapping[str, Any]]
    """What switches each source of error off."""

    def quantity(self, name: str) -> float:
        """A single printed number, by its name in `quantities.csv`; LookupError for another name."""
        return self.value("quantities", "value", quantity=name)

    def scenario(self, attitude: str = ATTITUDES[0]) -> Scenario:
        """The packaged scenario: its vehicle moved by torques, or as `prescribed`."""
        return with_attitude(parse_scenario(self.text(self._file), where=self._file), attitude)

    def scenario_text(self, attitude: str = ATTITUDES[0]) -> str:
        """As it is written, with the source of each number, or every key of the prescribed one."""
        return self.text(self._file) if attitude == ATTITUDES[0] else self.scenario(attitude).to_toml()

    def only(self, config: Scenario, *sources: str) -> Scenario:
        """The scenario with all sources of error off but these."""
        changes: dict[str, Any] = {}
        for source, change in self.off.items():
            changes |= {} if source in sources else change
        return config.updated(changes)

    @property
    def _file(self) -> str:
        return f"{self.package.rsplit('.', 1)[1]}.toml"
