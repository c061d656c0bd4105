"""The plan of an ensemble: what is flown, in which chunks, and by what a later call knows that it is the same one.

What is drawn for one vehicle depends on the seed, the vehicle's number and the key, and on nothing else. Every quantity
comes from the quantile function of its distribution at uniform numbers of a stream of its own, so a draw that is added,
or left out, moves no other, and a cut-off needs no second try.
"""

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

import numpy as np
from scipy.special import ndtr, ndtri

from fluxtwin.sim.base import files
from fluxtwin.sim.base.errors import BadInput
from fluxtwin.sim.base.random_streams import stream
from fluxtwin.sim.base.seals import sealed_json, unsealed_json
from fluxtwin.sim.base.section_types import as_tuple
from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.run.world import build_world
from fluxtwin.sim.scenario.draws import SYMMETRIC, DrawSection, nominal
from fluxtwin.sim.scenario.scenario import Scenario, parse_scenario

_BITS = 52


def nominal_values(scenario: Scenario) -> dict[str, Any]:
    """The scenario's own value of every drawn key, as an array."""
    tree = scenario.model_dump() if scenario.draws else {}
    return {key: np.asarray(nominal(tree, key)) for key in scenario.draws}


def vehicle_scenario(scenario: Scenario, seed: int, vehicle: int, drawn: Mapping[str, Any] | None = None) -> Scenario:
    """The scenario of one vehicle of the ensemble: its drawn values, its own seed, no draws; vehicles count from 0.

    Simulated alone it is the vehicle of the ensemble to the last bit. Raises BadInput, naming the vehicle, where a
    drawn value is impossible. drawn: what `drawn_values` gives, where the caller has it.
    """
    changes = drawn_values(scenario, seed, vehicle) if drawn is None else drawn
    try:
        return scenario.updated({**changes, "seed": vehicle_seed(seed, vehicle), "draws": None})
    except BadInput as error:
        raise BadInput(
            f"vehicle {vehicle} cannot be: {error}",
            where="draws",
            wanted="a distribution whose every value is possible (at_least and at_most cut a normal off)",
        ) from None


def vehicle_seed(seed: int, vehicle: int) -> int:
    """The seed of everything random in the flight of this vehicle."""
    return int(stream(seed, f"ensemble.seed.{vehicle}").integers(2**_BITS))


def drawn_values(
    scenario: Scenario, seed: int, vehicle: int, values: Mapping[str, Any] | None = None
) -> dict[str, Any]:
    """The value of every drawn key, by dotted key. values: those of `nominal_values`, where the caller has them."""
    about = nominal_values(scenario) if values is None else values
    drawn = {}
    for key, draw in scenario.draws.items():
        drawn[key] = _value(draw, about[key], stream(seed, f"ensemble.draws.{key}.{vehicle}"), key)
    return drawn


def flattened(values: Mapping[str, Any]) -> dict[str, Any]:
    """The drawn values as a row of a table: `key`, `key[0]`, `key[0][1]`; of a symmetric tensor the upper triangle."""
    row: dict[str, Any] = {}
    for key, value in values.items():
        if not isinstance(value, tuple):
            row[key] = value
            continue
        whole = np.asarray(value)
        for index in np.ndindex(whole.shape):
            if key not in SYMMETRIC or index[0] <= index[1]:
                row[key + "".join(f"[{i}]" for i in index)] = whole[index].item()
    return row


def _value(draw: DrawSection, value: Any, rng: np.random.Generator, key: str) -> Any:
    if draw.kind == "choice":
        return draw.given[int(rng.integers(len(draw.given)))]
    # never 0 or 1, whose quantiles may be infinite
    uniform = np.asarray((rng.integers(2**_BITS, size=np.shape(value)) + 0.5) * 2.0**-_BITS, dtype=np.float64)
    drawn = quantile(draw, np.asarray(value, dtype=np.float64), uniform, where=f"draws.{key}")
    if key in SYMMETRIC:
        drawn = np.triu(drawn) + np.triu(drawn, 1).T
    return as_tuple(drawn.tolist())


def quantile(draw: DrawSection, value: FloatArray, uniform: FloatArray, *, where: str = "draws") -> FloatArray:
    """What a distribution makes of uniform numbers in (0, 1), both of the key's shape, about the scenario's `value`.

    Raises BadInput where a cut-off leaves nothing of a normal distribution.
    """
    kind = draw.kind
    if kind in ("uniform", "log_uniform"):
        low, high = (np.asarray(end, dtype=np.float64) for end in draw.given)
        if kind == "uniform":
            return np.asarray(low + (high - low) * uniform)
        return np.asarray(low * np.exp(np.log(high / low) * uniform))
    if kind == "isotropic":
        direction = ndtri(uniform)
        return np.asarray(draw.given * direction / np.linalg.norm(direction))
    sigma = np.asarray(draw.given, dtype=np.float64) * (np.abs(value) if kind == "relative_normal" else 1.0)
    return _cut_normal(value, np.broadcast_to(sigma, value.shape), draw, uniform, where)


def _cut_normal(mean: FloatArray, sigma: FloatArray, draw: DrawSection, uniform: FloatArray, where: str) -> FloatArray:
    """The quantile of a normal distribution between the draw's limits; a sigma of 0 is the mean."""
    if draw.at_least is None and draw.at_most is None:
        return np.asarray(mean + sigma * ndtri(uniform))
    low = -np.inf if draw.at_least is None else np.asarray(draw.at_least, dtype=np.float64)
    high = np.inf if draw.at_most is None else np.asarray(draw.at_most, dtype=np.float64)
    scale = np.where(sigma > 0.0, sigma, 1.0)
    below, above = ndtr((low - mean) / scale), ndtr((high - mean) / scale)
    if np.any((sigma > 0.0) & ~(above - below > 1e-12)) or np.any((sigma == 0.0) & ((mean < low) | (mean > high))):
        raise BadInput(
            "at_least and at_most leave nothing of the distribution",
            where=where,
            wanted="limits within some sigmas of the scenario's value",
        )
    drawn = np.clip(mean + sigma * ndtri(below + (above - below) * uniform), low, high)
    return np.where(sigma > 0.0, drawn, mean)


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
        """The scenario of one vehicle, see `vehicle_scenario`."""
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
