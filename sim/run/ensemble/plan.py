"""The plan of an ensemble: what is flown, in which chunks, and by what a later call knows that it is the same one."""

from __future__ import annotations

import contextlib
import hashlib
import importlib.metadata
import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any

from fluxtwin.sim.base import files
from fluxtwin.sim.base.errors import BadInput
from fluxtwin.sim.base.seals import sealed_json, unsealed_json
from fluxtwin.sim.run.ensemble.draws import (
    drawn_values,
    flattened,
    nominal_values,
    vehicle_scenario,
    vehicle_seed,
)
from fluxtwin.sim.run.world import build_world
from fluxtwin.sim.scenario.scenario import Scenario, parse_scenario

RECORD = "ensemble.json"
_LEAST, _PARTS = 32, 32
_CHUNK_BYTES = 32_000_000
_ROW_BYTES = 120
"""About what a row of one vehicle takes in memory while its chunk is made."""
_REMEMBERED = 10_000  # some 20 MB
_MOST_VEHICLES = 1_000_000
_PACKAGES = ("fluxtwin", "numpy", "scipy")
"""Another version of these may draw other numbers, or round otherwise."""


@dataclass(frozen=True)
class Plan:
    """So many vehicles of a scenario with [draws], so many in a chunk."""

    scenario: Scenario
    seed: int
    vehicles: int
    in_chunk: int

    @property
    def chunks(self) -> int:
        """How many there are; the last may be short."""
        return -(-self.vehicles // self.in_chunk)

    def members(self, number: int) -> range:
        return range(number * self.in_chunk, min((number + 1) * self.in_chunk, self.vehicles))

    def vehicle(self, number: int) -> Scenario:
        """The scenario of one vehicle, see `draws.vehicle_scenario`."""
        return vehicle_scenario(self.scenario, self.seed, number, self.drawn(number))

    def row(self, number: int) -> dict[str, Any]:
        """Number, seed and what was drawn, as the table of vehicles has it."""
        return {"vehicle": number, "seed": vehicle_seed(self.seed, number), **flattened(self.drawn(number))}

    def check(self, number: int) -> None:
        """Raises BadInput for a vehicle of a chunk that cannot be."""
        for vehicle in self.members(number):
            self.vehicle(vehicle)

    @cached_property
    def drawn(self) -> Callable[[int], dict[str, Any]]:
        """What was drawn for a vehicle of that number, by dotted key. Remembers: check, both tables and flight ask."""
        values = nominal_values(self.scenario)
        return lru_cache(_REMEMBERED)(lambda number: drawn_values(self.scenario, self.seed, number, values))

    def record(self) -> dict[str, Any]:
        """Everything as plain values, for a process elsewhere and for the folder of the results."""
        return {
            "scenario": self.scenario.to_toml(),
            "folder": str(self.scenario.path_of(".").resolve()),
            "seed": self.seed,
            "vehicles": self.vehicles,
            "vehicles_in_chunk": self.in_chunk,
            "files": _digests(self.scenario),
            "versions": _versions(),
        }

    @cached_property
    def fingerprint(self) -> str:
        """SHA-256 of all that decides what a vehicle does; every chunk carries it."""
        decisive = {key: value for key, value in self.record().items() if key not in ("folder", "vehicles")}
        return hashlib.sha256(json.dumps(decisive, sort_keys=True).encode("utf-8")).hexdigest()

    @classmethod
    def from_record(cls, record: Mapping[str, Any]) -> Plan:
        scenario = parse_scenario(record["scenario"], folder=record["folder"])
        return cls(scenario, int(record["seed"]), int(record["vehicles"]), int(record["vehicles_in_chunk"]))


def chunk_size(rows: int, vehicles: int) -> int:
    """Vehicles in a chunk: some 32 MB at most, and of many vehicles enough chunks for all cores."""
    fitting = max(1, _CHUNK_BYTES // (_ROW_BYTES * rows))
    return min(fitting, max(_LEAST, -(-vehicles // _PARTS)), vehicles)


def make_plan(
    scenario: Scenario,
    vehicles: int,
    seed: int | None = None,
    in_chunk: int | None = None,
) -> Plan:
    """The plan, whose vehicles are not checked yet.

    seed: the scenario's own where not given. in_chunk: vehicles in a chunk; `chunk_size` where not given.
    Raises BadInput for a scenario that has no ensemble.
    """
    if scenario.replay is not None:
        raise BadInput("[replay] flies what one vehicle did", where="ensemble", wanted="a scenario with an [orbit]")
    if not 1 <= vehicles <= _MOST_VEHICLES:
        raise BadInput(f"{vehicles} vehicles", where="--vehicles", wanted=f"1 to {_MOST_VEHICLES:,}")
    if in_chunk is not None and in_chunk < 1:
        raise BadInput(f"{in_chunk} vehicles in a chunk", where="--chunk", wanted="1 or more")
    if seed is not None and seed < 0:
        raise BadInput(f"{seed}", where="--seed", wanted="a whole number, 0 or more")
    assert scenario.schedule is not None
    if scenario.schedule.in_view_of_stations and any(key.startswith("orbit.") for key in scenario.draws):
        raise BadInput(
            "with drawn orbits every vehicle has other passes, so their samples stand at other times",
            where="schedule.in_view_of_stations",
            wanted="false, or one orbit for all",
        )
    rows = build_world(scenario).time.size
    chosen = chunk_size(rows, vehicles) if in_chunk is None else in_chunk
    return Plan(scenario, scenario.seed if seed is None else seed, vehicles, chosen)


def require_same(plan: Plan, folder: Path, record: str = RECORD) -> None:
    """BadInput unless what was begun in the folder is this plan; says what differs. More vehicles are welcome."""
    path = folder / record
    try:
        then = unsealed_json(path.read_text(encoding="utf-8"), where=str(path), wanted="another --out")
        given, now = dict(then["plan"]), plan.record()
    except (OSError, ValueError, KeyError, TypeError):
        raise BadInput(
            "cannot be read as the record of what was flown", where=str(path), wanted="another --out"
        ) from None
    words = {
        "scenario": "the scenario",
        "files": "a file that the scenario names",
        "versions": "the program",
        "seed": "the seed",
        "vehicles_in_chunk": "the size of the chunks",
    }
    other = [text for key, text in words.items() if given.get(key) != now[key]]
    if other:
        numbers = [
            f"{key} {given.get(key)} then, {now[key]} now" for key in ("seed", "versions") if words[key] in other
        ]
        raise BadInput(
            f"cannot go on: {' and '.join(other)} changed since this was begun"
            + (f" ({'; '.join(numbers)})" if numbers else ""),
            where=str(folder),
            wanted="what it was begun with, or another folder",
        )
    if int(given["vehicles"]) > plan.vehicles:
        raise BadInput(
            f"{plan.vehicles} vehicles, but {given['vehicles']} were begun",
            where=str(folder),
            wanted="as many, or more",
        )


def recorded_chunk(folder: Path) -> int | None:
    """Vehicles in a chunk of the ensemble in this folder; None where there is none."""
    try:
        return int(json.loads((folder / RECORD).read_text(encoding="utf-8"))["plan"]["vehicles_in_chunk"])
    except (OSError, ValueError, KeyError, TypeError):
        return None


def write_record(plan: Plan, folder: Path, record: str = RECORD) -> Path:
    """Write the plan beside the results."""
    return files.write_json(folder / record, sealed_json({"fingerprint": plan.fingerprint, "plan": plan.record()}))


def _versions() -> dict[str, str]:
    versions = {}
    for name in _PACKAGES:
        with contextlib.suppress(importlib.metadata.PackageNotFoundError):  # run from its source, not installed
            versions[name] = importlib.metadata.version(name)
    return versions


def _digests(scenario: Scenario) -> dict[str, str]:
    """SHA-256 of the files that the scenario names."""
    paths = [] if scenario.orbit is None or scenario.orbit.tle is None else [scenario.path_of(scenario.orbit.tle)]
    models = (scenario.field.truth, scenario.field.model)
    paths += [Path(model.removeprefix("chaos:")) for model in models if model.startswith("chaos:")]
    return {path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in paths if path.is_file()}
