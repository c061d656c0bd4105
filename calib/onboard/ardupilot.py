"""ArduPilot: COMPASS_OFS, COMPASS_DIA and COMPASS_ODI, in a parameter file.

The correction is that of `AP_Compass_Backend::correct_field` in the firmware: the offset is added, COMPASS_SCALE
multiplies where it is within 1/1.5 to 1.5, then the symmetric matrix of diagonals and off-diagonals. What is refused here
is what the firmware's own calibrator does not accept (`CompassCalibrator::fit_acceptable`; COMPASS_OFFS_MAX is 1800 mGauss
unless it was changed). A parameter file has NAME,VALUE on each line and comments behind # (mavros `param.py`,
`MissionPlannerParam`).
"""

from __future__ import annotations

import re

import numpy as np

from fluxtwin.calib.common.conventions import OffsetFirst, six_of, symmetric
from fluxtwin.calib.onboard.target import Number, Target, as_float32, float32, named_values
from fluxtwin.sim.earth.constants import NT_PER_MG

_LINE = re.compile(r"\s*(?P<name>[A-Z0-9_]+)\s*[,\s]\s*(?P<value>[^\s,#]+)")
_OFFSETS_MAX_MG = 1800.0
_DIAGONAL = (0.2, 5.0)
_OFF_DIAGONAL = 1.0
_SCALE = (1.0 / 1.5, 1.5)


class ArduPilot(Target):
    """The parameters of one of three compasses."""

    name = "ardupilot"
    what = "parameters of ArduPilot"
    formula = (
        "B = M (m + OFS), M = [[DIA_X, ODI_X, ODI_Y], [ODI_X, DIA_Y, ODI_Z], [ODI_Y, ODI_Z, DIA_Z]]; "
        "m, B, OFS in mGauss"
    )
    source = "ArduPilot, libraries/AP_Compass/AP_Compass_Backend.cpp, correct_field"
    ending = ".param"
    looks = re.compile(r"^\s*COMPASS_OFS\d?_X\b", re.MULTILINE)
    symmetric = True
    instances = 3

    def numbers(self, held: OffsetFirst, instance: int) -> tuple[Number, ...]:
        units = ["mGauss"] * 3 + ["1"] * 7
        values = [*(-held.o_nT / NT_PER_MG), *six_of(held.M), 1.0]
        names = [*_names(instance), _scale(instance)]
        return tuple(Number(*of) for of in zip(names, map(float32, values), units, strict=True))

    def read(self, text: str, instance: int, where: str) -> OffsetFirst:
        names = _names(instance)
        found = named_values(text, _LINE, names, where)
        given = [
            match["value"]
            for match in map(_LINE.match, text.splitlines())
            if match and match["name"] == _scale(instance)
        ]
        scale = as_float32(given[0], f"{where}: {_scale(instance)}") if given else 0.0
        M = symmetric([found[name] for name in names[3:]])
        if not np.diag(M).any():
            M = M + np.eye(3)  # the firmware takes diagonals of zero for one
        held = M * (scale if _SCALE[0] <= scale <= _SCALE[1] else 1.0)
        return OffsetFirst(held, -NT_PER_MG * np.array([found[name] for name in names[:3]]))

    def beyond(self, held: OffsetFirst) -> list[str]:
        largest = float(np.abs(held.o_nT).max() / NT_PER_MG)
        diagonal, off = np.diag(held.M), np.abs(held.M[~np.eye(3, dtype=bool)]).max()
        found = []
        if largest >= _OFFSETS_MAX_MG:
            found.append(f"an offset of {largest:.0f} mGauss is not below COMPASS_OFFS_MAX ({_OFFSETS_MAX_MG:.0f})")
        if not (diagonal > _DIAGONAL[0]).all() or not (diagonal < _DIAGONAL[1]).all():
            found.append(
                f"a diagonal of {diagonal.round(3).tolist()} is not within {_DIAGONAL[0]} to {_DIAGONAL[1]:.0f}"
            )
        if off >= _OFF_DIAGONAL:
            found.append(f"an off-diagonal of {off:.2f} is not below {_OFF_DIAGONAL:.0f}")
        return found


def _names(instance: int) -> list[str]:
    number = "" if instance == 1 else str(instance)
    return [f"COMPASS_{kind}{number}_{axis}" for kind in ("OFS", "DIA", "ODI") for axis in "XYZ"]


def _scale(instance: int) -> str:
    return "COMPASS_SCALE" + ("" if instance == 1 else str(instance))
