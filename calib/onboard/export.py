"""From a calibration to the file of a target and back, with the error that the way adds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from fluxtwin.calib.common.conventions import (
    OffsetFirst,
    correction_from_offset_first,
    offset_first_from_correction,
    polar_split,
)
from fluxtwin.calib.common.digits import plain
from fluxtwin.calib.common.direction import ROWS, even_directions
from fluxtwin.calib.common.records import Calibration
from fluxtwin.calib.onboard import cubeadcs
from fluxtwin.calib.onboard.ardupilot import ArduPilot
from fluxtwin.calib.onboard.gomspace import GomSpace
from fluxtwin.calib.onboard.own import CHeader, Json, Matlab
from fluxtwin.calib.onboard.px4 import Px4
from fluxtwin.calib.onboard.target import Number, Target
from fluxtwin.sim.base.errors import BadInput
from fluxtwin.sim.base.limits import text_of
from fluxtwin.sim.base.seals import require_sealed
from fluxtwin.sim.base.shown import Shown
from fluxtwin.sim.base.types import FloatArray
from fluxtwin.sim.earth import epoch
from fluxtwin.sim.earth.frames import angle_between

TARGETS: dict[str, Target] = {one.name: one for one in (ArduPilot(), Px4(), GomSpace(), CHeader(), Json(), Matlab())}
TARGETS |= {name: cubeadcs.stated(name) for name in cubeadcs.STATED}
NAMES = tuple(dict.fromkeys(name.partition(":")[0] for name in TARGETS))
FIELDS_NT = (20e3, 60e3)
"""Field sizes in low orbit, over which the added error is given."""
WORST_FORM_DEG = 1.0
"""A target that turns the field by more, because M is symmetric there, is refused."""
_SEEN_NT = 1e-6  # less is the arithmetic of this computer


@dataclass(frozen=True)
class AddedError:
    """The largest error over fields of `FIELDS_NT` in any direction."""

    largest_nT: float
    largest_deg: float


@dataclass(frozen=True)
class Export(Shown):
    """A calibration in the form of one target."""

    to: str
    formula: str
    source: str
    numbers: tuple[Number, ...]
    """As they are in the file."""
    form: AddedError
    """What the target's form cannot hold: a matrix that is not symmetric."""
    rounding: AddedError
    """What its number type adds."""
    passed_over: AddedError
    """What the software adds by passing over numbers that seem small to it."""
    notes: tuple[str, ...]
    """What was left out or waived, and what the person who loads it should know."""
    text: str
    """The file."""
    comment: str
    """What begins a comment in it; empty for none."""

    @property
    def lines(self) -> tuple[str, ...]:
        """The added error in sentences."""
        low, high = (f"{size / 1e3:.0f}" for size in FIELDS_NT)
        said = [f"added error, the largest over fields of {low} to {high} uT in any direction:"]
        for why, error in (
            ("the rounding of its numbers", self.rounding),
            ("a symmetric M, whose rotation is lost", self.form),
            ("numbers that it ignores", self.passed_over),
        ):
            if error is self.rounding or error.largest_nT > _SEEN_NT:
                said.append(f"  {plain(error.largest_nT, 2)} nT, {plain(error.largest_deg, 2)} deg by {why}")
        return tuple(said)

    def to_dict(self) -> dict[str, Any]:
        """Plain numbers and text for JSON."""
        numbers = [number._asdict() for number in self.numbers]
        added = {name: asdict(getattr(self, name)) for name in ("form", "rounding", "passed_over")}
        return {
            **{name: getattr(self, name) for name in ("to", "formula", "source")},
            "numbers": numbers,
            "added_error": {**added, "fields_nT": list(FIELDS_NT)},
            "notes": list(self.notes),
        }

    def write(self, path: Path | str) -> Path:
        """The file, whole or not at all."""
        from fluxtwin.sim.base import files

        if not self.comment:
            return files.write_text(path, self.text)
        return files.write_toml(path, self.text, comment=self.comment)


def find_target(name: str) -> Target:
    """The target of that name. Raises BadInput for none."""
    if isinstance(name, str) and name in TARGETS:
        return TARGETS[name]
    if isinstance(name, str) and name.partition(":")[0] == cubeadcs.CubeAdcs.name:
        return cubeadcs.stated(name)
    raise BadInput(f"{name!r} is no target", where="--to", wanted=" or ".join(NAMES))


