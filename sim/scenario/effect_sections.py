"""[effects.NAME] in a scenario: the catalogue as strict sections, and back from sections to effects.

The keys are made from the effect itself: each parameter with its unit as suffix (`offset_s`), three parameters that
end in _x, _y, _z as one list of three (`b_nT`), nine that end in _xx ... _zz as a 3x3 list, and each discrete setting
under its own name (`head`). Of an effect that there may be several of each has a section of its own, [effects.driver.NAME].
"""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Mapping, Sequence
from datetime import datetime, timedelta
from typing import TYPE_CHECKING, Annotated, Any, Self, get_type_hints

import numpy as np
import tomli_w
from pydantic import BeforeValidator, Field, create_model, model_validator

from fluxtwin.sim.base.section_types import Section
from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.earth.epoch import iso
from fluxtwin.sim.effects.base import MATRIX, Effect, Parameter
from fluxtwin.sim.effects.catalogue import CATALOGUE, find_effect

if TYPE_CHECKING:
    from fluxtwin.sim.scenario.scenario import Scenario

_PER_TIME = {
    "deg/h": "deg_h",
    "deg/s": "deg_s",
    "km/s": "km_s",
    "km/h": "km_h",
    "rad/s": "rad_s",
    "kg m2": "kg_m2",
    "A m2 s/T": "Am2_s_per_T",
}  # as in the other sections
_SHAPES = {3: tuple("xyz"), 9: MATRIX}


@dataclasses.dataclass(frozen=True)
class Key:
    """One key of an effect's section and the parameters it holds."""

    name: str
    parameters: tuple[Parameter, ...]

    @property
    def count(self) -> int:
        """1 number, 3 (a list) or 9 (a 3x3 list)."""
        return len(self.parameters)


def unit_suffix(unit: str) -> str:
    """The unit as it ends a key: "nT/(A m2)" is nT_per_Am2, "deg/h" is deg_h, "1/K" is per_K, "1" is nothing."""
    if unit in _PER_TIME:
        return _PER_TIME[unit]
    above, *below = unit.split("/", 1)
    parts = ["" if above == "1" else above, *(["per", *below] if below else [])]
    words = "_".join(part for part in parts if part).replace("sqrt(s)", "sqrt_s").replace("^", "")
    return re.sub(r"[^A-Za-z0-9_]", "", words)


def keys_of(effect: Effect) -> tuple[Key, ...]:
    """The parameter keys of an effect's section, in the order of theta."""
    keys, rest = [], list(effect.parameters)
    while rest:
        for size, ends in sorted(_SHAPES.items(), reverse=True):
            names = [parameter.name for parameter in rest[:size]]
            stem = names[0].removesuffix(f"_{ends[0]}")
            if names == [f"{stem}_{end}" for end in ends] and len({p.unit for p in rest[:size]}) == 1:
                break
        else:
            size, stem = 1, rest[0].name
        suffix = unit_suffix(rest[0].unit)
        keys.append(Key(f"{stem}_{suffix}" if suffix else stem, tuple(rest[:size])))
        rest = rest[size:]
    return tuple(keys)


def every_key(effect: Effect) -> tuple[Key, ...]:
    """The parameter keys of its section, those that go with some of its settings only among them."""
    return tuple({key.name: key for form in effect.forms for key in keys_of(form)}.values())


def active_effects(scenario: Scenario) -> tuple[tuple[Effect, FloatArray], ...]:
    """The scenario's effects with their parameters, in the order of the catalogue."""
    active = []
    for default in CATALOGUE:
        given = getattr(scenario.effects, default.name)
        if default.keyed_by is None:
            named = {} if given is None else {default.name: given}
        else:
            named = {f"{default.name}.{key}": section for key, section in given.items()}
        for name, section in named.items():
            settings = {setting: getattr(section, setting) for setting in _settings(default)}
            effect = dataclasses.replace(find_effect(name), **settings)
            values = [getattr(section, key.name) for key in keys_of(effect)]
            whole = [
                np.zeros(key.count) if v is None else np.ravel(v)
                for key, v in zip(keys_of(effect), values, strict=True)
            ]
            active.append((effect, np.concatenate(whole).astype(np.float64)))
    return tuple(active)


