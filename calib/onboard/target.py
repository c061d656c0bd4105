"""What a target is: how one piece of flight software holds a calibration, and in what kind of file.

Every target says its formula with units, writes its file and reads it back. The error that its number type adds is not
declared anywhere: it is measured on what is read back.
"""

from __future__ import annotations

import re
from abc import ABC, abstractmethod
from collections.abc import Iterable, Sequence
from typing import ClassVar, NamedTuple

import numpy as np

from fluxtwin.calib.common.conventions import OffsetFirst
from fluxtwin.sim.base.errors import BadInput
from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.earth.constants import NT_PER_MG

NT_PER_GAUSS = 1000.0 * NT_PER_MG


class Number(NamedTuple):
    """One number of the file."""

    name: str
    text: str
    """As it is written; float32 and float64 in the fewest digits that give the same number back."""
    unit: str


class Target(ABC):
    """One kind of flight software. Instances have no state."""

    name: ClassVar[str]
    """As `--to` takes it."""
    what: ClassVar[str]
    """What the file is, in words."""
    formula: ClassVar[str]
    """From reading m to field B, with units."""
    source: ClassVar[str]
    """Who says so."""
    ending: ClassVar[str]
    looks: ClassVar[re.Pattern[str]]
    """What a file of this target has somewhere."""
    comment: ClassVar[str] = "#"
    """What begins a comment in the file; empty where comments are not known to be allowed."""
    symmetric: ClassVar[bool] = False
    """Whether M can only be symmetric."""
    has_torquers: ClassVar[bool] = False
    instances: ClassVar[int] = 1
    """How many magnetometers the software knows."""

    @abstractmethod
    def numbers(self, held: OffsetFirst, instance: int) -> tuple[Number, ...]:
        """The numbers of the file, rounded to its type; instance counts from 1."""

    def lay_out(self, numbers: Sequence[Number], heading: Sequence[str], instance: int) -> str:
        """The whole file but its first line, which says who wrote it; by default NAME,VALUE on each line."""
        return "\n".join([*(f"# {line}" for line in heading), *(f"{n.name},{n.text}" for n in numbers), ""])

    def is_of(self, text: str) -> bool:
        """Whether a file looks like one of this target."""
        return self.looks.search(text) is not None

    @abstractmethod
    def read(self, text: str, instance: int, where: str) -> OffsetFirst:
        """The calibration in a file. Raises BadInput naming what is missing."""

    def says(self, held: OffsetFirst) -> str:
        """The formula for this calibration."""
        return self.formula

    def beyond(self, held: OffsetFirst) -> list[str]:
        """What the software would refuse, in sentences."""
        return []

    def in_use(self, held: OffsetFirst) -> OffsetFirst:
        """What the software makes of the file, where it passes some of it over."""
        return held

    def notes(self, held: OffsetFirst) -> list[str]:
        """What the person who loads the file should know, in sentences."""
        return []


def float32(value: float) -> str:
    """The fewest digits that give the same single-precision number back."""
    return str(np.format_float_positional(np.float32(value), unique=True, trim="0"))


def scales_beyond(scale: FloatArray, allowed: tuple[float, float]) -> list[str]:
    """Scales that are not within the allowed ones, in a sentence."""
    if (scale >= allowed[0]).all() and (scale <= allowed[1]).all():
        return []
    return [f"a scale of {scale.round(3).tolist()} is not within {allowed[0]} to {allowed[1]:.0f}"]


def as_float32(text: str, where: str) -> float:
    """A number of single precision. Raises BadInput for none."""
    try:
        value = float(np.float32(text))
    except ValueError:
        value = np.nan
    if not np.isfinite(value):
        raise BadInput(f"{text!r} is no number", where=where, wanted="a finite number")
    return value


def named_values(text: str, pattern: re.Pattern[str], wanted: Iterable[str], where: str) -> dict[str, float]:
    """The wanted names in a file with one on a line; `pattern` has the groups name and value.

    Raises BadInput for a name that is missing, stands twice, or has no number.
    """
    names = list(wanted)
    found: dict[str, float] = {}
    for match in filter(None, map(pattern.match, text.splitlines())):
        name = match["name"]
        if name in found:
            raise BadInput(f"{name} stands twice", where=where, wanted="one value for each name")
        if name in names:
            found[name] = as_float32(match["value"], f"{where}: {name}")
    missing = [name for name in names if name not in found]
    if missing:
        raise BadInput(f"{', '.join(missing)} not in the file", where=where, wanted=", ".join(names))
    return found
