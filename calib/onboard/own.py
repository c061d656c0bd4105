"""Files for software of one's own: a C header in float32, JSON and MATLAB in float64, all with M, o and T as they are.

MATLAB's `magcal` of the Navigation and Sensor Fusion toolboxes corrects rows, C = (D - b) A (mathworks.com, `magcal`); the
script ends with that A and b.
"""

from __future__ import annotations

import importlib.metadata
import json
import re
from collections.abc import Sequence

import numpy as np

from fluxtwin.calib.common.conventions import OffsetFirst
from fluxtwin.calib.onboard.target import Number, Target, as_float32, float32
from fluxtwin.sim.base.errors import BadInput
from fluxtwin.sim.base.seals import sealed_json, unsealed_json
from fluxtwin.sim.base.types import FloatArray

_FORMULA = "B = M (m - o); m, B, o in nT"
_WITH_T = "B = M (m - o) + T D; m, B, o in nT, D in A m2, T in nT/(A m2)"
_PREFIX = "FLUXTWIN_MAG_"


class _Own(Target):
    source = "stated in the file"
    formula = _FORMULA
    has_torquers = True

    def says(self, held: OffsetFirst) -> str:
        return _FORMULA if held.T_nT_per_Am2 is None else _WITH_T

    def _text(self, value: float) -> str:
        return repr(value)

    def numbers(self, held: OffsetFirst, instance: int) -> tuple[Number, ...]:
        of_T = [] if held.T_nT_per_Am2 is None else [("T", held.T_nT_per_Am2, "nT/(A m2)")]
        return tuple(
            Number(name + "".join(f"[{i}]" for i in at), self._text(float(array[at])), unit)
            for name, array, unit in [("M", held.M, "1"), ("o", held.o_nT, "nT"), *of_T]
            for at in np.ndindex(array.shape)
        )


class CHeader(_Own):
    """Constants in float32, ready for a loop over three axes."""

    name = "c-header"
    what = "a C header"
    ending = ".h"
    looks = re.compile(f"{_PREFIX}M")
    comment = "//"

    def _text(self, value: float) -> str:
        return float32(value)

    def lay_out(self, numbers: Sequence[Number], heading: Sequence[str], instance: int) -> str:
        lines = [*(f"// {line}" for line in heading), "#ifndef FLUXTWIN_MAG_H", "#define FLUXTWIN_MAG_H", ""]
        for name, rows in _arrays(numbers).items():
            size = f"[{len(rows)}]" + (f"[{len(rows[0])}]" if len(rows[0]) > 1 else "")
            inner = [", ".join(f"{text}f" for text in row) for row in rows]
            inside = ", ".join(row if len(rows[0]) == 1 else f"{{ {row} }}" for row in inner)
            lines.append(f"static const float {_PREFIX}{name}{size} = {{ {inside} }};")
        return "\n".join([*lines, "", "#endif", ""])

    def read(self, text: str, instance: int, where: str) -> OffsetFirst:
        found = {}
        for match in re.finditer(rf"{_PREFIX}(\w+)(?:\[\d\])+\s*=\s*\{{(.*?)\}};", text, re.DOTALL):
            words = re.findall(r"[-+.\deE]+(?=f\b)", match[2])
            found[match[1]] = np.array([as_float32(word, f"{where}: {match[1]}") for word in words])
        return _held(found, where)


class Json(_Own):
    """One JSON object."""

    name = "json"
    what = "JSON"
    ending = ".json"
    looks = re.compile(r'\A\s*\{(?=.*"formula")(?=.*"M")', re.DOTALL)
    comment = ""

    def lay_out(self, numbers: Sequence[Number], heading: Sequence[str], instance: int) -> str:
        arrays = {
            name: [[float(x) for x in row] if len(row) > 1 else float(row[0]) for row in rows]
            for name, rows in _arrays(numbers).items()
        }
        units = {number.name.split("[")[0]: number.unit for number in numbers}
        content = {
            "fluxtwin": importlib.metadata.version("fluxtwin"),
            "formula": heading[-1],
            "about": heading[0],
            **arrays,
            "units": units,
        }
        return json.dumps(sealed_json(content), indent=2, ensure_ascii=False, allow_nan=False) + "\n"

    def read(self, text: str, instance: int, where: str) -> OffsetFirst:
        try:
            content = unsealed_json(text, where=where, wanted="the JSON of fluxtwin export")
            names: list[str] = [name for name in ("M", "o", "T") if name in content]
            found = {name: np.array(content[name], dtype=np.float64) for name in names}
        except BadInput:
            raise
        except (ValueError, TypeError):
            raise BadInput("is not the JSON of fluxtwin export", where=where, wanted="M, o and T as numbers") from None
        return _held(found, where)


class Matlab(_Own):
    """A script that sets M, o and T, and A and b of `magcal`."""

    name = "matlab"
    what = "a MATLAB script"
    ending = ".m"
    looks = re.compile(r"^M = \[", re.MULTILINE)
    comment = "%"

    def lay_out(self, numbers: Sequence[Number], heading: Sequence[str], instance: int) -> str:
        lines = [f"% {line}" for line in heading]
        for name, rows in _arrays(numbers).items():
            lines.append(f"{name} = [{'; '.join(' '.join(row) for row in rows)}];")
        lines += ["% As magcal has it, for readings in the rows of D: C = (D - b) * A", "A = M';", "b = o';", ""]
        return "\n".join(lines)

    def read(self, text: str, instance: int, where: str) -> OffsetFirst:
        found = {}
        for match in re.finditer(r"^(M|o|T) = \[(.*?)\];", text, re.MULTILINE):
            try:
                found[match[1]] = np.array([float(word) for word in re.split(r"[\s;,]+", match[2].strip())])
            except ValueError:
                raise BadInput("is no array of numbers", where=f"{where}: {match[1]}", wanted="numbers") from None
        return _held(found, where)


def _arrays(numbers: Sequence[Number]) -> dict[str, list[list[str]]]:
    """The texts of M, o and T, row by row."""
    found: dict[str, list[str]] = {}
    for number in numbers:
        found.setdefault(number.name.partition("[")[0], []).append(number.text)
    columns = {"M": 3, "o": 1, "T": 3}
    return {
        name: [texts[k : k + columns[name]] for k in range(0, len(texts), columns[name])]
        for name, texts in found.items()
    }


def _held(found: dict[str, FloatArray], where: str) -> OffsetFirst:
    for name, size in (("M", 9), ("o", 3), ("T", 9)):
        if name not in found and name != "T":
            raise BadInput(f"{name} is missing", where=where, wanted="M (3 x 3) and o (3)")
        if name in found and (found[name].size != size or not np.isfinite(found[name]).all()):
            raise BadInput(f"{name} is not {size} finite numbers", where=where, wanted=f"{size} numbers")
    T = found["T"].reshape(3, 3) if "T" in found else None
    return OffsetFirst(found["M"].reshape(3, 3), found["o"].reshape(3), T)
