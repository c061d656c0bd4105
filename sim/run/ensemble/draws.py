"""What is drawn for one vehicle; it depends on the seed, the vehicle's number and the key, and on nothing else.

Every quantity comes from the quantile function of its distribution at uniform numbers of a stream of its own, so a
draw that is added, or left out, moves no other, and a cut-off needs no second try.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from scipy.special import ndtr, ndtri

from fluxtwin.sim.base.errors import BadInput
from fluxtwin.sim.base.random_streams import stream
from fluxtwin.sim.base.section_types import as_tuple
from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.scenario.draws import SYMMETRIC, DrawSection, nominal
from fluxtwin.sim.scenario.scenario import Scenario

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
