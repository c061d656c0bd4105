"""PX4: CAL_MAGn_XOFF, _XSCALE and _XODIAG, in a parameter file of QGroundControl.

The correction is that of `calibration::Magnetometer::Correct` in the firmware: the offset is subtracted, then the symmetric
matrix acts; the rotation CAL_MAGn_ROT is left as it is. Scales of 0.1 to 3 are allowed (src/modules/sensors/module.yaml).
`set_offset`, `set_scale` and `set_offdiagonal` take up a group of three only where it differs by more than 0.01 from what
is in use, which at start is no offset and M = 1. A parameter file has vehicle, component, name, value and type, with tabs
between them, and comments behind # (mavros `param.py`, `QGroundControlParam`); 9 is MAVLink's type of a float32.
"""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np

from fluxtwin.calib.common.conventions import OffsetFirst, six_of, symmetric
from fluxtwin.calib.onboard.target import NT_PER_GAUSS, Number, Target, float32, named_values, scales_beyond

_LINE = re.compile(r"\s*(?:\d+\s+\d+\s+)?(?P<name>[A-Z0-9_]+)[\s,]+(?P<value>[^\s,#]+)")
_SCALE = (0.1, 3.0)
_TAKEN_UP = 0.01  # Gauss, or a pure number


class Px4(Target):
    """The parameters of one of four magnetometers."""

    name = "px4"
    what = "parameters of PX4"
    formula = (
        "B = M (m - OFF), M = [[XSCALE, XODIAG, YODIAG], [XODIAG, YSCALE, ZODIAG], [YODIAG, ZODIAG, ZSCALE]]; "
        "m, B, OFF in Gauss"
    )
    source = "PX4-Autopilot, src/lib/sensor_calibration/Magnetometer.hpp, Correct"
    ending = ".params"
    looks = re.compile(r"\bCAL_MAG\d_XOFF\b")
    symmetric = True
    instances = 4

    def numbers(self, held: OffsetFirst, instance: int) -> tuple[Number, ...]:
        units = ["Gauss"] * 3 + ["1"] * 6
        values = [*(held.o_nT / NT_PER_GAUSS), *six_of(held.M)]
        return tuple(Number(*of) for of in zip(_names(instance), map(float32, values), units, strict=True))

    def lay_out(self, numbers: Sequence[Number], heading: Sequence[str], instance: int) -> str:
        head = [*(f"# {line}" for line in heading), "# Vehicle-Id Component-Id Name Value Type"]
        return "\n".join([*head, *(f"1\t1\t{n.name}\t{n.text}\t9" for n in numbers), ""])

    def read(self, text: str, instance: int, where: str) -> OffsetFirst:
        names = _names(instance)
        found = named_values(text, _LINE, names, where)
        M = symmetric([found[name] for name in names[3:]])
        return OffsetFirst(M, NT_PER_GAUSS * np.array([found[name] for name in names[:3]]))

    def beyond(self, held: OffsetFirst) -> list[str]:
        return scales_beyond(np.diag(held.M), _SCALE)

    def in_use(self, held: OffsetFirst) -> OffsetFirst:
        """After a start with these parameters, without the groups that are too small to be taken up."""
        six = np.array(six_of(held.M))
        scale, off = _taken_up(six[:3], np.ones(3)), _taken_up(six[3:], np.zeros(3))
        return OffsetFirst(symmetric([*scale, *off]), NT_PER_GAUSS * _taken_up(held.o_nT / NT_PER_GAUSS, np.zeros(3)))

    def notes(self, held: OffsetFirst) -> list[str]:
        six, used = np.array(six_of(held.M)), np.array(six_of(self.in_use(held).M))
        groups = {
            "OFF": (held.o_nT, self.in_use(held).o_nT),
            "SCALE": (six[:3], used[:3]),
            "ODIAG": (six[3:], used[3:]),
        }
        passed_over = [name for name, (ours, theirs) in groups.items() if not np.array_equal(ours, theirs)]
        if not passed_over:
            return []
        return [
            f"PX4 ignores {' and '.join(passed_over)}: at start it loads a group of three numbers only if together "
            f"they differ from no calibration by more than {_TAKEN_UP} (Gauss, or a pure number). The added error "
            "includes this"
        ]


def _taken_up(ours: np.ndarray, at_start: np.ndarray) -> np.ndarray:
    return ours if float(np.linalg.norm(ours - at_start)) > _TAKEN_UP else at_start


def _names(instance: int) -> list[str]:
    return [f"CAL_MAG{instance - 1}_{axis}{kind}" for kind in ("OFF", "SCALE", "ODIAG") for axis in "XYZ"]
