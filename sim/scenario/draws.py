"""[draws] of a scenario: which of its keys differ from vehicle to vehicle of an ensemble, and how.

The unit is the key's own, as its name says it. A single simulation takes no notice: it flies the values as they stand.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Annotated, Any, Self

import numpy as np
from pydantic import BeforeValidator, Field, model_validator

from fluxtwin.sim.base.errors import nearest
from fluxtwin.sim.base.section_types import Section, as_tuple, one_of

FIXED = ("name", "seed", "schedule", "station", "replay", "closure", "draws")
"""What all vehicles of an ensemble have in common, whatever is drawn."""
SYMMETRIC = ("spacecraft.inertia_kg_m2",)
"""Tensors: the lower triangle follows the upper one."""
KINDS = ("normal", "relative_normal", "uniform", "log_uniform", "isotropic", "choice")


def _numbers(value: Any) -> Any:
    """Numbers, or lists of lists of them, as tuples; ValueError for anything else."""
    try:
        whole = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError):
        whole = np.array(np.nan)
    if isinstance(value, bool | str) or not np.isfinite(whole).all():
        raise ValueError("a number is wanted, or numbers in the shape of the key")
    return as_tuple(value)


Numbers = Annotated[Any, BeforeValidator(_numbers)]
Ends = Annotated[tuple[Numbers, Numbers], BeforeValidator(as_tuple)]


class DrawSection(Section):
    """How one key is drawn; exactly one distribution. Components of vectors and tensors are independent."""

    normal: Numbers | None = None
    """Standard deviation about the scenario's value."""
    relative_normal: Numbers | None = None
    """Standard deviation as a share of the scenario's value: 0.03 is 3 %."""
    uniform: Ends | None = None
    """Lowest and highest value."""
    log_uniform: Ends | None = None
    """Lowest and highest value, both above zero; the logarithm is uniform."""
    isotropic: Annotated[float, Field(gt=0)] | None = None
    """Length of a vector of random direction; 1 for a quaternion that takes every attitude alike."""
    choice: Annotated[tuple[Any, ...], BeforeValidator(as_tuple), Field(min_length=1)] | None = None
    """One of these values."""
    at_least: Numbers | None = None
    """normal, relative_normal: the distribution is cut off below this value,"""
    at_most: Numbers | None = None
    """and above this one."""

    @model_validator(mode="after")
    def _whole(self) -> Self:
        one_of(self, *KINDS)
        if (self.at_least is not None or self.at_most is not None) and "normal" not in self.kind:
            raise ValueError("at_least and at_most cut off a normal or relative_normal, nothing else")
        if "normal" in self.kind and np.any(np.asarray(self.given) < 0.0):
            raise ValueError(f"{self.kind} is a standard deviation: 0 or more")
        if self.kind in ("uniform", "log_uniform"):
            low, high = (np.asarray(end) for end in self.given)
            if not np.all(low <= high) or (self.kind == "log_uniform" and not np.all(low > 0.0)):
                raise ValueError(f"{self.kind} wants [lowest, highest]" + " above zero" * (self.kind == "log_uniform"))
        return self

    @property
    def kind(self) -> str:
        return next(kind for kind in KINDS if getattr(self, kind) is not None)

    @property
    def given(self) -> Any:
        return getattr(self, self.kind)


def nominal(tree: Mapping[str, Any], key: str) -> Any:
    """The value of a dotted key in a dumped scenario; KeyError where there is none, None where it has no value."""
    node: Any = tree
    for part in key.split("."):
        if not isinstance(node, Mapping):
            raise KeyError(key)
        node = node[part]
    return node


def faults(draws: Mapping[str, DrawSection], tree: Mapping[str, Any]) -> list[str]:
    """What is wrong with the draws of a dumped scenario, a sentence each."""
    return [f"draws.{key}: {fault}" for key, draw in draws.items() for fault in _faults(key, draw, tree)]


def _faults(key: str, draw: DrawSection, tree: Mapping[str, Any]) -> Iterator[str]:
    if key.split(".")[0] in FIXED:
        yield "is the same for all vehicles and cannot be drawn"
        return
    top = key.split(".")[0]
    if top in tree and tree[top] is None:
        yield f"the scenario has no [{top}]: add the section"
        return
    try:
        value = nominal(tree, key)
    except KeyError:
        yield "the scenario has no such key" + nearest(key, leaves(tree))
        return
    if value is None or isinstance(value, Mapping):
        yield "has no value in the scenario: give it one, which a single simulation uses"
    elif draw.kind != "choice":
        yield from _misfits(value, draw)


def _misfits(value: Any, draw: DrawSection) -> Iterator[str]:
    """Where numbers that are drawn do not fit a key with this value."""
    try:
        shape = np.shape(value)
        numeric = np.asarray(value).dtype.kind == "f"
    except ValueError:
        numeric = False
    if not numeric:
        yield f"is {value!r:.40}, not a quantity: only choice can draw it"
        return
    asked = [draw.at_least, draw.at_most, *(draw.given if draw.kind.endswith("uniform") else [draw.given])]
    if any(np.shape(part) not in ((), shape) for part in asked if part is not None):
        yield "wants one number" + (f", or numbers of the shape {shape}" if shape else "")
    if draw.kind == "isotropic" and len(shape) != 1:
        yield "is no vector: isotropic draws a direction"
    if draw.kind == "relative_normal" and not np.any(value):
        yield "is 0 in the scenario: a share of it is 0 (normal takes a sigma in the key's unit)"


def leaves(tree: Mapping[str, Any], prefix: str = "") -> Iterator[str]:
    """The dotted keys of a dumped scenario that a draw may name."""
    for name, value in tree.items():
        if isinstance(value, Mapping):
            yield from leaves(value, f"{prefix}{name}.")
        elif value is not None and f"{prefix}{name}".split(".")[0] not in FIXED:
            yield f"{prefix}{name}"