def effect_section(effect: Effect, theta: FloatArray, covariance: FloatArray | None = None) -> dict[str, Any]:
    """The section [effects.NAME] that switches this effect on; `Scenario.updated({"effects.NAME": ...})` takes it.

    covariance: (p, p), in the order of theta, to be carried along; the simulation does not use it.
    """
    section = {name: value for name in _settings(effect) if (value := getattr(effect, name)) is not None}
    start = 0
    for key in keys_of(effect):
        values = np.asarray(theta, dtype=np.float64)[start : start + key.count]
        section[key.name] = values.reshape({1: (), 3: (3,), 9: (3, 3)}[key.count]).tolist()
        start += key.count
    if covariance is not None:
        section["covariance"] = np.asarray(covariance, dtype=np.float64).tolist()
    return section


def effect_tree(effect: Effect, theta: FloatArray | Sequence[float]) -> dict[str, Any]:
    """The same as [effects] with nothing else in it; an effect that wants a name of its own and has none is called NAME."""
    section = effect_section(effect, np.asarray(theta, dtype=np.float64))
    if effect.keyed_by is not None:
        section = {getattr(effect, effect.keyed_by) or "NAME": section}
    return {effect.family: section}


def effect_toml(effect: Effect, theta: FloatArray | Sequence[float]) -> str:
    """The same as TOML text."""
    return tomli_w.dumps({"effects": effect_tree(effect, theta)})


def effects_record(scenario: Scenario) -> dict[str, Mapping[str, Any]]:
    """All sections with every setting and parameter written out."""
    return {effect.name: effect_section(effect, theta) for effect, theta in active_effects(scenario)}


def _plain(value: Any) -> Any:
    """What TOML read, as settings have it: lists as tuples, times as text."""
    if isinstance(value, list):
        return tuple(_plain(item) for item in value)
    if isinstance(value, datetime) and value.utcoffset() == timedelta(0):
        return iso(np.datetime64(value.replace(tzinfo=None), "ns"), "ms")
    return value


class EffectSection(Section):
    """Base of all [effects.NAME]: at least one parameter is given; those that are not are zero."""

    covariance: Annotated[tuple[tuple[float, ...], ...] | None, BeforeValidator(_plain)] = None
    """Of the parameters, row by row: how well a diagnosis knows them."""

    @model_validator(mode="after")
    def _something(self) -> Self:
        effect = find_effect(type(self).__name__)
        effect = dataclasses.replace(effect, **{name: getattr(self, name) for name in _settings(effect)})
        keys = keys_of(effect)
        names = [key.name for key in keys]
        for other in {key.name for key in every_key(effect)} & self.model_fields_set - set(names):
            raise ValueError(f"{other} goes with another setting; with these the keys are {', '.join(names)}")
        if not self.model_fields_set & set(names):
            raise ValueError(f"give {'' if len(names) == 1 else 'at least one of '}{', '.join(names)}")
        size = sum(key.count for key in keys)
        if self.covariance is not None and [len(row) for row in self.covariance] != [size] * size:
            raise ValueError(f"covariance is {size} x {size}, one row a parameter")
        return self


def _settings(effect: Effect) -> dict[str, Any]:
    """Name and type of each discrete setting that the section has."""
    hints = get_type_hints(type(effect))
    return {item.name: hints[item.name] for item in dataclasses.fields(effect) if item.name != effect.keyed_by}


def _number(parameter: Parameter) -> Any:
    low = None if np.isneginf(parameter.low) else parameter.low
    high = None if np.isposinf(parameter.high) else parameter.high
    return Annotated[float, Field(ge=low, le=high)]


def _section_type(effect: Effect) -> type[EffectSection]:
    fields: dict[str, Any] = {}
    for name, hint in _settings(effect).items():
        fields[name] = (Annotated[hint, BeforeValidator(_plain)], getattr(effect, name))
    for key in every_key(effect):
        numbers = [_number(parameter) for parameter in key.parameters]
        if key.count == 1:
            kind: Any = numbers[0]
        elif key.count == 3:
            kind = tuple[tuple(numbers)]  # type: ignore[misc]
        else:
            rows = tuple(tuple[tuple(numbers[3 * row : 3 * row + 3])] for row in range(3))  # type: ignore[misc]
            kind = tuple[rows]  # type: ignore[valid-type]
        fields[key.name] = (Annotated[kind | None, BeforeValidator(_plain)], None)
    section: type[EffectSection] = create_model(effect.name, __base__=EffectSection, **fields)
    return section


if TYPE_CHECKING:
    EffectsSection = Section
else:
    EffectsSection = create_model(
        "EffectsSection",
        __base__=Section,
        **{
            effect.name: (_section_type(effect) | None, None)
            if effect.keyed_by is None
            else (dict[str, _section_type(effect)], {})
            for effect in CATALOGUE
        },
    )
    """[effects]: one optional section for each effect of the catalogue, or one by name for each of its kind."""
