"""The verbs between a calibration and the flight software that uses it."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from fluxtwin.verbs import as_calibration

if TYPE_CHECKING:
    from fluxtwin.calib.common.records import Calibration
    from fluxtwin.calib.onboard.export import Export


def export(
    calibration: Calibration | Path | str,
    to: str,
    out: Path | str | None = None,
    *,
    instance: int = 1,
    force: bool = False,
) -> Export:
    """The calibration as flight software holds it: its numbers, the error that their type adds, the text of the file.

    to: ardupilot, px4, gomspace, c-header, json or matlab. out: where it is written, if anywhere; instance: which of the
    software's magnetometers, from 1. Raises BadInput, unless force, for what the software cannot hold or would refuse.
    """
    from fluxtwin.calib.onboard.export import export_calibration
    from fluxtwin.calib.onboard.targets import find_target
    from fluxtwin.outputs import Kind, claim

    target = find_target(to)
    read = calibration if isinstance(calibration, Path | str) else None
    claim({"--out": (out, Kind(target.what, (target.ending,)))}, [read], force=force)
    made = export_calibration(as_calibration(calibration), to, instance=instance, force=force)
    if out is not None:
        made.write(out)
    return made


def import_calibration(path: Path | str, *, instance: int = 1) -> Calibration:
    """The calibration in a file of flight software (as `export` writes them), or in a calibration file.

    Raises BadInput for a file that holds none.
    """
    from fluxtwin.calib.onboard.export import import_calibration as imported

    return imported(path, instance=instance)
