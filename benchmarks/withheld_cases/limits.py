"""Does the smallest size that an answer prints come true?

A perfect flight is diagnosed. The size printed for one effect is then flown in the same world with noise of another
draw, in the one parameter that is printed, with a sign at random, and the record is diagnosed again (`printed`). False
alarm 1 %, miss 10 % are promised.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from itertools import combinations_with_replacement
from pathlib import Path

import numpy as np

from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.telemetry.telemetry_files import write_telemetry
from withheld_cases import of_place, spacecraft
from withheld_cases.cases import PLAIN, case_seed, declared, identity, sealed_world
from withheld_cases.chain import Truth, fly
from withheld_cases.draft import recording
from withheld_cases.of_sensor import products
from withheld_cases.store import Store
from withheld_cases.worlds import REGIMES, World, draw_world

_TRIES = 60
_AXES = "xyz"
Sized = Callable[[str, float], Truth]
"""Printed parameter and its signed value to the truth."""


def along_track_error(parameter: str, value: float) -> Truth:
    """Reported position ahead [km]."""
    return Truth("along_track_error", "orbit", {parameter: value}, place=lambda w, t: of_place.ahead(w, t, value))


def ring_current(parameter: str, value: float) -> Truth:
    """External field [nT], constant; at the dipole equator the induced part comes on top of it."""
    dst = (1.0 + of_place.INDUCED_SHARE) * value
    return Truth(
        "ring_current",
        "field",
        {parameter: value},
        field=lambda w, t, r: of_place.ring_field_N_nT(w, t, r, np.full(t.size, dst)),
    )


def time_tag_offset(parameter: str, value: float) -> Truth:
    """Samples later than the stamp [s]."""
    return Truth("time_tag_offset", "time", {parameter: value}, clock=lambda w, t: np.full(t.size, value))


def solar_array_current(parameter: str, value: float) -> Truth:
    """Field per current on one axis [nT/A]."""
    axis = _unit(parameter)
    return Truth(
        "solar_array_current",
        "spacecraft",
        {parameter: value},
        stray=lambda w, t, field: np.outer(spacecraft.array_current_A(w, t), value * axis),
    )


def thermal_bias_drift(parameter: str, value: float) -> Truth:
    """Slope of b on one axis [nT/K]; what it is at the mean temperature is re-estimated with b."""
    axis = _unit(parameter)

    def correction(w: World, t: np.ndarray) -> tuple[FloatArray, FloatArray]:
        warmer = spacecraft.temperature_degC(w, t)
        return np.zeros((t.size, 3, 3)), np.outer(warmer - warmer.mean(), value * axis)

    return Truth("thermal_bias_drift", "sensor", {parameter: value}, correction=correction)


def cubic_nonlinearity(parameter: str, value: float) -> Truth:
    """What one axis gains of one product of three components [nT at 50,000 nT]: `c_z_xxy`."""
    _, axis, factors = parameter.split("_")
    which = list(combinations_with_replacement(range(3), 3)).index(tuple(sorted(map(_AXES.index, factors))))

    def sense(w: World, t: np.ndarray, reading: FloatArray, perfect: object) -> FloatArray:
        return reading + np.outer(products(reading, 3)[:, which], value * np.eye(3)[_AXES.index(axis)])

    return Truth("cubic_nonlinearity", "sensor", {parameter: value}, sense=sense)


SIZED: Mapping[str, Sized] = {
    maker.__name__: maker
    for maker in (
        along_track_error,
        ring_current,
        time_tag_offset,
        thermal_bias_drift,
        solar_array_current,
        cubic_nonlinearity,
    )
}
COLUMNS = {"thermal_bias_drift": ("temperature_degC",), "solar_array_current": ("array_current_A",)}
"""Without its column an effect is sought by what stands in, whose parameters are in other units."""


def _unit(parameter: str) -> FloatArray:
    """The axis that the last letter of a parameter names."""
    axis: FloatArray = np.eye(3)[_AXES.index(parameter[-1])]
    return axis


def draw(seed: int, number: int) -> tuple[str, World, int]:
    """The effect, the world that can show it, and the key of the noise of its second flight."""
    name = tuple(SIZED)[number % len(SIZED)]
    rng = case_seed(seed, "limits", number)
    regime = REGIMES[(number // len(SIZED)) % len(REGIMES)]
    for _ in range(_TRIES):
        world = recording(draw_world(rng, regime), *COLUMNS.get(name, ()))
        draft = PLAIN[name](world, np.random.default_rng(int(rng.integers(0, 2**31))))
        if draft is not None:
            return name, dataclasses.replace(world, recorded=draft.world.recorded), int(rng.integers(1, 2**31))
    raise RuntimeError(f"limits {number} ({name}, {regime}): no world shows it")


def make(root: str, seed: int, number: int) -> str:
    """The perfect flight, its question, and which effect is meant."""
    store, case = Store(Path(root)), identity(seed, "limits", number)
    if store.has("sealed", case):
        return case
    try:
        name, world, key = draw(seed, number)
    except RuntimeError as error:
        store.write("sealed", case, {"case": case, "population": "limits", "number": number, "void": str(error)})
        return case
    write_telemetry(fly(world, ()), store.path("telemetry", case))
    store.write("asked", case, declared(case, world))
    stage = SIZED[name]("c_x_xxx", 0.0).stage
    truth = {"name": name, "stage": stage, "parameters": {}, "signal": True, "target": 0.0, "visible": 0.0, "size": 0.0}
    sealed = {"case": case, "population": "limits", "number": number, "label": name, "seed": seed, "second_key": key}
    store.write("sealed", case, sealed | {"truths": [truth]} | sealed_world(world))
    return case