def export_calibration(calibration: Calibration, to: str, *, instance: int = 1, force: bool = False) -> Export:
    """The calibration for a target of `TARGETS`; instance: which of its magnetometers, from 1.

    Raises BadInput for an unknown target, and, unless force, for what the target has no place for or would refuse.
    """
    target = find_target(to)
    require_instance(target, instance)
    wholly = offset_first_from_correction(calibration.correction)
    # M = O P without its rotation O where only a symmetric P fits: the size of the field stays exact.
    M: FloatArray = polar_split(wholly.M)[1] if target.symmetric else wholly.M
    formed = OffsetFirst(M, wholly.o_nT, wholly.T_nT_per_Am2 if target.has_torquers else None)
    refused = [*_left_out(calibration, target), *target.beyond(formed)]
    form = added_error(wholly, formed)
    if form.largest_deg > WORST_FORM_DEG:
        refused.append(
            f"M is held symmetric: a rotation of up to {form.largest_deg:.2g} deg would be lost; put it into the mounting "
            "of the sensor"
        )
    if refused and not force:
        raise BadInput("; ".join(refused), where=f"--to {to}", wanted="another target; --force writes it anyway")
    numbers = target.numbers(formed, instance)
    text = target.lay_out(numbers, _heading(calibration, target.says(formed)), instance)
    held = target.read(text, instance, to)
    return Export(
        to=to,
        formula=target.says(formed),
        source=target.source,
        numbers=numbers,
        form=form,
        rounding=added_error(formed, held),
        passed_over=added_error(held, target.in_use(held)),
        notes=(*refused, *target.notes(held)),
        text=text,
        comment=target.comment,
    )


def import_calibration(path: Path | str, *, instance: int = 1, magnetometer: int | None = None) -> Calibration:
    """The calibration in a file of any target, or in a calibration file.

    magnetometer: of a record; in place of an instance, for software that may hold only one. The calibration has no
    covariance and no span. Raises BadInput for a file that no target knows, or that lacks a number.
    """
    path = Path(path)
    text = text_of(path, wanted="a calibration")
    require_sealed(text, where=str(path))
    if path.suffix.lower() == ".toml":
        return Calibration.from_toml(path)
    target = next((one for one in TARGETS.values() if one.is_of(text)), None)
    if target is None:
        raise BadInput("holds no calibration that is known", where=str(path), wanted=f"a file of {', '.join(NAMES)}")
    if magnetometer is not None:
        instance = min(magnetometer, target.instances)
    require_instance(target, instance)
    correction = correction_from_offset_first(target.read(text, instance, str(path)))
    method = f"read from {target.what}"
    return Calibration(correction.S, correction.b_nT, correction.T_nT_per_Am2, method=method)


def added_error(exact: OffsetFirst, held: OffsetFirst) -> AddedError:
    """The largest difference of corrected readings, over `FIELDS_NT` and all directions."""
    worst_nT, worst_rad = 0.0, 0.0
    for size in FIELDS_NT:
        field_nT = size * even_directions(ROWS)
        theirs = held.apply(exact.undo(field_nT))
        worst_nT = max(worst_nT, float(np.linalg.norm(theirs - field_nT, axis=1).max()))
        worst_rad = max(worst_rad, float(angle_between(theirs, field_nT).max()))
    return AddedError(worst_nT, float(np.degrees(worst_rad)))


def require_instance(target: Target, instance: int) -> None:
    """Raises BadInput for a magnetometer that the target does not know."""
    if not 1 <= instance <= target.instances:
        wanted = "1" if target.instances == 1 else f"1 to {target.instances}"
        raise BadInput(f"{instance}", where="--instance", wanted=f"{wanted} for {target.name}")


def _left_out(calibration: Calibration, target: Target) -> list[str]:
    T = calibration.T_nT_per_Am2
    found = []
    if T is not None and T.any() and not target.has_torquers:
        found.append(f"{target.what} have no place for the torquers' T")
    if calibration.telemetry_bias:
        found.append(f"no place for the fields that follow {', '.join(calibration.telemetry_bias)}")
    if calibration.residual_to:
        found.append(f"it acts on readings that {calibration.residual_to} had corrected, not on those of the sensor")
    return found


def _heading(calibration: Calibration, formula: str) -> Sequence[str]:
    whose = calibration.spacecraft or "a magnetometer"
    span = "" if calibration.span is None else f", {epoch.iso(calibration.span[0])} to {epoch.iso(calibration.span[1])}"
    return (
        f"Calibration {calibration.digest[:12]} of {' '.join(whose.split())}{span}; reading m, field B in body axes",
        formula,
    )
