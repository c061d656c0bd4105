"""CubeADCS: the in-orbit calibration of a magnetometer, telecommands 63 (the first) and 66 (the second).

The layout is public (flight software that sends them): twelve int16 in thousandths, offsets 1 to 3, then S11 S22 S33 S12 S13
S21 S23 S31 S32. What no public source says is the unit of the offset, its sign, and whether it acts before or after the
matrix; so those come from whoever holds the maker's manual, and stand in the file.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np

from fluxtwin.calib.common.conventions import OffsetFirst
from fluxtwin.calib.onboard.target import Number, Target, named_values
from fluxtwin.sim.base.errors import BadInput
from fluxtwin.sim.earth.constants import NT_PER_MG

FORMS = ("S(m-o)", "S(m+o)", "Sm-o", "Sm+o")
UNITS_NT = {"uT": 1e3, "mG": NT_PER_MG}
STATED = tuple(f"cubeadcs:{form},{unit}" for form, unit in product(FORMS, UNITS_NT))
"""Every way to state what the manual says."""
_PER_UNIT = 1000
_LARGEST = np.iinfo(np.int16).max
_PLACES = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 0), (1, 2), (2, 0), (2, 1))
_NAMES = (*(f"offset_{axis}" for axis in "123"), *(f"S{row + 1}{column + 1}" for row, column in _PLACES))
_TELECOMMANDS = {1: 63, 2: 66}
_FIRST = re.compile(r"^# (cubeadcs:\S+) ", re.MULTILINE)
_LINE = re.compile(r"\s*(?P<name>\w+),(?P<value>-?\d+)\s*$")


@dataclass(frozen=True)
class CubeAdcs(Target):
    """The telecommand of one of two magnetometers, under a stated formula."""

    form: str
    unit: str

    name = "cubeadcs"
    what = "a CubeADCS telecommand"
    source = "layout: flight software that sends telecommands 63 and 66; formula and unit: as you stated them"
    ending = ".csv"
    instances = 2

    @property
    def formula(self) -> str:  # type: ignore[override]
        """From reading m to field B."""
        return f"B = {self.form}; m, B, o in {self.unit}; offset_ and S in thousandths, int16"

    def numbers(self, held: OffsetFirst, instance: int) -> tuple[Number, ...]:
        offset = held.o_nT if "(" in self.form else held.M @ held.o_nT
        values = [*(self._sign * offset / UNITS_NT[self.unit]), *(held.M[place] for place in _PLACES)]
        units = [f"0.001 {self.unit}"] * 3 + ["0.001"] * 9
        return tuple(
            Number(name, f"{round(_PER_UNIT * float(value))}", unit)
            for name, value, unit in zip(_NAMES, values, units, strict=True)
        )

    def lay_out(self, numbers: Sequence[Number], heading: Sequence[str], instance: int) -> str:
        stated = f"{self._stated} telecommand {_TELECOMMANDS[instance]}, in the order of the telecommand"
        return super().lay_out(numbers, (stated, *heading), instance)

    def is_of(self, text: str) -> bool:
        found = _FIRST.search(text)
        return found is not None and found[1] == self._stated

    def read(self, text: str, instance: int, where: str) -> OffsetFirst:
        found = named_values(text, _LINE, _NAMES, where)
        values = np.array([found[name] for name in _NAMES]) / _PER_UNIT
        M = np.empty((3, 3))
        for place, value in zip(_PLACES, values[3:], strict=True):
            M[place] = value
        offset = self._sign * UNITS_NT[self.unit] * values[:3]
        return OffsetFirst(M, offset if "(" in self.form else np.asarray(np.linalg.solve(M, offset), dtype=np.float64))

    def beyond(self, held: OffsetFirst) -> list[str]:
        largest = _LARGEST / _PER_UNIT
        over = [n.name for n in self.numbers(held, 1) if abs(int(n.text)) > _LARGEST]
        return [f"{', '.join(over)} beyond {largest} (int16 in thousandths, {self.unit})"] if over else []

    @property
    def _stated(self) -> str:
        return f"{self.name}:{self.form},{self.unit}"

    @property
    def _sign(self) -> float:
        return 1.0 if "-" in self.form else -1.0


def stated(to: str) -> CubeAdcs:
    """The target that `cubeadcs:FORM,UNIT` states. Raises BadInput where form or unit is not stated."""
    if to not in STATED:
        raise BadInput(
            "no public source says in what unit CubeADCS holds the offset, whether it is added or subtracted, and "
            "whether before or after the matrix",
            where=f"--to {to}",
            wanted=f"what the maker's manual says, cubeadcs:FORM,UNIT with FORM one of {', '.join(FORMS)} and UNIT one of "
            f"{', '.join(UNITS_NT)}: --to 'cubeadcs:S(m-o),uT'",
        )
    return CubeAdcs(*to.removeprefix("cubeadcs:").split(","))
