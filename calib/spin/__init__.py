"""Calibration of a spinning spacecraft from the field, the orbit and sun pulses."""

from fluxtwin.sim.base.doors import door

__getattr__, __dir__ = door(
    __name__,
    calibrate="calibrate_spin",
)
