"""Calibrations as flight software holds them: written for it, and read back. A target is a file and in `TARGETS`."""

from fluxtwin.sim.base.doors import door

__getattr__, __dir__ = door(
    __name__,
    export="Export export_calibration import_calibration TARGETS",
)
