"""The verbs between a calibration and the flight software that uses it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fluxtwin.verbs import as_calibration

if TYPE_CHECKING:
    from fluxtwin.calib.common.fit import Fit
    from fluxtwin.calib.common.records import Calibration, Onboard
    from fluxtwin.calib.onboard.export import Export
    from fluxtwin.sim.earth.field_models import FieldModel
    from fluxtwin.sim.telemetry.record import Telemetry


def export(
    calibration: Calibration | Path | str,
    to: str,
    out: Path | str | None = None,
    *,
    instance: int = 1,
    force: bool = False,
) -> Export:
    """The calibration as flight software holds it: its numbers, the error that their type adds, the text of the file.

    to: ardupilot, px4, gomspace, c-header, json, matlab or cubeadcs:FORM,UNIT.
    out: where it is written, if anywhere.
    instance: which of the software's magnetometers, from 1.
    force: write also what the software cannot hold or would refuse, for which BadInput is raised otherwise.
    """
    from fluxtwin.calib.onboard.export import export_calibration, find_target
    from fluxtwin.outputs import Kind, claim

    target = find_target(to)
    read = calibration if isinstance(calibration, Path | str) else None
    claim({"--out": (out, Kind(target.what, (target.ending,)))}, [read], force=force)
    made = export_calibration(as_calibration(calibration), to, instance=instance, force=force)
    if out is not None:
        made.write(out)
    return made


def import_calibration(path: Path | str, *, instance: int = 1) -> Calibration:
    """The calibration in a file of flight software, or in a calibration file.

    path: of a file as `export` writes them. instance: which of the software's magnetometers, from 1.

    Raises BadInput for a file that holds none.
    """
    from fluxtwin.calib.onboard.export import import_calibration as imported

    return imported(path, instance=instance)


def as_onboard(onboard: Calibration | Path | str, magnetometer: int = 1) -> Onboard:
    """What was applied on board to the readings of a magnetometer, read first where a file is named."""
    from fluxtwin.calib.common.onboard import onboard_of
    from fluxtwin.calib.onboard.export import import_calibration as imported

    if isinstance(onboard, Path | str):
        return onboard_of(imported(onboard, magnetometer=magnetometer), Path(onboard).name)
    known = as_calibration(onboard)
    return onboard_of(known, known.method or "calibration")


def calibrate_undone(
    records: Sequence[Telemetry], onboard: Calibration | Path | str, model: FieldModel, **options: Any
) -> Fit:
    """`fluxtwin.calibrate` of the sensor's own readings: what was applied on board is undone, and named in the answer.

    Raises BadInput where |B| says that it was not applied to these readings.
    """
    from fluxtwin.calib.checks.unit import NOT_APPLIED, check_calibrated
    from fluxtwin.calib.common.digits import plain
    from fluxtwin.calib.common.onboard import composed, undone
    from fluxtwin.calib.methods import calibrate_by
    from fluxtwin.sim.base.errors import BadInput

    before = as_onboard(onboard, records[0].magnetometer)
    seen = [found.text for one in records for found in check_calibrated(one, model, one.has_reading, before)]
    for text in seen:
        if NOT_APPLIED in text:
            wanted = "the calibration on board, or calibrate without --onboard"
            raise BadInput(text.rpartition("; ")[0], where=f"--onboard {before.name}", wanted=wanted)
    fit = calibrate_by([undone(record, before) for record in records], model, **options)
    left = composed(fit.calibration, before)
    b = ", ".join(plain(float(x)) for x in left.b_nT)
    said = (
        f"the calibration on board ({before.name}) was undone: S, b and T act on the sensor's own readings, and so "
        f"fluxtwin export writes them. The readings as they came down still had b = ({b}) nT and elements of S up to "
        f"{plain(float(abs(left.S).max()), 2)}"
    )
    known = replace(fit.calibration, onboard=before)
    return replace(fit, calibration=known, messages=(said, *dict.fromkeys(seen), *fit.messages))
