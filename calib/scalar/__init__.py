"""Calibration from the size of the field alone: no attitude is needed."""

from fluxtwin.sim.base.doors import door

__getattr__, __dir__ = door(
    __name__,
    calibrate="calibrate_scalar",
)
